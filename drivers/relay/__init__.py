"""Modbus outputs as laser switches: a watched I/O block, and a plain relay without a watchdog."""

from drivers.relay.laser import Coil, Output, OutputBit, PlainRelay, WatchedBlock

__all__ = ["Coil", "Output", "OutputBit", "PlainRelay", "WatchedBlock"]
