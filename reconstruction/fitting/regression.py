"""Parabolas through the points of a band in windows along it: loops over every point of a row.

Local polynomials (after Cleveland 1979), so that neither a bend nor an end draws the middle inward;
points far across have no say. Lengths along the row are in reaches.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray

STEP = 0.5  # reaches from node to node
WINDOW = 1.25  # reaches to either side of a node that its parabola sees, at least
_WIDEST = 4.0  # reaches: at most, where it would not know its middle
_ENOUGH = 24  # points in a window: more need no wider one
_LEAST_POINTS = 4  # in a window; it grows until it has them
_PARABOLA = 5.0  # points; fewer in a window get a line
_LOOSE = 0.6  # variances of a point: a middle known no better is not known
FAR = 4.0  # standard deviations: farther across, a point has no say
_FEW = 16  # places in a window, among which a stray must be looked for one by one ...
_WORSE = 1.25  # ... and how much farther than far it must be from the others' fit
EXACT = 1e-9  # of the slice's size: noise of the arithmetic

# Place, slope and bend of a window's parabola: x + sx u + bx u^2, y + sy u + by u^2; and the
# variance of its middle, in variances of a point.
Parabola = tuple[float, float, float, float, float, float, float]
_NOTHING = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def regress(
    along: FloatArray,
    places: FloatArray,
    grid: FloatArray,
    spread: FloatArray,
    widest: FloatArray,
    period: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middle of the band, deviation across it and points close by at every place of the grid.

    Places are in order of `along`; those of a closed row repeat after a period. A window is as wide
    as it must be to know its middle, up to the widest it may be, and to hold a few points.
    """
    count = len(along)
    middles, sigma = np.empty((len(grid), 2)), np.empty(len(grid))
    close = np.empty(len(grid))
    for g in range(len(grid)):
        far = FAR * spread[g] + EXACT if spread[g] < np.inf else np.inf
        window = WINDOW
        while True:
            first, last = _within(along, grid[g], window, period)
            # About one of the places, that differences of large coordinates do not cancel.
            origin = places[first % count]
            fit = _fitted(along, places, origin, grid[g], window, first, last, far, period)
            few = last - first < min(_LEAST_POINTS, count) and window < 1e6
            scarce = last - first < _ENOUGH and window < widest[g]
            vague = fit[6] > _LOOSE and window < _WIDEST
            if not (few or scarce or vague):
                break
            window *= 1.25
        middles[g, 0], middles[g, 1] = origin[0] + fit[0], origin[1] + fit[1]
        sigma[g], close[g] = _scatter(along, places, origin, grid[g], first, last, fit, far, period)
    return middles, sigma, close


@njit(cache=True, nogil=True, error_model="numpy")
def _fitted(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    window: float,
    first: int,
    last: int,
    far: float,
    period: float,
) -> Parabola:
    """The fit in a window, once more without what lies far from it."""
    fit = _parabola(along, places, origin, at, window, first, last, last, _NOTHING, np.inf, period)
    if far == np.inf:
        return fit
    if last - first <= _FEW:
        fit = _without_the_worst(along, places, origin, at, window, first, last, fit, far, period)
    return _parabola(along, places, origin, at, window, first, last, last, fit, far, period)


@njit(cache=True, nogil=True, inline="always")
def _within(along: FloatArray, at: float, window: float, period: float) -> tuple[int, int]:
    """First and last + 1 of the places in a window; below 0 and from count on they repeat."""
    count = len(along)
    first = np.searchsorted(along, at - window)
    last = np.searchsorted(along, at + window)
    if period < np.inf:
        if at - window < 0.0:
            before = np.searchsorted(along, at - window + period)
            first = (before if before > last else last) - count
        if at + window > period:
            last = np.searchsorted(along, at + window - period) + count
        if last > first + count:
            last = first + count
    return int(first), int(last)


@njit(cache=True, nogil=True, inline="always")
def _wrapped(m: int, count: int, period: float) -> tuple[int, float]:
    """Row of a repeated place, and how far its repetition is moved along."""
    if m < 0:
        return m + count, -period
    if m >= count:
        return m - count, period
    return m, 0.0


@njit(cache=True, nogil=True, inline="always")
def _across(fit: Parabola, u: float, x: float, y: float) -> float:
    """Distance of a place from the parabola, across its slope in the middle."""
    ex = x - fit[0] - (fit[2] + fit[4] * u) * u
    ey = y - fit[1] - (fit[3] + fit[5] * u) * u
    slope = math.sqrt(fit[2] * fit[2] + fit[3] * fit[3])
    return float((ex * fit[3] - ey * fit[2]) / max(slope, 1e-300))


