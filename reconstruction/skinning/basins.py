"""What is inside of a wall of points that has holes: space divided where it is narrowest.

From the outside, and from places deep inside, space is flooded in order of how far it is from all
points: wide places first, holes between points last. So the two floods meet in the wall, and
where it has a hole, in its narrowest place, however large that is; yet a slot is filled through its
mouth, as long as that is wider than the holes are::

    outside ->  :   .  . inside . .   :        (Beucher, Lantuejoul 1979: the watershed)
                :     ______________  :
                 . . :  <- outside   .:        a slot
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

from reconstruction.arrays import BoolArray, IntArray
from reconstruction.errors import Unfittable

_LEAST_CORE = 3.0  # grains from all points: deep inside
_SIZES = 8  # of cores, from the largest to that
_LEVELS = 256
_OUTSIDE, _INSIDE = 1, 2


def inside_of(taken: BoolArray, step_mm: float, *, grain_mm: float, margin_mm: float) -> BoolArray:
    """Places of a grid (i, j, k) that lie inside of the points, whose places are taken.

    Parameters
    ----------
    margin_mm
        How far the grid reaches beyond all points.

    Raises
    ------
    Unfittable
        Nothing lies deep inside: the part is thin, or open, everywhere.
    """
    away = np.asarray(distance_transform_edt(~taken)) * step_mm
    widest = max(margin_mm, _LEAST_CORE * grain_mm)
    marks = np.zeros(taken.shape, np.int8)
    for reach in np.geomspace(widest, _LEAST_CORE * grain_mm, _SIZES):
        regions, _ = label(away > reach)
        outside = regions == regions[0, 0, 0]
        if reach == widest:
            marks[outside] = _OUTSIDE
        marks[(regions > 0) & ~outside & (marks == 0)] = _INSIDE
    if not (marks == _INSIDE).any():
        raise Unfittable("nothing lies deep inside of the points; is the part thin everywhere?")
    narrow = np.clip((_LEVELS - 1) * (1.0 - away / widest), 0.0, _LEVELS - 1.0)
    _flood(marks, narrow.astype(np.uint8))
    return np.asarray(marks == _INSIDE)


@njit(cache=True)
def _flood(marks: NDArray[np.int8], narrow: NDArray[np.uint8]) -> None:
    """Spread marks (i, j, k) to where there are none, by level (i, j, k), low ones first."""
    size_i, size_j, size_k = marks.shape
    flat, levels = marks.ravel(), narrow.ravel()
    following = np.full(len(flat), -1, np.int64)
    first, last = np.full(_LEVELS, -1, np.int64), np.full(_LEVELS, -1, np.int64)
    for place in range(len(flat)):
        if flat[place] > 0:
            _queue(place, levels[place], first, last, following)
    for level in range(_LEVELS):
        while first[level] >= 0:
            place = first[level]
            first[level] = following[place]
            i, rest = divmod(place, size_j * size_k)
            j, k = divmod(rest, size_k)
            for axis in range(3):
                at = (i, j, k)[axis]
                stride = (size_j * size_k, size_k, 1)[axis]
                for way in (-1, 1):
                    if not 0 <= at + way < (size_i, size_j, size_k)[axis]:
                        continue
                    beside = place + way * stride
                    if flat[beside] == 0:
                        flat[beside] = flat[place]
                        _queue(beside, max(level, levels[beside]), first, last, following)


@njit(cache=True)
def _queue(place: int, level: int, first: IntArray, last: IntArray, following: IntArray) -> None:
    following[place] = -1
    if first[level] < 0:
        first[level] = place
    else:
        following[last[level]] = place
    last[level] = place
