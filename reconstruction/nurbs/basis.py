"""B-spline basis functions at many parameters, and the domain they live on.

The paper's eqs. 2 and 3, but only the p + 1 functions that are not zero at a parameter, in the
order of *The NURBS Book* (Piegl and Tiller, 2nd ed., 1997), algorithms A2.1 to A2.3. Knots of a
periodic direction are given as stored, n + 2p + 1 of them (`reconstruction.nurbs.values`). They
reach the kernels read-only always: for numba a writable array is another type, compiled once more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.nurbs import kernels


def domain_of(degree: int, knots: FloatArray) -> tuple[float, float]:
    """Return the parameter interval on which a full set of basis functions exists."""
    return float(knots[degree]), float(knots[len(knots) - 1 - degree])


def in_domain(u: ArrayLike, degree: int, knots: FloatArray, *, periodic: bool) -> FloatArray:
    """Parameters inside the domain: periodic ones reduced modulo the period, open ones checked.

    Returns
    -------
    Float array of shape (m,); a scalar counts as one parameter. A periodic direction's end is its
    start; a parameter that lies in the domain already is not touched by rounding.

    Raises
    ------
    ValueError
        A parameter is not finite, or lies outside the domain of an open direction.
    """
    values: FloatArray = np.ascontiguousarray(u, dtype=np.float64)  # a scalar becomes (1,)
    start, end = domain_of(degree, knots)
    if values.ndim != 1:
        raise ValueError(f"parameters must be a scalar or of shape (m,), got {values.shape}")
    if not len(values) or (start <= values.min() and values.max() < end):
        return values
    if not periodic:
        _require_inside(values, start, end)
        return values
    if not np.all(np.isfinite(values)):
        raise ValueError("a parameter is not finite")
    inside = (start <= values) & (values < end)
    reduced = start + np.mod(values - start, end - start)
    reduced = np.where(reduced < end, reduced, start)  # mod of -1e-20 rounds up to the period
    return np.where(inside, values, reduced)


def _require_inside(values: FloatArray, start: float, end: float) -> None:
    outside = ~((start <= values) & (values <= end))
    if np.any(outside):
        wrong = float(values[np.argmax(outside)])
        raise ValueError(f"parameter {wrong:g} lies outside the domain [{start:g}, {end:g}]")


def find_spans(u: FloatArray, degree: int, knots: FloatArray) -> IntArray:
    """Index k of the knot span with knots[k] <= u < knots[k + 1]; (m,) -> (m,).

    The domain's end belongs to the last span that has a length. Parameters must lie in the domain.
    """
    spans: IntArray = kernels.spans_of(u, frozen(knots), degree, len(knots) - degree - 2)
    return spans


def basis_functions(
    u: ArrayLike, degree: int, knots: FloatArray, *, periodic: bool = False
) -> tuple[IntArray, FloatArray]:
    """Return the basis functions that are not zero at each parameter.

    Returns
    -------
    spans, values
        Shapes (m,) and (m, p + 1). ``values[r, j]`` belongs to the full control point
        ``spans[r] - p + j`` (modulo n where periodic).

    References
    ----------
    The NURBS Book, A2.1 and A2.2.
    """
    inside = in_domain(u, degree, knots, periodic=periodic)
    spans = find_spans(inside, degree, knots)
    values, _ = kernels.basis_rows(inside, spans, frozen(knots), degree)
    return spans, values


def basis_derivatives(
    u: ArrayLike, degree: int, knots: FloatArray, order: int, *, periodic: bool = False
) -> tuple[IntArray, FloatArray]:
    """Like `basis_functions`, with derivatives up to `order`: values (order + 1, m, p + 1).

    References
    ----------
    The NURBS Book, A2.3.
    """
    if order < 0:
        raise ValueError(f"a derivative has an order of 0 or more, not {order}")
    inside = in_domain(u, degree, knots, periodic=periodic)
    spans = find_spans(inside, degree, knots)
    rows = kernels.basis_derivative_rows(inside, spans, frozen(knots), degree, order)
    return spans, np.ascontiguousarray(np.moveaxis(rows, 2, 0))
