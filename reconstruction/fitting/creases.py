"""Creases: corners that a smooth curve can only round.

Where the smooth fit turns much within its own resolution and little beside it, the run is cut into
pieces that meet at corners (`pieces`); they become one curve with threefold knots there. A corner
stays if its one-sided tangents differ by more than three standard deviations and by most of what
the smooth curve turns, and if the raw points about it lie as near to it as to the smooth curve
(`misfits`); all of them, if they explain the points with less freedom (Schwarz 1978).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.misfits import MIXED, excess
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.pieces import (
    WINDOW,
    Corner,
    Cut,
    Piece,
    corner_cost,
    cut_at,
    met,
    preferred,
    stilled,
)
from reconstruction.fitting.recognition import Shape
from reconstruction.fitting.smoothing import Fit, Noise
from reconstruction.fitting.spline import evaluate, nurbs_of
from reconstruction.fitting.uncertainty import deviations_along, variances_at
from reconstruction.nurbs import Curve

_A_SPAN = 8  # places on the smooth curve
_PLACES = 60  # to either side of a corner
_LEAST_TURN = math.radians(20)
_CONCENTRATED = 0.6  # share of the turning in three windows that a corner does in one
_MOST = 24  # corners
_MOSTLY = 0.6  # share of a bend's turning that a corner does at once
_SIGNIFICANT = 3.0  # standard deviations of the angle


def creased(fit: Fit, cells: ArcCells, points: FloatArray) -> Shape | None:
    """Return the curve with corners, if the points (n, 2) prefer it to the smooth one.

    Suspects that turn out to be bends are dropped, and the others tried again.
    """
    cuts, turns = _suspects(fit)
    while len(cuts):
        cut = cut_at(fit, cells, cuts)
        if cut is None:
            return None
        worse = _excesses(cut.corners, fit, points, cuts, cut.noise)
        dear = cut.noise.inflation * corner_cost(cells, cut.noise)
        sound = _sharp(cut.corners, turns) & (worse < dear)
        if sound.all():
            return _joined(cut, fit, cells, float(worse.sum()))
        cuts, turns = cuts[sound], turns[sound]
    return None


def _joined(cut: Cut, fit: Fit, cells: ArcCells, worse: float) -> Shape | None:
    """The pieces as one curve, if they are preferred to the smooth one."""
    pieces = met(cut, cells)
    if pieces is None or not preferred(fit, cells, pieces, cut.noise, worse):
        return None
    return _shape(stilled(pieces, cells, cut.noise), cells, cut.noise, closed=fit.closed)


def _excesses(
    corners: list[Corner], fit: Fit, points: FloatArray, cuts: FloatArray, noise: Noise
) -> FloatArray:
    reach = MIXED * float(span_lengths(fit.control_mm, fit.spans).mean())
    sigma = math.sqrt(noise.variance_mm2)
    return np.array(
        [
            excess(corner.line(reach, _PLACES), fit, points, cut, sigma)
            for corner, cut in zip(corners, cuts, strict=True)
        ]
    )


def _suspects(fit: Fit) -> tuple[FloatArray, FloatArray]:
    """Parameters where the smooth curve turns much in a short way, and how much, in rad."""
    t = np.arange(_A_SPAN * fit.spans) / _A_SPAN
    _, first, second = evaluate(fit.control_mm, t)
    square = np.maximum((first**2).sum(axis=1), 1e-300)
    turning = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / square / _A_SPAN
    near = _summed(turning, int(WINDOW * _A_SPAN), closed=fit.closed)
    wide = _summed(np.abs(turning), int(3 * WINDOW * _A_SPAN), closed=fit.closed)
    sharp = np.where(np.abs(near) > _CONCENTRATED * wide, np.abs(near), 0.0)
    turned = np.abs(near)
    cuts: list[int] = []
    for _ in range(_MOST):
        best = int(sharp.argmax())
        if sharp[best] < _LEAST_TURN:
            break
        cuts.append(best)
        away = np.abs(t - t[best])
        sharp[np.minimum(away, fit.spans - away) < 2 * WINDOW] = 0.0
    found = np.sort(np.array(cuts, dtype=np.int64))
    inner = (t[found] > WINDOW) & (t[found] < fit.spans - WINDOW)
    found = found if fit.closed else found[inner]
    return t[found], turned[found]


def _summed(values: FloatArray, window: int, *, closed: bool) -> FloatArray:
    """Sums over centred windows."""
    half = min(window // 2, (len(values) - 1) // 2)
    padded = np.pad(values, half, mode="wrap" if closed else "constant")
    sums = np.concatenate([[0.0], padded.cumsum()])
    return np.asarray(sums[2 * half + 1 :] - sums[: -2 * half - 1])


def _sharp(corners: list[Corner], turns: FloatArray) -> BoolArray:
    """Which corners turn by more than their one-sided tangents are uncertain, in order.

    And by most of what the smooth curve turns there: else it is a bend, cut in two.
    """
    sharp = []
    for corner, whole in zip(corners, turns, strict=True):
        p, da = _tangent(corner.before.fit, corner.end, -1.0)
        q, db = _tangent(corner.after.fit, corner.start, 1.0)
        turn = abs(math.atan2(p[0] * q[1] - p[1] * q[0], float(p @ q)))
        sharp.append(turn >= max(_LEAST_TURN, _MOSTLY * whole, _SIGNIFICANT * math.hypot(da, db)))
    return np.array(sharp)


def _tangent(fit: Fit, at: float, inward: float) -> tuple[FloatArray, float]:
    """Tangent at an end, and roughly its standard deviation: the band's over two spans."""
    t = np.clip([at, at + inward * min(2.0, fit.spans / 2)], 0.0, fit.spans)
    places, first, _ = evaluate(fit.control_mm, t)
    deviation = np.sqrt(variances_at(fit.control_mm, fit.inverse, t, closed=False))
    length = max(float(np.linalg.norm(places[1] - places[0])), 1e-300)
    return first[0], float(deviation.max()) / length


def _shape(pieces: list[Piece], cells: ArcCells, noise: Noise, *, closed: bool) -> Shape:
    """One curve, parametrised by length, threefold knots at the corners."""
    lengths = [float(span_lengths(p.fit.control_mm, p.fit.spans).sum()) for p in pieces]
    stops = np.concatenate([[0.0], np.cumsum(lengths)]) / sum(lengths)
    curve = _curve(pieces, stops, closed=closed)
    fine = np.linspace(0.0, 1.0, 1025)
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


def _curve(pieces: list[Piece], stops: FloatArray, *, closed: bool) -> Curve:
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
