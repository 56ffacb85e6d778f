r"""One turn of the table under the lit laser: what the profiler sent, and where the table was.

One thread does it all: every wait of the table's driver is spent listening to the profiler::

    table's driver    move __ ask __ wait 5 ms __ ask __ wait 5 ms ....... arrived, compared
    the waits               look for a stop, renew the lease, keep the laser on; take profiles
    laser          on ______________________________________________________________ off

The laser is off before the table is stopped, whatever goes wrong: `Onlooker.failing`. Nothing is
thrown away here: `acquisition.timing` says which profile was taken where.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.lease import LONGEST_WAIT_S, lasing
from acquisition.opening import OpenStation
from drivers.axis import Pause
from drivers.errors import FrameError, NoReply, Refused
from drivers.profiler import Profile
from drivers.sweeping import Course, Sweeper

_KEEP_ON_S = LONGEST_WAIT_S / 2  # half, because switching on again takes its time, too
_NUMBERS = 1 << 32
_LONGEST_STEP_S = 1.0  # between stamps: longer silences end a turn before
_AFTER_S = 0.02  # listened on after the table stands: what is under way arrives


class StampsBroken(FrameError):  # noqa: N818 (the house names errors after the fact)
    """The sensor's time did not go on from profile to profile; the table turned as it should."""


class Sense(Enum):
    """Which way round."""

    FORWARD = "angles grow"
    BACKWARD = "angles fall"


@dataclass(frozen=True, slots=True, eq=False)
class Turned:
    """What came of one turn: profiles by their number, each once; positions by their time."""

    profiles: tuple[Profile, ...]
    numbers: tuple[int, ...]  # of the profiles, unwrapped: the gaps are what was lost
    arrived_s: FloatArray  # (n,)
    asked_s: FloatArray  # (k,)
    table_rad: FloatArray  # (k,)

    @property
    def stamps_s(self) -> FloatArray:
        """The sensor's own times, (n,)."""
        return np.array([each.sensor_time_s for each in self.profiles])


class Turner:
    """Turns the table of one station, and listens.

    Parameters
    ----------
    look
        Raises to give the turn up: the operator's stop, the safety chain.
    heard
        Told how many profiles have come so far, several times a second.
    patience_s
        How long the profiler may be silent while it is lit.
    """

    def __init__(
        self,
        station: OpenStation,
        look: Callable[[], None],
        patience_s: float,
        heard: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._station = station
        self._look = look
        self._patience_s = patience_s
        self._heard = heard

    def turn(self, to_rad: float, speed_rad_s: float) -> Turned:
        """Turn from where the table stands, lit, and stand dark.

        Raises
        ------
        LeaseLapsed, Stopped, DriverError
            The laser is off, the table was told to stop.
        """
        station = self._station
        table = station.table
        if not isinstance(table, Sweeper):
            raise Refused("table: this one cannot be turned at a speed of its own; step and shoot")
        with lasing(station.laser, station.lease) as keep_on:
            listening = _Listening(station, self._look, keep_on, self._patience_s, self._heard)
            station.profiler.discard()
            table.sweep_to(to_rad, Course(speed_rad_s, listening), listening)
            listening(_AFTER_S)
        return listening.turned()


class _Listening(Pause):
    """The pause of a turn, and who looks on while it goes on."""

    def __init__(
        self,
        station: OpenStation,
        look: Callable[[], None],
        keep_on: Callable[[], None],
        patience_s: float,
        heard: Callable[[int], None],
    ) -> None:
        self._station = station
        self._look = look
        self._keep_on = keep_on
        self._patience_s = patience_s
        self._heard = heard
        self._profiles: list[Profile] = []
        self._arrived_s: list[float] = []
        self._asked: list[tuple[float, float]] = []
        self._kept_on_s = self._told_s = self._last_s = station.clock()

    def __call__(self, seconds: float, /) -> None:
        """Listen for so long, no longer than 50 ms between two looks."""
        clock = self._station.clock
        until_s = clock() + seconds
        while True:
            self._attend()
            left_s = until_s - clock()
            self._take(min(max(left_s, 0.0), _KEEP_ON_S))
            if clock() >= until_s:
                return

    def seen(self, asked_s: float, position: float) -> None:
        """The table said where it is."""
        self._asked.append((asked_s, position))

    def failing(self) -> None:
        """Dark, and nothing hangs on the lease: while an axis is stopped nobody renews it."""
        self._station.laser.off()
        self._station.lease.give_back()

    def turned(self) -> Turned:
        """Everything that came, by its number.

        Raises
        ------
        NoReply
            Nothing came at all.
        StampsBroken
            It was restarted, perhaps, or its clock was set.
        """
        if len(self._profiles) < 2:
            raise NoReply("profiler: nothing came while the table turned; is the laser on?")
        first = self._profiles[0].frame
        ahead = [(each.frame - first + _NUMBERS // 2) % _NUMBERS for each in self._profiles]
        by_number = {n: k for k, n in reversed(list(enumerate(ahead)))}
        numbers = tuple(sorted(by_number))
        chosen = [by_number[number] for number in numbers]
        profiles = tuple(self._profiles[k] for k in chosen)
        if any(
            not 0.0 < b.sensor_time_s - a.sensor_time_s < _LONGEST_STEP_S
            for a, b in pairwise(profiles)
        ):
            raise StampsBroken(
                "profiler: its time stamps do not go on from profile to profile; was it restarted,"
                " was its clock set, or are its stamps switched off?"
            )
        asked = np.array(sorted(set(self._asked))).reshape(-1, 2)
        return Turned(
            profiles, numbers, np.array([self._arrived_s[k] for k in chosen]),
            asked[:, 0], asked[:, 1],
        )  # fmt: skip

    def _attend(self) -> None:
        """What must be done every 50 ms, done every 25."""
        now_s = self._station.clock()
        if now_s - self._kept_on_s < _KEEP_ON_S:
            return
        self._kept_on_s = now_s
        self._look()
        self._keep_on()
        if now_s - self._last_s > self._patience_s:
            raise NoReply(
                f"profiler: nothing for {self._patience_s:.2f} s while the table turned; is the"
                " laser on, and does the sensor measure by itself?"
            )
        if now_s - self._told_s >= 0.2:
            self._told_s = now_s
            self._heard(len(self._profiles))

    def _take(self, seconds: float) -> None:
        """Take what comes; a burst no longer than until the next look."""
        clock = self._station.clock
        until_s = clock() + seconds
        with suppress(NoReply, FrameError):  # `_attend` knows how long it may be silent
            for profile in self._station.profiler.profiles(seconds):
                self._last_s = clock()
                self._profiles.append(profile)
                self._arrived_s.append(self._last_s)
                if self._last_s >= until_s or self._last_s - self._kept_on_s >= _KEEP_ON_S:
                    return
