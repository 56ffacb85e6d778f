"""A Baumer OX200 profile sensor on its two wires: registers on Modbus TCP, profiles on UDP."""

from sim.baumer_ox.frames import Encoding
from sim.baumer_ox.reading import Quality
from sim.baumer_ox.sensor import OxSensor, OxSettings

__all__ = ["Encoding", "OxSensor", "OxSettings", "Quality"]
