"""Uniform cubic B-splines in the plane, the form in which sections are fitted.

Knots are the integers; span i, ``i <= t < i + 1``, uses control points i .. i + 3, for a closed one
modulo their number n. The domain is [0, n] closed and [0, n - 3] open, and control point j sits at
the knot j - 1 (its Greville abscissa)::

    control   0   1   2   3   4
    knot     -1   0   1   2   3
                  |--span 0 ..

Uniform knots are no limit: where more are needed the parametrisation runs slower, and what is
penalised (`bending`) knows arc length only.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import Curve, clamped


def spans_of(control_mm: FloatArray, *, closed: bool) -> int:
    """Return the number of knot spans, which is the end of the domain."""
    return len(control_mm) if closed else len(control_mm) - 3


def nurbs_of(control_mm: FloatArray, *, closed: bool) -> Curve:
    """Return the same curve as a NURBS curve on [0, 1]."""
    spans = spans_of(control_mm, closed=closed)
    knots = np.arange(-3.0, spans + 4.0) / spans
    curve = Curve(3, knots, control_mm, np.ones(len(control_mm)), periodic=closed)
    return curve if closed else clamped(curve)


@njit(cache=True, nogil=True)
def evaluate(control: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points, first and second derivatives (m, 2) at parameters (m,) inside the domain.

    A closed curve's parameters lie in [0, n]; an open one's in [0, n - 3].
    """
    n = len(control)
    points, first, second = np.zeros((3, len(t), 2))
    for m in range(len(t)):
        span = min(max(int(t[m]), 0), n - 1)
        f = t[m] - span
        if span == n - 3 and f == 0.0:  # the end of an open curve belongs to its last span
            span, f = span - 1, 1.0
        g = 1.0 - f
        b = (g * g * g / 6, (3 * f * f * f - 6 * f * f + 4) / 6,
             (3 * g * g * g - 6 * g * g + 4) / 6, f * f * f / 6)  # fmt: skip
        d = (-g * g / 2, (3 * f * f - 4 * f) / 2, (4 * g - 3 * g * g) / 2, f * f / 2)
        e = (g, 3 * f - 2, 3 * g - 2, f)
        for k in range(4):
            c = control[(span + k) % n]
            for axis in range(2):
                points[m, axis] += b[k] * c[axis]
                first[m, axis] += d[k] * c[axis]
                second[m, axis] += e[k] * c[axis]
    return points, first, second
