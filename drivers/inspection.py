"""Asking a device who it is and how it fares, without changing anything about it.

`identify` makes a device ready: it may reset it, or write what a setting must be. Who only looks,
while somebody else may own the station, asks by these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from drivers.axis import Identity
from drivers.laser import Guarantee


@runtime_checkable
class Inspected(Protocol):
    """A device whose `identify` does more than ask."""

    def inspect(self) -> Identity:
        """Ask who it is and compare it, as `identify` does; nothing is reset, set or moved."""
        ...


@runtime_checkable
class Watched(Protocol):
    """A laser switch whose `guarantee` sets the device's own watchdog."""

    def standing_guarantee(self) -> Guarantee:
        """What the device promises as it stands; nothing is written."""
        ...


@runtime_checkable
class Counted(Protocol):
    """What counts how its wire fares."""

    def counters(self) -> Mapping[str, int]:
        """By name, since it was opened: asked, timeouts, damaged, late, and others."""
        ...
