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
    means: FloatArray,
    covariances: FloatArray,
    variances: FloatArray,
    band: FloatArray,
    right: FloatArray,
    *,
    closed: bool,
    rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refine t in place, add the data to band and right.

    Returns
    -------
    distances, scatters, weights, each (m,): mean distance of a cell's points, their variance across
    the curve about it, and the cell's robust weight.

    Parameters
    ----------
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
    full = np.concatenate((control, control[:3])) if closed else control
    for m in range(len(t)):
        x, y = means[m]
        u = t[m]
        for step in range(rounds + 1):
            span = max(min(int(u), int(end) - 1), 0)
            f = u - span
            g = 1.0 - f
            b = (g * g * g / 6, (3 * f * f * f - 6 * f * f + 4) / 6,
                 (3 * g * g * g - 6 * g * g + 4) / 6, f * f * f / 6)  # fmt: skip
            d = (-g * g / 2, (3 * f * f - 4 * f) / 2, (4 * g - 3 * g * g) / 2, f * f / 2)
            e = (g, 3 * f - 2, 3 * g - 2, f)
            px = py = dx = dy = ex = ey = 0.0
            for k in range(4):
                cx, cy = full[span + k, 0], full[span + k, 1]
                px += b[k] * cx
                py += b[k] * cy
                dx += d[k] * cx
                dy += d[k] * cy
                ex += e[k] * cx
                ey += e[k] * cy
            wx, wy = x - px, y - py
            square = max(dx * dx + dy * dy, 1e-300)
            if step == rounds:
                break
            # Near the centre of curvature Newton's step would be wild: it is kept within a knot.
            bent = max(square - (wx * ex + wy * ey), 0.25 * square)
            u += min(max((wx * dx + wy * dy) / bent, -1.0), 1.0)
            if closed:
                u = u + end if u < 0.0 else u
                u = u - end if u >= end else u
            else:
                u = min(max(u, 0.0), end)
        t[m] = u
        speed = math.sqrt(square)
        nx, ny = -dy / speed, dx / speed
        kappa = (dx * ey - dy * ex) / (square * speed)
        distance = wx * nx + wy * ny
        xx, xy, yy = covariances[m]
        along = (dx * dx * xx + 2 * dx * dy * xy + dy * dy * yy) / square
        across = (dy * dy * xx - 2 * dx * dy * xy + dx * dx * yy) / square
        flat = max(1.0 - kappa * distance, 0.25)
        distance += 0.5 * kappa * (variances[m] - along) / flat
        distances[m], scatters[m] = distance, max(across, 0.0)
        spread = math.sqrt(variances[m] / counts[m])
        z = math.fabs(distance) / spread if spread > 0.0 else 0.0
        share = min(max((_NONE - z) / (_NONE - _FULL), 0.0), 1.0) if counts[m] == 1.0 else 1.0
        weights[m] = share * share * (3.0 - 2.0 * share)
        scale = counts[m] * weights[m] / variances[m]
        for k in range(4):
            at = span + k if span + k < n else span + k - n
            row[k] = b[k] * (normals[at, 0] * nx + normals[at, 1] * ny)
        for k in range(4):
            at = span + k if span + k < n else span + k - n
            right[at, 0] += scale * row[k] * distance
            for q in range(k, 4):
                band[at, q - k] += scale * row[k] * row[q]
    return distances, scatters, weights
