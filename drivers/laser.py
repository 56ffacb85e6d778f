"""Switching the laser: the Protocol that every switch keeps, and who guarantees what.

Off is never elided, never behind another command, always read back. On is only sent under a lease
that the caller holds; the driver does not know leases, it only switches.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.axis import Identity


@dataclass(frozen=True, slots=True)
class Guarantee:
    """Who turns the laser off when everything above is dead, and after how long.

    `watchdog_s` is None where nothing does: such a switch refuses unattended runs.
    """

    watchdog_s: float | None
    sentence: str  # for the operator, at start-up


class LaserSwitch(Protocol):
    """A switch of the laser's supply or interlock."""

    def identify(self) -> Identity:
        """Ask the switch who it is."""
        ...

    def guarantee(self) -> Guarantee:
        """Set the device's own watchdog, read it back, and say what it promises."""
        ...

    def on(self) -> None:
        """Switch on and read back; also renews the device's watchdog when called again.

        Raises
        ------
        Refused
            The output did not follow.
        """
        ...

    def off(self) -> None:
        """Switch off and read back, whatever is believed to be the state.

        Raises
        ------
        Refused
            The output did not follow: press the emergency stop.
        LinkLost
            Nobody heard it: open the link again, which moves and lights nothing, and say it again.
        """
        ...

    def is_on(self) -> bool:
        """Read the output back."""
        ...
