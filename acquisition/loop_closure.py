"""A kept slice taken again before a scan goes on: is it the same part, and do the axes stand so.

Profile by profile, in the sensor's plane at the kept pose::

    z |   . again     d = z again - z kept at the same x, along the kept profile's normal
      |  .|.
      | o-d-o kept    median over a stretch: what moved;  spread around it: the sensor's noise
      +------- x

The difference is the rms of the medians, beyond what noise alone makes of them; the worst 5 % of
them are left out, so that a few at an edge do not decide. Twice the noise would be no
difference to see in the surface; three times is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.errors import NotAsKept
from acquisition.frames import (
    Kinematics,
    onto_sheet,
    part_to_station,
    sensor_to_station,
    station_to_part,
)
from acquisition.poses import Pose, Sweep
from drivers.profiler import Reason

_TIMES_NOISE = 3.0
_ENOUGH_POINTS = 10  # of a profile
_ENOUGH_PROFILES = 3
_STRETCHES = 8  # of a profile: a part that is turned a little is nearer here and further there
_ENOUGH_OVERLAP = 0.5  # of the points that either saw; noise at edges takes a few
_KEPT_SHARE = 0.95  # of the stretches
_WIDEST_GAP = 4.0  # kept points further apart than so many pitches bound no line
_SLOPE_OVER = 3  # points to either side: the slope of two neighbours is their noise
_MAD, _MEDIAN_SD = 1.4826, 1.2533  # of a normal distribution
_LOOKS = 24  # profiles that are tried against every turn


@dataclass(frozen=True, slots=True)
class Closure:
    """How a slice that was taken again lies to the kept one."""

    index: int
    difference_mm: float  # nan where nothing overlaps
    noise_mm: float  # one standard deviation of a single point, and no less than one count
    overlap: float  # share of the points
    turned_rad: float | None = None  # a turn of the table that would explain a difference

    @property
    def limit_mm(self) -> float:
        """What is refused beyond."""
        return _TIMES_NOISE * self.noise_mm

    @property
    def agrees(self) -> bool:
        """Whether it is the same slice."""
        return self.overlap >= _ENOUGH_OVERLAP and self.difference_mm <= self.limit_mm


def comparable(sweep: Sweep) -> bool:
    """Whether a slice has enough points to be compared."""
    counts = [int((each.reasons == Reason.MEASURED).sum()) for each in sweep.profiles]
    enough = max(1, min(_ENOUGH_PROFILES, len(counts)))  # a stripe is one profile
    return sum(count >= _ENOUGH_POINTS for count in counts) >= enough


def compare(kept: Sweep, again: Sweep, kinematics: Kinematics) -> Closure:
    """Compare two sweeps of the same slice, each at its own read-back poses."""
    old = [profile.points_mm for profile in kept.profiles]
    new = [
        _moved(profile.points_mm, pose, before, kinematics)
        for profile, pose, before in zip(again.profiles, again.poses, kept.poses, strict=False)
    ]
    apart = [_distances(one, other) for one, other in zip(old, new, strict=False)]
    seen = [max(len(one), len(other)) for one, other in zip(old, new, strict=False)]
    overlap = sum(len(each) for each in apart) / max(1, sum(seen))
    quantum_mm = max((abs(each.scale_mm[1]) for each in kept.profiles), default=0.0)
    difference_mm, noise_mm = _judged(apart)
    noise_mm = max(noise_mm, quantum_mm)
    found = Closure(kept.index, difference_mm, noise_mm, overlap)
    if found.agrees:
        return found
    return Closure(kept.index, difference_mm, noise_mm, overlap, _turn(old, new, kept, found))


def must_agree(closure: Closure) -> None:
    """Refuse what is not the same slice.

    Raises
    ------
    NotAsKept
        Names the difference, the noise, and what would explain it.
    """
    if closure.agrees:
        return
    if closure.turned_rad is not None:
        why = (
            f"as if it were turned by {math.degrees(closure.turned_rad):.3g} deg: the table lost"
            " its place, or the part was moved"
        )
    else:
        why = "it is another part, or was moved, or an axis lost its place"
    raise NotAsKept(
        f"slice {closure.index}, taken again, {_apart(closure)}; {why}; put the part back as it"
        " stood, or scan anew with another --out"
    )


def in_words(closure: Closure) -> str:
    """The comparison on one line."""
    return f"slice {closure.index} taken again {_apart(closure)}"


def _apart(closure: Closure) -> str:
    if not closure.overlap:
        return "meets no point of the kept one"
    return (
        f"lies {closure.difference_mm:.4f} mm from the kept one (noise {closure.noise_mm:.4f} mm,"
        f" limit {closure.limit_mm:.4f} mm, {closure.overlap:.0%} of the points seen by both)"
    )


def _moved(points_mm: FloatArray, pose: Pose, before: Pose, kinematics: Kinematics) -> FloatArray:
    """Points (n, 2) taken at a pose as the sensor would have seen them at the pose before."""
    if pose.table_rad == before.table_rad or not len(points_mm):
        return points_mm
    count = len(points_mm)
    station = sensor_to_station(points_mm, np.full(count, pose.stage_mm), kinematics)
    part = station_to_part(station, np.full(count, pose.table_rad), kinematics)
    turned = part_to_station(part, np.full(count, before.table_rad), kinematics)
    return onto_sheet(turned, np.full(count, before.stage_mm), kinematics)


def _distances(old: FloatArray, new: FloatArray) -> FloatArray:
    """Distances of new points (n, 2) from the line through old ones, where it has no gap."""
    if len(old) < _ENOUGH_POINTS or not len(new):
        return np.empty(0)
    x, first = np.unique(old[:, 0], return_index=True)
    z = old[first, 1]
    if len(x) < _ENOUGH_POINTS:
        return np.empty(0)
    right = np.clip(np.searchsorted(x, new[:, 0]), 1, len(x) - 1)
    width = x[right] - x[right - 1]
    near = (new[:, 0] >= x[0]) & (new[:, 0] <= x[-1])
    near &= width <= _WIDEST_GAP * float(np.median(np.diff(x)))
    low = np.maximum(right - 1 - _SLOPE_OVER, 0)
    high = np.minimum(right + _SLOPE_OVER, len(x) - 1)
    slope = (z[high] - z[low]) / (x[high] - x[low])
    apart = (new[:, 1] - np.interp(new[:, 0], x, z)) / np.hypot(1.0, slope)
    return np.asarray(apart[near])


def _judged(apart: Sequence[FloatArray]) -> tuple[float, float]:
    """Difference and noise of a single point, of the distances of each profile, by stretches."""
    enough = [
        stretch
        for each in apart
        if len(each) >= _ENOUGH_POINTS
        for stretch in np.array_split(each, min(_STRETCHES, len(each) // _ENOUGH_POINTS))
    ]
    if not enough:
        return math.nan, 0.0
    medians = np.array([float(np.median(each)) for each in enough])
    spread = np.concatenate([each - at for each, at in zip(enough, medians, strict=True)])
    noise_mm = _MAD * float(np.median(np.abs(spread))) / math.sqrt(2.0)
    chance = (_MEDIAN_SD * math.sqrt(2.0) * noise_mm) ** 2 / np.array([len(e) for e in enough])
    beyond = np.sort(medians**2 - chance)
    kept = beyond[: max(1, round(_KEPT_SHARE * len(beyond)))]
    return math.sqrt(max(0.0, float(np.mean(kept)))), float(noise_mm)


def _turn(
    old: Sequence[FloatArray], new: Sequence[FloatArray], kept: Sweep, found: Closure
) -> float | None:
    """The turn, in whole stops, after which most of the difference is gone; None without one."""
    angles = [pose.table_rad for pose in kept.poses]
    steps = np.array([after - before for before, after in pairwise(angles)])
    if len(steps) < _ENOUGH_PROFILES or np.ptp(steps) > 0.1 * abs(float(np.mean(steps))):
        return None  # no even turn, stop by stop
    stops = len(old)
    looks = range(0, min(stops, len(new)), max(1, stops // _LOOKS))
    rms = []
    for turn in range(stops):
        apart = [_distances(old[(k + turn) % stops], new[k]) for k in looks]
        shared = sum(map(len, apart)) / max(1, sum(len(new[k]) for k in looks))
        rms.append(_judged(apart)[0] if shared >= _ENOUGH_OVERLAP else math.inf)
    best = int(np.nanargmin(rms))
    if best == 0 or not rms[best] < max(found.limit_mm, 0.3 * rms[0]):
        return None
    return math.remainder(best * float(np.mean(steps)), math.tau)
