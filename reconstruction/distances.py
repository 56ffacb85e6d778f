"""Signed distances of points to a polygon in the plane: what a section's residual is made of.

Segments that follow each other lie together, so their order is a tree of boxes as it is: a point
goes down into the nearer box first, and into no box that can hold nothing nearer than it has
found. The answer is exact, near and far.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray

_LEAF = 4  # segments
_DEEP = 64  # a point's way down holds a box a level


def polygon_distances(
    points_mm: FloatArray, polygon_mm: FloatArray, *, closed: bool = True
) -> FloatArray:
    """Distance of every point to the polygon, negative on the left of its way.

    A polygon that runs counter-clockwise has its inside on the left: inside is negative.

    Parameters
    ----------
    points_mm : (n, 2)
    polygon_mm : (m, 2), m >= 2
        Corners in order.
    closed
        Whether the last one is joined to the first.

    Returns
    -------
    (n,) in mm
    """
    return distances_to_nearest(points_mm, [(polygon_mm, closed)])


def distances_to_nearest(
    points_mm: FloatArray, polygons: Sequence[tuple[FloatArray, bool]]
) -> FloatArray:
    """Distance of every point to the nearest of some polygons, negative on the left of its way.

    Parameters
    ----------
    points_mm : (n, 2)
    polygons
        Of each the corners (m, 2) and whether it is closed; the largest first are fastest, for a
        point does not look farther than what it has found already.

    Returns
    -------
    (n,) in mm; of two polygons equally near the first tells the sign; inf without any
    """
    points = np.ascontiguousarray(points_mm, dtype=np.float64)
    distances = np.full(len(points), np.inf)
    for polygon_mm, closed in polygons:
        corners = np.ascontiguousarray(polygon_mm, dtype=np.float64)
        _measure(points, corners, len(corners) - (not closed), distances)
    return distances


@njit(cache=True, nogil=True, error_model="numpy")
def _measure(points: FloatArray, corners: FloatArray, segments: int, distances: FloatArray) -> None:
    """Put the signed distance to the polygon where it is smaller than what stands there."""
    lines = _lines(corners, segments)
    boxes = _boxes(corners, segments)
    leaves = len(boxes) // 2
    waiting, squares = np.empty(_DEEP, np.int64), np.empty(_DEEP)
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        best, nearest = distances[n] * distances[n], -1
        waiting[0], squares[0], count = 1, _square_to_box(x, y, boxes, 1), 1
        while count > 0:
            count -= 1
            if squares[count] >= best:
                continue
            box = waiting[count]
            while box < leaves:
                near, far = 2 * box, 2 * box + 1
                near_square = _square_to_box(x, y, boxes, near)
                far_square = _square_to_box(x, y, boxes, far)
                if far_square < near_square:
                    near, far = far, near
                    near_square, far_square = far_square, near_square
                if far_square < best:
                    waiting[count], squares[count] = far, far_square
                    count += 1
                box = near
                if near_square >= best:
                    break
            if box >= leaves:
                first = (box - leaves) * _LEAF
                for k in range(first, min(first + _LEAF, segments)):
                    square = _square_to(x, y, lines, k)
                    if square < best:
                        best, nearest = square, k
        if nearest >= 0:
            distances[n] = math.sqrt(best) * _side(x, y, corners, segments, nearest)


@njit(cache=True, nogil=True)
def _boxes(corners: FloatArray, segments: int) -> FloatArray:
    """Low and high corners of the boxes of the tree, (2 leaves, 4); inf where one is empty.

    In box b lie the boxes 2 b and 2 b + 1; the root is 1, the last half are the leaves.
    """
    leaves = 1
    while leaves * _LEAF < segments:
        leaves *= 2
    boxes = np.full((2 * leaves, 4), np.inf)
    boxes[:, 2:] = -np.inf
    for k in range(segments):
        box = boxes[leaves + k // _LEAF]
        for corner in (k, (k + 1) % len(corners)):
            for axis in range(2):
                box[axis] = min(box[axis], corners[corner, axis])
                box[2 + axis] = max(box[2 + axis], corners[corner, axis])
    for b in range(leaves - 1, 0, -1):
        for axis in range(2):
            boxes[b, axis] = min(boxes[2 * b, axis], boxes[2 * b + 1, axis])
            boxes[b, 2 + axis] = max(boxes[2 * b, 2 + axis], boxes[2 * b + 1, 2 + axis])
    return boxes


@njit(cache=True, nogil=True, inline="always")
def _square_to_box(x: float, y: float, boxes: FloatArray, b: int) -> float:
    dx = max(boxes[b, 0] - x, x - boxes[b, 2], 0.0)
    dy = max(boxes[b, 1] - y, y - boxes[b, 3], 0.0)
    return float(dx * dx + dy * dy)


@njit(cache=True, nogil=True)
def _lines(corners: FloatArray, segments: int) -> FloatArray:
    """Start, way and inverse square length of every segment, (segments, 5); 0 without length."""
    lines = np.empty((segments, 5))
    for k in range(segments):
        a, b = corners[k], corners[(k + 1) % len(corners)]
        ux, uy = b[0] - a[0], b[1] - a[1]
        square = ux * ux + uy * uy
        lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3] = a[0], a[1], ux, uy
        lines[k, 4] = 1.0 / square if square > 0.0 else 0.0
    return lines


@njit(cache=True, nogil=True, inline="always")
def _square_to(x: float, y: float, lines: FloatArray, k: int) -> float:
    wx, wy = x - lines[k, 0], y - lines[k, 1]
    ux, uy = lines[k, 2], lines[k, 3]
    share = min(max((wx * ux + wy * uy) * lines[k, 4], 0.0), 1.0)
    dx, dy = wx - share * ux, wy - share * uy
    return float(dx * dx + dy * dy)


@njit(cache=True)
def _side(x: float, y: float, corners: FloatArray, segments: int, k: int) -> float:
    """-1 on the left of segment k, +1 on its right; at a corner the bend of both decides."""
    count = len(corners)
    is_first, is_last = k == 0 and segments < count, k == segments - 1 and segments < count
    a, b = corners[k], corners[(k + 1) % count]
    ux, uy = b[0] - a[0], b[1] - a[1]
    share = (x - a[0]) * ux + (y - a[1]) * uy
    vx, vy = ux, uy
    px, py = a[0], a[1]
    if share <= 0.0 and not is_first:
        vx, vy = _bisect(_way(corners, k - 1, -1), _way(corners, k, 1))
    elif share >= ux * ux + uy * uy and not is_last:
        vx, vy = _bisect(_way(corners, k, -1), _way(corners, k + 1, 1))
        px, py = b[0], b[1]
    return -1.0 if vx * (y - py) - vy * (x - px) > 0.0 else 1.0


@njit(cache=True)
def _way(corners: FloatArray, k: int, step: int) -> tuple[float, float]:
    """Direction of segment k, or of the first one after it in steps that has a length."""
    count = len(corners)
    for n in range(k, k + step * count, step):
        a, b = corners[n % count], corners[(n + 1) % count]
        if a[0] != b[0] or a[1] != b[1]:
            break
    return b[0] - a[0], b[1] - a[1]


@njit(cache=True)
def _bisect(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    a = max(math.hypot(one[0], one[1]), 1e-300)
    b = max(math.hypot(other[0], other[1]), 1e-300)
    return one[0] / a + other[0] / b, one[1] / a + other[1] / b
