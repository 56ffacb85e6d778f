r"""The laser is on only under a lease that the scan's own loop renews.

A loop that hangs renews nothing: a thread that renewed for it would hide just that. ::

    lease      renew   renew   renew ......... lapsed
    laser  ____/~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~\____  off at the next look, and LeaseLapsed

Software can only look when it runs. What covers a program that is dead is the switch's own
watchdog, whose promise `drivers.laser.Guarantee` spells out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from acquisition.errors import LeaseLapsed
from drivers.axis import Pause
from drivers.endings import at_last
from drivers.laser import LaserSwitch

TTL_S = 0.12
LONGEST_WAIT_S = 0.05  # of anything in the loop, so that one late look is forgiven


class Lease:
    """Leave to light the laser, for `ttl_s` from the last renewal; begins lapsed.

    Parameters
    ----------
    clock
        Monotonic seconds.
    """

    def __init__(self, ttl_s: float, clock: Callable[[], float]) -> None:
        if not ttl_s > 0.0:
            raise ValueError(f"lease: a time to live of {ttl_s} s; it must be above 0")
        self.ttl_s = ttl_s
        self._clock = clock
        self._renewed_s: float | None = None

    @property
    def valid(self) -> bool:
        """Whether the laser may be on now."""
        return self._renewed_s is not None and self._clock() - self._renewed_s < self.ttl_s

    def renew(self) -> None:
        """Begin the time to live anew; lapsed or not, since with the laser off it may lapse."""
        self._renewed_s = self._clock()


@contextmanager
def lasing(laser: LaserSwitch, lease: Lease) -> Iterator[Callable[[], None]]:
    """Have the laser on inside the block, off on every way out, each read back by the driver.

    The block is left before anything moves and before a generator yields: a generator may close
    late. Off is sent whatever is believed, even where on failed.

    Yields
    ------
    keep_on
        Call it at least every 50 ms: it renews the lease, and the switch's own watchdog with it.

    Raises
    ------
    LeaseLapsed
        From `keep_on`, or right after switching on: the lease had lapsed with the laser on.
    """

    def keep_on() -> None:
        _must_be_valid(lease)
        lease.renew()
        laser.on()
        _must_be_valid(lease)  # a program that was stopped just there has lit it late

    with at_last(laser.off):
        lease.renew()
        laser.on()
        _must_be_valid(lease)
        lease.renew()
        yield keep_on


def pausing(lease: Lease, look: Callable[[], None], sleep: Callable[[float], object]) -> Pause:
    """Make the pause that drivers wait with: it renews, and it looks for a stop.

    Parameters
    ----------
    look
        Raises to abandon the wait; called before, between and after the sleeps, 50 ms at most.
    """

    def pause(seconds: float, /) -> None:
        left_s = seconds
        _look_and_renew()
        while left_s > 0.0:
            sleep(min(left_s, LONGEST_WAIT_S))
            left_s -= LONGEST_WAIT_S
            _look_and_renew()

    def _look_and_renew() -> None:
        look()
        lease.renew()

    return pause


def _must_be_valid(lease: Lease) -> None:
    if not lease.valid:
        raise LeaseLapsed(
            f"laser: its lease of {lease.ttl_s} s lapsed, so it was switched off; is this machine"
            " too busy, or the switch slow?"
        )
