"""What looks wrong in a stack of contours, said with the slice and the quantity."""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.doubt import Doubt
from reconstruction.skinning.loops import AROUND, Loops

_SAME = 1e-9  # of the size: closer heights or contours are one and the same
_FAR = 8.0  # times what is usual in the branch
_NOTABLE = 0.03  # of a contour's radius: less is no fault
_GROSS = 0.5  # of a contour's radius: the neighbours alone are the better witnesses
_WIDE = 2.5  # times the usual scatter across a contour
_LEAST_USUAL = 5  # contours, to say what is usual
_ARC = 8  # corners of a polygon looked at together


def unusable_loops(loops: Loops, doubts: list[Doubt]) -> BoolArray:
    """Loops that bound nothing: a hole in no outline, an outline in another without a hole."""
    unusable = np.zeros(len(loops), dtype=np.bool_)
    for number, outline in enumerate(loops.outlines):
        parent = int(loops.parents[number])
        host = parent == AROUND or loops.outlines[parent].hole
        if outline.hole == host:
            where = "lies in no outline" if outline.hole else "lies in another without a hole"
            what = f"{'a hole' if outline.hole else 'an outline'} {loops.across(number)} {where}"
            doubts.append(Doubt(outline.slice_index, f"{what}; left out"))
            unusable[number] = True
    return unusable


def crossings(loops: Loops) -> BoolArray:
    """Whether a loop crosses itself, and whether it crosses an earlier one of its slice, (l, 2)."""
    return np.asarray(_crossing(loops.levels, loops.corners_mm))


def scattered(loops: Loops) -> BoolArray:
    """Which contours' points scatter far more than usual, (l,): two may have run into one."""
    sigma = np.array([each.fitted.sigma_mm for each in loops.outlines])
    return np.asarray(sigma > _WIDE * np.median(sigma)) if len(sigma) else np.zeros(0, np.bool_)


def doubtful_shapes(loops: Loops, crossing: BoolArray) -> list[Doubt]:
    """Contours that cross themselves or each other, and slices that repeat the one below."""
    doubts = []
    for number in np.flatnonzero(crossing.any(axis=1)):
        whom = "itself" if crossing[number, 0] else "another one"
        what = f"a contour {loops.across(int(number))} crosses {whom}"
        doubts.append(Doubt(loops.outlines[number].slice_index, what))
    repeated = [int(loops.stack.indices[level]) for level in _repeated(loops)]
    if repeated:
        many = f" (as are {len(repeated) - 1} more)" if len(repeated) > 1 else ""
        what = f"its contours are those of the slice below, exactly{many}; was it recorded twice?"
        doubts.append(Doubt(repeated[0], what))
    return doubts


def _repeated(loops: Loops) -> list[int]:
    levels = np.unique(loops.levels)
    found = []
    for level in levels[1:]:
        here, below = loops.at(int(level)), loops.at(int(level) - 1)
        if len(here) == len(below) and np.allclose(
            loops.corners_mm[here],
            loops.corners_mm[below],
            rtol=0.0,
            atol=_SAME * float(loops.radii_mm[here].max()),
        ):
            found.append(int(level))
    return found


def off_the_line(loops: Loops, chain: list[int]) -> list[tuple[Doubt, int, bool]]:
    """Contours of a branch that lie far off the line of their neighbours.

    Returns
    -------
    The doubt, the contour's number, and whether it is so far off that it is better left out.
    """
    found = []
    radii = loops.radii_mm[chain]
    centres = _sticking_out(loops.centres_mm[chain], loops.heights_mm[chain])
    widths = _sticking_out(radii[:, None], loops.heights_mm[chain])
    for away, says, where in (
        (centres, "lies", "off the line of its neighbours"),
        (widths, "is", "too wide or too narrow between its neighbours"),
    ):
        sticking, usual = away
        for at in np.flatnonzero(sticking > np.maximum(_FAR * usual, _NOTABLE * radii)):
            number, gross = chain[at], says == "lies" and bool(sticking[at] > _GROSS * radii[at])
            what = f"a contour {loops.across(number)} {says} {sticking[at]:.3g} mm {where}"
            what += f" (usual: {usual:.2g} mm){'; left out' if gross else ''}"
            found.append((Doubt(loops.outlines[number].slice_index, what), number, gross))
    return found


