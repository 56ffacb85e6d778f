"""Exact shapes where the points prefer one: circle and ellipse, arc and line.

Each is fitted by orthogonal distance (Gauss-Newton on normal distances, with the same bias
corrections as the free curve) and takes its place if two judges agree: Schwarz's criterion (1978),
with the free curve's degrees of freedom, and the excess of misfit, which must be one that chance
explains; the criterion alone would forgive a shape errors that a free curve does not make.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.smoothing import Fit, Noise
from reconstruction.fitting.spline import evaluate
from reconstruction.fitting.uncertainty import variances_at
from reconstruction.nurbs import Curve, circle

_STEPS = 10
_SKETCHED = 128  # places on the free curve
_SUSPECT = 3.0  # posterior standard deviations, rms: a sketch farther off needs no second look ...
_SKETCHY = 0.5  # ... of which none is less than this share of the noise: exact data have hardly any
_NEAR = _SUSPECT**2 * _SKETCHED
_HOPELESS = 100.0  # times that
_CHANCE = 4.0  # standard deviations of excess misfit
_LEAST_RATIO = 0.05  # of an ellipse's axes
_FLATTEST = 1e4  # radius of an arc over its length


@dataclass(frozen=True, slots=True, eq=False)
class _Reading:
    """Where the data stand against a shape: outward distances and how they depend on it."""

    distances_mm: FloatArray  # (m,)
    normals: FloatArray  # (m, 2), outward
    curvatures: FloatArray  # (m,), positive where the centre is inside
    slopes: FloatArray  # (m, p): outward move of the shape for each parameter


Measure = Callable[[FloatArray, FloatArray], _Reading]


@dataclass(frozen=True, slots=True, eq=False)
class _Data:
    """Places to which a shape is fitted: a sketch of the free curve, or the cells themselves."""

    places_mm: FloatArray  # (m, 2)
    weights: FloatArray  # (m,), 1 / mm2
    variances_mm2: FloatArray  # (m,), of a point
    covariances_mm2: FloatArray  # (m, 3), of a cell


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    kind: str
    measure: Measure
    parameters: FloatArray
    covariance: FloatArray
    distances_mm: FloatArray  # (m,)
    scatters_mm2: FloatArray  # (m,)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """An exact curve that explains the points."""

    kind: str
    curve: Curve
    deviations_mm: FloatArray  # (k,), evenly over the domain
    u: FloatArray  # (m,), where each cell belongs
    distances_mm: FloatArray  # (m,)
    scatters_mm2: FloatArray  # (m,)
    freedom: float
    creases: tuple[float, ...] = ()  # in u
    noise: Noise | None = None  # where it is another than the free curve's


def recognised(fit: Fit, cells: ArcCells) -> Shape | None:
    """Return the shape the points prefer to the free curve, if there is one."""
    held = cells.counts * fit.weights
    own = fit.noise.variance_mm2 * fit.noise.relative
    data = _Data(cells.means_mm, held / (own * fit.noise.kinship), own, cells.covariances_mm2)
    price = math.log(max(float(held.sum()) / fit.noise.inflation, 2.0))  # of a degree of freedom
    free = _misfit(data, fit.distances_mm, fit.scatters_mm2)
    best, least = None, math.inf
    for trial in _trials(fit):
        found = _fitted(trial.kind, trial.measure, trial.parameters, data)
        if found is None:
            continue
        freedom = len(found.parameters)
        excess = _misfit(data, found.distances_mm, found.scatters_mm2) - free
        usual = max(1.3 * fit.edf - freedom, 1.0)
        explained = excess < usual + _CHANCE * (math.sqrt(2 * usual) + 1.0)
        # A free curve as stiff as a circle is still more than one.
        dearer = max(fit.edf, freedom + 1.0) * price
        score = excess + freedom * price
        if explained and score < min(dearer, least):
            best, least = found, score
    return None if best is None else _shape(fit, cells, best)


def _misfit(data: _Data, distances: FloatArray, scatters: FloatArray) -> float:
    return float((data.weights * (distances**2 + scatters)).sum())


def _trials(fit: Fit) -> list[_Fitted]:
    """Shapes that lie about within the free curve's own uncertainty: few curves come so far."""
    t = np.linspace(0.0, fit.spans, _SKETCHED, endpoint=not fit.closed)
    places, tangents, _ = evaluate(fit.control_mm, t)
    variances = np.maximum(
        variances_at(fit.control_mm, fit.inverse, t, closed=fit.closed),
        _SKETCHY**2 * fit.noise.variance_mm2,
    )
    # Even arc length would weigh alike; the parametrisation may run unevenly.
    shares = np.linalg.norm(tangents, axis=1)
    weights = shares / shares.mean() / np.maximum(variances, 1e-12 * float(np.ptp(places)) ** 2)
    nothing = np.zeros(len(t))
    data = _Data(places, weights, nothing, np.zeros((len(t), 3)))
    trials = _closed_trials(data) if fit.closed else _open_trials(data)
    return [trial for trial in trials
            if _misfit(data, trial.distances_mm, nothing) < _NEAR]  # fmt: skip


