"""A Leadshine stepper drive on RS-485, commanded by position registers ("PR" mode)."""

from sim.leadshine.drive import LeadshineDrive
from sim.leadshine.registers import Alarm, Family
from sim.leadshine.settings import LeadshineSettings

__all__ = ["Alarm", "Family", "LeadshineDrive", "LeadshineSettings"]
