r"""The laser is on only under a lease that the scan's own loop renews.

A loop that hangs renews nothing: a thread that renewed for it would hide just that. ::

    lease      renew   renew   renew ......... lapsed
    laser  ____/~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~~\____  off at the next look, and LeaseLapsed

Software can only look when it runs. Over a program that is dead or hangs watches a process of its
own, `acquisition.safety.guard`, which is told of every renewal; over that one, and a machine
without power, the switch's own watchdog, whose promise `drivers.laser.Guarantee` spells out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from acquisition.errors import LeaseLapsed
from acquisition.safety.guarding import Guard, NoGuard
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
    guard
        Who is told, and acts when it lapses while the laser is on.
    """

    def __init__(
        self, ttl_s: float, clock: Callable[[], float], guard: Guard | None = None
    ) -> None:
        if not ttl_s > 0.0:
            raise ValueError(f"lease: a time to live of {ttl_s} s; it must be above 0")
        self.ttl_s = ttl_s
        self._clock = clock
        self._guard = NoGuard() if guard is None else guard
        self._renewed_s: float | None = None

    @property
    def valid(self) -> bool:
        """Whether the laser may be on now."""
        return self._renewed_s is not None and self._clock() - self._renewed_s < self.ttl_s

    def renew(self) -> None:
        """Begin the time to live anew; lapsed or not, since with the laser off it may lapse."""
        self._renewed_s = self._clock()
        self._guard.renew(self.ttl_s)

    def take(self) -> None:
        """Begin it for the laser: from now on its end has consequences.

        Raises
        ------
        GuardLost
            Nobody would turn the laser off: it is not lit.
        """
        self._guard.take(self.ttl_s)
        self.renew()

    def give_back(self) -> None:
        """The laser was read back as off: nothing hangs on the lease any more."""
        self._guard.give_back()


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

    def dark() -> None:
        laser.off()
        lease.give_back()  # not where off failed: then the guard tries, too

    with at_last(dark):
        lease.take()
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
