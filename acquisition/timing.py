"""From what was heard in a turn to a sweep whose profiles have their poses. Pure.

::

    stamp  --the line under all arrivals-->  station's time  --less the latency-->  when it was seen
    when it was seen  --straight pieces between the positions read back-->  the table's angle

What was numbered and never came has its place, its pose, and no point but LOST ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from acquisition.clocks import ClockLine, SensorClock, TableCourse, table_course
from acquisition.continuous import MOST_TRIED
from acquisition.latency import Shift, View, shift_between
from acquisition.poses import Pose, Sweep, Timing
from acquisition.turning import Turned
from drivers.errors import Refused
from drivers.profiler import Profile

_KNOWN_RAD = 1e-4  # of the table: 3 um at 30 mm from its axis, less than a profiler's noise
_TIMES_NOISE = 3.0  # as for a slice that a resume takes again
_NUMBERS = 1 << 32
_NOTHING = Shift(math.nan, math.inf, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class Steadiness:
    """What is asked of a turn."""

    speed_rad_s: float
    run_in_rad: float
    tolerance_rad: float  # of positions read back, around steady motion


class Timekeeper:
    """What a run has learnt of the sensor's clock and of the latency; begins with nothing."""

    def __init__(self) -> None:
        self.clock = SensorClock()
        self._tried = 0
        self._weight = 0.0
        self._weighted_s = 0.0

    @property
    def latency_s(self) -> float:
        """The mean of what slices told, by their weights; nan before one did."""
        return self._weighted_s / self._weight if self._weight else math.nan

    @property
    def latency_sd_s(self) -> float:
        """One standard deviation of it."""
        return 1.0 / math.sqrt(self._weight) if self._weight else math.inf

    def must_learn(self, speed_rad_s: float) -> bool:
        """Whether the next slice is to be seen both ways round for the latency's sake."""
        return self._tried < MOST_TRIED and self.latency_sd_s * speed_rad_s > _KNOWN_RAD

    def learn(self, shift: Shift, speed_rad_s: float) -> None:
        """Take what a slice told."""
        self._tried += 1
        if shift.told:
            weight = (speed_rad_s / max(shift.sd_rad, 1e-9)) ** 2
            self._weight += weight
            self._weighted_s += weight * shift.shift_rad / speed_rad_s


def timed_sweep(
    index: int,
    turns: Sequence[Turned],
    stage_mm: float,
    steady: Steadiness,
    keeper: Timekeeper,
    nothing: Profile,
) -> Sweep:
    """Make a sweep of one turn, or of two in opposite senses, which tell the latency.

    Parameters
    ----------
    nothing
        What stands for a profile that never came.

    Raises
    ------
    Refused
        The table did not turn steadily, told where it is too rarely, or shows another part on its
        way back.
    """
    for turn in turns:
        keeper.clock.hear(turn.stamps_s, turn.arrived_s)
    line = keeper.clock.line()
    courses = [_course(turn, steady) for turn in turns]
    shift = _NOTHING
    if len(turns) == 2:
        shift = _shift(turns, courses, line, steady.speed_rad_s)
        _must_agree(index, shift)
        keeper.learn(shift, steady.speed_rad_s)
    latency_s = 0.0 if math.isnan(keeper.latency_s) else keeper.latency_s
    profiles: list[Profile] = []
    poses: list[Pose] = []
    arrived_s: list[float] = []
    for turn, course in zip(turns, courses, strict=True):
        for profile, heard_s in _with_gaps(turn, nothing):
            seen_s = line.station_s(np.array([profile.sensor_time_s])) - latency_s
            table_rad = float(course.at(seen_s)[0])
            if 0.0 <= table_rad < math.tau:
                profiles.append(profile)
                poses.append(Pose(table_rad, stage_mm, float(seen_s[0])))
                arrived_s.append(heard_s)
    timing = Timing(
        arrived_s=np.array(arrived_s),
        asked_s=np.concatenate([each.asked_s for each in turns]),
        asked_rad=np.concatenate([each.table_rad for each in turns]),
        speed_rad_s=steady.speed_rad_s,
        latency_s=keeper.latency_s,
        latency_sd_s=keeper.latency_sd_s,
        drift_ppm=line.drift_ppm,
        clock_late_s=line.late_s,
        table_rms_rad=max(each.residual_rad for each in courses),
        apart_mm=shift.apart_mm,
        noise_mm=shift.noise_mm,
        lost=int(np.count_nonzero(np.isnan(arrived_s))),
    )
    return Sweep(index, tuple(profiles), tuple(poses), timing)


