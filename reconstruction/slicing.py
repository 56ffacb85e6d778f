"""A cloud becomes a stream of slices, whatever its size.

Four passes: `survey_cloud`, `find_part`, a count of every slice, and the cut, which sorts every
point into its slice's place in a pile. A small pile lies in memory; a large one lies in a temporary
file, of which one slice at a time is read back, so that memory does not grow with the cloud.
"""

from __future__ import annotations

import math
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import BinaryIO

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.errors import TooFewPoints
from reconstruction.reduction import Box, bounding_box
from reconstruction.setting_aside import Aside, Keep, find_part
from reconstruction.slices import Frame, Slice
from reconstruction.survey import Axis, Pass, Spacing, Survey, choose_spacing, survey_cloud

_IN_MEMORY = 4_000_000  # points, 96 MB
_DRAWN = 30_000  # points of each reason kept for the picture
_MOST_SLICES = 100_000
PASSES = 4  # over the points of a cloud: survey, clusters, counting, sorting


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """What the cut did with every point of the cloud."""

    survey: Survey
    spacing: Spacing
    axis: Axis
    counts: IntArray  # (slices,), points in each
    aside: dict[Aside, int]  # how many points were set aside, by reason
    aside_mm: dict[Aside, FloatArray]  # some of them, to be drawn
    box: Box  # of what was kept
    pile: _Pile

    def slices(self) -> Iterator[Slice]:
        """The slices from the lowest up, empty ones too; may be called again."""
        stops = np.cumsum(self.counts)
        for index, (stop, count) in enumerate(zip(stops, self.counts, strict=True)):
            points = self.pile.read(int(stop - count), int(stop))
            yield Slice(index, points, self.frame(index), self.pile.corners(index))

    def slice_at(self, index: int) -> Slice:
        """One slice by its number."""
        start = int(self.counts[:index].sum())
        points = self.pile.read(start, start + int(self.counts[index]))
        return Slice(index, points, self.frame(index), self.pile.corners(index))

    def frame(self, index: int) -> Frame:
        """Frame of a slice: axes cyclic from the stacking axis, origin at its middle height."""
        origin = np.zeros(3)
        origin[self.axis.column] = self.spacing.middle_mm + index * self.spacing.step_mm
        return Frame(origin, np.eye(3)[list(self.axis.planar)])


def cut_cloud(
    points: Pass, axis: Axis, *, spacing_mm: float | None = None, crop: Box | None = None
) -> Cutting:
    """Cut a cloud into slices perpendicular to `axis`.

    Parameters
    ----------
    points : Pass
        Yields the finite points of the cloud in mm, (k, 3) at a time; called four times.
    axis : Axis
        The stacking axis.
    spacing_mm : float, optional
        Distance between slices; by default found from the cloud (`choose_spacing`).
    crop : Box, optional
        Only points in this box are used.

    Raises
    ------
    TooFewPoints
        Where nothing is left to slice.
    """
    inside = points if crop is None else cropped(points, crop)
    survey = survey_cloud(inside, axis)
    spacing = choose_spacing(survey, axis, given_mm=spacing_mm)
    keep = find_part(inside, survey, axis)
    start, lowest, levels = _number_levels(inside, keep, spacing, axis)
    spacing = replace(start, middle_mm=start.middle_mm + lowest * start.step_mm)
    pile = _Pile(int(levels.sum()), len(levels))
    aside_mm = _sort_into_pile(points, pile, keep, start, axis, lowest, levels, crop)
    box = pile.box
    aside = {reason: count for reason, (count, _) in aside_mm.items()}
    drawn = {reason: some for reason, (_, some) in aside_mm.items()}
    return Cutting(survey, spacing, axis, frozen(levels, np.int64), aside, drawn, box, pile)


def cropped(points: Pass, crop: Box) -> Pass:
    """Only the points in a box, pass by pass."""

    def passing() -> Iterator[FloatArray]:
        for chunk in points():
            kept = chunk[((chunk >= crop.low_mm) & (chunk <= crop.high_mm)).all(axis=1)]
            if len(kept):
                yield kept

    return passing


