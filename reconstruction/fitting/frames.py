"""Which way the places around each place lie, and how far across.

The principal axes of the nearest few places, then of more: where the places are a band, its length
outgrows its thickness, until a bend or another band comes into sight. The most slender of these
neighbourhoods tells the direction and, about a parabola, the thickness; where none is slender,
there is no direction.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray


@njit(cache=True, nogil=True, error_model="numpy")
def frames(places: FloatArray, neighbours: IntArray, hoods: IntArray) -> FloatArray:
    """Direction, deviation across and slenderness of q places; (m, 2), (q, k) -> (q, 5).

    Neighbours are in the order of their distance, each place the first of its own; `hoods` says
    how many of them are looked at, ascending from 4. Slenderness is the deviation along over that
    across; at last, that of the largest neighbourhood.
    """
    found = np.empty((len(neighbours), 5))
    for n in range(len(neighbours)):
        near = neighbours[n]
        count, ratio, cosine, sine, last = _most_slender(places, near, hoods)
        found[n, 0], found[n, 1] = cosine, sine
        found[n, 2] = _across(places, near[:count], cosine, sine)
        found[n, 3], found[n, 4] = (
            1.0 / math.sqrt(max(ratio, 1e-6)),
            1.0 / math.sqrt(max(last, 1e-6)),
        )
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _most_slender(
    places: FloatArray, near: IntArray, hoods: IntArray
) -> tuple[int, float, float, float, float]:
    """How many neighbours, their variance across over that along, their direction; and of all."""
    ox, oy = places[near[0], 0], places[near[0], 1]
    sx = sy = sxx = sxy = syy = 0.0
    best, most, tilt, ratio = np.inf, len(near), 0.0, 1.0
    h = 0
    for k in range(len(near)):
        x, y = places[near[k], 0] - ox, places[near[k], 1] - oy
        sx, sy, sxx, sxy, syy = sx + x, sy + y, sxx + x * x, sxy + x * y, syy + y * y
        if k + 1 < hoods[h]:
            continue
        count = k + 1.0
        a, b, c = sxx - sx * sx / count, sxy - sx * sy / count, syy - sy * sy / count
        swing = math.hypot(0.5 * (a - c), b)
        longer, shorter = 0.5 * (a + c) + swing, max(0.5 * (a + c) - swing, 0.0)
        # Few places look more slender than they are: two freedoms go into the line.
        ratio = shorter / max(longer, 1e-300) * (count - 1.0) / (count - 2.0) * (1.0 + 4.0 / count)
        if ratio < best:
            best, most, tilt = ratio, k + 1, 0.5 * math.atan2(2.0 * b, a - c)
        h += 1
        if h == len(hoods):
            break
    return most, best, math.cos(tilt), math.sin(tilt), ratio


@njit(cache=True, nogil=True, error_model="numpy")
def _across(places: FloatArray, near: IntArray, cosine: float, sine: float) -> float:
    """Standard deviation of places about a parabola over their direction."""
    count = len(near)
    s1 = s2 = s3 = s4 = d0 = d1 = d2 = dd = 0.0
    ox, oy = places[near[0], 0], places[near[0], 1]
    scale = 0.0
    for k in range(count):
        x, y = places[near[k], 0] - ox, places[near[k], 1] - oy
        scale = max(scale, x * x + y * y)
    scale = math.sqrt(max(scale, 1e-300))
    for k in range(count):
        x, y = (places[near[k], 0] - ox) / scale, (places[near[k], 1] - oy) / scale
        s, d = cosine * x + sine * y, cosine * y - sine * x
        s1, s2, s3, s4 = s1 + s, s2 + s * s, s3 + s * s * s, s4 + s * s * s * s
        d0, d1, d2, dd = d0 + d, d1 + d * s, d2 + d * s * s, dd + d * d
    a11, a12, a22 = s2 - s1 * s1 / count, s3 - s1 * s2 / count, s4 - s2 * s2 / count
    b1, b2, left = d1 - d0 * s1 / count, d2 - d0 * s2 / count, dd - d0 * d0 / count
    freedom = count - 1.0
    determinant = a11 * a22 - a12 * a12
    if count >= 6 and determinant > 1e-9 * a11 * a22:
        slope, bend = (a22 * b1 - a12 * b2) / determinant, (a11 * b2 - a12 * b1) / determinant
        left, freedom = left - slope * b1 - bend * b2, count - 3.0
    elif count >= 4 and a11 > 0.0:
        left, freedom = left - b1 * b1 / a11, count - 2.0
    return scale * math.sqrt(max(left, 0.0) / freedom)
