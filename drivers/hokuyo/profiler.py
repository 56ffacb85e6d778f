r"""A Hokuyo scanner as a profiler: one polar scan at a time, asked for, never streamed.

MD streams, and lights the laser by itself; a laser that is on only under a lease must not be lit
by a question. So this driver asks GD, which the sensor refuses while its laser is off::

        front (step AFRT)         angle = (step - AFRT + (cluster - 1) / 2) * 2 pi / ARES,
          z ^    .                counter-clockwise seen from above
            |   . r               x = -r sin(angle), to the right of the front
            |  . '                z =  r cos(angle)
            | .' angle
    x <-----o                     (x grows to the right: steps run from right to left)

A range is whole millimetres; x and z are kept in counts of 1 um, from which step and range can be
had again. A scan has no number of its own: `Profile.frame` counts those that were delivered.

GD gives the newest scan, of whenever that was. After `discard` the first may be of before it, and
the second was under way; only the third began after it::

    turns      |    0    |    1    |    2    |
    discarded         ^                        not 0, not 1: 2 is the first to be delivered
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.axis import Identity
from drivers.errors import FrameError, NoReply, Refused
from drivers.hokuyo.codes import LASER_OFF, MISHEARD, OK, reasons_of, status_name
from drivers.hokuyo.line import BITS_A_CHARACTER, ScipLine, refusal
from drivers.hokuyo.wire import Asked, Reply, Scan, Stamps, Window, scan_command, scan_of
from drivers.profiler import Profile, Tally

_SLICE_S: Final = 0.02  # the longest single wait
MM_PER_COUNT: Final = 0.001
_LONGEST_REPLY_S: Final = 0.05  # a switch-off is confirmed behind it
_LOOKS_A_SCAN: Final = 10
_MOST_WAITING: Final = 1000  # reads: above what a port's buffer holds
_STALE_SCANS: Final = 2  # that GD may still give after a discard


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Which part of the scan is a profile, and which sensor it must be.

    ``baud`` is None on USB, where a rate has no meaning.
    """

    first_step: int
    last_step: int
    cluster: int = 1
    baud: int | None = None
    serial: str = ""  # the sensor must have it; empty: any
    firmware: str = ""  # its firmware must begin so; empty: any

    def __post_init__(self) -> None:
        if self.baud is not None and self.baud <= 0:
            raise ValueError(f"hokuyo: {self.baud} baud; it must be above 0")
        if self.wire_s > _LONGEST_REPLY_S:
            raise ValueError(
                f"hokuyo: {self.window.points} ranges take {self.wire_s:.2f} s at {self.baud} baud,"
                f" and a switch-off would be confirmed that late; at most {_LONGEST_REPLY_S} s:"
                " narrow the steps, enlarge the cluster, or raise the baud rate"
            )

    @property
    def window(self) -> Window:
        """The steps to ask for."""
        return Window(self.first_step, self.last_step, self.cluster)

    @property
    def wire_s(self) -> float:
        """What a scan takes on the wire."""
        return self.window.reply_bytes * BITS_A_CHARACTER / self.baud if self.baud else 0.0


@dataclass(frozen=True, slots=True)
class Geometry:
    """What the sensor says of itself in PP."""

    model: str
    least_mm: int
    most_mm: int
    steps_a_turn: int
    first_step: int
    last_step: int
    front_step: int
    rpm: int

    @property
    def scan_s(self) -> float:
        """Seconds a turn."""
        return 60.0 / self.rpm


