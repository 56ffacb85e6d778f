"""From a chain and the raw points to a fitted curve.

chain -> preliminary curve -> one pass over the points: arc cells
      -> smooth -> noise looked at again, knots where they are needed -> smooth -> ...
      -> exact shape, where the points prefer one
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.bands import LEAST, factorise, solve
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.creases import creased
from reconstruction.fitting.curve import Exact, FittedCurve, finished
from reconstruction.fitting.ends import ends_of
from reconstruction.fitting.moments import ArcCells, cells_of_points, gather, nearest_vertices
from reconstruction.fitting.preliminary import (
    normal_equations,
    preliminary,
    reknotted,
    through,
)
from reconstruction.fitting.recognition import recognised
from reconstruction.fitting.scatter import by_spacing, looked_at_again
from reconstruction.fitting.smoothing import Fit, Noise, doubting, feet, smooth
from reconstruction.fitting.spline import evaluate, spans_of
from reconstruction.nurbs import Curve

_REACH = 6.0  # standard deviations: farther across is not of this curve
_SLACK = 0.25  # of the distance of nodes: a bend between them may be cut short by that
_GATHERED_FROM = 8_000  # points; fewer are fitted one by one, each with a robust weight of its own
_VERTICES_A_SPAN = 5
_LEAST_VERTICES = 512
_MOST_SPANS = 400
_NEARLY = 0.2  # standard deviations: still enough to look at noise and knots
_FEW = 12  # points too few to tell one of them an outlier
_EXACT = 1e-7  # of the length: scatter below it is none
_PASSES = 6
_FINE = 8  # places a span among which rough foot points are looked for


def fit_chain(
    points_mm: FloatArray,
    chain: Chain,
    *,
    exact: Exact = Exact.AUTO,
    heights_mm: FloatArray | None = None,
) -> FittedCurve:
    """Fit the raw points (n, 2), in any order, that a chain says belong together.

    Parameters
    ----------
    heights_mm
        (n,), true heights of the points above the cutting plane; kept as moments.

    Raises
    ------
    TooFewPoints
        Fewer than 4 points near the chain, or a chain without length.
    """
    points = np.ascontiguousarray(points_mm, dtype=np.float64)
    if len(points) < 4 or not chain.length_mm > 0:
        raise TooFewPoints(
            f"{len(points)} points on a chain of {chain.length_mm:g} mm; a curve needs 4 apart"
        )
    fit, cells, far = free_fit(points, chain, heights_mm)
    shape = recognised(fit, cells) if exact is Exact.AUTO else None
    shape = creased(fit, cells, points) if shape is None else shape
    return finished(fit, cells, shape, _gap_ends(chain), far, ambiguous=chain.ambiguous)


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
    t, _ = feet(control, cells, rough, closed=closed)
    relative = by_spacing(control, cells, t, closed=closed)
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


def _gap_ends(chain: Chain) -> FloatArray:
    """The nodes on either side of every gap, (k, 2, 2)."""
    start = np.array(chain.gaps, dtype=np.int64)
    after = (start + 1) % len(chain.nodes_mm)
    return np.stack([chain.nodes_mm[start], chain.nodes_mm[after]], axis=1)


def free_fit(
    points: FloatArray, chain: Chain, heights_mm: FloatArray | None = None
) -> tuple[Fit, ArcCells, int]:
    """Fit without recognition; the fit, its cells, and how many points lay too far off."""
    control, edf = preliminary(chain)
    control = reknotted(control, _wanted_spans(edf, len(points)), closed=chain.closed)
    cells, t, far = _gathered(points, chain, control, heights_mm)
    if cells.total < 4:
        raise TooFewPoints(f"{cells.total} of {len(points)} points lie near their chain; 4 needed")
    t, distances = feet(control, cells, t, closed=chain.closed)
    relative = by_spacing(control, cells, t, closed=chain.closed)
    sigma = max(_first_sigma(chain, cells, distances), _EXACT * chain.length_mm)
    noise = Noise(sigma**2, relative)
    fit = smooth(cells, control, t, noise, closed=chain.closed, still=_NEARLY)
    within = None if chain.closed else ends_of(fit, cells)
    for turn in range(_PASSES):
        wanted = _wanted_spans(fit.edf, len(cells))
        noise = looked_at_again(fit, cells)
        if turn > 1:  # more smoothing shows more noise, and less less: half-way does not swing
            halfway = np.sqrt(noise.relative * fit.noise.relative)
            noise = Noise(noise.variance_mm2, halfway, noise.inflation)
        settled = abs(np.log(noise.inflation / fit.noise.inflation)) < 0.1
        settled &= float(np.abs(np.log(noise.relative / fit.noise.relative)).max()) < 0.2
        if settled and turn > 0 and 0.8 < wanted / fit.spans < 1.25:
            break
        fit = _resumed(fit, cells, noise, wanted, within)
        within = None
    return doubting(fit, cells), cells, far


def fit_ordered(
    points_mm: FloatArray, shares: FloatArray, *, spans: int, closed: bool, sigma_mm: float
) -> Fit:
    """Fit points whose places along the curve are known, on a given number of spans.

    Parameters
    ----------
    shares
        (n,) on [0, 1], rough: of the length, or of a neighbouring section's parameter.
    sigma_mm
        Standard deviation across; the points' own takes its place.
    """
    band, right = normal_equations(
        shares * spans, points_mm, spans if closed else spans + 3, closed=closed
    )
    control = solve(*factorise(band), right)
    reach = np.full(max(_VERTICES_A_SPAN * spans, _LEAST_VERTICES), _REACH * sigma_mm)
    cells, t, _ = _along(points_mm, control, reach, None, closed=closed, singly=False)
    noise = Noise(sigma_mm**2, np.ones(len(cells)))
    return smooth(cells, control, t, noise, closed=closed, still=_NEARLY)


def _gathered(
    points: FloatArray, chain: Chain, control: FloatArray, heights_mm: FloatArray | None
) -> tuple[ArcCells, FloatArray, int]:
    """One pass over the points: cells and their rough foot points."""
    spans = spans_of(control, closed=chain.closed)
    count = max(_VERTICES_A_SPAN * spans, _LEAST_VERTICES)
    between = chain.length_mm / len(chain.nodes_mm)
    reach = _REACH * _sigma_along(chain, np.arange(count) / count) + _SLACK * between
    singly = len(points) < _GATHERED_FROM
    return _along(points, control, reach, heights_mm, closed=chain.closed, singly=singly)


def _along(
    points: FloatArray,
    control: FloatArray,
    reach: FloatArray,
    heights_mm: FloatArray | None,
    *,
    closed: bool,
    singly: bool,
) -> tuple[ArcCells, FloatArray, int]:
    """Cells along a curve, at as many vertices as there are reaches."""
    spans, count = spans_of(control, closed=closed), len(reach)
    t = np.arange(count) / count * spans if closed else np.linspace(0.0, spans, count)
    vertices, tangents, _ = evaluate(control, t)
    lengths = np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
    normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1) / lengths
    if singly:
        found = nearest_vertices(points, vertices, reach)
        near = np.flatnonzero(found >= 0)
        near = near[np.argsort(t[found[near]], kind="stable")]
        heights = None if heights_mm is None else heights_mm[near]
        return cells_of_points(points[near], heights), t[found[near]], len(points) - len(near)
    cells, at, far = gather(points, vertices, normals, reach, closed=closed, heights_mm=heights_mm)
    return cells, t[at], far


def _first_sigma(chain: Chain, cells: ArcCells, distances: FloatArray) -> float:
    """Standard deviation across to begin with: of single points their own, else the chain's."""
    own, theirs = np.abs(distances), float(np.median(chain.sigma_mm))
    if cells.total > len(cells):
        return theirs
    if len(cells) < _FEW:
        return max(theirs, float(own.max()))
    return 1.5 * float(np.median(own))  # of normal noise