def _number_levels(
    points: Pass, keep: Keep, spacing: Spacing, axis: Axis
) -> tuple[Spacing, int, IntArray]:
    """Count the part's points of each level, from the lowest one that holds any.

    Returns the spacing from which levels are counted, the lowest level, and the counts. The sort
    must count from the same place: from another, a point on a border would round to another level.
    """
    low = keep.corner_mm[axis.column]
    high = low + keep.edge_mm * keep.boxes.shape[axis.column]
    slices = (high - low) / spacing.step_mm
    if slices > _MOST_SLICES:
        raise TooFewPoints(
            f"a spacing of {spacing.step_mm:g} mm makes {slices:.6g} slices, at most "
            f"{_MOST_SLICES} are possible: choose a larger --spacing-mm"
        )
    first = math.floor((low - spacing.middle_mm) / spacing.step_mm)
    levels = math.ceil((high - spacing.middle_mm) / spacing.step_mm) - first + 2
    start = Spacing(spacing.step_mm, spacing.middle_mm + first * spacing.step_mm, spacing.rule)
    counts = np.zeros(levels, dtype=np.int64)
    for chunk in points():
        places = _classify(
            np.ascontiguousarray(chunk), *_grid(keep), *_levels(start, axis), 0, levels
        )
        counts += np.bincount(places[places >= 0], minlength=levels)
    occupied = np.flatnonzero(counts)
    if len(occupied) == 0:
        raise TooFewPoints("no cluster of 2 or more points is left: everything looks stray")
    lowest = int(occupied[0])
    return start, lowest, counts[lowest : occupied[-1] + 1]


def _grid(keep: Keep) -> tuple[FloatArray, float, object, float]:
    return keep.corner_mm, keep.edge_mm, keep.boxes, keep.plate_top_mm


def _levels(spacing: Spacing, axis: Axis) -> tuple[int, float, float]:
    return axis.column, spacing.middle_mm - spacing.step_mm / 2.0, spacing.step_mm


@njit(cache=True)
def _classify(
    points: FloatArray,
    corner: FloatArray,
    edge: float,
    boxes: object,
    plate_top: float,
    column: int,
    base: float,
    step: float,
    lowest: int,
    levels: int,
) -> IntArray:
    """The level of every point above the lowest, or minus its reason for being set aside."""
    places = np.empty(len(points), np.int64)
    nx, ny, nz = boxes.shape  # type: ignore[attr-defined]
    for n in range(len(points)):
        height = points[n, column]
        if height <= plate_top:
            places[n] = -3
            continue
        i = math.floor((points[n, 0] - corner[0]) / edge)
        j = math.floor((points[n, 1] - corner[1]) / edge)
        k = math.floor((points[n, 2] - corner[2]) / edge)
        known = 0 <= i < nx and 0 <= j < ny and 0 <= k < nz
        level = math.floor((height - base) / step) - lowest
        if known and boxes[int(i), int(j), int(k)] and 0 <= level < levels:  # type: ignore[index]
            places[n] = int(level)
        else:
            places[n] = -2
    return places


def _sort_into_pile(
    points: Pass,
    pile: _Pile,
    keep: Keep,
    start: Spacing,
    axis: Axis,
    lowest: int,
    levels: IntArray,
    crop: Box | None,
) -> dict[Aside, tuple[int, FloatArray]]:
    cursors = np.concatenate([[0], np.cumsum(levels)[:-1]])
    aside = {reason: _Remembered() for reason in Aside}
    for chunk in points():
        if crop is not None:
            outside = ~((chunk >= crop.low_mm) & (chunk <= crop.high_mm)).all(axis=1)
            aside[Aside.CROPPED].add(chunk[outside])
            inside = chunk[~outside]
        else:
            inside = chunk
        places = _classify(
            np.ascontiguousarray(inside), *_grid(keep), *_levels(start, axis), lowest, len(levels)
        )
        for reason in (Aside.STRAY, Aside.PLATE):
            aside[reason].add(inside[places == -reason])
        order, starts = _order_by_level(places, len(levels))
        sorted_mm = inside[order]
        for level in np.flatnonzero(np.diff(starts)):
            segment = sorted_mm[starts[level] : starts[level + 1]]
            pile.write(int(level), int(cursors[level]), segment)
            cursors[level] += len(segment)
    return {reason: (some.count, some.points) for reason, some in aside.items()}


