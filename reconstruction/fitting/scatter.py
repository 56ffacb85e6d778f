"""The noise looked at again: how it varies along the curve, and how independent the points are.

Noise may grow with the spacing of the points (both grow with incidence and with distance) and may
vary from place to place; either is believed when the residuals show it beyond doubt.

Points of one profile err together. Summed over blocks much longer than that kinship and shorter
than what the curve can follow, their residuals then scatter more than independent ones would; the
ratio is the inflation by which the data count less.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.smoothing import Fit, Noise
from reconstruction.fitting.spline import spans_of
from reconstruction.fitting.uncertainty import variances_at

_BLOCKS_A_FREEDOM = 3.0
_LEAST_BLOCKS = 64
_SIGNIFICANT = 2.5  # standard errors, for noise that varies ...
_BEYOND_DOUBT = 4.0  # ... and for kinship, whose estimate is drawn out to long blocks
_MEDIANS = 5.5  # times 1 / n: variance of the log of a median of n squares; of their mean, 2
_UNEVEN = 0.6  # standard deviation of the log spacing; points at random have 0.4
_CAUTION = 10.0  # blocks
_WINDOW = 3.0  # points to either side that tell the local spacing


def looked_at_again(fit: Fit, cells: ArcCells) -> Noise:
    """Noise as the residuals of a fit show it."""
    order = np.argsort(fit.t, kind="stable")
    relative = np.empty(len(cells))
    relative[order] = _relative(fit, cells, order)
    relative /= np.average(relative, weights=cells.counts)
    inflation = _inflation(fit, cells, order)
    return Noise(fit.noise.variance_mm2, relative, inflation, fit.noise.doubt)


def _relative(fit: Fit, cells: ArcCells, order: IntArray) -> FloatArray:
    """Variance of a point over its mean, by cell in the curve's order; all one without evidence."""
    counts = cells.counts[order]
    leverages = np.minimum(_leverages(fit, cells)[order], 0.95)
    squares = (fit.distances_mm**2 / (1.0 - leverages) + fit.scatters_mm2)[order]
    held = counts * fit.weights[order]
    share, spread = _log_spacing(fit.control_mm, cells, fit.t, order, closed=fit.closed)
    growth = _growth(squares, held, spread)
    relative = np.exp(growth * (spread - np.average(spread, weights=held)))
    return relative * _drift(squares / relative, held, share, closed=fit.closed)


def seen_first(
    control_mm: FloatArray, cells: ArcCells, t: FloatArray, squares: FloatArray, *, closed: bool
) -> FloatArray:
    """Relative variances to begin with, about a curve that need only run within the band.

    Where points are far sparser they are trusted less, and where they scatter farther: `squares`
    (m,) are the cells' mean squares across it.
    """
    order = np.argsort(t, kind="stable")
    relative = np.empty(len(cells))
    share, spread = _log_spacing(control_mm, cells, t, order, closed=closed)
    spread = spread - spread.max() if spread.std() >= _UNEVEN else np.zeros(len(cells))
    found = _drift(squares[order] / np.exp(spread), cells.counts[order], share, closed=closed)
    relative[order] = np.exp(spread) * found
    return np.asarray(relative / np.average(relative, weights=cells.counts))


def _log_spacing(
    control_mm: FloatArray, cells: ArcCells, t: FloatArray, order: IntArray, *, closed: bool
) -> tuple[FloatArray, FloatArray]:
    """Share of the length and log of the local spacing, in the curve's order."""
    spans = spans_of(control_mm, closed=closed)
    lengths = np.concatenate([[0.0], span_lengths(control_mm, spans).cumsum()])
    along = np.interp(t[order], np.arange(spans + 1), lengths)
    period = float(lengths[-1]) if closed else np.inf
    return along / lengths[-1], np.log(_spacings(along, cells.counts[order], period))


def _leverages(fit: Fit, cells: ArcCells) -> FloatArray:
    """Share of each cell's own distance in the curve beside it, (m,)."""
    variances = variances_at(fit.control_mm, fit.inverse, fit.t, closed=fit.closed)
    own = fit.noise.variance_mm2 * fit.noise.relative * fit.noise.kinship
    return np.asarray(variances * cells.counts * fit.weights / own)


def _growth(squares: FloatArray, held: FloatArray, spread: FloatArray) -> float:
    """Exponent of the variance over the spacing, by likelihood; 0 if it may be chance."""
    x = spread - np.average(spread, weights=held)
    growth, information = _likeliest_growth(squares, held, x)
    return growth if growth * growth * information > _SIGNIFICANT**2 else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _likeliest_growth(squares: FloatArray, held: FloatArray, x: FloatArray) -> tuple[float, float]:
    """Scoring for squares that scatter about a multiple of exp(growth * x)."""
    growth, information = 0.0, 1e-300
    for m in range(len(x)):
        information += 0.5 * held[m] * x[m] * x[m]
    for _ in range(20):
        total = tilted = plain = 0.0
        for m in range(len(x)):
            relative = held[m] * squares[m] * math.exp(-growth * x[m])
            total += relative
            tilted += relative * x[m]
            plain += held[m]
        step = 0.5 * tilted / max(total / plain, 1e-300) / information
        growth = min(max(growth + min(max(step, -0.5), 0.5), 0.0), 4.0)
        if abs(step) < 1e-3:
            break
    return growth, information


