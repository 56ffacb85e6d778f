"""SICK Profiler 2: whole profiles by reads of its memory, on a half duplex serial line."""

from drivers.sick.line import FORGETS_S, SickLine
from drivers.sick.profiler import Addresses, ByteOrder, Settings, SickProfiler2, reading_s

__all__ = [
    "FORGETS_S",
    "Addresses",
    "ByteOrder",
    "Settings",
    "SickLine",
    "SickProfiler2",
    "reading_s",
]
