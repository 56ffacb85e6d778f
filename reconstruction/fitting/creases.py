"""Creases: corners that a smooth curve can only round.

Where the smooth fit turns much within its own resolution and little beside it, the run is cut; each
piece is fitted by itself a little past the cut, neighbours meet where they cross, and the pieces
become one curve with threefold knots at the corners. The corners stay if the one-sided tangents
differ by more than three standard deviations and the pieces explain the points with less freedom
than the smooth curve (Schwarz 1978), and if the raw points about
each corner lie on both sides of it alike. Cells beside a cut may hold both walls and are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.errors import ReconstructionError
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.misfits import MIXED, excess
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.preliminary import reknotted, through
from reconstruction.fitting.recognition import Shape
from reconstruction.fitting.scatter import looked_at_again
from reconstruction.fitting.smoothing import Fit, Noise, smooth
from reconstruction.fitting.spline import evaluate, nurbs_of
from reconstruction.fitting.uncertainty import deviations_along, variances_at
from reconstruction.nurbs import Curve

_A_SPAN = 8  # places on the smooth curve
_FINE = 16  # places on a piece, a span: which piece a cell is nearest to, and roughly where
_WINDOW = 4.0  # spans in which a rounded corner turns
_LEAST_TURN = math.radians(20)
_CONCENTRATED = 0.6  # share of the turning in three windows that a corner does in one
_MOST = 24  # corners
_LOST = 16.0  # squared deviations that a point set aside costs
_MIXED_OFF = 3.5  # standard deviations: cells farther off, or thicker, hold both walls
_LEAST_CELLS = 12  # of a piece
_NEARLY = 0.2  # standard deviations: still enough to tell where pieces cross; ...
_STILL = 0.02  # ... and to stay
_MOSTLY = 0.6  # share of a bend's turning that a corner does at once
_SIGNIFICANT = 3.0  # standard deviations of the angle
_DEAR = 4.0  # degrees of freedom that a corner must save


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    fit: Fit
    rows: IntArray  # of the cells


def creased(fit: Fit, cells: ArcCells, points: FloatArray) -> Shape | None:
    """Return the curve with corners, if the points (n, 2) prefer it to the smooth one.

    Suspects that turn out to be bends are dropped, and the others tried again.
    """
    cuts, turns = _suspects(fit)
    while len(cuts):
        cut = _cut(fit, cells, cuts)
        if cut is None:
            return None
        pieces, noise = cut
        shape = _joined(pieces, cells, noise, closed=fit.closed)
        worse = _excesses(shape, fit, points, cuts)
        price = noise.inflation * math.log(max(cells.total / noise.inflation, 2.0))
        sound = _sharp(pieces, turns, closed=fit.closed) & (worse < _DEAR * price)
        if sound.all():
            return shape if _preferred(fit, cells, pieces, noise, float(worse.sum())) else None
        cuts, turns = cuts[sound], turns[sound]
    return None


def _excesses(shape: Shape, fit: Fit, points: FloatArray, cuts: FloatArray) -> FloatArray:
    sigma = math.sqrt((shape.noise or fit.noise).variance_mm2)
    return np.array(
        [
            excess(shape.curve, fit, points, corner, cut, sigma)
            for corner, cut in zip(shape.creases, cuts, strict=True)
        ]
    )


def _cut(fit: Fit, cells: ArcCells, cuts: FloatArray) -> tuple[list[_Piece], Noise] | None:
    """The pieces between cuts, met at corners, and the noise they show.

    None if they do not meet, or a single cut is in vain.
    """
    rows = _clear(fit, cells, cuts)
    pieces = [_fitted(fit, cells, rows, start, end) for start, end in _ways(fit, cuts)]
    whole = [piece for piece in pieces if piece is not None]
    if len(whole) < len(pieces):
        return None
    # At the most favourable noise already: of one suspect there is nothing else to be tried.
    best = Noise(whole[0].fit.noise.variance_mm2, np.ones(len(cells)))
    if len(cuts) == 1 and not _preferred(fit, cells, whole, best):
        return None
    settled = _settled(fit, whole, cells)
    met = None if settled is None else _met(*settled, cells, closed=fit.closed)
    return None if settled is None or met is None else (met, settled[1])


def _clear(fit: Fit, cells: ArcCells, cuts: FloatArray) -> IntArray:
    """Rows of the cells that belong to one side only: beside a cut they may hold both."""
    away = np.abs(fit.t[:, None] - cuts)
    if fit.closed:
        away = np.minimum(away, fit.spans - away)
    return np.flatnonzero((away.min(axis=1) > MIXED) & (cells.counts > 0))


def _suspects(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Parameters where the smooth curve turns much in a short way, and how much, in rad."""
    t = np.arange(_A_SPAN * fit.spans) / _A_SPAN
    _, first, second = evaluate(fit.control_mm, t)
    square = np.maximum((first**2).sum(axis=1), 1e-300)
    turning = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / square / _A_SPAN
    near = _summed(turning, int(_WINDOW * _A_SPAN), closed=fit.closed)
    wide = _summed(np.abs(turning), int(3 * _WINDOW * _A_SPAN), closed=fit.closed)
    sharp = np.where(np.abs(near) > _CONCENTRATED * wide, np.abs(near), 0.0)
    turned = np.abs(near)
    cuts: list[int] = []
    for _ in range(_MOST):
        best = int(sharp.argmax())
        if sharp[best] < _LEAST_TURN:
            break
        cuts.append(best)
        away = np.abs(t - t[best])
        sharp[np.minimum(away, fit.spans - away) < 2 * _WINDOW] = 0.0
    found = np.sort(np.array(cuts, dtype=np.int64))
    inner = (t[found] > _WINDOW) & (t[found] < fit.spans - _WINDOW)
    found = found if fit.closed else found[inner]
    return t[found], turned[found]


