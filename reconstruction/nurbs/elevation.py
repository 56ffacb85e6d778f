"""Degree elevation of bundles of B-splines.

The elevated splines have every knot once more. Their coefficient i is the mean over j of the polar
form at the knots i + 1 .. i + p + 1 without the j-th (Prautzsch, *Degree elevation of B-spline
curves*, CAGD 1, 1984), and each such value is an ordinary coefficient after knot insertion: of the
old splines with every distinct knot doubled except the one that was left out. Knots that never
meet in one window of p + 1 may be left out together, so a few refinements give all values, and all
steps are convex combinations: nothing is solved, removed or extrapolated.
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.nurbs.bundle import Bundle
from reconstruction.nurbs.knot_algebra import clamped, doubled, period_knots, unrolled


def elevated(bundle: Bundle, *, by: int = 1) -> Bundle:
    """Raise the degree; the splines stay what they are. An open unclamped bundle comes out clamped.

    Raises
    ------
    ValueError
        `by` is negative.
    """
    if by < 0:
        raise ValueError(f"the degree can be raised, not lowered: by={by}")
    for _ in range(by):
        bundle = _elevated_period(bundle) if bundle.periodic else _elevated_clamped(bundle)
    return bundle


def _elevated_period(bundle: Bundle) -> Bundle:
    """Elevate one period with enough of its neighbours around it, then take the period out."""
    margin = 2 * (bundle.degree + 1)
    wide = _elevated_clamped(unrolled(bundle, margin, margin))
    degree = wide.degree
    count = len(bundle.coefficients) + len(np.unique(period_knots(bundle)))
    start, end = bundle.domain
    first = int(np.searchsorted(wide.knots, start, side="right")) - 1 - degree
    knots = wide.knots[first : first + count + 2 * degree + 1].copy()
    knots[count + degree] = end
    return Bundle(degree, knots, wide.coefficients[first : first + count], periodic=True)


def _elevated_clamped(bundle: Bundle) -> Bundle:
    bundle = clamped(bundle)
    degree = bundle.degree
    inner = np.unique(bundle.knots[degree + 1 : -degree - 1])
    knots = np.sort(np.concatenate([bundle.knots, inner, bundle.domain]))
    windows = np.lib.stride_tricks.sliding_window_view(knots[1:-1], degree + 1)
    group = np.arange(len(inner)) % (degree // 2 + 2)
    total = np.zeros((len(windows), bundle.coefficients.shape[1]))
    for number in range(-1, int(group.max(initial=-1)) + 1):
        kept_out = inner[group == number]
        finer = doubled(bundle, np.setdiff1d(inner, kept_out)).coefficients
        left_out = np.concatenate([kept_out, bundle.domain]) if number < 0 else kept_out
        share, index = _shares(windows, left_out, kept_out, bundle.domain[0])
        for j in range(degree + 1):
            rows = share[:, j]
            total[rows] += finer[index[rows, j]]
    return Bundle(degree + 1, knots, total / (degree + 1), periodic=False)


def _shares(
    windows: FloatArray, left_out: FloatArray, kept_out: FloatArray, start: float
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.bool_]], IntArray]:
    """Which places of which windows this refinement answers, and with which coefficient.

    The refinement lacks one knot for each of `kept_out`, and one at the domain's start; a window's
    coefficient moves down by the number of those that lie before the knot it leaves out.
    """
    share = np.isin(windows, left_out)
    lacking = np.searchsorted(kept_out, windows) + (windows > start)
    index = np.arange(len(windows))[:, None] - lacking
    return share, index.astype(np.int64)
