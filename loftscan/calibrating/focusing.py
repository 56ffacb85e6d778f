"""How far and which way the table turns, before anything else is known: the sharpest part.

Placed with a wrong angle scale a part's points smear; with the right one the views fall onto each
other and fill the fewest cells. The focus is the sum of squared counts of cells, searched over the
scale on both senses, so that half the steps a turn, or the other sense, is found as such and not
as a bad fit. The laser plane's place is then sharpened in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kinematics, Turning
from loftscan.calibrating.model import Seen, placed_with, turned

_POINTS, _CELL_MM = 2500, 3.0  # of the search
_FINE_POINTS, _FINE_CELL_MM = 8000, 2.0  # of the sharpening
_LEAST, _MOST = 0.2, 2.6  # true turn for a reported one
_STEP = 0.006  # 2 degrees at the end of a turn
_CLEARLY = 1.10  # sharper than what the station says, before it is contradicted
_CLEARLY_CROSSED, _LEAST_CROSSED = 1.25, 0.5  # turned by less, all of it lies on itself
_NEAR = 0.08  # of the scale: no contradiction
_CANDIDATES = 3
_COARSE = 3  # every so manieth scale is enough to tell which axis turns
_APART = 0.02  # of the scale, between two that are tried
_FINE_MM = (4.0, 2.0, 1.0, 0.5)


@dataclass(frozen=True, slots=True)
class Focus:
    """What was found, and how sharp."""

    kinematics: Kinematics  # with the scale, the sense and the place found
    sharpness: float  # beside that of the best smear
    axes_swapped: bool = False
    planes_swapped: bool = False  # the sensor's x and z


def thinned(seen: Seen, points: int) -> Seen:
    """Every so manieth of the rows."""
    step = max(1, len(seen) // points)
    return seen.of(np.arange(0, len(seen), step))


def focus(seen: Seen, nominal: Kinematics) -> Focus:
    """Find the table's scale and sense, and whether the axes or the sensor's own are exchanged."""
    few = thinned(seen, _POINTS)
    if _planes_swapped(few, nominal):
        return Focus(nominal, 0.0, planes_swapped=True)
    grid = np.arange(_LEAST, _MOST, _STEP)
    scales = np.concatenate([-grid[::-1], grid])
    sharp = np.array([_sharpness(few, _turned_by(nominal, each), _CELL_MM) for each in scales])
    many = thinned(seen, _FINE_POINTS)
    tried = [_sharpened(many, _turned_by(nominal, each)) for each in _peaks(scales, sharp)]
    found, best = _believed(tried, nominal)
    return Focus(
        found,
        best / float(np.median(sharp)),
        axes_swapped=_axes_swapped(seen, nominal, scales),
    )


def _peaks(scales: FloatArray, sharp: FloatArray) -> list[float]:
    """The sharpest scales, none near another; some near 1 are always among them."""
    found: list[float] = []
    near_one = np.abs(scales - 1.0) <= _NEAR
    for rows in (np.flatnonzero(near_one), np.arange(len(scales))):
        wanted = len(found) + _CANDIDATES
        for row in rows[np.argsort(-sharp[rows])]:
            if len(found) < wanted and all(abs(scales[row] - each) > _APART for each in found):
                found.append(float(scales[row]))
    return found


def _believed(
    tried: list[tuple[Kinematics, float]], nominal: Kinematics
) -> tuple[Kinematics, float]:
    """The sharpest; one that contradicts the station only if it is clearly sharper."""
    agree = [each for each in tried
             if each[0].table_sense is nominal.table_sense
             and abs(each[0].table_deg_per_deg - 1.0) <= 1.5 * _NEAR]  # fmt: skip
    best = max(tried, key=lambda each: each[1])
    own = max(agree, key=lambda each: each[1], default=best)
    return own if own[1] * _CLEARLY >= best[1] else best


def _turned_by(kinematics: Kinematics, scale: float) -> Kinematics:
    sense = kinematics.table_sense
    if scale < 0.0:
        sense = next(each for each in Turning if each is not sense)
    return replace(kinematics, table_sense=sense, table_deg_per_deg=abs(scale))


def _sharpness(seen: Seen, kinematics: Kinematics, cell_mm: float) -> float:
    part_mm = placed_with(kinematics, seen).part_mm
    return _crowding(np.floor(part_mm / cell_mm).astype(np.int64))


def _crowding(cells: np.ndarray[tuple[int, ...], np.dtype[np.int64]]) -> float:
    """Sum of squared counts of cells (n, 3), a point."""
    low = cells.min(axis=0)
    sizes = cells.max(axis=0) - low + 1
    moved = cells - low
    number = (moved[:, 0] * sizes[1] + moved[:, 1]) * sizes[2] + moved[:, 2]
    counts = np.unique(number, return_counts=True)[1]
    return float(np.sum(counts.astype(np.float64) ** 2) / len(cells))


def _sharpened(seen: Seen, start: Kinematics) -> tuple[Kinematics, float]:
    """Walk the axis's place and the scale downhill, coordinate by coordinate, ever finer."""
    best, at = _sharpness(seen, start, _FINE_CELL_MM), start
    for step_mm in _FINE_MM:
        steps = (("standoff_mm", step_mm), ("side_mm", step_mm),
                 ("table_deg_per_deg", step_mm / 1000.0))  # fmt: skip
        for name, step in steps:
            for way in (-step, step):
                while True:
                    tried = replace(at, **{name: getattr(at, name) + way})
                    sharp = _sharpness(seen, tried, _FINE_CELL_MM)
                    if sharp <= best:
                        break
                    best, at = sharp, tried
    return at, best


def _planes_swapped(seen: Seen, nominal: Kinematics) -> bool:
    """Whether the points lie where they would with x for z: the station knows its standoff."""
    middle = np.median(seen.planar_mm, axis=0)
    expected = np.array([nominal.x_sign * nominal.side_mm, nominal.standoff_mm])
    as_said = float(np.linalg.norm(middle - expected))
    swapped = float(np.linalg.norm(middle[::-1] - expected))
    return swapped < 0.25 * as_said and as_said > 0.25 * nominal.standoff_mm


def _axes_swapped(seen: Seen, nominal: Kinematics, scales: FloatArray) -> bool:
    """Whether the part is sharp when the stage's positions turn it and the table's lift it."""
    span_mm, span_rad = float(np.ptp(seen.stage_mm)), float(np.ptp(seen.table_rad))
    if span_mm <= 0.0 or span_rad <= 0.0:
        return False
    few = thinned(seen, _POINTS)
    scales = scales[np.abs(scales) >= _LEAST_CROSSED][::_COARSE]
    said = max(_flat_sharpness(few, nominal, few.table_rad, each, few.stage_mm) for each in scales)
    turns = few.stage_mm / span_mm * math.tau
    crossed = max(_flat_sharpness(few, nominal, turns, each, few.table_rad) for each in scales)
    return crossed > _CLEARLY_CROSSED * said


def _flat_sharpness(
    seen: Seen, nominal: Kinematics, turns_rad: FloatArray, scale: float, level: FloatArray
) -> float:
    """Sharpness in the plane, level by level: what lifts the part need not be known."""
    flat = np.column_stack(
        [nominal.standoff_mm - seen.planar_mm[:, 1],
         nominal.x_sign * seen.planar_mm[:, 0] - nominal.side_mm,
         np.zeros(len(seen))]
    )  # fmt: skip
    back = turned(flat, -nominal.table_sign * scale * turns_rad)
    cells = np.floor(back / _CELL_MM).astype(np.int64)
    cells[:, 2] = np.unique(level, return_inverse=True)[1]
    return _crowding(cells)
