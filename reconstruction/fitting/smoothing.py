"""The smoothing fit: normal moves of the control points, stiffness by restricted likelihood.

Residuals are normal distances only, so that a curve of n control points spends at most n degrees of
freedom, not 2 n. Every round linearises both the distances and the curvature about the current
curve (`sweep`, `bending`), solves one banded system and moves the stiffness towards its restricted
maximum likelihood by the generalised Fellner-Schall step (Wood, Fasiolo 2017,
doi:10.1111/biom.12666). The stiffness varies along the curve, log-linearly between stations,
because a curve of flat sides and tight bends has no single one; the stations are tied to their
neighbours by a random walk, which speaks only where the data say little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.errors import ReconstructionError
from reconstruction.fitting.bands import factorise, inverse_band, solve
from reconstruction.fitting.bending import (
    add_penalty,
    control_normals,
    curvature_changes,
    row_values,
    row_variances,
    span_lengths,
)
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.spline import spans_of
from reconstruction.fitting.sweep import sweep

_SPANS_A_STATION = 3
_MOST_STATIONS = 48
_TIE = 0.25  # precision of the difference of two neighbouring stations' log stiffness
_FAINT = 0.05  # degrees of freedom that are as good as none
_RUN_AWAY_MM = 1e150  # its square is the largest that a number holds
_ROUNDS = 25
_LEAST_POINTS = 3.0
_MOST_DOUBT = 1.5  # variance of the log stiffness
_LEASH = 3.0  # standard deviations that a control point may well go from its start, and a span
_STIFFER = 6.0  # in log stiffness
_RIDGE = 1e-13  # of the largest pivot: rounding must not make the system indefinite


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """What is believed about the data's scatter."""

    variance_mm2: float  # of one point across the curve
    relative: FloatArray  # (m,), each cell's share in it, about 1
    inflation: float = 1.0  # how much less independent the points are than they look ...
    doubt: FloatArray | float = 1.0  # ... and (m,) here and there besides: see `straying`

    @property
    def kinship(self) -> FloatArray:
        """How many points are as good as one independent one, (m,)."""
        return np.broadcast_to(self.inflation * np.asarray(self.doubt), self.relative.shape)

    def only(self, rows: IntArray) -> Noise:
        """Return that of these cells."""
        doubt = self.doubt if isinstance(self.doubt, float) else self.doubt[rows]
        return replace(self, relative=self.relative[rows], doubt=doubt)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A free curve at rest among its cells."""

    control_mm: FloatArray  # (n, 2)
    closed: bool
    t: FloatArray  # (m,), foot point of every cell
    log_stiffness: FloatArray  # (stations,)
    noise: Noise
    edf: float  # degrees of freedom spent
    distances_mm: FloatArray  # (m,), mean normal distance, left positive
    scatters_mm2: FloatArray  # (m,), variance across the curve inside each cell
    weights: FloatArray  # (m,), robust, 0 .. 1
    inverse: FloatArray  # (n, 4), posterior covariance of the normal moves, on the band
    rounds: int

    @property
    def spans(self) -> int:
        """Knot spans, the end of the domain."""
        return spans_of(self.control_mm, closed=self.closed)


@dataclass(frozen=True, slots=True, eq=False)
class _Leash:
    """Where the control points started, and the variance of a weak prior about it.

    Large circles bend little: without it a loop that few points hold could grow without end.
    """

    start_mm: FloatArray  # (n, 2)
    variance_mm2: float
    least_mm2: float  # exact data have no scatter at all; so much they are said to have


def smooth(
    cells: ArcCells,
    control_mm: FloatArray,
    t: FloatArray,
    noise: Noise,
    *,
    closed: bool,
    log_stiffness: FloatArray | None = None,
    still: float = 0.02,
) -> Fit:
    """Fit from a curve nearby, until it is still.

    Parameters
    ----------
    t
        (m,), rough foot points of the cells.
    log_stiffness
        Where to start, at stations spread evenly; by default one the points can just resist.
    still
        Standard deviations: a control point that moves less stands still.
    """
    spans = spans_of(control_mm, closed=closed)
    hats = _hats(spans, closed)
    lengths = span_lengths(control_mm, spans)
    usual = _usual_log_stiffness(cells, lengths, noise)
    if log_stiffness is None:
        log_stiffness = np.full(hats.shape[1], usual)
    else:
        log_stiffness = _stretched(log_stiffness, hats.shape[1], closed=closed)
    leash = _leash(control_mm, _LEASH**2 * noise.variance_mm2 + float(lengths.mean()) ** 2)
    before = np.zeros_like(log_stiffness)
    fit = None
    for turn in range(_ROUNDS):
        tried, moves = _round(
            cells, control_mm, t.copy(), noise, log_stiffness, hats, leash, turn, closed=closed
        )
        if not _sound(tried, cells):
            break
        fit, t = tried, tried.t
        control_mm, noise = fit.control_mm, fit.noise
        step = fit.log_stiffness - log_stiffness
        hasty = log_stiffness + step * _haste(step, before)
        log_stiffness = usual + _within(hasty - usual, 16.0)
        before = step
        if np.abs(moves[:, 0]).max() < still * np.sqrt(fit.inverse[:, 0].min()):
            break
    if fit is None:
        raise ReconstructionError(
            f"{cells.total} points do not hold a curve of {len(control_mm)} control points;"
            " is what was chained together one run?"
        )
    return fit


def _leash(start_mm: FloatArray, variance_mm2: float) -> _Leash:
    return _Leash(start_mm, variance_mm2, (1e-7 * float(np.ptp(start_mm, axis=0).max())) ** 2)


def feet(
    control_mm: FloatArray, cells: ArcCells, t: FloatArray, *, closed: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Foot points of the cells, from rough ones, normal distances, scatters across; all (m,).

    Raises
    ------
    ReconstructionError
        The curve has run away: it is so large that the square of its size is no number.
    """
    found, size, extent_mm = t.copy(), len(control_mm), float(np.ptp(control_mm))
    if not extent_mm < _RUN_AWAY_MM:
        raise ReconstructionError(
            f"a trial curve has run away to {extent_mm:.3g} mm; are the points those of one part?"
        )
    nothing = np.full(len(cells), (1e-7 * extent_mm) ** 2)
    distances, scatters, _ = sweep(
        control_mm, control_normals(control_mm, closed=closed), found, cells.counts,
        cells.counts, cells.means_mm, cells.covariances_mm2, nothing, np.zeros((size, 4)),
        np.zeros((size, 1)), closed=closed, rounds=3,
    )  # fmt: skip
    return found, distances, scatters


