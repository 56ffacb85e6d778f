"""Where an open run ends: half of the density of its points is reached there.

Noise along the curve carries points over the end, on average sigma / sqrt(2 pi) times as many as
lie on a millimetre; that many are allowed to lie beyond, and the next one marks the end.
"""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.smoothing import Fit

_NEAR = 20.0  # points beside an end that tell the density there


def ends_of(fit: Fit, cells: ArcCells) -> tuple[float, float]:
    """Return the parameters of an open fit between which its points lie."""
    order = np.argsort(fit.t, kind="stable")
    held = (cells.counts * fit.weights)[order]
    lengths = np.concatenate([[0.0], span_lengths(fit.control_mm, fit.spans).cumsum()])
    knots = np.arange(fit.spans + 1.0)
    along = np.interp(fit.t[order], knots, lengths)
    sigma = math.sqrt(fit.noise.variance_mm2)
    start = _first(along, held, sigma)
    end = lengths[-1] - _first((lengths[-1] - along)[::-1], held[::-1], sigma)
    start, end = max(start, 0.0), min(end, float(lengths[-1]))
    if not end - start > 0.5 * lengths[-1]:
        return 0.0, float(fit.spans)
    return float(np.interp(start, lengths, knots)), float(np.interp(end, lengths, knots))


def _first(along: FloatArray, held: FloatArray, sigma: float) -> float:
    """Place from which the points lie at their density, counted from 0."""
    ranks = held.cumsum() - 0.5 * held + 0.5
    near = min(_NEAR, 0.5 * float(held.sum()))
    stretch = float(np.interp(2 * near, ranks, along) - np.interp(near, ranks, along))
    density = near / max(stretch, 1e-300)
    beyond = density * sigma / math.sqrt(math.tau)
    if beyond >= 1.0:
        return float(np.interp(beyond, ranks, along))
    return float(along[0]) - (1.0 - beyond) / density
