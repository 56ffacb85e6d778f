"""Baumer OX200 line profiler: Modbus TCP for identity, setup and state, UDP for profiles."""

from drivers.baumer_ox.profiler import BaumerOx, Settings, profile_of
from drivers.baumer_ox.registers import Device, Quality, Readings

__all__ = ["BaumerOx", "Device", "Quality", "Readings", "Settings", "profile_of"]
