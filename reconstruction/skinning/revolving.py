"""Fitting a surface of revolution: its profile as sections are fitted, its axis along with it.

Cells turn about the axis into the half plane of height and radius; there the profile is the
smoothing fit of an open or closed run (`fitting.smoothing`), its stiffness by restricted
likelihood. Then axis and profile move together by Gauss-Newton: where only a part of the turn is
covered, a lean of the axis and a bulge of the profile look much alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import ReconstructionError, Unfittable
from reconstruction.fitting.bands import LEAST
from reconstruction.fitting.bending import add_penalty, control_normals, curvature_changes
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.preliminary import preliminary, reknotted
from reconstruction.fitting.smoothing import Fit, Noise, smooth, stiffness_along
from reconstruction.fitting.spanning import span
from reconstruction.fitting.spline import spans_of
from reconstruction.skinning.adjustment import Cells, Fitted, spread_over, trusted
from reconstruction.skinning.primitives import polar, turned
from reconstruction.skinning.revolution import Revolution, nearest, refined
from reconstruction.slices import Frame

_ROUNDS = 10
_LAST_ROUNDS = 3
_STILL = 1e-3  # squared, in standard deviations of the axis
_BOXES = (100, 50, 25, 12)  # along the profile's extent; coarser where cells lie far apart
_MOST_BOXES = 600
_NEARLY_ALL = 0.95  # of the cells, on a single file of boxes
_ARCS_A_SPAN = 4
_MOST_SPANS = 100
_CLOSED = 3.0  # usual steps that the ends of a loop may lie apart
_LEAST_LOOP = 12  # boxes
_NEARLY = 0.2  # standard deviations: still enough while the axis moves


@dataclass(frozen=True, slots=True, eq=False)
class _Half:
    """Cells in the half plane, the error of their points taken out of their spread."""

    places_mm: FloatArray  # (m, 2), height and mean radius of the points
    spreads_mm2: FloatArray  # (m, 3): hh, hr, rr
    held: FloatArray  # (m,), weight, 1 / mm2
    variance_mm2: float  # of a point


@dataclass(frozen=True, slots=True, eq=False)
class Sketch:
    """A surface of revolution, and the section fit of its profile."""

    found: Fitted
    frame: Frame
    fit: Fit  # of the profile


def sketched(frame: Frame, cells: Cells) -> Sketch | None:
    """Fit a surface of revolution from an axis nearby; None where no profile is to be found."""
    half = _half(frame, cells)
    profile = _first_profile(half)
    if profile is None:
        return None
    form = Revolution(frame, *profile)
    try:
        return _settled(_reknotted(form, _first_fit(form, half, None), half), frame, cells, _ROUNDS)
    except (ReconstructionError, np.linalg.LinAlgError):
        return None


def revolved(sketch: Sketch, cells: Cells) -> Fitted | None:
    """Fit it to all cells."""
    try:
        return _settled(sketch.fit, sketch.frame, cells, _LAST_ROUNDS).found
    except (ReconstructionError, np.linalg.LinAlgError):
        return None


def _settled(fit: Fit, frame: Frame, cells: Cells, rounds: int) -> Sketch:
    """Profile for the axis, both together, in turn, until the axis stands still."""
    form = Revolution(frame, fit.control_mm, fit.closed)
    t = nearest(fit.control_mm, _half(frame, cells).places_mm, closed=fit.closed)
    for _ in range(rounds):
        half = _half(form.frame, cells)
        t = refined(form.control_mm, half.places_mm, t, closed=form.closed)
        if not np.isfinite(t).all():
            raise Unfittable("the profile of a surface of revolution has run away")
        fit = _profile(form, half, t, fit.log_stiffness)
        form = replace(form, control_mm=fit.control_mm)
        found, right = _together(form, fit, cells, t)
        step = np.asarray(np.linalg.solve(found.normal_matrix, right), dtype=np.float64)
        if not np.isfinite(step).all():
            raise Unfittable("the axis of a surface of revolution has run away")
        if float(step[:4] @ found.normal_matrix[:4, :4] @ step[:4]) < _STILL:
            break
        form = form.moved(step)
    return Sketch(found, form.frame, fit)


def _half(frame: Frame, cells: Cells) -> _Half:
    heights, radii, outward, around = polar(frame, cells.moments.means_mm)
    spread = cells.moments.covariances_mm2 - cells.scale[:, None, None] * cells.noise_mm2
    axis = frame.axes[2]
    along, away = spread @ axis, np.einsum("mij,mj->mi", spread, outward)
    hh, hr, rr = along @ axis, (along * outward).sum(axis=1), (away * outward).sum(axis=1)
    aside = np.einsum("mii->m", spread) - hh - rr
    # The mean radius of the points is larger than that of their mean.
    noise = cells.scale * np.einsum("mi,ij,mj->m", around, cells.noise_mm2, around)
    blur = np.sqrt(np.maximum(np.maximum(aside + noise, noise), 0.0)) / radii
    trust = trusted(blur)
    shift = np.where(trust > 0.0, 0.5 * aside / radii, 0.0)
    held = cells.precisions * trust
    variance = float(cells.independent @ trust) / max(float(held.sum()), 1e-300)
    return _Half(
        np.column_stack([heights, radii + shift]), np.column_stack([hh, hr, rr]), held, variance
    )


def _first_profile(half: _Half) -> tuple[FloatArray, bool] | None:
    """Control points of a profile through the cells' middles, and whether it closes."""
    places, held = half.places_mm[half.held > 0.0], half.held[half.held > 0.0]
    if len(places) < LEAST:
        return None
    for boxes in _BOXES:
        edge = max(float(np.ptp(places, axis=0).max()) / boxes, 1e-300)
        nodes = _in_order(places, held, edge)
        if nodes is not None:
            break
    else:
        return None
    steps = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    gap = float(np.linalg.norm(nodes[-1] - nodes[0]))
    closed = len(nodes) >= _LEAST_LOOP and gap < _CLOSED * float(np.median(steps))
    nodes = nodes if _runs_outward(nodes, closed=closed) else nodes[::-1]
    control, edf = preliminary(Chain(nodes, np.full(len(nodes), edge), closed))
    return reknotted(control, _wanted_spans(edf), closed=closed), closed


