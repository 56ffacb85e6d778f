"""A first curve from a chain's nodes: a linear smoothing spline over their chord length.

x and y share one stiffness, found by restricted likelihood from the nodes' own scatter; it
penalises third differences of the control points (Eilers, Marx 1996). What it gets wrong, the fit
of the raw points puts right: it need only lie within their band.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bands import LEAST, factorise, inverse_band, solve
from reconstruction.fitting.bending import add_penalty, row_variances
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.spline import evaluate, spans_of

_ROUNDS = 12
_MOST_SPANS = 160
_SPIKE = 1.5  # times the way past a node: so far no node stands out ...
_HOP = 2.0  # ... if that is this many times the usual way, too


def preliminary(chain: Chain) -> tuple[FloatArray, float]:
    """Return control points (n, 2) and degrees of freedom of a curve along the chain.

    At open ends it is a step longer, so that no point lies beyond it.
    """
    nodes = _without_spikes(chain.nodes_mm, closed=chain.closed)
    ends = np.vstack([nodes, nodes[:1]]) if chain.closed else nodes
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(ends, axis=0), axis=1).cumsum()])
    spans = min(max(len(nodes), LEAST), _MOST_SPANS)
    if chain.closed:
        return smoothed(nodes, along[:-1] / along[-1] * spans, spans, closed=True)
    beyond = along[-1] / (len(nodes) - 1)
    t = (along + beyond) / (along[-1] + 2 * beyond) * spans
    return smoothed(nodes, t, spans, closed=False)


def _without_spikes(nodes: FloatArray, *, closed: bool) -> FloatArray:
    """Without nodes that stand far out between two neighbours close together: no run does that."""
    if len(nodes) < LEAST:
        return nodes
    arms = np.linalg.norm(np.diff(nodes, axis=0, append=nodes[:1]), axis=1)
    before = np.roll(arms, 1)
    across = np.linalg.norm(np.roll(nodes, -1, axis=0) - np.roll(nodes, 1, axis=0), axis=1)
    far = np.maximum(_SPIKE * across, _HOP * np.median(arms))
    inner = np.full(len(nodes), fill_value=True)
    inner[[0, -1]] = closed
    spikes = inner & (np.minimum(before, arms) > far)
    return np.asarray(nodes[~spikes])


def smoothed(
    places: FloatArray, t: FloatArray, spans: int, *, closed: bool
) -> tuple[FloatArray, float]:
    """Control points and degrees of freedom of the smoothing spline at parameters (m,)."""
    unknowns = spans if closed else spans + 3
    data, right = normal_equations(t, places, unknowns, closed=closed)
    rank = spans - 1 if closed else spans
    control, edf = _likeliest(
        data, right, places, t, _third_differences(spans), rank, float(places.var())
    )
    return control, edf


@njit(cache=True, nogil=True, error_model="numpy")
def _likeliest(
    data: FloatArray, right: FloatArray, places: FloatArray, t: FloatArray, rows: FloatArray,
    rank: int, variance: float,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Control points and degrees of freedom at the stiffness of greatest restricted likelihood."""
    unknowns, spans = len(data), len(rows)
    still, nothing = np.zeros(spans), np.zeros((unknowns, 1))
    scatter = variance * 1e-3 + 1e-300
    ratio, edf, control = 1.0, 0.0, right
    largest = data[:, 0].max()
    for _ in range(_ROUNDS):
        band = data.copy()
        add_penalty(band, nothing, rows, still, np.full(spans, ratio))
        for j in range(unknowns):
            band[j, 0] += 1e-12 * largest
        main, border, corner = factorise(band)
        control = solve(main, border, corner, right)
        spent = ratio * row_variances(rows, inverse_band(main, border, corner)).sum()
        edf = unknowns - spent
        off = places - evaluate(control, t)[0]
        freedom = max(len(t) - edf, 0.5 + 0.1 * len(t))
        scatter = (off * off).sum() / (2 * freedom) + 1e-300
        form = 0.0
        for i in range(spans):
            for d in range(2):
                bend = 0.0
                for k in range(4):
                    bend += rows[i, k] * control[(i + k) % unknowns, d]
                form += bend * bend
        form /= scatter
        ratio *= min(max(2 * max(rank - spent, 0.1) / max(ratio * form, 1e-3), 0.05), 20.0)
        ratio = min(max(ratio, 1e-6), 1e9)
    return control, edf


def reknotted(
    control_mm: FloatArray,
    spans: int,
    *,
    closed: bool,
    within: tuple[float, float] | None = None,
) -> FloatArray:
    """Return control points of nearly the same curve on `spans` spans of equal arc length.

    Parameters
    ----------
    within
        Of an open curve: the stretch to keep, in the old parameter.
    """
    old = spans_of(control_mm, closed=closed)
    start, end = within or (0.0, float(old))
    fine = np.linspace(start, end, 8 * max(old, spans) + 1)
    points = evaluate(control_mm, fine)[0]
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    wanted = np.arange(4 * spans + (not closed)) / 4
    places = evaluate(control_mm, np.interp(wanted / spans * along[-1], along, fine))[0]
    return through(places, wanted, spans, closed=closed)


def through(places: FloatArray, t: FloatArray, spans: int, *, closed: bool) -> FloatArray:
    """Control points of the curve that runs through places (m, 2) at parameters (m,)."""
    unknowns = spans if closed else spans + 3
    band, right = normal_equations(t, places, unknowns, closed=closed)
    add_penalty(band, right, _third_differences(spans), np.zeros(spans), np.full(spans, 1e-9))
    return solve(*factorise(band), right)


def _third_differences(spans: int) -> FloatArray:
    return np.tile([-1.0, 3.0, -3.0, 1.0], (spans, 1))


@njit(cache=True, nogil=True)
def normal_equations(
    t: FloatArray, places: FloatArray, unknowns: int, *, closed: bool
) -> tuple[FloatArray, FloatArray]:
    """B'B on the band (unknowns, 4), and B' places (unknowns, 2)."""
    band, right = np.zeros((unknowns, 4)), np.zeros((unknowns, 2))
    last = (unknowns if closed else unknowns - 3) - 1
    for m in range(len(t)):
        span = min(max(int(t[m]), 0), last)
        f = t[m] - span
        g = 1.0 - f
        b = (g * g * g / 6, (3 * f * f * f - 6 * f * f + 4) / 6,
             (3 * g * g * g - 6 * g * g + 4) / 6, f * f * f / 6)  # fmt: skip
        for k in range(4):
            at = (span + k) % unknowns
            right[at, 0] += b[k] * places[m, 0]
            right[at, 1] += b[k] * places[m, 1]
            for q in range(k, 4):
                band[at, q - k] += b[k] * b[q]
    return band, right