def _closed_trials(data: _Data) -> list[_Fitted]:
    ring = _fitted("circle", _measure_circle, _algebraic_circle(data), data, most=_NEAR)
    oval = _fitted("ellipse", _measure_ellipse, _principal_ellipse(data), data, most=_NEAR)
    found = [] if ring is None else [ring]
    if (
        oval is not None
        and _LEAST_RATIO < oval.parameters[2] / oval.parameters[3] < 1 / _LEAST_RATIO
    ):
        found.append(oval)
    return found


def _open_trials(data: _Data) -> list[_Fitted]:
    ends = data.places_mm[[0, -1]]
    chord = ends[1] - ends[0]
    length = float(np.hypot(*chord))
    if not length > 0:
        return []
    middle, along = ends.mean(axis=0), chord / length

    def measure_line(parameters: FloatArray, places: FloatArray) -> _Reading:
        return _measure_line(parameters, places, middle, along)

    straight = _fitted("line", measure_line, np.zeros(2), data, most=_NEAR)
    bent = _fitted("arc", _measure_circle, _algebraic_circle(data), data, most=_NEAR)
    found = [] if straight is None else [straight]
    if bent is not None and bent.parameters[2] < _FLATTEST * length:
        found.append(bent)
    return found


def _fitted(
    kind: str, measure: Measure, start: FloatArray, data: _Data, *, most: float = math.inf
) -> _Fitted | None:
    """Gauss-Newton on normal distances; None where it does not settle on a shape.

    Or where its first two steps leave a misfit far beyond `most`.
    """
    parameters = start
    for turn in range(_STEPS):
        with np.errstate(all="ignore"):  # what is not finite is refused below
            reading = measure(parameters, data.places_mm)
            along, scatters = _turned(data.covariances_mm2, reading.normals)
            bias = 0.5 * reading.curvatures * (data.variances_mm2 - along)
            distances = reading.distances_mm - bias
            normal_matrix = reading.slopes.T @ (data.weights[:, None] * reading.slopes)
        if not (np.isfinite(normal_matrix).all() and np.isfinite(distances).all()):
            return None
        try:
            covariance = np.asarray(np.linalg.inv(normal_matrix), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        if turn == 2 and _misfit(data, distances, scatters) > _HOPELESS * most:
            return None
        step = covariance @ (reading.slopes.T @ (data.weights * distances))
        if not (np.isfinite(step).all() and (covariance.diagonal() > 0).all()):
            return None
        parameters = np.asarray(parameters + step)
        if float(step @ normal_matrix @ step) < 1e-4:
            return _Fitted(kind, measure, parameters, covariance, distances, scatters)
    return None


def _turned(covariances: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Variances along and across a shape from (m, 3) covariances and its normals."""
    xx, xy, yy = covariances.T
    nx, ny = normals.T
    across = nx * nx * xx + 2 * nx * ny * xy + ny * ny * yy
    return np.maximum(xx + yy - across, 0.0), np.maximum(across, 0.0)


def _algebraic_circle(data: _Data) -> FloatArray:
    """Kasa's circle, (centre x, centre y, radius): a start."""
    centre = data.places_mm.mean(axis=0)
    places = data.places_mm - centre
    rows = np.column_stack([2 * places, np.ones(len(places))])
    found = np.linalg.lstsq(rows, (places**2).sum(axis=1), rcond=None)[0]
    radius = math.sqrt(max(float(found[2] + found[0] ** 2 + found[1] ** 2), 1e-300))
    return np.array([centre[0] + found[0], centre[1] + found[1], radius])


def _measure_circle(parameters: FloatArray, places: FloatArray) -> _Reading:
    arms = places - parameters[:2]
    lengths = np.maximum(np.linalg.norm(arms, axis=1), 1e-300)
    normals = arms / lengths[:, None]
    curvatures = np.full(len(places), 1.0 / parameters[2])
    slopes = np.column_stack([normals, np.ones(len(places))])
    return _Reading(lengths - parameters[2], normals, curvatures, slopes)


def _principal_ellipse(data: _Data) -> FloatArray:
    """(centre x, y, half axes a, b, turn of a in rad) from the sketch's second moments.

    Along an ellipse they are nearly its half axes squared, halved.
    """
    spread = np.cov(data.places_mm.T)
    values, axes = np.linalg.eigh(spread)
    a, b = math.sqrt(2 * values[1]), math.sqrt(2 * max(values[0], 1e-6 * values[1]))
    return np.array([*data.places_mm.mean(axis=0), a, b, math.atan2(axes[1, 1], axes[0, 1])])


def _measure_ellipse(parameters: FloatArray, places: FloatArray) -> _Reading:
    x, y, a, b, turn = parameters
    along = np.array([math.cos(turn), math.sin(turn)])
    beside = np.array([-along[1], along[0]])
    p, q = (places - [x, y]) @ along, (places - [x, y]) @ beside
    angle = _ellipse_feet(a, b, p, q)
    c, s = np.cos(angle), np.sin(angle)
    root = np.sqrt(b * b * c * c + a * a * s * s)
    np_, nq = b * c / root, a * s / root
    distances = (p - a * c) * np_ + (q - b * s) * nq
    normals = np_[:, None] * along + nq[:, None] * beside
    curvatures = a * b / root**3
    lever = a * c * nq - b * s * np_
    slopes = np.column_stack([normals, np_ * c, nq * s, lever])
    return _Reading(distances, normals, curvatures, slopes)


@njit(cache=True, nogil=True, error_model="numpy")
def _ellipse_feet(a: float, b: float, p: FloatArray, q: FloatArray) -> FloatArray:
    """Eccentric angle of the nearest point, by Newton from the angle of the scaled place."""
    angles = np.arctan2(q * a, p * b)
    for m in range(len(p)):
        for _ in range(8):
            c, s = math.cos(angles[m]), math.sin(angles[m])
            slope = (p[m] - a * c) * (-a * s) + (q[m] - b * s) * (b * c)
            speed = a * a * s * s + b * b * c * c
            bent = speed + (p[m] - a * c) * a * c + (q[m] - b * s) * b * s
            step = min(max(slope / max(bent, 0.2 * speed), -0.5), 0.5)
            angles[m] += step
            if abs(step) < 1e-7:
                break
    return angles


def _shape(fit: Fit, cells: ArcCells, found: _Fitted) -> Shape:
    curve = _curve(fit, found)
    grid = np.linspace(*curve.domain, 2049)
    places = curve(grid)
    slopes = found.measure(found.parameters, places[::8]).slopes
    u = grid[cKDTree(places).query(cells.means_mm)[1]]
    noise = _noise(fit, cells, found)
    # The parameters were found at the free curve's noise.
    covariance = found.covariance * (noise.variance_mm2 / fit.noise.variance_mm2)
    deviations = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes))
    return Shape(
        found.kind, curve, deviations, u, found.distances_mm, found.scatters_mm2,
        len(found.parameters), noise=noise,
    )  # fmt: skip


