"""How a surface ends beyond its outermost outline: at a level brim that a cap closes, or an apex.

The area inside the outlines tells. Towards a smooth dome it falls linearly with height, towards a
cone's tip its root does. Where either runs out before a slice that holds nothing, there is the
apex; else the wall is carried on half-way to that slice and closed by a flat cap, which is said to
stand on no measured point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.skinning.branch import End, Ending
from reconstruction.skinning.outlines import Outline

_LOOK = 4  # outlines that tell how the area falls
_PLACES = 256
_SLACK = 1.15  # times the way to the next slice that an apex may lie away: heights have noise
_SLENDER = 3.0  # length over width: a ridge does not run out in one point
_SAME = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Brim:
    """A level end: the surface's last row lies in a plane, and a flat cap closes it."""

    height_mm: float  # along the stacking axis
    axis: FloatArray  # (3,), unit

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", frozen(self.axis))

    def row_mm(self, places_mm: FloatArray, *, last: int) -> FloatArray:
        """A row (m, 3) in the plane, beyond the outermost of rows (k, m, 3) the way they run."""
        edge = places_mm[-1 if last else 0]
        if len(places_mm) < 2:
            row = np.array(edge)
            self.press(row)
            return row
        inner = places_mm[-2 if last else 1]
        way = edge - inner
        rise = float((way @ self.axis).mean())
        rest = self.height_mm - float((edge @ self.axis).mean())
        share = min(max(rest / rise, 0.0), 1.0) if abs(rise) > 0.0 else 0.0
        row = np.array(edge + share * way)
        self.press(row)
        return row

    def press(self, row_mm: FloatArray) -> None:
        """Move a row (m, 3) into the plane along the axis, in place."""
        row_mm += (self.height_mm - row_mm @ self.axis)[:, None] * self.axis


@dataclass(frozen=True, slots=True, eq=False)
class Apex:
    """A pointed or rounded end in one point."""

    point_mm: FloatArray  # (3,), a first guess
    sharp: bool  # a tip, not a dome

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", frozen(self.point_mm))

    def row_mm(self, places_mm: FloatArray, *, last: int) -> FloatArray:
        """The point, once for every station."""
        del last
        return np.repeat(self.point_mm[None], places_mm.shape[1], axis=0)


def brim_or_apex(outlines: Sequence[Outline], end: End, *, last: bool) -> Brim | Apex:
    """Say how a branch ends.

    Parameters
    ----------
    outlines
        Of the branch, in order.
    last
        The end after the last outline, not the one before the first.
    """
    near = list(outlines[-_LOOK:])[::-1] if last else list(outlines[:_LOOK])
    edge = near[0]
    axis = edge.frame.axes[2]
    if end.ending is Ending.JOINED:
        return Brim(end.height_mm, axis)
    if len(near) < 2:
        return Brim(0.5 * (edge.height_mm + end.height_mm), axis)
    step = edge.height_mm - near[1].height_mm
    reach = end.height_mm - edge.height_mm if end.ending is Ending.CLOSED else step
    apex = _apex(near, reach)
    if apex is not None:
        return apex
    return Brim(edge.height_mm + 0.5 * min(reach, step, key=abs), axis)


def _apex(near: list[Outline], reach: float) -> Apex | None:
    """Where the areas of outlines, the outermost first, run out within reach; None: they do not."""
    areas, middles, slender = zip(*(_shape(outline) for outline in near), strict=True)
    if slender[0] > _SLENDER or not all(a < b for a, b in pairwise(areas)):
        return None
    rises = np.array([outline.height_mm - near[0].height_mm for outline in near])
    way = math.copysign(1.0, reach)
    dome, dome_misfit = _runs_out(rises * way, np.array(areas))
    tip, tip_misfit = _runs_out(rises * way, np.sqrt(areas))
    sharp = tip_misfit < dome_misfit and len(near) > 2
    beyond = tip if sharp else dome
    if not 0.0 < beyond < _SLACK * abs(reach):
        return None
    rise = way * min(beyond, abs(reach))
    middle = np.array(middles[0])
    if len(near) > 1 and abs(rises[1]) > 0.0:
        middle = middle + (middle - np.array(middles[1])) * (rise / -rises[1])
    edge = near[0]
    return Apex(edge.frame.to_part(middle[None])[0] + rise * edge.frame.axes[2], sharp)


def _runs_out(rises: FloatArray, values: FloatArray) -> tuple[float, float]:
    """Rise at which a line through values is zero, and how badly it fits, relatively."""
    slope, level = np.polyfit(rises, values, 1)
    if not slope < 0.0:
        return math.inf, math.inf
    # Through the outermost value itself: it is nearest to the end.
    misfit = float(np.abs(values - level - slope * rises).max()) / float(values.max())
    steep = (values[0] - values[1]) / (rises[0] - rises[1])
    return float(values[0] / -min(steep, slope)) if steep < 0.0 else math.inf, misfit


def _shape(outline: Outline) -> tuple[float, FloatArray, float]:
    """Area, centroid (2,) and length over width of what an outline encloses."""
    polygon = outline.polygon_mm(_PLACES)
    x, y = (polygon - polygon[0]).T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    cross = x * next_y - next_x * y
    twice = float(cross.sum())
    if abs(twice) < _SAME * float(np.ptp(polygon, axis=0).max()) ** 2:
        return 0.0, polygon.mean(axis=0), math.inf
    middle = np.array([((x + next_x) @ cross), ((y + next_y) @ cross)]) / (3.0 * twice)
    arms = polygon - polygon[0] - middle
    values = np.linalg.eigvalsh(arms.T @ arms)
    return abs(twice) / 2.0, polygon[0] + middle, math.sqrt(values[1] / max(values[0], 1e-300))
