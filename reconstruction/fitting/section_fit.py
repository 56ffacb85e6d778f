"""From a chain and the raw points to a fitted curve.

chain -> preliminary curve -> one pass over the points: arc cells
      -> smooth -> noise looked at again, knots where they are needed -> smooth -> ...
      -> exact shape, where the points prefer one
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.distances import polygon_distances
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
)
from reconstruction.fitting.recognition import recognised
from reconstruction.fitting.scatter import looked_at_again, seen_first
from reconstruction.fitting.smoothing import Fit, Noise, doubting, feet, smooth, stiff_start
from reconstruction.fitting.spline import evaluate, spans_of
from reconstruction.fitting.straying import WINDING, doubted, windings

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
_RETRIES = 4  # of a fit that winds ...
_LOSS = 0.02  # ... as long as they lose no more of the points ...
_OFF = 1.5  # ... and these lie no more times as far off as from the chain


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
    t, distances, scatters = feet(control, cells, t, closed=chain.closed)
    squares = distances**2 + scatters
    relative = seen_first(control, cells, t, squares, closed=chain.closed)
    even = distances / np.sqrt(relative)
    sigma = max(_first_sigma(chain, cells, even), _EXACT * chain.length_mm)
    noise = Noise(sigma**2, relative)
    fit = _settled(cells, control, t, noise, closed=chain.closed)
    fit = _unwound(fit, cells, control, t, noise, chain)
    return doubting(fit, cells), cells, far


def _unwound(
    fit: Fit, cells: ArcCells, control: FloatArray, t: FloatArray, noise: Noise, chain: Chain
) -> Fit:
    """The fit, or one with doubt where it winds about its chain; see `straying`."""
    wound = windings(fit, chain)
    for _ in range(_RETRIES):
        if not wound.max() > WINDING:
            break
        noise = replace(noise, doubt=noise.doubt * doubted(fit, wound))
        stiff = stiff_start(cells, control, noise, closed=chain.closed)
        again = _settled(cells, control, t, noise, closed=chain.closed, log_stiffness=stiff)
        less = windings(again, chain)
        # The chain itself may be wrong there: then more doubt would only lose its points.
        if not less.max() < wound.max() or _loses(again, fit, cells, chain):
            break
        fit, wound = again, less
    return fit


def _loses(fit: Fit, before: Fit, cells: ArcCells, chain: Chain) -> bool:
    """Whether a fit has let go of points, or lies farther from them than the chain does."""
    lost = float(cells.counts @ (before.weights - fit.weights))
    away = polygon_distances(cells.means_mm, chain.nodes_mm, closed=chain.closed)
    squares = away**2 + cells.covariances_mm2[:, [0, 2]].sum(axis=1)
    usual = float(np.average(squares, weights=cells.counts))
    return lost > _LOSS * cells.total or fit.noise.variance_mm2 > _OFF**2 * usual


def _settled(
    cells: ArcCells,
    control: FloatArray,
    t: FloatArray,
    noise: Noise,
    *,
    closed: bool,
    log_stiffness: FloatArray | None = None,
) -> Fit:
    """Fit until noise and knots are what the fit itself asks for."""
    fit = smooth(
        cells, control, t, noise, closed=closed, log_stiffness=log_stiffness, still=_NEARLY
    )
    within = None if closed else ends_of(fit, cells)
    for turn in range(_PASSES):
        wanted = _wanted_spans(fit.edf, len(cells))
        noise = looked_at_again(fit, cells)
        if turn > 1:  # more smoothing shows more noise, and less less: half-way does not swing
            noise = replace(noise, relative=np.sqrt(noise.relative * fit.noise.relative))
        settled = abs(np.log(noise.inflation / fit.noise.inflation)) < 0.1
        settled &= float(np.abs(np.log(noise.relative / fit.noise.relative)).max()) < 0.2
        if settled and turn > 0 and 0.8 < wanted / fit.spans < 1.25:
            break
        fit = _resumed(fit, cells, noise, wanted, within)
        within = None
    return fit


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
    step = float(np.linalg.norm(np.diff(vertices, axis=0), axis=1).max())
    reach = np.maximum(reach, step)  # exact data, too, lie that far from the nearest vertex
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
