"""Knot vectors as other programs write them.

Ours are flat, and a periodic direction carries p knots before and behind its period
(reconstruction.nurbs.values). Open CASCADE, STEP and IGES list each knot once with a multiplicity;
in a periodic direction they list one period only, and count poles from the *last* copy of the
knot at the start of the domain::

    flat, p = 2          -.3 -.3  0  0  .4  .7  .7  1  1  1.4      domain [0, 1]
    knots                         0     .4  .7      1
    multiplicities                2      1   2      2
    the first pole's basis function starts at   flat[first_pole]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, IntArray, frozen

# Knots closer than this part of the whole vector are one knot that rounding split.
_SAME_KNOT = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class DistinctKnots:
    """Increasing knots with their multiplicities."""

    knots: FloatArray  # (k,)
    multiplicities: IntArray  # (k,)
    first_pole: int  # our control point that comes first; 0 unless periodic

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", frozen(self.knots))
        object.__setattr__(self, "multiplicities", frozen(self.multiplicities, np.int64))


def distinct(degree: int, knots: FloatArray, *, periodic: bool) -> DistinctKnots:
    """Count equal knots of a flat vector; of a periodic one take a single period, both ends.

    Parameters
    ----------
    knots
        (n + p + 1,) open or (n + 2p + 1,) periodic.

    Raises
    ------
    ValueError
        A knot so multiple that the direction breaks there.
    """
    snapped = _snapped(knots)
    start, end = snapped[degree], snapped[len(knots) - 1 - degree]
    within = snapped[(snapped >= start) & (snapped <= end)] if periodic else snapped
    values, counts = np.unique(within, return_counts=True)
    if periodic:
        counts[-1] = counts[0] = np.count_nonzero(snapped == start)
    _check_multiplicities(degree, counts, periodic=periodic)
    last_copy = int(np.flatnonzero(snapped == start)[-1])
    return DistinctKnots(values, counts, last_copy - degree if periodic else 0)


def flat(degree: int, knots: FloatArray, multiplicities: IntArray, *, periodic: bool) -> FloatArray:
    """Reverse `distinct` with `first_pole` 0: (k,), (k,) -> flat knots."""
    if not periodic:
        return np.repeat(knots, multiplicities)
    period = knots[-1] - knots[0]
    body = np.repeat(knots[:-1], multiplicities[:-1])
    steps = np.arange(len(body) + 2 * degree + 1) - (degree + 1 - int(multiplicities[0]))
    turns, place = np.divmod(steps, len(body))
    return np.asarray(body[place] + turns * period)


def clamped(degree: int, knots: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cut a periodic direction open at its seam, exactly, by Boehm's knot insertion.

    Parameters
    ----------
    knots
        (n + 2p + 1,), periodic.
    points
        (n, ...), each once; homogeneous where weights differ.

    Returns
    -------
    knots, points
        (m + p + 1,) with p + 1 equal knots at either end, and (m, ...); the domain is the same.
    """
    count = len(points)
    period = knots[degree + count] - knots[degree]
    # Knots and points of one more p, so that the end of the period lies inside.
    longer = _snapped(np.concatenate([knots, knots[2 * degree + 1 :][:degree] + period]))
    full = np.take(points, np.arange(count + 2 * degree), axis=0, mode="wrap")
    start, end = longer[degree], longer[degree + count]
    for seam in (start, end):
        for _ in range(degree - int(np.count_nonzero(longer == seam))):
            longer, full = _inserted(degree, longer, full, seam)
    first = int(np.searchsorted(longer, start))
    inside = longer[first : np.searchsorted(longer, end, side="right")]
    ends = np.concatenate([inside[:1], inside, inside[-1:]])
    return ends, full[first - 1 :][: len(ends) - degree - 1]


def _inserted(
    degree: int, knots: FloatArray, points: FloatArray, knot: float
) -> tuple[FloatArray, FloatArray]:
    """Insert one knot; the curve stays (Boehm 1980, doi:10.1016/0010-4485(80)90154-2)."""
    last = int(np.searchsorted(knots, knot, side="right")) - 1
    i = np.arange(last - degree + 1, last + 1)
    share = (knot - knots[i]) / (knots[i + degree] - knots[i])
    share = share.reshape(-1, *[1] * (points.ndim - 1))
    mixed = share * points[i] + (1 - share) * points[i - 1]
    points = np.concatenate([points[: last - degree + 1], mixed, points[last:]])
    return np.insert(knots, last + 1, knot), points


def _snapped(knots: FloatArray) -> FloatArray:
    """Give knots that only rounding separates the value of the first of them."""
    apart = np.diff(knots) > _SAME_KNOT * max(abs(knots[0]), abs(knots[-1]))
    group = np.concatenate([[0], np.cumsum(apart)])
    return np.asarray(knots[np.concatenate([[True], apart])][group])


def _check_multiplicities(degree: int, counts: IntArray, *, periodic: bool) -> None:
    inner = counts if periodic else counts[1:-1]
    if np.any(inner > degree) or np.any(counts > degree + 1):
        raise ValueError(f"a knot stands more often than the degree {degree} allows")
