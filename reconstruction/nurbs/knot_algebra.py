"""Knot insertion, refinement, splitting, clamping and reversal of bundles of B-splines.

Everything rests on Boehm's insertion of one knot (*The NURBS Book*, A5.1): each new coefficient is
a convex combination of two old ones, so repeating it stays accurate whatever the knot spacing; the
Oslo algorithm is shorter to call, but extrapolates inside. In a periodic bundle the same
knot appears once in every period, and a window of n + 1 new coefficients is one whole period::

    old   ... k-n | k-n+1 ............ k-p | k-p+1 ... k-s | ........ k | ...
    new             same as old              combined        old, moved on by one
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.nurbs.basis import in_domain
from reconstruction.nurbs.bundle import Bundle


def inserted(bundle: Bundle, u: float, *, times: int = 1) -> Bundle:
    """Insert the knot u `times` times; the splines stay what they are.

    Raises
    ------
    ValueError
        u lies outside an open domain, or would come to stand more often than the degree.

    Notes
    -----
    A u that differs from a knot by rounding alone is that knot: a span of no more than a rounding
    error has no slope.
    """
    bundle = _canonical(bundle)
    value = _knot_at(bundle, u)
    there = int(np.count_nonzero(bundle.knots == value))
    if times < 0 or (times and there + times > bundle.degree):
        raise ValueError(
            f"knot {value:g} stands {there} times; {times} more do not fit degree {bundle.degree}"
        )
    for _ in range(times):
        bundle = _inserted_once(bundle, value)
    return bundle


def refined(bundle: Bundle, knots: Iterable[float]) -> Bundle:
    """Insert many knots, repeated ones as often as they are given."""
    for u in knots:
        bundle = inserted(bundle, float(u))
    return bundle


def doubled(bundle: Bundle, knots: FloatArray) -> Bundle:
    """Repeat knots that an open bundle has inside its domain, up to p + 1 times (for elevation)."""
    for u in knots:
        bundle = _inserted_once(bundle, float(u))
    return bundle


def clamped(bundle: Bundle) -> Bundle:
    """Give both ends p + 1 equal knots; a periodic bundle is opened at its start."""
    if bundle.periodic:
        return opened(bundle, bundle.domain[0])
    start, end = bundle.domain
    for u in (start, end):
        bundle = inserted(bundle, u, times=_missing(bundle, u))
    first = _last_index(bundle.knots, start) - bundle.degree
    last = int(np.searchsorted(bundle.knots, end)) - 1
    return _cut(bundle, first, last, start, end)


def opened(bundle: Bundle, u: float) -> Bundle:
    """Cut a periodic bundle at u: one clamped bundle that runs from u over one period."""
    if not bundle.periodic:
        raise ValueError("only a periodic direction can be opened; split an open one")
    bundle = _canonical(bundle)
    value = _knot_at(bundle, u)
    bundle = inserted(bundle, value, times=_missing(bundle, value))
    count, degree = len(bundle.coefficients), bundle.degree
    first = _last_index(bundle.knots, value) - degree
    start, end = bundle.domain
    wide = _unrolled_from(bundle, first, count + 1)
    knots = wide.knots.copy()
    knots[: degree + 1] = value
    knots[count + 1 :] = end if value == start else value + (end - start)
    return Bundle(degree, knots, wide.coefficients, periodic=False)


def split(bundle: Bundle, u: float) -> tuple[Bundle, Bundle]:
    """Split open splines at u, strictly inside the domain; the new ends are clamped.

    Raises
    ------
    ValueError
        u is not inside the domain, or the bundle is periodic (`opened` cuts those).
    """
    start, end = bundle.domain
    if bundle.periodic:
        raise ValueError("one cut does not make two parts of a periodic direction; open it first")
    u = _knot_at(bundle, u)
    if not start < u < end:
        raise ValueError(f"split at {u:g}: not inside the domain ({start:g}, {end:g})")
    bundle = inserted(bundle, u, times=_missing(bundle, u))
    first = int(np.searchsorted(bundle.knots, u))
    after = _last_index(bundle.knots, u) - bundle.degree
    more = np.full(bundle.degree + 1, u)
    return (
        Bundle(
            bundle.degree,
            np.concatenate([bundle.knots[:first], more]),
            bundle.coefficients[:first],
            periodic=False,
        ),
        Bundle(
            bundle.degree,
            np.concatenate([more, bundle.knots[after + bundle.degree + 1 :]]),
            bundle.coefficients[after:],
            periodic=False,
        ),
    )


def reversed_bundle(bundle: Bundle) -> Bundle:
    """Run through the same domain backwards: new(u) = old(start + end - u)."""
    start, end = bundle.domain
    knots = _mapped(bundle.knots, (start, end), (end, start))[::-1]
    backwards = bundle.coefficients[::-1]
    if bundle.periodic:  # the wrapped net reversed begins with the p coefficients at its end
        backwards = np.roll(backwards, bundle.degree, axis=0)
    return Bundle(bundle.degree, knots, backwards, bundle.periodic)


def reparametrised(bundle: Bundle, start: float, end: float) -> Bundle:
    """Map the domain affinely to [start, end]."""
    if not (math.isfinite(start) and math.isfinite(end) and start < end):
        raise ValueError(f"a domain must increase: [{start:g}, {end:g}]")
    return Bundle(
        bundle.degree,
        _mapped(bundle.knots, bundle.domain, (start, end)),
        bundle.coefficients,
        bundle.periodic,
    )


def unrolled(bundle: Bundle, before: int, after: int) -> Bundle:
    """Return a periodic bundle as an open one with more spans on both sides.

    The result has `before` coefficients ahead of the first one, and `after` more than the n that
    are stored, so its coefficient ``before`` is the stored coefficient 0.
    """
    return _unrolled_from(bundle, -before, before + len(bundle.coefficients) + after)


def period_knots(bundle: Bundle) -> FloatArray:
    """Return the n knots of one period, ascending, in [start, end): an end counts as a start."""
    start, end = bundle.domain
    once = bundle.knots[bundle.degree : -bundle.degree - 1]
    return np.sort(np.where(once == end, start, once))


def repeated_knots(
    once: FloatArray, domain: tuple[float, float], first: int, count: int
) -> FloatArray:
    """Return `count` knots of the endless sequence that repeats `once` with the domain's period.

    Index 0 is the first of `once`. Equal knots come out equal in every period, to the last bit.
    """
    start, end = domain
    turns, place = np.divmod(np.arange(first, first + count), len(once))
    base = once[place]
    knots = base + turns * (end - start)
    knots[(base == start) & (turns == 1)] = end
    return np.asarray(knots)


def _knot_at(bundle: Bundle, u: float) -> float:
    """Reduce u to the domain; take the nearest knot where they differ by rounding alone."""
    value = float(in_domain(u, bundle.degree, bundle.knots, periodic=bundle.periodic)[0])
    start, end = bundle.domain
    nearest = float(bundle.knots[np.argmin(np.abs(bundle.knots - value))])
    if abs(nearest - value) > 4 * np.spacing(max(abs(start), abs(end))):
        return value
    return start if bundle.periodic and nearest == end else nearest


def _canonical(bundle: Bundle) -> Bundle:
    """Rebuild the outer knots of a periodic bundle, so that equal knots are equal in all bits."""
    if not bundle.periodic:
        return bundle
    once = period_knots(bundle)
    return Bundle(
        bundle.degree,
        repeated_knots(once, bundle.domain, -_ahead(bundle), len(bundle.knots)),
        bundle.coefficients,
        periodic=True,
    )


def _ahead(bundle: Bundle) -> int:
    """Count the stored knots that lie before the first knot of `period_knots`."""
    once = bundle.knots[bundle.degree : -bundle.degree - 1]
    end = bundle.domain[1]
    return bundle.degree - int(np.count_nonzero(once == end))


def _unrolled_from(bundle: Bundle, first: int, count: int) -> Bundle:
    """Take `count` coefficients of a periodic bundle from index `first` of any period on."""
    indices = np.arange(first, first + count) % len(bundle.coefficients)
    knots = repeated_knots(
        period_knots(bundle), bundle.domain, first - _ahead(bundle), count + bundle.degree + 1
    )
    return Bundle(bundle.degree, knots, bundle.coefficients[indices], periodic=False)


def _inserted_once(bundle: Bundle, u: float) -> Bundle:
    degree, knots, old = bundle.degree, bundle.knots, bundle.coefficients
    count, span = len(old), _last_index(knots, u)
    low = span - count + 1 if bundle.periodic else 0
    index = np.arange(low, low + count + 1)
    factors = np.where(index <= span - degree, 1.0, 0.0)
    inside = (index > span - degree) & (index <= span) & (index < len(knots) - degree)
    left, right = knots[index[inside]], knots[index[inside] + degree]
    factors[inside] = np.where(left < u, (u - left) / np.where(left < u, right - left, 1.0), 0.0)
    keep, move = (
        (index % count, (index - 1) % count)
        if bundle.periodic
        else (np.minimum(index, count - 1), np.maximum(index - 1, 0))
    )
    new = factors[:, None] * old[keep] + (1.0 - factors)[:, None] * old[move]
    if not bundle.periodic:
        return Bundle(degree, np.insert(knots, span + 1, u), new, periodic=False)
    return _one_period(bundle, u, np.roll(new, low, axis=0))


def _one_period(bundle: Bundle, u: float, coefficients: FloatArray) -> Bundle:
    """Put u among the knots of every period; the domain's start keeps its place."""
    once = np.sort(np.append(period_knots(bundle), u))
    ahead = _ahead(bundle)
    knots = repeated_knots(once, bundle.domain, -ahead, len(bundle.knots) + 1)
    return Bundle(bundle.degree, knots, coefficients, periodic=True)


def _cut(bundle: Bundle, first: int, last: int, start: float, end: float) -> Bundle:
    """Coefficients first..last, whose inner knots have full multiplicity at both ends."""
    knots = bundle.knots[first : last + bundle.degree + 2].copy()
    knots[0], knots[-1] = start, end
    return Bundle(bundle.degree, knots, bundle.coefficients[first : last + 1], periodic=False)


def _missing(bundle: Bundle, u: float) -> int:
    return max(0, bundle.degree - int(np.count_nonzero(bundle.knots == u)))


def _last_index(knots: FloatArray, u: float) -> int:
    return int(np.searchsorted(knots, u, side="right")) - 1


def _mapped(
    knots: FloatArray, domain: tuple[float, float], target: tuple[float, float]
) -> FloatArray:
    (start, end), (first, last) = domain, target
    new = first + (knots - start) * ((last - first) / (end - start))
    return np.where(knots == start, first, np.where(knots == end, last, new))