@njit(cache=True)
def _order_by_level(places: IntArray, levels: int) -> tuple[IntArray, IntArray]:
    """Counting sort: indices of the kept points level by level, and where each level starts."""
    starts = np.zeros(levels + 1, np.int64)
    for place in places:
        if place >= 0:
            starts[place + 1] += 1
    starts = np.cumsum(starts)
    order = np.empty(starts[-1], np.int64)
    cursors = starts[:-1].copy()
    for n in range(len(places)):
        place = places[n]
        if place >= 0:
            order[cursors[place]] = n
            cursors[place] += 1
    return order, starts


@dataclass(slots=True)
class _Remembered:
    """How many points were set aside, and the first of them."""

    count: int = 0
    chunks: list[FloatArray] = field(default_factory=list)

    def add(self, points: FloatArray) -> None:
        room = _DRAWN - min(self.count, _DRAWN)
        if room and len(points):
            self.chunks.append(points[:room].copy())
        self.count += len(points)

    @property
    def points(self) -> FloatArray:
        return np.concatenate([np.empty((0, 3)), *self.chunks])


class _Pile:
    """Points sorted by slice, in memory or in a temporary file that vanishes with the pile."""

    def __init__(self, points: int, levels: int) -> None:
        self._corners = np.full((levels, 2, 3), [[[np.inf] * 3, [-np.inf] * 3]])
        self._memory: FloatArray | None = None
        self._file: BinaryIO | None = None
        if points <= _IN_MEMORY:
            self._memory = np.empty((points, 3))
        else:
            # Unbuffered: each slice is one seek and one read or write anyway.
            self._file = tempfile.TemporaryFile(prefix="loftscan-", buffering=0)  # noqa: SIM115
            weakref.finalize(self, self._file.close)

    @property
    def box(self) -> Box:
        return Box(self._corners[:, 0].min(axis=0), self._corners[:, 1].max(axis=0))

    def corners(self, level: int) -> FloatArray | None:
        """Between which corners (2, 3) the points of a level lie; None where there are none."""
        corners = self._corners[level]
        return corners if corners[0, 0] <= corners[1, 0] else None

    def write(self, level: int, start: int, points: FloatArray) -> None:
        # Noted here, while the points are in the cache anyway: nobody reads them again for it.
        box, corners = bounding_box(points), self._corners[level]
        np.minimum(corners[0], box.low_mm, out=corners[0])
        np.maximum(corners[1], box.high_mm, out=corners[1])
        if self._memory is not None:
            self._memory[start : start + len(points)] = points
        elif self._file is not None:
            self._file.seek(24 * start)
            _write_all(self._file, np.ascontiguousarray(points).data.cast("B"))

    def read(self, start: int, stop: int) -> FloatArray:
        if self._memory is not None:
            return self._memory[start:stop]
        assert self._file is not None
        self._file.seek(24 * start)
        points = np.empty((stop - start, 3))
        if len(points):
            _read_all(self._file, points.data.cast("B"))
        return points


def _write_all(file: BinaryIO, data: memoryview) -> None:
    # An unbuffered write may take less than it was given.
    while data:
        data = data[file.write(data) :]


def _read_all(file: BinaryIO, room: memoryview) -> None:
    # One read takes 2 GiB at most.
    while room:
        taken = file.readinto(room)  # type: ignore[attr-defined]
        if not taken:
            raise OSError("the temporary file of the sorted points ended early; run again")
        room = room[taken:]