def _drift(squares: FloatArray, held: FloatArray, share: FloatArray, *, closed: bool) -> FloatArray:
    """Variance by stretches of the curve over its mean, drawn to the mean as far as chance goes.

    By medians: a corner that the curve rounds would make its stretch look noisy, and be rounded
    the more for it.
    """
    stretches = int(min(held.sum() / 60, 24))
    if stretches < 3:
        return np.ones(len(squares))
    at = np.minimum((share * stretches).astype(np.int64), stretches - 1)
    counts = np.bincount(at, held, stretches) + 1e-9
    usual = float(_medians(squares, held, np.zeros(len(at), np.int64), 1)[0])
    if not usual > 0.0:  # exact data
        return np.ones(len(squares))
    logs = np.log((counts * _medians(squares, held, at, stretches) / usual + 1.0) / (counts + 1.0))
    chance = _MEDIANS / (counts + 1.0)
    excess = float(np.average(logs**2 - chance, weights=counts))
    if excess < _SIGNIFICANT * float(np.average(chance, weights=counts)) * np.sqrt(2 / stretches):
        return np.ones(len(squares))
    logs *= excess / (excess + chance)
    middles = (np.arange(stretches) + 0.5) / stretches
    return np.asarray(np.exp(np.interp(share, middles, logs, period=1.0 if closed else None)))


def _medians(values: FloatArray, weights: FloatArray, at: IntArray, groups: int) -> FloatArray:
    """Weighted median of the values of each group, (groups,); 0 of none."""
    order = np.lexsort((values, at))
    heights, group = weights[order].cumsum(), at[order]
    ends = np.searchsorted(group, np.arange(groups), side="right")
    below = np.concatenate([[0.0], heights])[np.concatenate([[0], ends[:-1]])]
    totals = np.concatenate([[0.0], heights])[ends] - below
    middles = np.searchsorted(heights, below + totals / 2)
    found = values[order][np.minimum(middles, len(order) - 1)]
    return np.where(totals > 0, found, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _spacings(along: FloatArray, counts: FloatArray, period: float) -> FloatArray:
    """Arc length a point, over the nearest few to either side; a gap counts four times at most."""
    m = len(along)
    out = np.empty(m)
    apart = 1e-2 * (along[m - 1] - along[0]) / m  # nearer together they count as one
    for i in range(m):
        least, most = np.inf, 0.0
        for way in (1, -1):
            points, length, j = 0.5 * counts[i], 0.0, i
            while points < _WINDOW or j == i:
                k = j + way
                if k < 0 or k >= m:
                    if period == np.inf or points > 0.5 * m:
                        break
                    k -= way * m
                step = way * (along[k] - along[j])
                step = step if step >= 0.0 else step + period
                length += step
                points += counts[k] if step > apart else 0.0
                j = k
            if points >= _WINDOW and j != i:
                spacing = length / (points - 0.5 * counts[j])
                least, most = min(least, spacing), max(most, spacing)
        out[i] = math.sqrt(least * min(most, 4.0 * least)) if most > 0.0 else 0.0
    mean = max(out.mean(), 1e-300)
    for i in range(m):
        out[i] = min(max(out[i], 1e-3 * mean), 1e3 * mean)
    return out


def _inflation(fit: Fit, cells: ArcCells, order: IntArray) -> float:
    held = cells.counts * fit.weights
    total = float(held.sum())
    size = min(total / max(_BLOCKS_A_FREEDOM * fit.edf, 1.0), total / _LEAST_BLOCKS)
    if size < 2.0:
        return 1.0
    scale = np.sqrt(fit.noise.variance_mm2 * fit.noise.relative * fit.noise.doubt)
    sums, counts = (held * fit.distances_mm / scale)[order], held[order]
    ratio, blocks = _block_ratio(sums, counts, size, fit.edf / total)
    if ratio < 1.0 + _BEYOND_DOUBT * np.sqrt(2.0 / blocks):
        return 1.0
    # Kinship reaches over the borders of blocks: what that hides halves as they double. The
    # estimate scatters itself, and one too small does more harm than one too large.
    half, _ = _block_ratio(sums, counts, size / 2, fit.edf / total)
    return max(2.0 * ratio - half, ratio) * (1.0 + _CAUTION / blocks)


@njit(cache=True, nogil=True)
def _block_ratio(
    sums: FloatArray, counts: FloatArray, size: float, leverage: float
) -> tuple[float, int]:
    """Sum of squared block sums over its value for independent points; the number of blocks."""
    square = expected = total = count = 0.0
    blocks = 0
    for m in range(len(sums)):
        total += sums[m]
        count += counts[m]
        if count >= size:
            square += total * total
            expected += max(count - count * count * leverage, 0.1 * count)
            blocks += 1
            total = count = 0.0
    return square / max(expected, 1e-300), max(blocks, 1)
