"""Fitting a form to cells of points by orthogonal distances (Gauss-Newton).

A cell stands for the mean distance of its points to second order. With the curvatures of the form,
the covariance T of the cell's points and that of a point's error N, both in the tangent plane, the
distance of the cell's mean is too small by 1/2 tr(II T) and, its points being noisy, too large by
1/2 tr(II N) (II positive where the form bends away from its normal)::

        _..---.._      points spread along a bend: their mean lies inside;
      -'    x    '-    noise along a bend: the points move outside, on average.

Where a cell or the noise is so wide that the second order is not enough, as at a cone's tip, the
cell is not trusted: it is no part of the fit, and counts as neither for the form nor against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.patches import pooled
from reconstruction.skinning.primitives import Form, Reading

_TRUSTED = 0.35  # spread over radius of curvature up to which a cell counts in full ...
_DISTRUSTED = 0.6  # ... and from which it does not count
_FLAT = (
    0.35  # scatter for the form's bend over that for noise, up to which a cell pulls in full ...
)
_BENT = 0.6  # ... and from which it does not pull
_TINY = 1e-300
_STILL = 1e-4  # squared, in standard deviations
_NEAR = 1e-2
_HALVINGS = 6
_BISQUARE = 6.0  # robust standard deviations from which a cell does not count


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Moments with what is believed about their scatter.

    The error of a point of cell m has the covariance ``scale[m] * noise_mm2``.
    """

    moments: Moments
    precisions: FloatArray  # (m,), independent points over variance across, 1 / mm2
    variances_mm2: FloatArray  # (m,), of a point across the wall
    scale: FloatArray  # (m,)
    noise_mm2: FloatArray  # (3, 3)

    def __len__(self) -> int:
        return len(self.precisions)

    @property
    def independent(self) -> FloatArray:
        """How many independent points each cell is worth, (m,)."""
        return self.precisions * self.variances_mm2

    def only(self, rows: IntArray) -> Cells:
        """Return these cells."""
        part = Moments(
            self.moments.counts[rows],
            self.moments.means_mm[rows],
            self.moments.covariances_mm2[rows],
        )
        return Cells(
            part, self.precisions[rows], self.variances_mm2[rows], self.scale[rows], self.noise_mm2
        )

    def weighed(self, weights: FloatArray) -> Cells:
        """Return the same with every cell's precision times a weight (m,)."""
        return Cells(
            self.moments, self.precisions * weights, self.variances_mm2, self.scale, self.noise_mm2
        )


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """What the spread of its points, and their error, do to every cell."""

    shifts_mm: FloatArray  # (m,), to be added to the distance of the mean
    scatters_mm2: FloatArray  # (m,), variance of the points across
    blur: FloatArray  # (m,), the greater spread over radius of curvature, the cell's or the noise's
    pulls_mm2: FloatArray  # (m, 3), covariance of distance and place over the form, see `_pulled`


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A form and how the cells stand against it."""

    form: Form
    normal_matrix: FloatArray  # (p, p), of its freedoms
    freedom: float  # how many the cells fill
    distances_mm: FloatArray  # (m,), mean distance of a cell's points
    spread: Spread
    trust: FloatArray  # (m,), 0 .. 1
    chart: FloatArray  # (m, 2), where on the form

    @property
    def covariance(self) -> FloatArray:
        """Of the form's freedoms, (p, p)."""
        return np.asarray(np.linalg.inv(self.normal_matrix))


def adjusted(form: Form, cells: Cells, *, rounds: int) -> Fitted | None:
    """Fit by Gauss-Newton from a form nearby; None where it does not settle."""
    for _ in range(rounds):
        here, slopes = against(form, cells)
        if not np.isfinite(here.distances_mm).all():
            return None
        weights = cells.precisions * here.trust
        right = slopes.T @ (weights * here.distances_mm) + _pulled(here, cells, weights)
        step = _solved(here.normal_matrix, right)
        if step is None:
            return None
        if float(step @ right) < _STILL:
            return here
        form = form.moved(step)
    return None


def approached(form: Form, cells: Cells, *, rounds: int) -> Fitted | None:
    """Come near a form from afar, whatever outliers there are; None where that fails.

    Cells weigh by their distance (Tukey's biweight), and no step may lead farther off.
    """
    here, slopes = against(form, cells)
    for _ in range(rounds):
        z = np.sqrt(cells.precisions) * np.abs(here.distances_mm)
        weights = cells.precisions * here.trust * _biweight(z)
        right = slopes.T @ (weights * here.distances_mm)
        step = _solved(slopes.T @ (weights[:, None] * slopes), right)
        if step is None:
            return None
        if float(step @ right) < _NEAR:
            break
        here, slopes = _descended(here, step, cells, weights)
    return here if np.isfinite(here.distances_mm).all() else None


def against(form: Form, cells: Cells) -> tuple[Fitted, FloatArray]:
    """Measure cells against a form; that, and the slopes (m, p)."""
    with np.errstate(all="ignore"):  # what is not finite is refused by `_solved`
        places = cells.moments.means_mm
        reading, chart = form.measure(places), form.chart(places)
        spread = spread_over(reading, cells)
        trust = trusted(spread.blur)
        weights = cells.precisions * trust
        matrix = reading.slopes.T @ (weights[:, None] * reading.slopes)
        distances = reading.distances_mm + np.where(trust > 0.0, spread.shifts_mm, 0.0)
    return Fitted(form, matrix, len(matrix), distances, spread, trust, chart), reading.slopes


