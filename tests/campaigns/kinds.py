"""Every way to stop a scan, and what is promised of it; docs/safety.md is the same in words."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from signal import Signals

from tests.campaigns.victims import Instant, Victim

STOP_S = 0.25
KILLED_S = 0.07  # until the guard's word: the owner's end, and no silence on a network
HUNG_S = 0.19  # the lease before that
WATCHDOG_S = 0.25 + 0.05  # the block's own, and 50 ms
STOPPED_S = 0.6  # how long a program stands still: more than twice any lease


@dataclass(frozen=True, slots=True)
class Struck:
    """A stop: when, and until when the program was not to act at all."""

    time_s: float
    until_s: float = math.inf


Strike = Callable[[Victim, Instant], Struck | None]


def signalled(number: Signals) -> Strike:
    """Send a signal."""

    def strike(victim: Victim, _: Instant) -> Struck:
        now_s = time.monotonic()
        victim.process.send_signal(number)
        return Struck(now_s)

    return strike


def held(seconds: float) -> Strike:
    """Stop the program, and let it go on after a while."""

    def strike(victim: Victim, _: Instant) -> Struck:
        now_s = time.monotonic()
        victim.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        until_s = time.monotonic()
        victim.process.send_signal(signal.SIGCONT)
        return Struck(now_s, until_s)

    return strike


def _interrupted_twice(victim: Victim, instant: Instant) -> Struck | None:
    victim.process.send_signal(signal.SIGINT)
    time.sleep(0.001 + 0.03 * instant.which)
    return signalled(signal.SIGINT)(victim, instant)


def _unread(victim: Victim, _: Instant) -> Struck:
    victim.stop_reading()
    return Struck(time.monotonic())


def _unplugged(victim: Victim, _: Instant) -> Struck:
    """Pull a cable of the station, any one; it is back half a second later."""
    now_s = time.monotonic()
    os.kill(victim.station_pid, signal.SIGUSR1)
    return Struck(now_s)


def _two_unplugged(victim: Victim, instant: Instant) -> Struck:
    """Pull two of the station's cables together, any two."""
    pairs = list(combinations(("table", "stage", "profiler", "relay"), 2))
    now_s = time.monotonic()
    victim.unplug(*pairs[int(len(pairs) * instant.which)])
    return Struck(now_s)


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to stop a scan, and what is promised of it."""

    name: str
    strike: Strike
    codes: tuple[int, ...]  # of the exit, where slices are missing then
    laser_s: float | None = STOP_S
    axes_s: float | None = STOP_S
    counts_from_end: bool = False  # the seconds: all is to be at rest when the program has ended
    by_script: bool = False
    raises: bool = False
    piped: bool = False
    dies: bool = False  # nobody is left who could tell an axis to stop
    at_border: bool = False  # the slice under way is finished and kept

    def too_late(self, laser_s: float, axes_s: float) -> Iterator[str]:
        """What was not at rest within its bound."""
        if self.laser_s is not None and laser_s > self.laser_s:
            yield f"laser on {1000.0 * laser_s:.0f} ms after the stop"
        if self.axes_s is not None and axes_s > self.axes_s:
            yield f"an axis moves {1000.0 * axes_s:.0f} ms after the stop"


def _by_itself(_victim: Victim, _instant: Instant) -> Struck | None:
    """The script raises, and says when."""
    return None


KINDS = (
    Kind(
        "SIGINT once", signalled(signal.SIGINT), (3,), laser_s=0.0, axes_s=0.0,
        counts_from_end=True, at_border=True,
    ),
    Kind("SIGINT twice", _interrupted_twice, (3,)),
    Kind("SIGTERM", signalled(signal.SIGTERM), (3,)),
    Kind("SIGHUP", signalled(signal.SIGHUP), (3,)),
    Kind("exception", _by_itself, (1,), by_script=True, raises=True),
    Kind("script SIGINT", signalled(signal.SIGINT), (-signal.SIGINT,), by_script=True),
    Kind("unplugged", _unplugged, (4,), laser_s=None, axes_s=None),
    Kind("two unplugged", _two_unplugged, (4,), laser_s=None, axes_s=None),
    Kind("stdout closed", _unread, (), laser_s=0.0, axes_s=0.0, counts_from_end=True, piped=True),
    Kind("SIGKILL", signalled(signal.SIGKILL), (-signal.SIGKILL,), laser_s=KILLED_S, dies=True),
    Kind("SIGSTOP", held(STOPPED_S), (4, -signal.SIGKILL), laser_s=HUNG_S, axes_s=None, dies=True),
)  # fmt: skip
