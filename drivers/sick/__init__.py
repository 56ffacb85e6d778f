"""SICK Profiler 2: whole profiles by reads of its memory, on a half duplex serial line."""

from drivers.sick.line import SickLine
from drivers.sick.profiler import Addresses, ByteOrder, Settings, SickProfiler2

__all__ = ["Addresses", "ByteOrder", "Settings", "SickLine", "SickProfiler2"]