def _summed(values: FloatArray, window: int, *, closed: bool) -> FloatArray:
    """Sums over centred windows."""
    half = min(window // 2, (len(values) - 1) // 2)
    padded = np.pad(values, half, mode="wrap" if closed else "constant")
    sums = np.concatenate([[0.0], padded.cumsum()])
    return np.asarray(sums[2 * half + 1 :] - sums[: -2 * half - 1])


def _ways(fit: Fit, cuts: FloatArray) -> list[tuple[float, float]]:
    """Start and end of every piece; of a closed curve the last runs over the seam."""
    if fit.closed:
        ends = np.append(cuts[1:], cuts[0] + fit.spans)
        return list(zip(cuts.tolist(), ends.tolist(), strict=True))
    return list(pairwise([0.0, *cuts.tolist(), float(fit.spans)]))


def _fitted(fit: Fit, cells: ArcCells, rows: IntArray, start: float, end: float) -> _Piece | None:
    """Fit the cells of one piece by a curve that runs on past its cuts."""
    share = fit.t[rows] - start
    share = np.mod(share, fit.spans) if fit.closed else share
    rows = rows[(share >= 0) & (share <= end - start)]
    if len(rows) < _LEAST_CELLS:
        return None
    places = _straightened(fit, start, end)
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()])
    spans = max(int(end - start), 4)
    t = along / along[-1] * spans
    control = through(places, t, spans, closed=False)
    own = cells.only(rows)
    feet = t[cKDTree(places).query(own.means_mm)[1]]
    noise = fit.noise.only(rows)
    try:
        return _Piece(smooth(own, control, feet, noise, closed=False, still=_NEARLY), rows)
    except ReconstructionError:
        return None


