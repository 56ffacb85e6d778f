"""Open sections as strands: what runs across the surface in one plane, in coordinates they share.

A slice gives one strand, of one run or more where the light lost the part. A plane through the
axis that sees both sides of it gives two, half a turn apart::

    stripes     (along x, along y of the planes), at the height of the plane
    meridians   (distance from the axis, height along it), at the angle of the half plane
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.layout import Fan
from reconstruction.skinning.outlines import Outline

_PLACES = 257  # of a run
_BEYOND = 0.1  # of how far a plane reaches on one side of the axis: less beyond it is noise
_FEWEST = 2  # places
_REACH = 0.02  # of a run's length, that its points may go beyond its curve, ...
_ACROSS = 4.0  # ... and standard deviations of a point off it
_LAST = 3  # places of a run that tell the way on


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """One open section."""

    slice_index: int
    position: float  # height of the plane in mm, or angle in rad
    runs_mm: tuple[FloatArray, ...]  # (n, 2) each

    @property
    def length_mm(self) -> float:
        """Of all its runs."""
        return sum(length_mm(run) for run in self.runs_mm)


def length_mm(run: FloatArray) -> float:
    """Of a polyline (n, 2)."""
    return float(np.linalg.norm(np.diff(run, axis=0), axis=1).sum())


def stripes_of(stack: Sequence[SliceOutlines]) -> tuple[Strand, ...]:
    """A strand of every slice that has open runs; slices in parallel planes, by height."""
    axes = stack[0].frame.axes
    return tuple(
        Strand(piece.index, piece.height_mm, runs)
        for piece in stack
        if (runs := tuple(part @ axes[:2].T for run in piece.runs for part in _placed(run, piece)))
    )


def meridians_of(stack: Sequence[SliceOutlines], fan: Fan) -> tuple[Strand, ...]:
    """One or two strands of every slice through the axis, by angle."""
    found = [strand for piece in stack for strand in _sides(piece, fan)]
    return tuple(sorted(found, key=lambda each: each.position))


def _sides(piece: SliceOutlines, fan: Fan) -> list[Strand]:
    runs = [fan.places_of(part, piece.frame) for run in piece.runs for part in _placed(run, piece)]
    if not runs:
        return []
    ahead = max(float(run[:, 0].max()) for run in runs)
    behind = -min(float(run[:, 0].min()) for run in runs)
    angle = fan.angle_of(piece.frame)
    found = []
    for sign, reach, other in ((1.0, ahead, behind), (-1.0, behind, ahead)):
        if not reach > max(_BEYOND * other, 0.0):
            continue
        turned = [run * np.array([sign, 1.0]) for run in runs]
        own = tuple(part for run in turned for part in _ahead(run))
        if own:
            position = (angle + (math.pi if sign < 0.0 else 0.0)) % math.tau
            found.append(Strand(piece.index, position, own))
    return found


def _ahead(run: FloatArray) -> list[FloatArray]:
    """The parts of a run (n, 2) on this side of the axis."""
    on_this_side = run[:, 0] >= 0.0
    if on_this_side.all():
        return [run]
    parts = np.split(np.arange(len(run)), np.flatnonzero(np.diff(on_this_side)) + 1)
    return [run[part] for part in parts if on_this_side[part[0]] and len(part) >= _FEWEST]


def _placed(run: Outline, piece: SliceOutlines) -> list[FloatArray]:
    """Places (n, 3) along a run in the part frame, gap by gap, as far as its points go.

    A fitted curve ends in the middle of its last points. What bridges its gaps is left to the
    neighbours.
    """
    line = run.polygon_mm(_PLACES)
    points = piece.frame.to_plane(piece.grains.points_mm)[:, :2]
    reach_mm = _REACH * length_mm(line)
    across_mm = _ACROSS * run.fitted.sigma_mm
    low, high = (
        _beyond(end, end - inner, points, reach_mm, across_mm)
        for end, inner in ((line[0], line[_LAST]), (line[-1], line[-1 - _LAST]))
    )
    parts = _between_gaps(run, line)
    parts[0] = np.concatenate([low, parts[0]])
    parts[-1] = np.concatenate([parts[-1], high])
    return [piece.frame.to_part(part) for part in parts if len(part) >= _FEWEST]


def _between_gaps(run: Outline, line: FloatArray) -> list[FloatArray]:
    """A run's line (n, 2), evenly in its parameter, without what lies in its gaps."""
    u = np.linspace(*run.fitted.domain, len(line))
    number = np.zeros(len(line), np.int64)
    inside = np.zeros(len(line), np.bool_)
    for start, end in run.fitted.gap_intervals:
        inside |= (u > start) & (u < end)
        number += u >= end
    return [line[(number == part) & ~inside] for part in range(int(number[-1]) + 1)]


def _beyond(
    end: FloatArray, way: FloatArray, points: FloatArray, reach_mm: float, across_mm: float
) -> FloatArray:
    """Where the outermost of the points straight on from an end lies, (1, 2); (0, 2): none does."""
    way = way / max(float(np.linalg.norm(way)), 1e-300)
    arms = points - end
    ahead, across = arms @ way, np.abs(arms @ np.array([-way[1], way[0]]))
    on = ahead[(ahead > 0.0) & (ahead < reach_mm) & (across < across_mm)]
    return end + float(on.max()) * way[None] if len(on) else np.empty((0, 2))