def _noise(fit: Fit, cells: ArcCells, found: _Fitted) -> Noise:
    """What scatters about the shape; exact data may have more about the free curve."""
    held = cells.counts * fit.weights
    squares = (found.distances_mm**2 + found.scatters_mm2) / fit.noise.relative
    freedom = max(float(held.sum()) - len(found.parameters), 1.0)
    least = (1e-7 * float(np.ptp(cells.means_mm, axis=0).max())) ** 2
    return replace(fit.noise, variance_mm2=max(float(held @ squares) / freedom, least))


def _curve(fit: Fit, found: _Fitted) -> Curve:
    parameters = found.parameters
    if found.kind == "circle":
        return _ring(fit, parameters[:2], parameters[2] * np.eye(2))
    if found.kind == "ellipse":
        return _oval(fit, parameters)
    if found.kind == "arc":
        return _arc(fit, parameters)
    ends = evaluate(fit.control_mm, np.array([0.0, fit.spans]))[0]
    reading = found.measure(parameters, ends)
    points = ends - reading.distances_mm[:, None] * reading.normals
    return Curve(1, np.array([0.0, 0.0, 1.0, 1.0]), points, np.ones(2), periodic=False)


def _oval(fit: Fit, parameters: FloatArray) -> Curve:
    x, y, a, b, turn = parameters
    c, s = math.cos(turn), math.sin(turn)
    return _ring(fit, np.array([x, y]), np.array([[a * c, a * s], [-b * s, b * c]]))