def _sticking_out(values: FloatArray, heights: FloatArray) -> tuple[FloatArray, float]:
    """How far values (m, d) stick out of a row, and how far they usually are off the line.

    One that sticks out is off the line between its neighbours, and they, for it, are off theirs
    by half of that to the other side; so steps, bends and the ends of the row have 0.
    """
    sticking = np.zeros(len(values))
    if len(values) < _LEAST_USUAL:
        return sticking, 0.0
    share = (heights[1:-1] - heights[:-2]) / (heights[2:] - heights[:-2])
    off = values[1:-1] - values[:-2] - share[:, None] * (values[2:] - values[:-2])
    sizes = np.linalg.norm(off, axis=1)
    against = -np.einsum("kd,kd->k", off[1:], off[:-1]) > 0.25 * sizes[1:] * sizes[:-1]
    beside = np.minimum(sizes[1:], sizes[:-1]) > 0.25 * np.maximum(sizes[1:], sizes[:-1])
    opposed = np.concatenate([[True], against & beside, [True]])
    peak = (sizes >= np.append(sizes[1:], 0.0)) & (sizes >= np.append(0.0, sizes[:-1]))
    sticking[1:-1] = np.where(opposed[1:] & opposed[:-1] & peak, sizes, 0.0)
    return sticking, float(np.median(sizes))


@njit(cache=True)
def _crossing(levels: IntArray, corners: FloatArray) -> BoolArray:
    loops, arcs = len(corners), corners.shape[1] // _ARC
    found = np.zeros((loops, 2), np.bool_)
    boxes = np.empty((loops, arcs, 4))
    for one in range(loops):
        for arc in range(arcs):
            boxes[one, arc] = _box(corners[one], arc)
        for other in range(one, -1, -1):
            if levels[other] != levels[one]:
                break
            kind = 0 if one == other else 1
            for i in range(arcs):
                for j in range(i if kind == 0 else 0, arcs):
                    if not found[one, kind] and _touch(boxes[one, i], boxes[other, j]):
                        found[one, kind] = _arcs_cross(corners[one], i, corners[other], j, kind)
    return found


@njit(cache=True)
def _box(loop: FloatArray, arc: int) -> FloatArray:
    """Lowest and highest coordinates of an arc's edges, the last corner's successor included."""
    box = np.array([np.inf, np.inf, -np.inf, -np.inf])
    for k in range(arc * _ARC, (arc + 1) * _ARC + 1):
        x, y = loop[k % len(loop), 0], loop[k % len(loop), 1]
        box[0], box[1] = min(box[0], x), min(box[1], y)
        box[2], box[3] = max(box[2], x), max(box[3], y)
    return box


@njit(cache=True)
def _touch(one: FloatArray, other: FloatArray) -> bool:
    apart = one[2] < other[0] or other[2] < one[0] or one[3] < other[1] or other[3] < one[1]
    return not apart


@njit(cache=True)
def _arcs_cross(one: FloatArray, arc: int, other: FloatArray, far: int, kind: int) -> bool:
    """Whether two arcs cross; of one loop (kind 0), edges that share a corner do not."""
    count = len(one)
    for i in range(arc * _ARC, (arc + 1) * _ARC):
        for j in range(far * _ARC, (far + 1) * _ARC):
            beside = kind == 0 and (j <= i + 1 or i + count - j == 1)
            if not beside and _cross(one, i, other, j):
                return True
    return False


@njit(cache=True)
def _cross(one: FloatArray, i: int, other: FloatArray, j: int) -> bool:
    """Whether the edge from corner i crosses the edge from corner j."""
    ax, ay = one[i, 0], one[i, 1]
    bx, by = one[(i + 1) % len(one), 0], one[(i + 1) % len(one), 1]
    cx, cy = other[j, 0], other[j, 1]
    dx, dy = other[(j + 1) % len(other), 0], other[(j + 1) % len(other), 1]
    c = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    d = (bx - ax) * (dy - ay) - (by - ay) * (dx - ax)
    a = (dx - cx) * (ay - cy) - (dy - cy) * (ax - cx)
    b = (dx - cx) * (by - cy) - (dy - cy) * (bx - cx)
    return bool(c * d < 0.0 and a * b < 0.0)
