"""Oriental Motor AZ drives (AZD-KD, -CD) on Modbus RTU: a turntable or a linear stage."""

from drivers.oriental.axis import AzAxis
from drivers.oriental.settings import Settings, Turning

__all__ = ["AzAxis", "Settings", "Turning"]