def doubting(fit: Fit, cells: ArcCells) -> Fit:
    """Return the fit with a covariance that knows how little is known of the stiffness itself.

    Averaged over a log-normal stiffness, the prior's variance grows by the exponential of half the
    variance of its logarithm. Inside a gap, where only the ties tell it, that is much; elsewhere
    the curve's own data correct half of it.
    """
    borne = np.bincount(np.minimum(fit.t.astype(np.int64), fit.spans - 1), minlength=fit.spans) > 0
    hats = _hats(fit.spans, fit.closed)
    normals = control_normals(fit.control_mm, closed=fit.closed)
    _, _, rows = curvature_changes(fit.control_mm, normals, fit.spans, closed=fit.closed)
    lengths = span_lengths(fit.control_mm, fit.spans)
    stiffness = np.exp(hats @ fit.log_stiffness) / lengths
    shares = stiffness * row_variances(rows, fit.inverse)
    known = np.diag(0.5 * np.maximum(hats.T @ (1.0 - shares), 0.0) + _FAINT)
    doubt = np.linalg.inv(known + _ties(hats.shape[1], fit.closed)).diagonal()
    loose = _leash(fit.control_mm, math.inf)  # it held the search back; it is no knowledge
    bare = hats.T @ ~borne / hats.sum(axis=0)
    softer = fit.log_stiffness - 0.25 * (1.0 + bare) * np.minimum(doubt, _MOST_DOUBT)
    again, _ = _round(
        cells, fit.control_mm, fit.t.copy(), fit.noise, softer, hats, loose, 0, closed=fit.closed
    )
    return replace(fit, inverse=again.inverse) if _sound(again, cells) else fit


def stiffness_along(fit: Fit) -> FloatArray:
    """Weight of the squared change of curvature over every span, (spans,)."""
    lengths = span_lengths(fit.control_mm, fit.spans)
    stiffness = np.exp(_hats(fit.spans, fit.closed) @ fit.log_stiffness)
    return np.asarray(stiffness / np.maximum(lengths, 1e-3 * lengths.mean()))


