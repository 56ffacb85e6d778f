"""How far the loops of two slices cover each other, row by row.

Every loop is cut by rows of its own, so that a small one is measured as well as a large one. In a
row, everything is exact::

    lower    p -----------[    hole    ]------ p
    upper       q ------------[ hole ]-------------- q
    row      ---|dddddddd|----|======|-|ddddd|-----    d: both regions, =: the holes of both

Two regions meet directly where both have material, or both void. The loops agree also where both
enclose a place and neither region has it: a thin wall that slopes agrees with itself in the next
slice through the hole in it, though it may not meet itself at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.loops import Loops

_ROWS = 24  # across every loop
_DIRECT, _AGREED, _COMMON = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """Loops of a lower slice (a) and an upper one (b), and shares of areas; 0 for loop and hole.

    The last row and column of `direct` stand for what is around all loops: void without a border.
    """

    direct: FloatArray  # (a + 1, b + 1), common part of two regions, of the smaller
    agreement: FloatArray  # (a, b), where the loops agree, of what the smaller encloses
    likeness: FloatArray  # (a, b), what both enclose over what any does


def measure_overlaps(loops: Loops, lower: IntArray, upper: IntArray) -> Overlaps:
    """Compare loops (a,) with loops (b,), given by their numbers."""
    numbers = np.concatenate([lower, upper])
    a, n = len(lower), len(numbers)
    shared, enclosed, owned = _sweep(
        loops.corners_mm[numbers], loops.depths[numbers], loops.holes[numbers], a
    )
    # Of two measures of the same area, the one in the rows of the smaller loop is the finer.
    by_lower = enclosed[:a, None] <= enclosed[None, a:]
    areas = np.where(by_lower, shared[:, :a, a:n], shared[:, a:, :a].transpose(0, 2, 1))
    smaller = np.minimum(enclosed[:a, None], enclosed[None, a:])
    direct = np.ones((a + 1, n - a + 1))
    direct[:a, -1] = _share(shared[_DIRECT, :a, n], owned[:a])
    direct[-1, :-1] = _share(shared[_DIRECT, a:, n], owned[a:])
    direct[:a, :-1] = _share(areas[_DIRECT], np.minimum(owned[:a, None], owned[None, a:]))
    united = enclosed[:a, None] + enclosed[None, a:] - areas[_COMMON]
    return Overlaps(direct, _share(areas[_AGREED], smaller), _share(areas[_COMMON], united))


def likeness_to(loops: Loops, one: int, others: IntArray) -> FloatArray:
    """Area common to a loop and each of others (k,), over united area; be they holes or not."""
    corners = loops.corners_mm[np.append(one, others)]
    nothing = np.zeros(len(corners), dtype=np.int64)
    shared, enclosed, _ = _sweep(corners, nothing, nothing > 0, 1)
    common = shared[_COMMON, 0, 1 : len(corners)]
    return _share(common, enclosed[0] + enclosed[1:] - common)


def _share(part: FloatArray, whole: FloatArray) -> FloatArray:
    return part / np.maximum(whole, 1e-300)


@njit(cache=True)
def _sweep(
    corners: FloatArray, depths: IntArray, holes: BoolArray, lower: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Areas that loops share (3, n, n + 1), that each encloses (n,), and of its region (n,).

    Loops 0..lower-1 are of one slice, the others of the other; each is measured in its own rows
    against those of the other slice and, in the last column, against what is around them.
    """
    n, count = len(corners), corners.shape[1]
    shared, enclosed, owned = np.zeros((3, n, n + 1)), np.zeros(n), np.zeros(n)
    low, high = np.empty((n, 2)), np.empty((n, 2))
    for each in range(n):
        for k in range(2):
            low[each, k], high[each, k] = corners[each, :, k].min(), corners[each, :, k].max()
    places, owners = np.empty(n * count), np.empty(n * count, np.int64)
    inside, near = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for p in range(n):
        for each in range(n):
            near[each] = (low[each] <= high[p]).all() and (low[p] <= high[each]).all()
        step = (high[p, 1] - low[p, 1]) / _ROWS
        own = (0, lower) if p < lower else (lower, n)
        other = (lower, n) if p < lower else (0, lower)
        for row in range(_ROWS):
            events = _cross(corners, near, low[p, 1] + (row + 0.5) * step, places, owners)
            inside[:] = False
            for event in range(events - 1):
                inside[owners[event]] = not inside[owners[event]]
                area = (places[event + 1] - places[event]) * step
                if inside[p] and area > 0.0:
                    mine = _innermost(inside, depths, own) == p
                    enclosed[p] += area
                    owned[p] += area if mine else 0.0
                    _share_out(p, area, mine, inside, depths, holes, other, shared)
    return shared, enclosed, owned


@njit(cache=True)
def _share_out(
    p: int,
    area: float,
    mine: bool,  # noqa: FBT001
    inside: BoolArray,
    depths: IntArray,
    holes: BoolArray,
    other: tuple[int, int],
    shared: FloatArray,
) -> None:
    """Add a stretch of a row inside of p to what it shares with each loop around the stretch."""
    theirs = _innermost(inside, depths, other)
    for q in range(other[0], other[1]):
        if inside[q] and holes[q] == holes[p]:
            shared[_COMMON, p, q] += area
            if mine == (theirs == q):
                shared[_AGREED, p, q] += area
            if mine and theirs == q:
                shared[_DIRECT, p, q] += area
    if holes[p] and mine and theirs < 0:
        shared[_DIRECT, p, len(depths)] += area


@njit(cache=True)
def _cross(
    corners: FloatArray, near: BoolArray, y: float, places: FloatArray, owners: IntArray
) -> int:
    """Where a row crosses loops that are near, sorted; how many places that are."""
    events = 0
    for each in range(len(corners)):
        if not near[each]:
            continue
        x0, y0 = corners[each, -1, 0], corners[each, -1, 1]
        for i in range(corners.shape[1]):
            x1, y1 = corners[each, i, 0], corners[each, i, 1]
            if (y0 <= y) != (y1 <= y):
                x = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
                at = events
                while at > 0 and places[at - 1] > x:
                    places[at], owners[at] = places[at - 1], owners[at - 1]
                    at -= 1
                places[at], owners[at] = x, each
                events += 1
            x0, y0 = x1, y1
    return events


@njit(cache=True)
def _innermost(inside: BoolArray, depths: IntArray, among: tuple[int, int]) -> int:
    found = -1
    for each in range(among[0], among[1]):
        if inside[each] and (found < 0 or depths[each] > depths[found]):
            found = each
    return found