def _in_order(places: FloatArray, held: FloatArray, edge: float) -> FloatArray | None:
    """Middles (k, 2) of the boxes that hold places, in a single file; None: they make none."""
    box = np.floor((places - places.min(axis=0)) / edge).astype(np.int64)
    _, at = np.unique(box @ np.array([2 * max(_BOXES), 1]), return_inverse=True)
    sums = np.bincount(at, held)
    nodes = np.stack([np.bincount(at, held * column) / sums for column in places.T], axis=1)
    if not LEAST <= len(nodes) <= _MOST_BOXES:
        return None
    runs = span(nodes)
    if not runs:
        return None
    longest = max(runs, key=len)
    return nodes[longest] if float(sums[longest].sum()) > _NEARLY_ALL * sums.sum() else None


def _runs_outward(nodes: FloatArray, *, closed: bool) -> bool:
    """Whether the left normals point away from the axis, or out of a loop."""
    if not closed:
        return bool(nodes[-1, 0] >= nodes[0, 0])
    h, r = (nodes - nodes[0]).T
    return float(h @ np.roll(r, -1) - r @ np.roll(h, -1)) < 0.0


def _wanted_spans(edf: float) -> int:
    return int(min(max(2.5 * edf + 10, LEAST), _MOST_SPANS))


def _first_fit(form: Revolution, half: _Half, stiffness: FloatArray | None) -> Fit:
    t = nearest(form.control_mm, half.places_mm, closed=form.closed)
    return _profile(form, half, t, stiffness)


def _reknotted(form: Revolution, fit: Fit, half: _Half) -> Fit:
    """Fit again on as many spans as the first fit turned out to need."""
    wanted = _wanted_spans(fit.edf)
    if 0.8 < wanted / fit.spans < 1.25:
        return fit
    control = reknotted(fit.control_mm, wanted, closed=form.closed)
    return _first_fit(replace(form, control_mm=control), half, fit.log_stiffness)


def _profile(form: Revolution, half: _Half, t: FloatArray, stiffness: FloatArray | None) -> Fit:
    """The smoothing fit of the profile, from the form's own and its foot points (m,)."""
    arcs, at = _pooled(half, t, spans_of(form.control_mm, closed=form.closed))
    noise = Noise(half.variance_mm2, np.ones(len(arcs)))
    return smooth(
        arcs, form.control_mm, at, noise, closed=form.closed, log_stiffness=stiffness,
        still=_NEARLY,
    )  # fmt: skip