def _course(turn: Turned, steady: Steadiness) -> TableCourse:
    """The table's course where it is measured, and half of the run-in around it."""
    margin_rad = steady.run_in_rad / 2.0
    there = (turn.table_rad > -margin_rad) & (turn.table_rad < math.tau + margin_rad)
    try:
        course = table_course(turn.asked_s[there], turn.table_rad[there])
    except ValueError as few:
        raise Refused(f"{few}; turn more slowly: raise ring.profiles_per_turn") from few
    if course.residual_rad > steady.tolerance_rad:
        raise Refused(
            f"table: its positions scatter by {math.degrees(course.residual_rad):.3f} deg around"
            f" steady motion, {math.degrees(steady.tolerance_rad):.3f} are tolerated; lengthen"
            " continuous.run_in_deg, turn more slowly, or step and shoot"
        )
    return course


def _shift(
    turns: Sequence[Turned], courses: Sequence[TableCourse], line: ClockLine, speed_rad_s: float
) -> Shift:
    views = [
        View([each.points_mm for each in turn.profiles], course.at(line.station_s(turn.stamps_s)))
        for turn, course in zip(turns, courses, strict=True)
    ]
    try:
        return shift_between(views[0], views[1], speed_rad_s)
    except ValueError:
        return _NOTHING  # nearly nothing was seen at this height


def _must_agree(index: int, shift: Shift) -> None:
    """No latency explains what is left: whatever it is, no angle is to be believed."""
    if shift.apart_mm > _TIMES_NOISE * shift.noise_mm:
        raise Refused(
            f"table: slice {index}, seen both ways round, lies {shift.apart_mm:.4f} mm from itself"
            f" (noise {shift.noise_mm:.4f} mm), whatever the latency; did the part slip, or the"
            " table lose steps? fasten it, turn more slowly, or step and shoot"
        )


def _with_gaps(turn: Turned, nothing: Profile) -> list[tuple[Profile, float]]:
    """Profiles and when they were heard, with what was numbered and never came in its place."""
    every = [(turn.profiles[0], float(turn.arrived_s[0]))]
    ways = pairwise(zip(turn.numbers, turn.profiles, strict=True))
    for ((before, old), (after, new)), heard_s in zip(ways, turn.arrived_s[1:], strict=True):
        step_s = (new.sensor_time_s - old.sensor_time_s) / (after - before)
        for missing in range(1, after - before):
            stamp_s = old.sensor_time_s + missing * step_s
            frame = (old.frame + missing) % _NUMBERS
            every.append((replace(nothing, sensor_time_s=stamp_s, frame=frame), math.nan))
        every.append((new, float(heard_s)))
    return every


def in_words(timing: Timing) -> str:
    """How a slice was timed, on one line."""
    told = (
        f"latency {1e3 * timing.latency_s:.3f} ms (sd {1e3 * timing.latency_sd_s:.3f})"
        if math.isfinite(timing.latency_s)
        else "the part is too round to tell the latency: it is turned by that, not bent"
    )
    apart = ""
    if math.isfinite(timing.apart_mm):
        apart = (
            f"; both ways round {timing.apart_mm:.4f} mm apart, of which noise"
            f" {timing.noise_mm:.4f}"
        )
    return (
        f"{told}{apart}; clock {timing.drift_ppm:+.1f} ppm, heard"
        f" {1e3 * timing.clock_late_s:.3f} ms late; table within"
        f" {math.degrees(timing.table_rms_rad):.4f} deg; {timing.lost} of"
        f" {len(timing.arrived_s)} profiles lost"
    )