def _straightened(fit: Fit, start: float, end: float) -> FloatArray:
    """The smooth curve without its rounded corners, drawn on along its tangents past the cuts."""
    margin = min(_WINDOW / 2, (end - start) / 4)
    first = margin if fit.closed or start > 0.0 else 0.0
    last = margin if fit.closed or end < fit.spans else 0.0
    t = np.linspace(start + first, end - last, 8 * max(int(end - start), 4))
    places, tangents, _ = evaluate(fit.control_mm, np.mod(t, fit.spans) if fit.closed else t)
    beyond = np.linspace(0.0, 2.5, 12)[1:, None]
    head = places[0] - first * beyond[::-1] * tangents[0]
    tail = places[-1] + last * beyond * tangents[-1]
    return np.vstack([head[: 12 * (first > 0)], places, tail[: 12 * (last > 0)]])


def _met(
    pieces: list[_Piece], noise: Noise, cells: ArcCells, *, closed: bool
) -> list[_Piece] | None:
    """Trim the pieces where they cross, share the cells anew, and fit between the corners."""
    stretches = [[0.0, float(piece.fit.spans)] for piece in pieces]
    for one in range(len(pieces) if closed else len(pieces) - 1):
        other = (one + 1) % len(pieces)
        crossing = _crossing(pieces[one].fit, pieces[other].fit)
        if crossing is None:
            return None
        stretches[one][1], stretches[other][0] = crossing
    if any(not end - start > 1.0 for start, end in stretches):
        return None
    trimmed = [_trimmed(piece.fit, *ends) for piece, ends in zip(pieces, stretches, strict=True)]
    fine = [np.linspace(0.0, len(control) - 3, _FINE * len(control)) for control in trimmed]
    trees = [cKDTree(evaluate(c, t)[0]) for c, t in zip(trimmed, fine, strict=True)]
    rows = np.concatenate([piece.rows for piece in pieces])
    found = [tree.query(cells.means_mm[rows]) for tree in trees]
    owner = np.argmin(np.stack([np.asarray(distances) for distances, _ in found]), axis=0)
    out = []
    for k, (control, t) in enumerate(zip(trimmed, fine, strict=True)):
        own = np.flatnonzero(owner == k)
        rough = replace(pieces[k].fit, control_mm=control, t=t[np.asarray(found[k][1])[own]])
        piece = _smoothed(rough, cells, rows[own], noise)
        if piece is None:
            return None
        out.append(piece)
    return out


def _settled(fit: Fit, pieces: list[_Piece], cells: ArcCells) -> tuple[list[_Piece], Noise] | None:
    """Fit the pieces at the noise that they show, to the cells that are of one wall."""
    own = [_of_one_wall(piece, cells) for piece in pieces]
    looked = [looked_at_again(piece.fit, cells.only(piece.rows)) for piece in own]
    relative = np.ones(len(cells))
    for piece, noise in zip(own, looked, strict=True):
        relative[piece.rows] = noise.relative
    held = [float(cells.counts[piece.rows].sum()) for piece in own]
    variance, inflation = (
        float(np.average(values, weights=held))
        for values in ([each.variance_mm2 for each in looked], [each.inflation for each in looked])
    )
    noise = Noise(variance, relative, inflation, fit.noise.doubt)
    again = [_smoothed(piece.fit, cells, piece.rows, noise, still=_NEARLY) for piece in own]
    whole = [piece for piece in again if piece is not None]
    return (whole, noise) if len(whole) == len(again) else None


def _of_one_wall(piece: _Piece, cells: ArcCells) -> _Piece:
    """Leave out cells near the corners that hold more than the noise explains: both walls."""
    fit, counts = piece.fit, cells.counts[piece.rows]
    squares = fit.distances_mm**2 + fit.scatters_mm2
    many = counts > 1
    if not many.any():
        return piece
    variance = float(np.median(squares[many] * counts[many] / np.maximum(counts[many] - 1, 1)))
    off = np.abs(fit.distances_mm) < _MIXED_OFF * np.sqrt(variance / counts)
    thin = fit.scatters_mm2 < variance * (1.0 + _MIXED_OFF * np.sqrt(2.0 / counts))
    within = (fit.t > 2 * _WINDOW) & (fit.t < fit.spans - 2 * _WINDOW)
    return _only(piece, np.flatnonzero((off & thin) | ~many | within))


