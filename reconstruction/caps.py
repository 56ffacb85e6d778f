"""Flat caps on the ends of a surface: a polygon into triangles that use each of its edges once.

Ears are cut off one by one. A contour that crosses itself has no true triangulation; then the
least bad corner is cut, so that the count of triangles, and with it the closedness of the mesh,
never depends on the contour being good.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray


def triangulate_polygon(corners_mm: FloatArray) -> IntArray:
    """Cut a closed polygon into triangles.

    Parameters
    ----------
    corners_mm : (n, 2), n >= 3
        Corners counter-clockwise, in the plane of the cap.

    Returns
    -------
    (n - 2, 3) int
        Corner indices, counter-clockwise; every edge of the polygon is in exactly one triangle.
    """
    if len(corners_mm) < 3:
        raise ValueError(f"a polygon has at least 3 corners, got {len(corners_mm)}")
    return np.asarray(_cut_ears(np.ascontiguousarray(corners_mm, dtype=np.float64)))


@njit(cache=True)
def _cut_ears(corners: FloatArray) -> IntArray:
    count = len(corners)
    following = np.roll(np.arange(count), -1)
    previous = np.roll(np.arange(count), 1)
    alive = np.ones(count, np.bool_)
    triangles = np.empty((count - 2, 3), np.int64)
    here = 0
    for cut in range(count - 2):
        ear = _find_ear(corners, previous, following, alive, here)
        before, after = previous[ear], following[ear]
        triangles[cut] = before, ear, after
        following[before], previous[after] = after, before
        alive[ear] = False
        # Skip one corner, so that ears are cut all round instead of fanning from one place.
        here = following[after]
    return triangles


@njit(cache=True)
def _find_ear(
    corners: FloatArray, previous: IntArray, following: IntArray, alive: BoolArray, here: int
) -> int:
    ear, best, fallback = here, -np.inf, here
    while True:
        before, after = previous[ear], following[ear]
        area = _turn(corners[before], corners[ear], corners[after])
        if area > best:
            best, fallback = area, ear
        if area > 0.0 and _is_empty(corners, following, before, ear, after):
            return ear
        ear = after
        if ear == here:
            return fallback


@njit(cache=True)
def _is_empty(corners: FloatArray, following: IntArray, before: int, ear: int, after: int) -> bool:
    a, b, c = corners[before], corners[ear], corners[after]
    other = following[after]
    while other != before:
        p = corners[other]
        if _turn(a, b, p) >= 0.0 and _turn(b, c, p) >= 0.0 and _turn(c, a, p) >= 0.0:
            return False
        other = following[other]
    return True


@njit(cache=True)
def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