def _pooled(half: _Half, t: FloatArray, spans: int) -> tuple[ArcCells, FloatArray]:
    """Cells pooled to arcs along the profile, and the parameters of those."""
    count = spans * _ARCS_A_SPAN
    arc = np.minimum((t * _ARCS_A_SPAN).astype(np.int64), count - 1)
    sums = np.bincount(arc, half.held, count).astype(np.float64)
    filled = sums > 0.0

    def mean(values: FloatArray) -> FloatArray:
        totals = np.bincount(arc, half.held * values, count)
        return np.asarray(totals / np.maximum(sums, 1e-300), dtype=np.float64)

    h, r = half.places_mm.T
    middle = np.column_stack([mean(h), mean(r)])
    p, q = (half.places_mm - middle[arc]).T
    hh, hr, rr = half.spreads_mm2.T
    # The error of a point is put back, of one size in both directions as the fit takes it.
    spread = np.column_stack(
        [mean(hh + p * p) + half.variance_mm2, mean(hr + p * q),
         mean(rr + q * q) + half.variance_mm2],
    )  # fmt: skip
    arcs = ArcCells(
        sums[filled] * half.variance_mm2, middle[filled], spread[filled],
        np.empty((0, 2, 2)), np.empty(0), np.empty((0, 3)),
    )  # fmt: skip
    return arcs, mean(t)[filled]


def _together(form: Revolution, fit: Fit, cells: Cells, t: FloatArray) -> tuple[Fitted, FloatArray]:
    """How cells stand against a form, and the right side of its normal equations."""
    places = cells.moments.means_mm
    half = np.column_stack(polar(form.frame, places)[:2])
    t = refined(form.control_mm, half, t, closed=form.closed)
    reading = form.measure_at(places, t)
    spread = spread_over(reading, cells)
    trust = trusted(spread.blur)
    distances = reading.distances_mm + np.where(trust > 0.0, spread.shifts_mm, 0.0)
    weights = cells.precisions * trust
    axis, profile = reading.slopes, form.profile_slopes(t)
    size = 4 + len(form.control_mm)
    data, right = np.empty((size, size)), np.empty(size)
    data[:4, :4] = axis.T @ (weights[:, None] * axis)
    data[4:, :4] = profile.T @ (weights[:, None] * axis)
    data[:4, 4:] = data[4:, :4].T
    data[4:, 4:] = (profile.T @ profile.multiply(weights[:, None])).toarray()
    right[:4], right[4:] = axis.T @ (weights * distances), profile.T @ (weights * distances)
    prior, pull = _prior(form, fit, float(np.ptp(places, axis=0).max()))
    matrix = data + prior
    freedom = float(np.trace(np.linalg.solve(matrix, data)))
    chart = np.column_stack([turned(form.frame, places)[:, 0], t])
    fitted = Fitted(form, matrix, freedom, distances, spread, trust, chart)
    return fitted, right + pull


def _prior(form: Revolution, fit: Fit, size_mm: float) -> tuple[FloatArray, FloatArray]:
    """What is known without data: the stiffness, and, weakly, that an axis is not just anywhere.

    Of a sphere no data tell the lean of the axis about the centre.
    """
    count = len(form.control_mm)
    normals = control_normals(form.control_mm, closed=form.closed)
    _, changes, rows = curvature_changes(form.control_mm, normals, fit.spans, closed=form.closed)
    band, pull = np.zeros((count, 4)), np.zeros((count, 1))
    add_penalty(band, pull, rows, changes, stiffness_along(fit))
    matrix = np.zeros((4 + count, 4 + count))
    matrix[[0, 1, 2, 3], [0, 1, 2, 3]] = [size_mm**-2, size_mm**-2, 1.0, 1.0]
    at = np.arange(count)
    for k in range(4):
        matrix[4 + at, 4 + (at + k) % count] += band[:, k]
        if k:
            matrix[4 + (at + k) % count, 4 + at] += band[:, k]
    return matrix, np.concatenate([np.zeros(4), pull[:, 0]])
