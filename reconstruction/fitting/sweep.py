"""One sweep over the data: foot points, normal distances, robust weights, normal equations.

Data are arc cells (`moments`): count, mean and covariance of points that lie close together along
the curve; a single point is a cell of one. A cell stands for the mean normal distance of its points
to second order: an arc's centroid lies inside it by kappa / 2 times the points' variance along the
curve, and isotropic noise moves points outward by kappa / 2 times its variance. ::

            o  p                     distances count to the left of the curve;
            | distance < 0           a counter-clockwise curve has its inside there
    ----C(t)+-------->
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray

_FULL = 3.0  # standard deviations up to which a point counts in full ...
_NONE = 5.0  # ... and from which it does not count


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(
    control: FloatArray,
    normals: FloatArray,
    t: FloatArray,
    counts: FloatArray,
    independent: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    variances: FloatArray,
    band: FloatArray,
    right: FloatArray,
    closed: bool,  # noqa: FBT001 (a kernel)
    rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refine t in place, add the data to band and right.

    Returns
    -------
    distances, scatters, weights, each (m,): mean distance of a cell's points, their variance across
    the curve about it, and the cell's robust weight.

    Parameters
    ----------
    counts, independent
        (m,), points of each cell, and how many independent ones they are worth.
    variances
        (m,), of one point across the curve, at each cell; also taken as its variance along it.
    covariances
        (m, 3): xx, xy, yy.
    rounds
        Newton steps for the foot points.
    """
    n = len(control)
    end = float(n if closed else n - 3)
    distances, scatters, weights = np.empty((3, len(t)))
    row = np.empty(4)
    polynomials = _polynomials(control, int(end))
    for _ in range(rounds):
        _step(polynomials, t, means, closed)
    for m in range(len(t)):
        span = max(min(int(t[m]), int(end) - 1), 0)
        f = t[m] - span
        px, py, dx, dy, ex, ey = _bent(polynomials, span, f)
        wx, wy = means[m, 0] - px, means[m, 1] - py
        square = max(dx * dx + dy * dy, 1e-300)
        inverse, precision = 1.0 / square, 1.0 / variances[m]
        root = math.sqrt(inverse)
        nx, ny = -dy * root, dx * root
        kappa = (dx * ey - dy * ex) * inverse * root
        distance = wx * nx + wy * ny
        xx, xy, yy = covariances[m, 0], covariances[m, 1], covariances[m, 2]
        along = (dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy) * inverse
        across = (dy * dy * xx - 2 * dx * dy * xy + dx * dx * yy) * inverse
        flat = max(1.0 - kappa * distance, 0.25)
        distance += 0.5 * kappa * (variances[m] - along) / flat
        distances[m], scatters[m] = distance, max(across, 0.0)
        share = 1.0
        if counts[m] == 1.0 and variances[m] > 0.0:
            z = math.fabs(distance) * math.sqrt(precision)
            share = min(max((_NONE - z) / (_NONE - _FULL), 0.0), 1.0)
        weights[m] = share * share * (3.0 - 2.0 * share)
        scale = independent[m] * weights[m] * precision
        g = 1.0 - f
        b = (g * g * g / 6, (3 * f * f * f - 6 * f * f + 4) / 6,
             (3 * g * g * g - 6 * g * g + 4) / 6, f * f * f / 6)  # fmt: skip
        for k in range(4):
            at = span + k if span + k < n else span + k - n
            row[k] = b[k] * (normals[at, 0] * nx + normals[at, 1] * ny)
        for k in range(4):
            at = span + k if span + k < n else span + k - n
            right[at, 0] += scale * row[k] * distance
            for q in range(k, 4):
                band[at, q - k] += scale * row[k] * row[q]
    return distances, scatters, weights


@njit(cache=True, nogil=True, error_model="numpy")
def _step(
    polynomials: FloatArray,
    t: FloatArray,
    means: FloatArray,
    closed: bool,  # noqa: FBT001
) -> None:
    """One Newton step of every foot point; cell by cell each would wait for the one before."""
    end = float(len(polynomials))
    for m in range(len(t)):
        span = max(min(int(t[m]), len(polynomials) - 1), 0)
        px, py, dx, dy, ex, ey = _bent(polynomials, span, t[m] - span)
        wx, wy = means[m, 0] - px, means[m, 1] - py
        square = max(dx * dx + dy * dy, 1e-300)
        # Near the centre of curvature Newton's step would be wild: it is kept within a knot.
        bent = max(square - (wx * ex + wy * ey), 0.25 * square)
        u = t[m] + min(max((wx * dx + wy * dy) / bent, -1.0), 1.0)
        if closed:
            u = u + end if u < 0.0 else u
            t[m] = u - end if u >= end else u
        else:
            t[m] = min(max(u, 0.0), end)


@njit(cache=True, nogil=True, inline="always")
def _bent(
    polynomials: FloatArray, span: int, f: float
) -> tuple[float, float, float, float, float, float]:
    """Place, first and second derivative on a span."""
    x0, x1, x2, x3, y0, y1, y2, y3 = polynomials[span]
    return (
        ((x3 * f + x2) * f + x1) * f + x0,
        ((y3 * f + y2) * f + y1) * f + y0,
        (3 * x3 * f + 2 * x2) * f + x1,
        (3 * y3 * f + 2 * y2) * f + y1,
        6 * x3 * f + 2 * x2,
        6 * y3 * f + 2 * y2,
    )


@njit(cache=True, nogil=True)
def _polynomials(control: FloatArray, spans: int) -> FloatArray:
    """Coefficients of x and of y on every span, the constant ones first, (spans, 8)."""
    n = len(control)
    out = np.empty((spans, 8))
    for i in range(spans):
        for axis in range(2):
            a, b = control[i, axis], control[(i + 1) % n, axis]
            c, d = control[(i + 2) % n, axis], control[(i + 3) % n, axis]
            out[i, 4 * axis] = (a + 4 * b + c) / 6
            out[i, 4 * axis + 1] = (c - a) / 2
            out[i, 4 * axis + 2] = (a - 2 * b + c) / 2
            out[i, 4 * axis + 3] = (d - 3 * c + 3 * b - a) / 6
    return out
