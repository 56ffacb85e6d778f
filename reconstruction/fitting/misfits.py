r"""Whether a corner is one: the raw points about it lie as near to it as to the smooth curve.

Arc cells beside a corner may hold points of both walls; the points themselves can tell. To a corner
that overshoots a round bend they are far. ::

        o                    o
       / \                  ./.\.          ( ) the smooth curve
      /(.)\                 /(.)\
     /(. .)\              ./(. .)\.
     a bend               a corner
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fitting.smoothing import Fit
from reconstruction.fitting.spline import evaluate

MIXED = 1.0  # spans to either side of a corner: cells so near may hold points of both walls
_AROUND = 6.0  # spans of the smooth curve, which rounds it
_FARTHEST = 5.0  # standard deviations that a point counts at most
_PLACES = 121


def excess(sharp: FloatArray, fit: Fit, points: FloatArray, cut: float, sigma_mm: float) -> float:
    """Squared standard deviations by which the points about a corner prefer the smooth curve.

    A corner has two sides for a point to be near to, and is longer for it: points spread evenly
    along a curve are the less likely anywhere on it, the longer it is.

    Parameters
    ----------
    sharp
        (k, 2), a line around the corner.
    fit
        The smooth curve, about its parameter `cut`.
    points
        (n, 2), the raw ones; those are counted whose nearest place of `sharp` is not an end of it.
    """
    t = cut + np.linspace(-_AROUND, _AROUND, _PLACES)
    t = np.mod(t, fit.spans) if fit.closed else np.clip(t, 0.0, fit.spans)
    smooth = evaluate(fit.control_mm, t)[0]
    far = _FARTHEST * sigma_mm
    margin = max(far, _length(sharp) / 2)
    near = _between(points, sharp.min(axis=0) - margin, sharp.max(axis=0) + margin)
    difference, count = _difference(points[near], sharp, smooth, far)
    longer = _length(sharp) / max(_length(_beside(smooth, sharp)), 1e-300)
    return difference / sigma_mm**2 + 2.0 * count * math.log(longer)


def _beside(line: FloatArray, other: FloatArray) -> FloatArray:
    """The stretch of a polyline between the feet of another's ends."""
    start, end = (int(np.argmin(((line - place) ** 2).sum(axis=1))) for place in other[[0, -1]])
    return line[start : end + 1]


def _length(line: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


@njit(cache=True, nogil=True, error_model="numpy")
def _difference(
    points: FloatArray, sharp: FloatArray, smooth: FloatArray, far: float
) -> tuple[float, int]:
    """Sum over points of their squares from one polyline less those from another, up to far**2.

    Of points whose nearest corner of the first is not an end of it; and how many they are.
    """
    total, count = 0.0, 0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        square, at = _square(x, y, sharp)
        if 0 < at < len(sharp) - 1:
            other, _ = _square(x, y, smooth)
            total += min(square, far * far) - min(other, far * far)
            count += 1
    return total, count


@njit(cache=True, nogil=True, error_model="numpy")
def _square(x: float, y: float, line: FloatArray) -> tuple[float, int]:
    """Squared distance from the two ways beside the nearest corner of a polyline; that corner."""
    best, at = math.inf, 0
    for m in range(len(line)):
        dx, dy = x - line[m, 0], y - line[m, 1]
        square = dx * dx + dy * dy
        if square < best:
            best, at = square, m
    for m in range(max(at - 1, 0), min(at + 1, len(line) - 1)):
        wx, wy = line[m + 1, 0] - line[m, 0], line[m + 1, 1] - line[m, 1]
        dx, dy = x - line[m, 0], y - line[m, 1]
        share = (dx * wx + dy * wy) / max(wx * wx + wy * wy, 1e-300)
        share = min(max(share, 0.0), 1.0)
        dx, dy = dx - share * wx, dy - share * wy
        best = min(best, dx * dx + dy * dy)
    return best, at


@njit(cache=True, nogil=True)
def _between(points: FloatArray, low: FloatArray, high: FloatArray) -> IntArray:
    """Rows of the points in a box; there may be half a million, and few of them in it."""
    rows = np.empty(len(points) + 1, np.int64)
    held = 0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        rows[held] = n  # without a branch, which nobody could foretell
        held += (low[0] <= x) & (x <= high[0]) & (low[1] <= y) & (y <= high[1])
    return rows[:held].copy()
