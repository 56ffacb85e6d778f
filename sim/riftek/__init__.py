"""A RIFTEK RF62X profile sensor on its two wires: HTTP for parameters, profiles on UDP."""

from sim.riftek.sensor import RfSensor, RfSettings
from sim.riftek.web import HttpSession

__all__ = ["HttpSession", "RfSensor", "RfSettings"]