def stiff_start(
    cells: ArcCells, control_mm: FloatArray, noise: Noise, *, closed: bool
) -> FloatArray:
    """Log stiffness to start from where a fit from the usual one strayed; one for all stations."""
    lengths = span_lengths(control_mm, spans_of(control_mm, closed=closed))
    return np.full(2, _usual_log_stiffness(cells, lengths, noise) + _STIFFER)


def _haste(step: FloatArray, before: FloatArray) -> FloatArray:
    """Factor that sums the geometric series of steps which shrink evenly (Aitken), up to 3."""
    ratio = step / np.where(before == 0.0, np.inf, before)
    return np.asarray(1.0 / (1.0 - np.minimum(np.maximum(ratio, 0.0), 2 / 3)))


def _within(values: NDArray[np.floating], bound: float) -> FloatArray:
    return np.asarray(np.minimum(np.maximum(values, -bound), bound))


def _round(
    cells: ArcCells,
    control: FloatArray,
    t: FloatArray,
    noise: Noise,
    log_stiffness: FloatArray,
    hats: FloatArray,
    leash: _Leash,
    turn: int,
    *,
    closed: bool,
) -> tuple[Fit, FloatArray]:
    """One linearisation, one solve, one step of the stiffness and of the noise."""
    solved = _solved(
        control, t, cells.counts, noise.kinship, cells.means_mm, cells.covariances_mm2,
        noise.relative, noise.variance_mm2, hats @ log_stiffness, leash.start_mm,
        leash.variance_mm2, closed=closed, rounds=2 if turn < 2 else 1,
    )  # fmt: skip
    moved, moves, distances, scatters, weights, inverse, shares, forms, held, square = solved
    edf = len(control) - float(shares.sum())
    learnt = log_stiffness + _fellner_schall(shares, forms, log_stiffness, hats, closed=closed)
    fit = Fit(
        moved, closed, t, learnt, _rescaled(noise, square, held, edf, leash.least_mm2),
        edf, distances, scatters, weights, inverse, rounds=turn + 1,
    )  # fmt: skip
    return fit, moves


@njit(cache=True, nogil=True, error_model="numpy")
def _solved(
    control: FloatArray, t: FloatArray, counts: FloatArray, kinship: FloatArray,
    means: FloatArray, covariances: FloatArray, relative: FloatArray, variance: float,
    logs: FloatArray, start: FloatArray, leash: float, *, closed: bool, rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray,
           FloatArray, float, float]:  # fmt: skip
    """What a round needs of all points and spans, in one compiled piece.

    Returns
    -------
    moved control points (n, 2), moves (n, 1); distances, scatters, weights of the cells (m,); the
    inverse's band (n, 4); freedom and bends of the spans (spans,); points held, their squares.
    """
    n, spans = len(control), len(logs)
    normals = control_normals(control, closed)
    _, changes, rows = curvature_changes(control, normals, spans, closed)
    band, right = np.zeros((n, 4)), np.zeros((n, 1))
    distances, scatters, weights = sweep(
        control, normals, t, counts, counts / kinship, means, covariances, variance * relative,
        band, right, closed, rounds,
    )  # fmt: skip
    lengths = span_lengths(control, spans)
    stiffness = np.exp(logs) / np.maximum(lengths, 1e-3 * lengths.mean())
    add_penalty(band, right, rows, changes, stiffness)
    largest = 0.0
    for j in range(n):
        away = (control[j, 0] - start[j, 0]) * normals[j, 0]
        away += (control[j, 1] - start[j, 1]) * normals[j, 1]
        band[j, 0] += 1.0 / leash
        right[j, 0] -= away / leash
        largest = max(largest, band[j, 0])
    for j in range(n):
        band[j, 0] += _RIDGE * largest
    main, border, corner = factorise(band)
    moves, inverse = solve(main, border, corner, right), inverse_band(main, border, corner)
    shares = stiffness * row_variances(rows, inverse)
    forms = stiffness * (changes + row_values(rows, moves)) ** 2
    held = square = 0.0
    for m in range(len(t)):
        own = counts[m] * weights[m]
        held += own
        square += own * (distances[m] * distances[m] + scatters[m]) / relative[m]
    # A linearisation is good for a span; farther off the curve would fold.
    farthest = np.abs(moves).max()
    if farthest > lengths.mean():
        moves *= lengths.mean() / farthest
    moved = control + moves * normals
    return moved, moves, distances, scatters, weights, inverse, shares, forms, held, square