class Hokuyo:
    """A `drivers.profiler.Profiler`; the line's link is closed by whoever opened it."""

    def __init__(self, line: ScipLine, settings: Settings) -> None:
        self._line = line
        self._settings = settings
        self._geometry: Geometry | None = None
        self._asked: Asked | None = None
        self._asked_s = 0.0
        self._status = ""  # of the last scan that was refused
        self._stamps = Stamps()
        self._stamp_ms: int | None = None
        self._stale = 0  # so many scans are still of before, or half of it
        self._profiles = self._lost = self._torn = self._strange = 0

    def identify(self) -> Identity:
        """Ask who it is, compare serial number, firmware and steps; switches nothing.

        Raises
        ------
        Refused
            Another sensor or firmware than the settings', or steps that it does not measure.
        """
        identity = self._line.identify()
        told = self._settings
        if told.serial and identity.serial != told.serial:
            raise Refused(
                f"{self._name}: serial number {identity.serial}, not {told.serial}; is it the"
                " right port?"
            )
        if not identity.firmware.startswith(told.firmware):
            raise Refused(f"{self._name}: firmware {identity.firmware}, not {told.firmware}")
        self._geometry = self._read_geometry()
        return identity

    def geometry(self) -> Geometry:
        """What the sensor says of its steps and ranges; asked once."""
        if self._geometry is None:
            self._geometry = self._read_geometry()
        return self._geometry

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they are measured, each scan once.

        The state is the driver's: leaving this iterator and asking for another loses nothing.

        Raises
        ------
        NoReply
            No scan came for `timeout_s`; says whether the laser is off, or what to check.
        Refused
            The sensor reports trouble, by its status.
        """
        since_s, damaged = self._line.clock(), self._bad
        while True:
            profile = self._look(since_s + timeout_s)
            if profile is not None:
                yield profile
                since_s, damaged = self._line.clock(), self._bad
            elif self._line.clock() >= since_s + timeout_s:
                raise NoReply(self._silence(timeout_s, self._bad - damaged))

    def discard(self) -> None:
        """Forget the scan that was asked for, and take only one that began after now."""
        if self._asked is not None:
            self._line.dialogue.give_up(self._asked)
        self._asked, self._status, self._stale = None, "", _STALE_SCANS
        for _ in range(_MOST_WAITING):
            if not self._line.listen(0.0):
                break

    def tally(self) -> Tally:
        """What was lost so far: lost is a scan that was asked for and never came."""
        return Tally(self._profiles, self._lost, self._torn, self._bad)

    @property
    def _name(self) -> str:
        return f"hokuyo at {self._line.address}"

    @property
    def _bad(self) -> int:
        return self._line.dialogue.damaged + self._strange

    def _look(self, deadline_s: float) -> Profile | None:
        """Let one short wait pass; the profile that it brought."""
        geometry, now_s = self.geometry(), self._line.clock()
        left_s = max(deadline_s - now_s, 0.0)
        if self._asked is None:
            rest_s = self._asked_s + geometry.scan_s / _LOOKS_A_SCAN - now_s
            if 0.0 < rest_s <= geometry.scan_s:
                self._line.listen(min(rest_s, _SLICE_S, left_s))
                return None
            self._asked, self._asked_s = self._line.send(scan_command(self._settings.window)), now_s
        reply = self._line.dialogue.take(self._asked)
        if reply is None:
            self._line.listen(min(_SLICE_S, left_s))
            reply = self._line.dialogue.take(self._asked)
        if reply is not None:
            self._asked = None
            return self._taken(reply, geometry)
        if self._line.clock() - self._asked_s > self._line.reply_s:
            self._line.dialogue.give_up(self._asked)
            self._asked = None
            self._lost += 1
        return None

    def _taken(self, reply: Reply, geometry: Geometry) -> Profile | None:
        self._status = reply.status
        if reply.status == LASER_OFF:
            return None
        if reply.status in MISHEARD:
            self._strange += 1
            return None
        if reply.status != OK:
            raise refusal(self._line.address, "GD", reply.status)
        try:
            scan = scan_of(reply, self._settings.window)
        except FrameError:
            self._torn += 1
            return None
        if scan.stamp_ms == self._stamp_ms:
            return None  # the sensor has not turned since
        self._stamp_ms = scan.stamp_ms
        if self._stale:
            self._stale -= 1
            return None
        self._profiles += 1
        time_s = self._stamps.seconds(scan.stamp_ms)
        return profile_of(scan, self._settings.window, geometry, time_s, self._profiles - 1)

    def _silence(self, timeout_s: float, damaged: int) -> str:
        start = f"{self._name}: no scan in {timeout_s:g} s"
        if self._status == LASER_OFF:
            return f"{start}; its laser is off"
        if self._status in MISHEARD:
            return f"{start}; it answers {self._status}: {status_name(self._status)}"
        if damaged:
            return f"{start}, but {damaged} damaged replies; check the cable and the baud rate"
        return f"{start}; is the sensor on, and its motor turning?"

    def _read_geometry(self) -> Geometry:
        names = ("MODL", "DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
        model, *rest = self._line.fields("PP", *names).items()
        said = dict([model, *rest])
        try:
            numbers = [int(said[name]) for name in names[1:]]
        except ValueError as wrong:
            raise FrameError(f"{self._name}: a parameter is no number ({wrong})") from wrong
        geometry = Geometry(said["MODL"], *numbers)
        if min(geometry.steps_a_turn, geometry.rpm) <= 0:
            raise FrameError(f"{self._name}: ARES and SCAN must be above 0, it says {numbers}")
        self._check_window(geometry)
        return geometry

    def _check_window(self, geometry: Geometry) -> None:
        window = self._settings.window
        if window.first < geometry.first_step or window.last > geometry.last_step:
            raise Refused(
                f"{self._name}: steps {window.first} to {window.last} are asked for, it measures"
                f" {geometry.first_step} to {geometry.last_step}; change the settings"
            )


def angles_rad(window: Window, geometry: Geometry) -> NDArray[np.float64]:
    """Angles of the ranges, counter-clockwise from the front; (n,) of `window.points`.

    A cluster stands at its middle: which of its steps was the nearest is not told.
    """
    first = window.first + np.arange(window.points) * window.cluster
    last = np.minimum(first + window.cluster - 1, window.last)
    steps = (first + last) / 2.0 - geometry.front_step
    return np.asarray(steps * (math.tau / geometry.steps_a_turn))


def profile_of(
    scan: Scan, window: Window, geometry: Geometry, time_s: float, number: int
) -> Profile:
    """Return the profile of a scan; a range that is a code keeps its place, at 0."""
    reasons = reasons_of(scan.ranges, geometry.model, geometry.least_mm, geometry.most_mm)
    ranges_mm = np.where(reasons == 0, scan.ranges, 0)
    angles = angles_rad(window, geometry)
    x_mm, z_mm = -ranges_mm * np.sin(angles), ranges_mm * np.cos(angles)
    counts = np.rint(np.stack([x_mm, z_mm], axis=1) / MM_PER_COUNT)
    return Profile(
        counts=counts.astype(np.int32),
        scale_mm=(MM_PER_COUNT, MM_PER_COUNT),
        offset_mm=(0.0, 0.0),
        reasons=reasons,
        intensity=np.empty(0, dtype=np.uint16),
        sensor_time_s=time_s,
        encoder=0,
        frame=number,
    )
