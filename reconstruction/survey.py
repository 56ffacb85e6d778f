"""A first look at a cloud: where it lies, how its rows stand, how far apart slices should be.

Everything here is one pass over the points with a bounded sample kept, so that a cloud of any
size can be surveyed. A pass is a function that yields the points again from the start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.errors import TooFewPoints
from reconstruction.reduction import Box, bounding_box

Pass = Callable[[], Iterable[FloatArray]]

_SAMPLE = 200_000
_SLICES_WANTED = 100
_POINTS_A_SLICE = 200
_LEAST_SLICES = 5
_REGULAR = 0.25  # steps within this share of their median count as the scanner's row step
_WIDE_BREAK = 0.3  # of the widest empty band, to part two levels
_ROWS_SHARE = 0.6  # of the steps must be regular
_LONELY = 0.1  # of the points that levels hold: fewer are strays between levels


class Axis(Enum):
    """The stacking axis: slices are perpendicular to it."""

    X = "x"
    Y = "y"
    Z = "z"

    @property
    def column(self) -> int:
        """Which coordinate is the height: 0, 1 or 2."""
        return "xyz".index(self.value)

    @property
    def planar(self) -> tuple[int, int, int]:
        """Columns of (plane x, plane y, height), cyclic so that the frame is right-handed."""
        return ((self.column + 1) % 3, (self.column + 2) % 3, self.column)


class SpacingRule(Enum):
    """Where the distance between slices came from."""

    GIVEN = "given"
    ROWS = "the rows of the scanner"
    LEVELS = "the levels on which the points lie"
    DENSITY = "the density of the cloud"


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What one pass over a cloud found; lengths in mm."""

    points: int
    box: Box  # of all points, strays included
    core: Box  # where the part is: between the outer 0.5 %, widened by half
    sample_mm: FloatArray  # (at most 400 000, 3), evenly taken from the whole cloud
    row_step_mm: float | None  # height between consecutive points, if it is regular

    def __post_init__(self) -> None:
        object.__setattr__(self, "sample_mm", frozen(self.sample_mm))


@dataclass(frozen=True, slots=True)
class Spacing:
    """Distance between slices, and the height that the middle of some slice should have."""

    step_mm: float
    middle_mm: float
    rule: SpacingRule


def survey_cloud(points: Pass, axis: Axis) -> Survey:
    """Pass over a cloud once.

    Raises
    ------
    TooFewPoints
        Fewer than 4 points, or all of them in one place.
    """
    count = 0
    lows, highs, kept = [], [], _Thinning(_SAMPLE)
    row_step: float | None = None
    for chunk in points():
        if count == 0:
            row_step = _row_step(chunk[:, axis.column])
        count += len(chunk)
        box = bounding_box(chunk)
        lows.append(box.low_mm)
        highs.append(box.high_mm)
        kept.add(chunk)
    if count < 4:
        raise TooFewPoints(
            f"{count} points in the cloud: a surface needs at least 4, in 2 slices; name another"
        )
    box = Box(np.min(lows, axis=0), np.max(highs, axis=0))
    if not (box.sides_mm > 0).any():
        raise TooFewPoints(f"all {count} points lie in one place: is this the right file?")
    sample = kept.points
    return Survey(count, box, _core(sample, box), sample, row_step)


class _Thinning:
    """Keeps every k-th point of a stream, k doubling whenever too many are held."""

    def __init__(self, wanted: int) -> None:
        self._wanted = wanted
        self._stride = 1
        self._seen = 0
        self._chunks: list[FloatArray] = []
        self._held = 0

    def add(self, chunk: FloatArray) -> None:
        # Counted from the stream's start, so that chunking decides nothing.
        taken = chunk[-self._seen % self._stride :: self._stride]
        self._seen += len(chunk)
        self._chunks.append(taken.copy())
        self._held += len(taken)
        while self._held > 2 * self._wanted:
            self._chunks = [np.concatenate(self._chunks)[::2]]
            self._held = len(self._chunks[0])
            self._stride *= 2

    @property
    def points(self) -> FloatArray:
        return np.concatenate(self._chunks)


def _core(sample_mm: FloatArray, box: Box) -> Box:
    low, high = np.percentile(sample_mm, [0.5, 99.5], axis=0)
    if not (high > low).any():
        return box  # nearly all points in one place: the few others are not strays of it
    margin = 0.5 * np.maximum(high - low, 1e-3 * (high - low).max())
    return Box(np.maximum(low - margin, box.low_mm), np.minimum(high + margin, box.high_mm))


def _row_step(heights_mm: FloatArray) -> float | None:
    """The step between rows, where a scanner wrote its points row under row."""
    steps = np.abs(np.diff(heights_mm))
    steps = steps[steps > 0]
    if len(steps) < 10:
        return None
    step = float(np.median(steps))
    regular = np.abs(steps - step) < _REGULAR * step
    return step if regular.mean() > _ROWS_SHARE else None