@njit(cache=True, nogil=True, error_model="numpy")
def _without_the_worst(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    window: float,
    first: int,
    last: int,
    fit: Parabola,
    far: float,
    period: float,
) -> Parabola:
    """The fit to all but the place that lies farthest from the fit to the others, if it is far.

    Among few, a stray draws the fit so near that it does not look like one.
    """
    worst = _WORSE * far
    for m in range(first, last):
        n, moved = _wrapped(m, len(along), period)
        others = _parabola(
            along, places, origin, at, window, first, last, m, _NOTHING, np.inf, period
        )
        x, y = places[n, 0] - origin[0], places[n, 1] - origin[1]
        across = abs(_across(others, along[n] + moved - at, x, y))
        if across > worst:
            worst, fit = across, others
    return fit


@njit(cache=True, nogil=True, error_model="numpy")
def _parabola(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    window: float,
    first: int,
    last: int,
    left_out: int,
    before: Parabola,
    far: float,
    period: float,
) -> Parabola:
    """Weighted fit in a window, without what lies far from the fit before; at ends a line.

    `left_out` is the position of a place that has no say; `last` is nobody's.
    """
    s0 = s1 = s2 = s3 = s4 = x0 = x1 = x2 = y0 = y1 = y2 = 0.0
    held = left = right = 0.0
    for m in range(first, last):
        if m == left_out:
            continue
        n, moved = _wrapped(m, len(along), period)
        u = along[n] + moved - at
        z = u / window
        weight = 1.0 - z * z
        if weight <= 0.0:
            continue
        weight *= weight
        x, y = places[n, 0] - origin[0], places[n, 1] - origin[1]
        if far < np.inf and abs(_across(before, u, x, y)) > far:
            continue
        held += 1.0
        left, right = min(left, z), max(right, z)
        w1 = weight * u
        w2 = w1 * u
        s0, s1, s2, s3, s4 = s0 + weight, s1 + w1, s2 + w2, s3 + w2 * u, s4 + w2 * u * u
        x0, x1, x2 = x0 + weight * x, x1 + w1 * x, x2 + w2 * x
        y0, y1, y2 = y0 + weight * y, y1 + w1 * y, y2 + w2 * y
    if s0 <= 0.0:
        return before
    mean, square = s1 / s0, s2 / s0
    a11, a12, a22 = s2 - s1 * mean, s3 - s2 * mean, s4 - s2 * square
    if a11 <= 1e-12 * s0:
        return x0 / s0, y0 / s0, 0.0, 0.0, 0.0, 0.0, 1.0 / s0
    bx = by = 0.0
    variance = 1.0 / s0 + mean * mean / a11
    determinant = a11 * a22 - a12 * a12
    known = held >= _PARABOLA and left < -0.4 and right > 0.4 and determinant > 1e-9 * a11 * a22
    if known:
        bent = mean * mean * a22 - 2.0 * mean * square * a12 + square * square * a11
        bent = 1.0 / s0 + bent / determinant
        known = bent < max(_LOOSE, variance)
    if known:
        variance = bent
        bx = (a11 * (x2 - square * x0) - a12 * (x1 - mean * x0)) / determinant
        by = (a11 * (y2 - square * y0) - a12 * (y1 - mean * y0)) / determinant
    sx = (x1 - mean * x0 - bx * a12) / a11
    sy = (y1 - mean * y0 - by * a12) / a11
    x, y = (x0 - sx * s1 - bx * s2) / s0, (y0 - sy * s1 - by * s2) / s0
    return x, y, sx, sy, bx, by, variance


@njit(cache=True, nogil=True, error_model="numpy")
def _scatter(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    first: int,
    last: int,
    fit: Parabola,
    far: float,
    period: float,
) -> tuple[float, float]:
    """Standard deviation of a window's places across its parabola; how many lie close by."""
    squares = held = close = 0.0
    for m in range(first, last):
        n, moved = _wrapped(m, len(along), period)
        across = _across(
            fit, along[n] + moved - at, places[n, 0] - origin[0], places[n, 1] - origin[1]
        )
        if abs(across) <= far:
            squares += across * across
            held += 1.0
            close += abs(along[n] + moved - at) <= STEP
    freedom = held - (3.0 if fit[4] != 0.0 or fit[5] != 0.0 else 2.0)
    return math.sqrt(squares / max(freedom, 1.0)), close
