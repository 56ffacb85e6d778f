"""Points and derivatives of curves, rational throughout.

A curve is summed in homogeneous space, (w x, w y, w z, w), and projected (the paper's eq. 1; the
derivatives after *The NURBS Book*, eq. 4.8).
"""

from __future__ import annotations

from math import comb
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import kernels
from reconstruction.nurbs.basis import basis_derivatives, basis_functions

if TYPE_CHECKING:
    from reconstruction.nurbs.values import Curve


def homogeneous(points: FloatArray, weights: FloatArray) -> FloatArray:
    """Control points (..., d) and weights (...) to homogeneous ones (..., d + 1)."""
    return np.concatenate([points * weights[..., None], weights[..., None]], axis=-1)


def wrapped(coefficients: FloatArray, degree: int, *, periodic: bool) -> FloatArray:
    """Append the first `degree` rows of a periodic net (n, ...) at its end; open nets stay."""
    if not periodic:
        return coefficients
    return np.concatenate([coefficients, coefficients[:degree]])


def evaluate_curve(curve: Curve, u: ArrayLike) -> FloatArray:
    """Points (m, d) in mm at parameters (m,).

    A clamped curve ends exactly on its control points (to one rounding where its weights differ).

    Raises
    ------
    ValueError
        A parameter is outside the domain of an open curve; a periodic curve takes any.
    """
    spans, values = basis_functions(u, curve.degree, curve.knots, periodic=curve.periodic)
    sums: FloatArray = kernels.combined(values, spans, _net(curve))
    return sums[:, :-1] / sums[:, -1:]


def curve_derivatives(curve: Curve, u: ArrayLike, order: int) -> FloatArray:
    """Points and derivatives up to `order` at parameters (m,); shape (order + 1, m, d).

    At a knot where a derivative jumps, the value is that of the span to the right.

    References
    ----------
    The NURBS Book, A3.2 and A4.2.
    """
    spans, basis = basis_derivatives(u, curve.degree, curve.knots, order, periodic=curve.periodic)
    net = _net(curve)
    return projected(np.stack([kernels.combined(values, spans, net) for values in basis]))


def projected(sums: FloatArray) -> FloatArray:
    """Project derivatives (order + 1, ..., d + 1) in homogeneous space to (..., d) in space."""
    points, weights = sums[..., :-1], sums[..., -1:]
    out = np.empty_like(points)
    for k in range(len(sums)):
        rest = points[k].copy()
        for i in range(1, k + 1):
            rest -= comb(k, i) * weights[i] * out[k - i]
        out[k] = rest / weights[0]
    return out


def _net(curve: Curve) -> FloatArray:
    full = homogeneous(curve.control_points_mm, curve.weights)
    return wrapped(full, curve.degree, periodic=curve.periodic)