def _only(piece: _Piece, which: IntArray) -> _Piece:
    fit = piece.fit
    noise = fit.noise.only(which)
    kept = {name: getattr(fit, name)[which] for name in ("t", "distances_mm", "scatters_mm2",
                                                         "weights")}  # fmt: skip
    return _Piece(replace(fit, noise=noise, **kept), piece.rows[which])


def _smoothed(
    rough: Fit, cells: ArcCells, rows: IntArray, noise: Noise, *, still: float = _STILL
) -> _Piece | None:
    try:
        again = smooth(
            cells.only(rows), rough.control_mm, rough.t, noise.only(rows), closed=False,
            log_stiffness=rough.log_stiffness, still=still,
        )  # fmt: skip
    except ReconstructionError:
        return None
    return _Piece(again, rows)


def _trimmed(fit: Fit, start: float, end: float) -> FloatArray:
    return reknotted(fit.control_mm, max(int(end - start), 4), closed=False, within=(start, end))


def _crossing(one: Fit, other: Fit) -> tuple[float, float] | None:
    """Parameters at which the end of one piece crosses the start of the next."""
    t = np.linspace(0.5 * one.spans, one.spans, 200)
    u = np.linspace(0.0, 0.5 * other.spans, 200)
    a, b = evaluate(one.control_mm, t)[0], evaluate(other.control_mm, u)[0]
    p, q = np.diff(a, axis=0)[:, None, :], np.diff(b, axis=0)[None, :, :]
    arms = b[None, :-1] - a[:-1, None]
    cross = p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (arms[..., 0] * q[..., 1] - arms[..., 1] * q[..., 0]) / cross
        r = (arms[..., 0] * p[..., 1] - arms[..., 1] * p[..., 0]) / cross
    hits = np.argwhere((s >= 0) & (s < 1) & (r >= 0) & (r < 1))
    if not len(hits):
        return None
    i, j = hits[0]
    return float(t[i] + s[i, j] * (t[1] - t[0])), float(u[j] + r[i, j] * (u[1] - u[0]))


def _preferred(
    fit: Fit, cells: ArcCells, pieces: list[_Piece], noise: Noise, worse: float = 0.0
) -> bool:
    """Whether the pieces explain the points, at the noise they show, with less than the curve.

    `worse` is what the points beside the cuts, which no cell tells of, add to their cost.
    """
    price = math.log(max(cells.total / noise.inflation, 2.0))
    smooth_cost = fit.edf * price
    cost = len(pieces) * _DEAR * price + worse / noise.inflation
    for piece in pieces:
        rows, own = piece.rows, piece.fit
        counts, among = cells.counts[rows], noise.only(rows)
        cost += own.edf * price
        cost += _misfit(counts, own.distances_mm, own.scatters_mm2, own.weights, among)
        smooth_cost += _misfit(
            counts, fit.distances_mm[rows], fit.scatters_mm2[rows], fit.weights[rows], among
        )
    return cost < smooth_cost


def _misfit(
    counts: FloatArray,
    distances: FloatArray,
    scatters: FloatArray,
    weights: FloatArray,
    noise: Noise,
) -> float:
    squares = (distances**2 + scatters) / (noise.variance_mm2 * noise.relative)
    lost = _LOST * (1.0 - weights)
    return float((counts / noise.kinship * (weights * squares + lost)).sum())


def _sharp(pieces: list[_Piece], turns: FloatArray, *, closed: bool) -> BoolArray:
    """Which corners turn by more than their one-sided tangents are uncertain, in order.

    And by most of what the smooth curve turns there: else it is a bend, cut in two.
    """
    pairs = [(pieces[-1], pieces[0])] if closed else []
    sharp = []
    for (before, after), whole in zip((*pairs, *pairwise(pieces)), turns, strict=True):
        p, da = _tangent(before.fit, float(before.fit.spans), -1.0)
        q, db = _tangent(after.fit, 0.0, 1.0)
        turn = abs(math.atan2(p[0] * q[1] - p[1] * q[0], float(p @ q)))
        sharp.append(turn >= max(_LEAST_TURN, _MOSTLY * whole, _SIGNIFICANT * math.hypot(da, db)))
    return np.array(sharp)


