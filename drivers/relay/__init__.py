"""Modbus outputs as laser switches: a watched I/O block, and a plain relay without a watchdog."""

from drivers.relay.inputs import BlockInputs
from drivers.relay.laser import Coil, Output, OutputBit, PlainRelay, TimedRelay, WatchedBlock

__all__ = ["BlockInputs", "Coil", "Output", "OutputBit", "PlainRelay", "TimedRelay", "WatchedBlock"]
