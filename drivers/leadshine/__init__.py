"""Leadshine PR drives (CS2RS, EM2RS, iEM-RS, DM556RS; CL57RS) as a linear stage on Modbus RTU."""

from drivers.leadshine.axis import LeadshineStage
from drivers.leadshine.registers import HomingMethod, HomingSense, Model
from drivers.leadshine.settings import Homing, StageSettings

__all__ = [
    "Homing",
    "HomingMethod",
    "HomingSense",
    "LeadshineStage",
    "Model",
    "StageSettings",
]
