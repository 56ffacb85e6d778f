"""Signed distances of points to a polygon in the plane: what a section's residual is made of.

Segments are filed in a grid of buckets; a point looks through the rings of buckets around its own
until no farther ring can hold a nearer segment, so the answer is exact, near and far.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray

_BUCKETS_A_SEGMENT = 4


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
    corners = np.ascontiguousarray(polygon_mm, dtype=np.float64)
    low = corners.min(axis=0)
    sides = np.maximum(corners.max(axis=0) - low, 1e-9)
    edge = math.sqrt(float(sides[0] * sides[1]) / (_BUCKETS_A_SEGMENT * len(corners)))
    edge = max(edge, float(sides.max()) / 1024)
    shape = np.maximum(1, np.ceil(sides / edge)).astype(np.int64)
    segments = len(corners) - (not closed)
    starts, filed = _file_segments(corners, segments, low, edge, shape)
    distances = np.empty(len(points_mm))
    points = np.ascontiguousarray(points_mm)
    _measure(points, corners, segments, low, edge, shape, starts, filed, distances)
    return distances


@njit(cache=True)
def _file_segments(
    corners: FloatArray, segments: int, low: FloatArray, edge: float, shape: IntArray
) -> tuple[IntArray, IntArray]:
    """Segments by bucket, compressed: bucket b holds ``filed[starts[b]:starts[b + 1]]``."""
    starts = np.zeros(shape[0] * shape[1] + 1, np.int64)
    for counting in (True, False):
        if not counting:
            filed = np.empty(starts[-1], np.int64)
            cursors = starts[:-1].copy()
        for k in range(segments):
            a, b = corners[k], corners[(k + 1) % len(corners)]
            i0 = _bucket(min(a[0], b[0]), low[0], edge, shape[0])
            i1 = _bucket(max(a[0], b[0]), low[0], edge, shape[0])
            j0 = _bucket(min(a[1], b[1]), low[1], edge, shape[1])
            j1 = _bucket(max(a[1], b[1]), low[1], edge, shape[1])
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    if counting:
                        starts[i * shape[1] + j + 1] += 1
                    else:
                        filed[cursors[i * shape[1] + j]] = k
                        cursors[i * shape[1] + j] += 1
        if counting:
            starts = np.cumsum(starts)
    return starts, filed


@njit(cache=True)
def _bucket(value: float, low: float, edge: float, count: int) -> int:
    return min(max(math.floor((value - low) / edge), 0), count - 1)


@njit(cache=True)
def _measure(
    points: FloatArray,
    corners: FloatArray,
    segments: int,
    low: FloatArray,
    edge: float,
    shape: IntArray,
    starts: IntArray,
    filed: IntArray,
    distances: FloatArray,
) -> None:
    high_x, high_y = low[0] + shape[0] * edge, low[1] + shape[1] * edge
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        # How far the point is outside the grid bounds everything in it from below (a convex box).
        away_x = max(low[0] - x, 0.0, x - high_x)
        away_y = max(low[1] - y, 0.0, y - high_y)
        away = away_x * away_x + away_y * away_y
        row = _bucket(x, low[0], edge, shape[0])
        column = _bucket(y, low[1], edge, shape[1])
        best, nearest = np.inf, -1
        ring = 0
        while ring <= max(shape[0], shape[1]):
            for i in range(max(0, row - ring), min(shape[0], row + ring + 1)):
                inner = abs(i - row) < ring
                for j in range(column - ring, column + ring + 1, 2 * ring if inner else 1):
                    if j < 0 or j >= shape[1]:
                        continue
                    bucket = i * shape[1] + j
                    for f in range(starts[bucket], starts[bucket + 1]):
                        square = _square_to_segment(x, y, corners, filed[f])
                        if square < best:
                            best, nearest = square, filed[f]
            if best <= away + (ring * edge) ** 2:
                break
            ring += 1
        distances[n] = math.sqrt(best) * _side(x, y, corners, segments, nearest)


@njit(cache=True)
def _square_to_segment(x: float, y: float, corners: FloatArray, k: int) -> float:
    a, b = corners[k], corners[(k + 1) % len(corners)]
    ux, uy = b[0] - a[0], b[1] - a[1]
    wx, wy = x - a[0], y - a[1]
    length = ux * ux + uy * uy
    share = min(max((wx * ux + wy * uy) / length, 0.0), 1.0) if length > 0.0 else 0.0
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