def choose_spacing(survey: Survey, axis: Axis, *, given_mm: float | None = None) -> Spacing:
    """Choose the distance between slices.

    In this order: what the caller gives; the rows that a slice-wise scanner wrote; separate levels
    of height; else 100 slices, or as many as leave 200 points to each, at least 5. Rows and levels
    are taken several at a time where they lie much closer together than the points within one.
    """
    heights = survey.sample_mm[:, axis.column]
    extent = float(np.ptp(np.percentile(heights, [0.5, 99.5])))
    if not extent > 0.0:
        raise TooFewPoints(
            f"nearly all points lie at one height along --axis {axis.value}: try another --axis"
        )
    if given_mm is not None:
        return _in_step(given_mm, heights, SpacingRule.GIVEN)
    if survey.row_step_mm is not None and survey.row_step_mm * _LEAST_SLICES <= extent:
        step = _gather_rows(survey.row_step_mm, survey, axis, extent)
        return _in_step(step, heights, SpacingRule.ROWS)
    levels = _find_levels(heights)
    if levels is not None:
        step = _gather_rows(levels, survey, axis, extent)
        return _in_step(step, heights, SpacingRule.LEVELS)
    slices = min(_SLICES_WANTED, max(_LEAST_SLICES, survey.points // _POINTS_A_SLICE))
    step = extent / slices
    # From the lowest point of all, if the sample nearly reached it: then it is no stray.
    low, lowest = float(heights.min()), float(survey.box.low_mm[axis.column])
    return Spacing(step, (lowest if low - lowest < step else low) + step / 2.0, SpacingRule.DENSITY)


def _gather_rows(step_mm: float, survey: Survey, axis: Axis, extent_mm: float) -> float:
    """As many rows together as make slices half as far apart as the points along their outline.

    The outline is taken for that of an ellipse in the part's bounding rectangle.
    """
    planar = survey.sample_mm[:, axis.planar[:2]]
    sides = np.ptp(np.percentile(planar, [0.5, 99.5], axis=0), axis=0)
    outline = math.pi / 2.0 * float(sides.sum())
    points_a_row = max(1.0, survey.points * step_mm / extent_mm)
    together = math.ceil(math.sqrt(0.5 * outline / points_a_row / step_mm))
    most = max(1, int(extent_mm / step_mm / _LEAST_SLICES))
    return step_mm * min(max(1, together), most)


def _in_step(step_mm: float, heights_mm: FloatArray, rule: SpacingRule) -> Spacing:
    """Put the middles of the slices where the heights crowd, by their circular mean."""
    phase = np.angle(np.exp(2j * math.pi * heights_mm / step_mm).mean())
    return Spacing(step_mm, float(phase) / (2.0 * math.pi) * step_mm, rule)


def _find_levels(heights_mm: FloatArray) -> float | None:
    """The distance of levels that empty bands keep apart, if it is regular."""
    low, high = np.percentile(heights_mm, [0.1, 99.9])
    if high <= low:
        return None
    counts, edges = np.histogram(heights_mm, bins=2048, range=(low, high))
    occupied = np.flatnonzero(counts)
    # A lonely point in the tail of a level leaves empty bins too: only wide breaks part levels.
    empty = np.diff(occupied) - 1
    breaks = np.flatnonzero(empty > _WIDE_BREAK * empty.max(initial=0))
    firsts = occupied[np.concatenate([[0], breaks + 1])]
    lasts = occupied[np.concatenate([breaks, [len(occupied) - 1]])]
    held = np.add.reduceat(counts, firsts)
    usual = float((held**2).sum() / held.sum())  # of the level that a point is likely to lie in
    full = held >= _LONELY * usual
    firsts, lasts = firsts[full], lasts[full]
    if len(firsts) < 3:
        return None
    lows, highs = edges[firsts], edges[lasts + 1]
    steps = np.diff((lows + highs) / 2.0)
    step = float(np.median(steps))
    regular = np.abs(steps - step) < _REGULAR * step
    apart = float(np.median(highs - lows)) < 0.7 * step
    if not apart or regular.mean() <= _ROWS_SHARE:
        return None
    numbers = np.concatenate([[0.0], np.cumsum(np.rint(steps / step))])
    # The bins round each step, and a stray beside a level widens it; medians know of neither.
    level = np.searchsorted(lows, heights_mm, "right") - 1
    level[heights_mm > highs[level]] = -1
    medians = [float(np.median(heights_mm[level == each])) for each in range(len(lows))]
    return float(np.polyfit(numbers, medians, 1)[0])
