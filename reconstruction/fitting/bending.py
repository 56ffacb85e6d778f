"""What the fit penalises: how the curvature changes along the curve, whatever its parametrisation.

Energy = sum over spans of stiffness * (change of curvature)**2 / length, the discrete form of
integral stiffness * (d kappa / ds)**2 ds, the minimum variation curve of Moreton and Sequin (1992).
Circles and lines are free, a gap is bridged by what comes nearest to an arc, and the points, which
do not determine the parametrisation, are not asked for it. Read as a prior, the curvature is a
random walk in arc length with variance 1 / stiffness a millimetre.

Control points move along normals only: ::

    c_j + delta_j * n_j        n_j: unit left normal of the curve at the knot c_j sits at
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray

_GAUSS = (0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15))
_SHARES = (5 / 18, 8 / 18, 5 / 18)


@njit(cache=True, nogil=True, error_model="numpy")
def control_normals(control: FloatArray, closed: bool) -> FloatArray:  # noqa: FBT001 (a kernel)
    """Unit left normals, one for each control point, (n, 2)."""
    n = len(control)
    normals = np.empty((n, 2))
    for j in range(n):
        at = j if closed else min(max(j, 1), n - 2)
        before, after = control[(at - 1) % n], control[(at + 1) % n]
        dx, dy = after[0] - before[0], after[1] - before[1]
        length = max(math.hypot(dx, dy), 1e-300)
        normals[j, 0], normals[j, 1] = -dy / length, dx / length
    return normals


@njit(cache=True, nogil=True, error_model="numpy")
def span_lengths(control: FloatArray, spans: int) -> FloatArray:
    """Arc length of every span by three-point Gauss, (spans,)."""
    n = len(control)
    lengths = np.zeros(spans)
    for i in range(spans):
        for q in range(3):
            f = _GAUSS[q]
            g = 1.0 - f
            d = (-g * g / 2, (3 * f * f - 4 * f) / 2, (4 * g - 3 * g * g) / 2, f * f / 2)
            dx = dy = 0.0
            for k in range(4):
                dx += d[k] * control[(i + k) % n, 0]
                dy += d[k] * control[(i + k) % n, 1]
            lengths[i] += _SHARES[q] * math.hypot(dx, dy)
    return lengths


@njit(cache=True, nogil=True, error_model="numpy")
def curvature_changes(
    control: FloatArray,
    normals: FloatArray,
    spans: int,
    closed: bool,  # noqa: FBT001 (a kernel)
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Curvature at the knots, its change over each span, and that change's derivatives.

    Returns
    -------
    curvatures (spans + 1,), changes (spans,), rows (spans, 4): ``rows[i, k]`` is the derivative of
    change i with respect to the normal move of control point i + k.
    """
    n = len(control)
    curvatures, slopes = np.empty(spans + 1), np.empty((spans + 1, 3))
    for i in range(spans + 1):
        a, b, c = control[i % n], control[(i + 1) % n], control[(i + 2) % n]
        dx, dy = (c[0] - a[0]) / 2, (c[1] - a[1]) / 2
        ex, ey = a[0] - 2 * b[0] + c[0], a[1] - 2 * b[1] + c[1]
        square = max(dx * dx + dy * dy, 1e-300)
        cube = square * math.sqrt(square)
        kappa = (dx * ey - dy * ex) / cube
        curvatures[i] = kappa
        for k in range(3):
            nx, ny = normals[(i + k) % n]
            first, second = 0.5 * (k - 1), (1.0 if k != 1 else -2.0)
            slopes[i, k] = (first * (nx * ey - ny * ex) + second * (dx * ny - dy * nx)) / cube
            slopes[i, k] -= 3 * kappa * first * (dx * nx + dy * ny) / square
    changes, rows = np.empty(spans), np.zeros((spans, 4))
    for i in range(spans):
        changes[i] = curvatures[i + 1] - curvatures[i]
        for k in range(3):
            rows[i, k + 1] += slopes[i + 1, k]
            rows[i, k] -= slopes[i, k]
    return curvatures, changes, rows


@njit(cache=True, nogil=True)
def add_penalty(
    band: FloatArray, right: FloatArray, rows: FloatArray, changes: FloatArray, weights: FloatArray
) -> None:
    """Add rows' W rows to the banded matrix and -rows' W changes to the right side."""
    n = len(band)
    for i in range(len(rows)):
        for k in range(4):
            scaled = weights[i] * rows[i, k]
            right[(i + k) % n, 0] -= scaled * changes[i]
            for q in range(k, 4):
                band[(i + k) % n, q - k] += scaled * rows[i, q]


@njit(cache=True, nogil=True)
def row_variances(rows: FloatArray, inverse: FloatArray) -> FloatArray:
    """Variance of every row's value, rows V rows', from the inverse's band; (spans,)."""
    n = len(inverse)
    out = np.zeros(len(rows))
    for i in range(len(rows)):
        for k in range(4):
            out[i] += rows[i, k] * rows[i, k] * inverse[(i + k) % n, 0]
            for q in range(k + 1, 4):
                out[i] += 2 * rows[i, k] * rows[i, q] * inverse[(i + k) % n, q - k]
    return out


@njit(cache=True, nogil=True)
def row_values(rows: FloatArray, moves: FloatArray) -> FloatArray:
    """Value of every row for moves (n, 1) of the control points; (spans,)."""
    n = len(moves)
    out = np.zeros(len(rows))
    for i in range(len(rows)):
        for k in range(4):
            out[i] += rows[i, k] * moves[(i + k) % n, 0]
    return out