def _ring(fit: Fit, centre: FloatArray, axes: FloatArray) -> Curve:
    """An ellipse that runs the way the free curve does."""
    x, y = fit.control_mm.T
    left = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0
    unit = circle(np.zeros(2), 1.0, np.eye(2))
    if not left:
        axes = np.array([axes[0], -axes[1]])
    points = centre + unit.control_points_mm @ axes
    return Curve(2, unit.knots, points, unit.weights, periodic=True)


def _measure_line(
    parameters: FloatArray, places: FloatArray, middle: FloatArray, along: FloatArray
) -> _Reading:
    """(turn in rad, shift to the left) of a line through `middle`."""
    turn, shift = parameters
    c, s = math.cos(turn), math.sin(turn)
    normal = np.array([-along[1] * c - along[0] * s, along[0] * c - along[1] * s])
    arms = places - middle
    lever = arms @ np.array([normal[1], -normal[0]])
    normals = np.tile(normal, (len(places), 1))
    slopes = np.column_stack([lever, np.ones(len(places))])
    return _Reading(arms @ normal - shift, normals, np.zeros(len(places)), slopes)


def _arc(fit: Fit, parameters: FloatArray) -> Curve:
    """The circle's arc from foot to foot of the free curve's ends, quarter turns at most a piece.

    The NURBS Book, section 7.3: the corner of a piece of half angle h weighs cos h.
    """
    places = evaluate(fit.control_mm, np.linspace(0.0, fit.spans, 4 * fit.spans + 1))[0]
    arms = places - parameters[:2]
    angles = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))
    pieces = max(math.ceil(abs(angles[-1] - angles[0]) / (math.pi / 2)), 1)
    half = (angles[-1] - angles[0]) / (2 * pieces)
    turns = angles[0] + half * np.arange(2 * pieces + 1)
    corner = np.arange(2 * pieces + 1) % 2 == 1
    weights = np.where(corner, math.cos(half), 1.0)
    arms = np.column_stack([np.cos(turns), np.sin(turns)]) / weights[:, None]
    inner = np.repeat(np.arange(1, pieces) / pieces, 2)
    knots = np.concatenate([np.zeros(3), inner, np.ones(3)])
    return Curve(2, knots, parameters[:2] + parameters[2] * arms, weights, periodic=False)