def _sound(fit: Fit, cells: ArcCells) -> bool:
    """Whether the system was positive definite, its solution a number, and points bear it."""
    solved = np.isfinite(fit.control_mm).all() and fit.inverse[:, 0].min() > 0.0
    return bool(solved and float(cells.counts @ fit.weights) >= _LEAST_POINTS)


def _rescaled(noise: Noise, square: float, held: float, edf: float, least_mm2: float) -> Noise:
    freedom = max(held - edf, 0.1 * held, 1.0)
    return replace(noise, variance_mm2=max(square / freedom, least_mm2))


def _fellner_schall(
    shares: FloatArray,
    forms: FloatArray,
    log_stiffness: FloatArray,
    hats: FloatArray,
    *,
    closed: bool,
) -> FloatArray:
    """Step of the log stiffness, held by the ties between stations.

    At rest the freedom a station takes from the curve's prior equals what the curve's bends spend.
    """
    rank = (len(shares) - 3) / len(shares) if closed else 1.0  # circles and shifts cost nothing
    free = np.maximum(hats.T @ (rank - shares), 0.0) + _FAINT
    bent = hats.T @ forms + _FAINT
    return _tied(free, bent, log_stiffness, _ties(len(log_stiffness), closed))


@njit(cache=True, nogil=True, error_model="numpy")
def _tied(free: FloatArray, bent: FloatArray, logs: FloatArray, ties: FloatArray) -> FloatArray:
    """The step of every station's log stiffness, by a Cholesky factor made in place."""
    count = len(free)
    step, matrix = np.empty(count), ties.copy()
    for i in range(count):
        step[i] = min(max(math.log(free[i] / bent[i]), -3.0), 3.0)
    if count < 3:
        return step
    for i in range(count):
        matrix[i, i] += 0.5 * free[i]
        step[i] *= 0.5 * free[i]
        for j in range(count):
            step[i] -= ties[i, j] * logs[j]
    for j in range(count):
        for k in range(j):
            for i in range(j, count):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
        root = 1.0 / math.sqrt(matrix[j, j])
        for i in range(j, count):
            matrix[i, j] *= root
        step[j] *= root
        for i in range(j + 1, count):
            step[i] -= matrix[i, j] * step[j]
    for j in range(count - 1, -1, -1):
        for i in range(j + 1, count):
            step[j] -= matrix[i, j] * step[i]
        step[j] /= matrix[j, j]
    for i in range(count):
        step[i] = min(max(step[i], -3.0), 3.0)
    return step


@lru_cache(maxsize=64)
def _ties(stations: int, closed: bool) -> FloatArray:  # noqa: FBT001 (the cache's key)
    steps = np.roll(np.eye(stations), 1, axis=1) - np.eye(stations)
    steps = steps if closed else steps[:-1]
    return np.asarray(frozen(_TIE * steps.T @ steps))


@lru_cache(maxsize=64)
def _hats(spans: int, closed: bool) -> FloatArray:  # noqa: FBT001
    """Weights (spans, stations) of linear interpolation between stations."""
    stations = min(max(spans // _SPANS_A_STATION, 1), _MOST_STATIONS)
    at = _places(spans, stations, closed=closed)
    low = np.minimum(np.floor(at).astype(np.int64), stations - 1)
    out = np.zeros((spans, stations))
    np.add.at(out, (np.arange(spans), low), 1.0 - (at - low))
    np.add.at(out, (np.arange(spans), (low + 1) % stations), at - low)
    return np.asarray(frozen(out))


def _places(spans: int, stations: int, *, closed: bool) -> FloatArray:
    share = (np.arange(spans) + 0.5) / spans
    return np.asarray(share * (stations if closed else stations - 1))


def _stretched(log_stiffness: FloatArray, stations: int, *, closed: bool) -> FloatArray:
    old = len(log_stiffness)
    if closed:
        at = np.arange(stations) / stations * old
        around = np.append(log_stiffness, log_stiffness[0])
        return np.asarray(np.interp(at, np.arange(old + 1), around))
    at = np.linspace(0, old - 1, stations)
    return np.asarray(np.interp(at, np.arange(old), log_stiffness))


def _usual_log_stiffness(cells: ArcCells, lengths: FloatArray, noise: Noise) -> float:
    precision = cells.total / len(lengths) / (noise.variance_mm2 * noise.inflation)
    return float(np.log(precision * lengths.mean() ** 5))
