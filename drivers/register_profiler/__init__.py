"""Any profiler whose columns stand in Modbus registers, as station.toml describes it."""

from drivers.register_profiler.banner import (
    EZ_ARRAY_ID,
    EZ_ARRAY_MEASUREMENTS,
    ez_array,
    ez_array_measurements,
)
from drivers.register_profiler.layout import (
    Flag,
    Layout,
    Packing,
    Table,
    Trigger,
    WordOrder,
    decoded,
)
from drivers.register_profiler.profiler import ReadTally, RegisterProfiler, must_tell_torn_reads

__all__ = [
    "EZ_ARRAY_ID",
    "EZ_ARRAY_MEASUREMENTS",
    "Flag",
    "Layout",
    "Packing",
    "ReadTally",
    "RegisterProfiler",
    "Table",
    "Trigger",
    "WordOrder",
    "decoded",
    "ez_array",
    "ez_array_measurements",
    "must_tell_torn_reads",
]
