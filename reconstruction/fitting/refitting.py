"""The streaming form: what was kept of a slice's points, fitted again along another curve.

Sections that are to be skinned share their knots and their parametrisation, which are known only
when all slices are in, and their points long gone. Their arc cells (`moments`) are not. ::

    points --fit_chain--> FittedCurve: curve, cells     ... points dropped
    other slices --align--> a curve along, knots
    cells, curve along ---refitted--> FittedCurve: those knots, that parametrisation
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bands import LEAST
from reconstruction.fitting.curve import FittedCurve, finished
from reconstruction.fitting.preliminary import through
from reconstruction.fitting.scatter import looked_at_again, seen_first
from reconstruction.fitting.smoothing import Noise, doubting, feet, smooth
from reconstruction.fitting.spline import evaluate
from reconstruction.nurbs import Curve

_FINE = 8  # places a span among which rough foot points are looked for
_NEARLY = 0.2  # standard deviations: still enough to look at the noise


def refitted(found: FittedCurve, along: Curve, *, spans: int) -> FittedCurve:
    """Fit the points of a curve again, along another one nearby; what was kept of them will do.

    The parametrisation is the other's, up to the distance between the two, and the knots are even
    in it: as sections want it that are to share their knots. Free; corners are rounded.

    Parameters
    ----------
    along
        Closed as `found` is; of a neighbouring section, or of the same one aligned with it.
    spans
        How many; at least 7, the periodic or clamped cubic's control points following from them.
    """
    if along.closed != found.closed or spans < LEAST:
        raise ValueError(
            f"along: closed {along.closed} for a curve that is closed {found.closed};"
            f" spans: {spans}, at least {LEAST}"
        )
    cells, closed = found.cells, found.closed
    control = _sampled(along, spans)
    fine = np.linspace(0.0, spans, _FINE * spans + 1)
    rough = fine[cKDTree(evaluate(control, fine)[0]).query(cells.means_mm)[1]]
    t, distances, scatters = feet(control, cells, rough, closed=closed)
    relative = seen_first(control, cells, t, distances**2 + scatters, closed=closed)
    fit = smooth(
        cells, control, t, Noise(found.sigma_mm**2, relative, found.inflation), closed=closed,
        still=_NEARLY,
    )  # fmt: skip
    fit = smooth(
        cells, fit.control_mm, fit.t, looked_at_again(fit, cells), closed=closed,
        log_stiffness=fit.log_stiffness,
    )  # fmt: skip
    ends = np.array([[found(start), found(end)] for start, end in found.gaps]).reshape(-1, 2, 2)
    far = found.points_used + found.outliers - cells.total
    return finished(doubting(fit, cells), cells, None, ends, far, ambiguous=found.ambiguous)


def _sampled(curve: Curve, spans: int) -> FloatArray:
    """Control points of nearly the same curve on even spans of its own parameter."""
    start, end = curve.domain
    t = np.arange(4 * spans + (not curve.closed)) / 4
    places = curve(start + (end - start) * t / spans)
    return through(places, t, spans, closed=curve.closed)