def trusted(blur: FloatArray) -> FloatArray:
    """How far to trust the second order where a spread is that much of the radius, (m,)."""
    share = np.clip((_DISTRUSTED - blur) / (_DISTRUSTED - _TRUSTED), 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def spread_over(reading: Reading, cells: Cells) -> Spread:
    """What the spread of its points does to every cell."""
    return Spread(
        *_spread_over(
            reading.normals, reading.around, reading.curvatures,
            cells.moments.covariances_mm2, cells.scale, cells.noise_mm2,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _pulling(bend: float, noise: float) -> float:
    """How far to believe a cell's covariance of distance and place, 0 .. 1.

    Where the form bends within a cell that is lopsided, as a wedge at a pole is, its points farther
    along lie farther off for the bend alone.

    Parameters
    ----------
    bend, noise
        Variance of the points' distances from a tangent plane, for the bend and for their error.
    """
    share = (_BENT - np.sqrt(max(bend, 0.0) / max(noise, _TINY))) / (_BENT - _FLAT)
    share = min(max(share, 0.0), 1.0)
    return float(share * share * (3.0 - 2.0 * share))


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_over(
    normals: FloatArray,
    around: FloatArray,
    curvatures: FloatArray,
    covariances: FloatArray,
    scale: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    count = len(normals)
    shifts, scatters, blur = np.empty(count), np.empty(count), np.empty(count)
    pulls = np.empty((count, 3))
    total_noise = noise[0, 0] + noise[1, 1] + noise[2, 2]
    for m in range(count):
        n, t = normals[m], around[m]
        across = across_noise = first = first_noise = total = squares = 0.0
        pull, turn = np.zeros(3), np.zeros(3)
        for i in range(3):
            total += covariances[m, i, i]
            for j in range(3):
                own = covariances[m, i, j] - scale[m] * noise[i, j]
                pull[i] += own * n[j]
                turn[i] += own * t[j]
                squares += own * own
                across += n[i] * n[j] * covariances[m, i, j]
                first += t[i] * t[j] * covariances[m, i, j]
                across_noise += n[i] * n[j] * noise[i, j]
                first_noise += t[i] * t[j] * noise[i, j]
        both = total - across
        both_noise = scale[m] * (total_noise - across_noise)
        across_noise *= scale[m]
        first_noise *= scale[m]
        one, other = curvatures[m, 0], curvatures[m, 1]
        shifts[m] = 0.5 * other * (both - both_noise)
        shifts[m] += 0.5 * (one - other) * (first - first_noise)
        scatters[m] = max(across, 0.0)
        surplus, aslant = across - across_noise, n @ turn
        # tr((II (T - N))**2), twice the variance of a bell-shaped cell's distances for the bend.
        bend = other * other * (squares - 2.0 * (pull @ pull) + surplus * surplus)
        bend += 2.0 * other * (one - other) * (turn @ turn - aslant * aslant)
        bend += ((one - other) * (first - first_noise)) ** 2
        pulls[m] = _pulling(0.5 * bend, across_noise) * (pull - surplus * n)
        if one == other:
            blur[m] = abs(one) * np.sqrt(max(both, both_noise, 0.0))
        else:
            second = max(both - first, both_noise - first_noise, 0.0)
            blur[m] = max(
                abs(one) * np.sqrt(max(first, first_noise, 0.0)), abs(other) * np.sqrt(second)
            )
    return shifts, scatters, blur, pulls


def _pulled(here: Fitted, cells: Cells, weights: FloatArray) -> FloatArray:
    """What the cells lack of the sum, over points, of distance times slope, (p,).

    The points of a cell that is cut askew lie the farther along the form the farther off it; the
    slopes change along it. It is smooth over the form, so patches will do.
    """
    places = cells.moments.means_mm
    patches = pooled(here.chart, places, weights)
    ways = patches.mean(here.spread.pulls_mm2, weights)
    turns = patches.along(lambda middles: here.form.measure(middles).slopes, ways)
    return np.asarray(patches.held @ turns)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    scale = np.sqrt(matrix.diagonal())
    if not (np.isfinite(matrix).all() and np.isfinite(right).all() and (scale > 0.0).all()):
        return None
    try:
        step = np.linalg.solve(matrix / np.outer(scale, scale), right / scale) / scale
    except np.linalg.LinAlgError:
        return None
    return np.asarray(step) if np.isfinite(step).all() else None


def _descended(
    here: Fitted, step: FloatArray, cells: Cells, weights: FloatArray
) -> tuple[Fitted, FloatArray]:
    """The form a step on, or half of it, and so on, until the sum of squares falls."""
    most = float(weights @ here.distances_mm**2)
    for _ in range(_HALVINGS):
        there = against(here.form.moved(step), cells)
        if float(weights @ there[0].distances_mm ** 2) <= most:
            break
        step = 0.5 * step
    return there


def _biweight(z: FloatArray) -> FloatArray:
    scale = max(1.4826 * float(np.median(z)), 1.0) * _BISQUARE
    return np.asarray(np.maximum(1.0 - (z / scale) ** 2, 0.0) ** 2)
