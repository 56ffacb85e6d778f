"""A SICK Profiler 2 on a half duplex serial line."""

from sim.sick.memory import ProfilerSettings, SickProfiler

__all__ = ["ProfilerSettings", "SickProfiler"]