def _tangent(fit: Fit, at: float, inward: float) -> tuple[FloatArray, float]:
    """Tangent at an end, and roughly its standard deviation: the band's over two spans."""
    t = np.array([at, at + inward * min(2.0, fit.spans / 2)])
    places, first, _ = evaluate(fit.control_mm, t)
    deviation = np.sqrt(variances_at(fit.control_mm, fit.inverse, t, closed=False))
    length = max(float(np.linalg.norm(places[1] - places[0])), 1e-300)
    return first[0], float(deviation.max()) / length


def _joined(pieces: list[_Piece], cells: ArcCells, noise: Noise, *, closed: bool) -> Shape:
    """One curve, parametrised by length, threefold knots at the corners."""
    lengths = [float(span_lengths(p.fit.control_mm, p.fit.spans).sum()) for p in pieces]
    stops = np.concatenate([[0.0], np.cumsum(lengths)]) / sum(lengths)
    curve = _curve(pieces, stops, closed=closed)
    fine = np.linspace(0.0, 1.0, 4097)
    distances, u, scatters = np.zeros((3, len(cells)))
    rest = np.ones(len(cells), np.bool_)
    rest[np.concatenate([piece.rows for piece in pieces])] = False
    found = cKDTree(curve(fine)).query(cells.means_mm[rest])
    distances[rest], u[rest] = np.asarray(found[0]), fine[np.asarray(found[1])]
    grid = np.linspace(0.0, 1.0, 1025)
    deviations = np.empty(len(grid))
    for piece, start, end in zip(pieces, stops[:-1], stops[1:], strict=True):
        u[piece.rows] = start + (end - start) * piece.fit.t / piece.fit.spans
        distances[piece.rows] = piece.fit.distances_mm
        scatters[piece.rows] = piece.fit.scatters_mm2
        band = deviations_along(piece.fit)
        inside = (grid >= start) & (grid <= end)
        places = np.linspace(start, end, len(band))
        deviations[inside] = np.interp(grid[inside], places, band)
    corners = stops[:-1] if closed else stops[1:-1]
    edf = sum(piece.fit.edf for piece in pieces)
    counts = [float(cells.counts[piece.rows].sum()) for piece in pieces]
    variance = np.average([piece.fit.noise.variance_mm2 for piece in pieces], weights=counts)
    return Shape(
        "free", curve, deviations, u, distances, scatters, edf, tuple(corners.tolist()),
        replace(noise, variance_mm2=float(variance)),
    )  # fmt: skip


def _curve(pieces: list[_Piece], stops: FloatArray, *, closed: bool) -> Curve:
    clamped = [nurbs_of(piece.fit.control_mm, closed=False) for piece in pieces]
    points: list[FloatArray] = []
    knots: list[FloatArray] = []
    for k, own in enumerate(clamped):
        before = clamped[k - 1].control_points_mm[-1] if k or closed else None
        first = own.control_points_mm[0]
        corner = first if before is None else (first + before) / 2
        points += [corner[None], own.control_points_mm[1:-1]]
        inner = stops[k] + (stops[k + 1] - stops[k]) * own.knots[4:-4]
        knots += [np.full(3, stops[k]), inner]
    if closed:
        period = np.concatenate(knots)
        around = np.concatenate([period[-1:] - 1.0, period, period[:6] + 1.0])
        control = np.vstack(points)
        return Curve(3, around, control, np.ones(len(control)), periodic=True)
    points.append(clamped[-1].control_points_mm[-1:])
    ends = np.concatenate([[stops[0]], *knots, np.full(4, stops[-1])])
    control = np.vstack(points)
    return Curve(3, ends, control, np.ones(len(control)), periodic=False)
