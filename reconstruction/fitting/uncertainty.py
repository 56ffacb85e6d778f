"""How far the curve may lie from the truth: the posterior of the smoothing fit.

With the penalty read as a prior, (data + stiffness)^-1 is the covariance of the normal moves; its
band covers the truth at its nominal rate averaged along the curve (Nychka 1988), bias included.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bending import control_normals
from reconstruction.fitting.smoothing import Fit
from reconstruction.fitting.spline import spans_of

_A_SPAN = 8


def deviations_along(fit: Fit) -> FloatArray:
    """Posterior standard deviation across the curve, evenly over the domain, ends included."""
    t = np.linspace(0.0, fit.spans, _A_SPAN * fit.spans + 1)
    return np.sqrt(variances_at(fit.control_mm, fit.inverse, t, closed=fit.closed))


def variances_at(
    control_mm: FloatArray, inverse: FloatArray, t: FloatArray, *, closed: bool
) -> FloatArray:
    """Posterior variance across the curve at parameters (m,)."""
    normals = control_normals(control_mm, closed=closed)
    spans = spans_of(control_mm, closed=closed)
    return np.asarray(_variances(control_mm, normals, inverse, t, spans))


@njit(cache=True, nogil=True, error_model="numpy")
def _variances(
    control: FloatArray, normals: FloatArray, inverse: FloatArray, t: FloatArray, spans: int
) -> FloatArray:
    n = len(control)
    out = np.zeros(len(t))
    row = np.empty(4)
    for m in range(len(t)):
        span = max(min(int(t[m]), spans - 1), 0)
        f = t[m] - span
        g = 1.0 - f
        b = (g * g * g / 6, (3 * f * f * f - 6 * f * f + 4) / 6,
             (3 * g * g * g - 6 * g * g + 4) / 6, f * f * f / 6)  # fmt: skip
        d = (-g * g / 2, (3 * f * f - 4 * f) / 2, (4 * g - 3 * g * g) / 2, f * f / 2)
        dx = dy = 0.0
        for k in range(4):
            dx += d[k] * control[(span + k) % n, 0]
            dy += d[k] * control[(span + k) % n, 1]
        speed = max(np.hypot(dx, dy), 1e-300)
        for k in range(4):
            mx, my = normals[(span + k) % n]
            row[k] = b[k] * (dx * my - dy * mx) / speed
        for k in range(4):
            out[m] += row[k] * row[k] * inverse[(span + k) % n, 0]
            for q in range(k + 1, 4):
                out[m] += 2 * row[k] * row[q] * inverse[(span + k) % n, q - k]
    return np.maximum(out, 0.0)
