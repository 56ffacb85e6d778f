"""The contours of all slices as polygons in one plane, and which of them lies in which.

::

    +-------------+      region of a loop: what it encloses, without what the loops in it enclose
    |  a  +---+   |      a: material, outside it the surroundings
    |     | h |   |      h: void, its parent is a
    |     +---+   |
    +-------------+      A contour parts its own region from its parent's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.skinning.outlines import Outline
from reconstruction.skinning.stack import Stack
from reconstruction.slices import Frame

CORNERS = 128  # of every polygon
AROUND = -1  # the parent of a loop that lies in no other
_PARALLEL = 1e-6  # of a unit normal: planes farther apart in direction are not a stack


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """The closed outlines of a stack, slice by slice, each as a polygon."""

    stack: Stack
    outlines: tuple[Outline, ...]
    levels: IntArray  # (l,): which of the slices given
    heights_mm: FloatArray  # (l,)
    holes: BoolArray  # (l,)
    corners_mm: FloatArray  # (l, CORNERS, 2)
    parents: IntArray  # (l,): the loop each lies in directly, or AROUND
    depths: IntArray  # (l,): how many it lies in
    areas_mm2: FloatArray  # (l,)
    centres_mm: FloatArray  # (l, 2), of the areas

    def __post_init__(self) -> None:
        for name in ("levels", "parents", "depths"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.int64))
        object.__setattr__(self, "holes", frozen(self.holes, np.bool_))
        for name in ("heights_mm", "corners_mm", "areas_mm2", "centres_mm"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.outlines)

    @property
    def radii_mm(self) -> FloatArray:
        """Of circles of the same area, (l,)."""
        return np.sqrt(self.areas_mm2 / np.pi)

    def across(self, number: int) -> str:
        """The size of a loop, to be read."""
        return f"{2.0 * self.radii_mm[number]:.3g} mm across"

    def at(self, level: int) -> IntArray:
        """Numbers of the loops of one slice."""
        low, high = np.searchsorted(self.levels, [level, level + 1])
        return np.arange(low, high)

    def without(self, dropped: BoolArray) -> Loops:
        """Leave out loops (l,) and nest the others anew."""
        kept = np.flatnonzero(~dropped)
        parents, depths = _nested(self.levels[kept], self.corners_mm[kept], self.areas_mm2[kept])
        outlines = tuple(self.outlines[each] for each in kept)
        taken = {
            name: getattr(self, name)[kept]
            for name in ("levels", "heights_mm", "holes", "corners_mm", "areas_mm2", "centres_mm")
        }
        return replace(self, outlines=outlines, parents=parents, depths=depths, **taken)


def loops_of(stack: Stack) -> Loops:
    """Sample closed outlines.

    Raises
    ------
    ValueError
        An outline is open, or lies in a plane that is not parallel to the others.
    """
    outlines = tuple(each for piece in stack.slices for each in piece)
    counts = [len(piece) for piece in stack.slices]
    levels = np.repeat(np.arange(len(stack)), counts)
    corners = np.empty((len(outlines), CORNERS, 2))
    for number, outline in enumerate(outlines):
        corners[number] = _polygon(outline, outlines[0].frame)
    areas, centres = _measured(corners)
    parents, depths = _nested(levels, corners, areas)
    holes = np.array([each.hole for each in outlines], dtype=np.bool_)
    at = stack.heights_mm[levels]
    return Loops(stack, outlines, levels, at, holes, corners, parents, depths, areas, centres)


def _polygon(outline: Outline, frame: Frame) -> FloatArray:
    """The corners in the plane of another slice's frame."""
    if not outline.fitted.closed:
        raise ValueError(f"slice {outline.slice_index}: an outline is open; only loops enclose")
    planar = outline.polygon_mm(CORNERS)
    own = outline.frame
    if np.array_equal(own.axes, frame.axes):
        return planar + (own.axes[:2] @ (own.origin_mm - frame.origin_mm))
    if abs(float(own.axes[2] @ frame.axes[2]) - 1.0) > _PARALLEL:
        raise ValueError(f"slice {outline.slice_index}: its plane is not parallel to the first one")
    return frame.to_plane(own.to_part(planar))[:, :2]


def _measured(corners: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Areas (l,) and their centres (l, 2); (l, c, 2) in either sense of rotation."""
    pole = corners.mean(axis=1)
    x, y = np.moveaxis(corners - pole[:, None, :], 2, 0)
    turns = x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y
    signed = turns.sum(axis=1) / 2.0
    safe = np.where(np.abs(signed) > 0.0, signed, 1.0)
    moments = [((c + np.roll(c, -1, axis=1)) * turns).sum(axis=1) / (6.0 * safe) for c in (x, y)]
    return np.abs(signed), pole + np.stack(moments, axis=1)


def _nested(levels: IntArray, corners: FloatArray, areas: FloatArray) -> tuple[IntArray, IntArray]:
    count = len(levels)
    borders = np.flatnonzero(np.diff(levels, prepend=-1, append=-1)) if count else np.zeros(1)
    return _nest(borders.astype(np.int64), corners, areas)


@njit(cache=True)
def _nest(borders: IntArray, corners: FloatArray, areas: FloatArray) -> tuple[IntArray, IntArray]:
    """Find the smallest loop around each; `borders` part the slices."""
    count = len(areas)
    parents, depths = np.full(count, -1, np.int64), np.zeros(count, np.int64)
    for b in range(len(borders) - 1):
        for inner in range(borders[b], borders[b + 1]):
            for outer in range(borders[b], borders[b + 1]):
                if outer == inner or areas[outer] <= areas[inner]:
                    continue
                if not _mostly_inside(corners[inner], corners[outer]):
                    continue
                depths[inner] += 1
                if parents[inner] < 0 or areas[outer] < areas[parents[inner]]:
                    parents[inner] = outer
    return parents, depths


@njit(cache=True)
def _mostly_inside(inner: FloatArray, outer: FloatArray) -> bool:
    """Whether most of a sample of the corners lies inside; noise may let contours touch."""
    step = max(len(inner) // 16, 1)
    inside = tested = 0
    for n in range(0, len(inner), step):
        x, y = inner[n, 0], inner[n, 1]
        odd = False
        for i in range(len(outer)):
            x0, y0 = outer[i - 1, 0], outer[i - 1, 1]
            x1, y1 = outer[i, 0], outer[i, 1]
            if (y0 <= y) != (y1 <= y) and x < x0 + (y - y0) / (y1 - y0) * (x1 - x0):
                odd = not odd
        tested += 1
        inside += odd
    return 2 * inside > tested