def _sigma_along(chain: Chain, share: FloatArray) -> FloatArray:
    """The chain's standard deviation at shares of its length, (m,)."""
    nodes = np.vstack([chain.nodes_mm, chain.nodes_mm[:1]]) if chain.closed else chain.nodes_mm
    sigma = np.append(chain.sigma_mm, chain.sigma_mm[:1]) if chain.closed else chain.sigma_mm
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(nodes, axis=0), axis=1).cumsum()])
    return np.asarray(np.interp(share * along[-1], along, np.maximum(sigma, np.median(sigma) / 2)))


def _wanted_spans(edf: float, cells: int) -> int:
    """Two and a half spans for every degree of freedom: the stiffness does the rest."""
    most = min(_MOST_SPANS, max(cells, LEAST))
    return int(min(max(2.5 * edf + 10, LEAST), most))


def _resumed(
    fit: Fit, cells: ArcCells, noise: Noise, spans: int, within: tuple[float, float] | None
) -> Fit:
    start, end = within or (0.0, float(fit.spans))
    control = reknotted(fit.control_mm, spans, closed=fit.closed, within=(start, end))
    t = _carried(fit, spans, start, end)
    return smooth(cells, control, t, noise, closed=fit.closed, log_stiffness=fit.log_stiffness)


def _carried(fit: Fit, spans: int, start: float, end: float) -> FloatArray:
    """Foot points in the new parametrisation: by share of the length kept."""
    old = np.linspace(start, end, 8 * fit.spans + 1)
    points = evaluate(fit.control_mm, old)[0]
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(points, axis=0), axis=1).cumsum()])
    return np.asarray(np.interp(fit.t, old, along / along[-1]) * spans)
