r"""The pieces of a run that is cut at suspected corners.

Each piece is fitted by itself a little past its cuts, first at the noise of the smooth curve, which
is too much, then at its own, without the cells that hold points of both walls; neighbours are
trimmed where they cross and fitted once more between the corners. ::

    -------. cut         --------- - -          ---------+ corner
            \       ->          \   |     ->             |
             |                     |                      |
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import ReconstructionError
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.misfits import MIXED
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.preliminary import reknotted, through
from reconstruction.fitting.scatter import looked_at_again
from reconstruction.fitting.smoothing import Fit, Noise, smooth
from reconstruction.fitting.spline import evaluate

WINDOW = 4.0  # spans in which a rounded corner turns
_FINE = 16  # places on a piece, a span: which piece a cell is nearest to, and roughly where
_LOST = 16.0  # squared deviations that a point set aside costs
_MIXED_OFF = 3.5  # standard deviations: cells farther off, or thicker, hold both walls
_LEAST_CELLS = 12  # of a piece
_FINER = 2.0  # spans of a piece to one of the whole: what is left of bends is not seen by the whole
_NEARLY = 0.2  # standard deviations: still enough to tell where pieces cross; ...
_STILL = 0.02  # ... and to stay
_DEAR = 4.0  # degrees of freedom that a corner must save


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A stretch between two cuts."""

    fit: Fit
    rows: IntArray  # of the cells


@dataclass(frozen=True, slots=True, eq=False)
class Corner:
    """Where two pieces cross; both run on past it."""

    before: Piece
    after: Piece
    end: float  # parameter on `before`
    start: float  # parameter on `after`

    def line(self, reach_mm: float, count: int) -> FloatArray:
        """Places (2 * count + 1, 2) within a reach to either side of it, itself in the middle."""
        sides = []
        for piece, at, way in ((self.before, self.end, -1.0), (self.after, self.start, 1.0)):
            fit = piece.fit
            span = float(span_lengths(fit.control_mm, fit.spans).mean())
            t = at + way * np.arange(count + 1) / count * reach_mm / span
            sides.append(evaluate(fit.control_mm, np.clip(t, 0.0, fit.spans))[0])
        return np.vstack([sides[0][:0:-1], (sides[0][:1] + sides[1][:1]) / 2, sides[1][1:]])


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A run in pieces that cross at its corners, and the noise about them."""

    pieces: list[Piece]
    corners: list[Corner]  # in the order of the cuts
    noise: Noise


def cut_at(fit: Fit, cells: ArcCells, cuts: FloatArray) -> Cut | None:
    """Cut a run; None if the pieces do not cross, or a single cut is in vain."""
    rows = _clear(fit, cells, cuts)
    pieces = [_fitted(fit, cells, rows, start, end) for start, end in _ways(fit, cuts)]
    whole = [piece for piece in pieces if piece is not None]
    if len(whole) < len(pieces):
        return None
    # At the most favourable noise already: of one suspect there is nothing else to be tried.
    best = Noise(whole[0].fit.noise.variance_mm2, np.ones(len(cells)))
    if len(cuts) == 1 and not preferred(fit, cells, whole, best):
        return None
    settled = _settled(fit, whole, cells)
    if settled is None:
        return None
    own, noise = settled
    pairs = [(own[-1], own[0])] if fit.closed else []
    corners = [_corner(*pair) for pair in (*pairs, *pairwise(own))]
    found = [corner for corner in corners if corner is not None]
    return Cut(own, found, noise) if len(found) == len(corners) else None


def _clear(fit: Fit, cells: ArcCells, cuts: FloatArray) -> IntArray:
    """Rows of the cells that belong to one side only: beside a cut they may hold both."""
    away = np.abs(fit.t[:, None] - cuts)
    if fit.closed:
        away = np.minimum(away, fit.spans - away)
    return np.flatnonzero((away.min(axis=1) > MIXED) & (cells.counts > 0))


def _ways(fit: Fit, cuts: FloatArray) -> list[tuple[float, float]]:
    """Start and end of every piece; of a closed curve the last runs over the seam."""
    if fit.closed:
        ends = np.append(cuts[1:], cuts[0] + fit.spans)
        return list(zip(cuts.tolist(), ends.tolist(), strict=True))
    return list(pairwise([0.0, *cuts.tolist(), float(fit.spans)]))


def _fitted(fit: Fit, cells: ArcCells, rows: IntArray, start: float, end: float) -> Piece | None:
    """Fit the cells of one piece by a curve that runs on past its cuts."""
    share = fit.t[rows] - start
    share = np.mod(share, fit.spans) if fit.closed else share
    inside = (share >= 0) & (share <= end - start)
    rows = rows[inside]
    if len(rows) < _LEAST_CELLS:
        return None
    places, smooth_t = _straightened(fit, start, end)
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()])
    spans = max(int(end - start), 4)
    t = along / along[-1] * spans
    control = through(places, t, spans, closed=False)
    own = cells.only(rows)
    feet = np.interp(start + share[inside], smooth_t, t)
    noise = fit.noise.only(rows)
    try:
        return Piece(smooth(own, control, feet, noise, closed=False, still=_NEARLY), rows)
    except ReconstructionError:
        return None


def _straightened(fit: Fit, start: float, end: float) -> tuple[FloatArray, FloatArray]:
    """The smooth curve without its rounded corners, drawn on along its tangents past the cuts.

    Places, and the smooth curve's parameters there, as if it ran on.
    """
    margin = min(WINDOW / 2, (end - start) / 4)
    first = margin if fit.closed or start > 0.0 else 0.0
    last = margin if fit.closed or end < fit.spans else 0.0
    t = np.linspace(start + first, end - last, 8 * max(int(end - start), 4))
    places, tangents, _ = evaluate(fit.control_mm, np.mod(t, fit.spans) if fit.closed else t)
    beyond = np.linspace(0.0, 2.5, 12)[1:, None]
    head = places[0] - first * beyond[::-1] * tangents[0]
    tail = places[-1] + last * beyond * tangents[-1]
    before, after = (t[:1] - first * beyond[::-1, 0], t[-1:] + last * beyond[:, 0])
    pieces = ((head, before, first), (places, t, 1.0), (tail, after, last))
    kept = [(each, at) for each, at, drawn in pieces if drawn > 0.0]
    return np.vstack([each for each, _ in kept]), np.concatenate([at for _, at in kept])


def met(cut: Cut, cells: ArcCells) -> list[Piece] | None:
    """Trim the pieces where they cross, share the cells anew, and fit between the corners."""
    pieces, noise = cut.pieces, cut.noise
    stretches = [[0.0, float(piece.fit.spans)] for piece in pieces]
    for corner in cut.corners:
        stretches[pieces.index(corner.before)][1] = corner.end
        stretches[pieces.index(corner.after)][0] = corner.start
    if any(not end - start > 1.0 for start, end in stretches):
        return None
    controls = [_trimmed(piece.fit, *ends) for piece, ends in zip(pieces, stretches, strict=True)]
    out = []
    for rough, rows in zip(*_shared(pieces, controls, stretches, cells), strict=True):
        piece = _smoothed(rough, cells, rows, noise, still=_NEARLY)
        if piece is None:
            return None
        out.append(piece)
    return out


def _shared(
    pieces: list[Piece],
    controls: list[FloatArray],
    stretches: list[list[float]],
    cells: ArcCells,
) -> tuple[list[Fit], list[IntArray]]:
    """The trimmed pieces with rough feet of their cells: of those nearest to them; their rows."""
    if len(pieces) == 1:
        (start, end), old = stretches[0], pieces[0].fit
        control = controls[0]
        t = np.clip((old.t - start) / (end - start), 0.0, 1.0) * (len(control) - 3)
        return [replace(old, control_mm=control, t=t)], [pieces[0].rows]
    fine = [np.linspace(0.0, len(control) - 3, _FINE * len(control)) for control in controls]
    trees = [cKDTree(evaluate(c, t)[0]) for c, t in zip(controls, fine, strict=True)]
    rows = np.concatenate([piece.rows for piece in pieces])
    found = [tree.query(cells.means_mm[rows]) for tree in trees]
    owner = np.argmin(np.stack([np.asarray(distances) for distances, _ in found]), axis=0)
    own = [np.flatnonzero(owner == k) for k in range(len(pieces))]
    rough = [
        replace(piece.fit, control_mm=control, t=t[np.asarray(nearest)[mine]])
        for piece, control, t, (_, nearest), mine in zip(
            pieces, controls, fine, found, own, strict=True
        )
    ]
    return rough, [rows[mine] for mine in own]


def _settled(fit: Fit, pieces: list[Piece], cells: ArcCells) -> tuple[list[Piece], Noise] | None:
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


def stilled(pieces: list[Piece], cells: ArcCells, noise: Noise) -> list[Piece]:
    """The same, quite still."""
    again = [_smoothed(piece.fit, cells, piece.rows, noise) for piece in pieces]
    still = [piece for piece in again if piece is not None]
    return still if len(still) == len(again) else pieces


def _of_one_wall(piece: Piece, cells: ArcCells) -> Piece:
    """Leave out cells near the corners that hold more than the noise explains: both walls."""
    fit, counts = piece.fit, cells.counts[piece.rows]
    squares = fit.distances_mm**2 + fit.scatters_mm2
    many = counts > 1
    if not many.any():
        return piece
    variance = float(np.median(squares[many] * counts[many] / np.maximum(counts[many] - 1, 1)))
    off = np.abs(fit.distances_mm) < _MIXED_OFF * np.sqrt(variance / counts)
    thin = fit.scatters_mm2 < variance * (1.0 + _MIXED_OFF * np.sqrt(2.0 / counts))
    within = (fit.t > 2 * WINDOW) & (fit.t < fit.spans - 2 * WINDOW)
    return _only(piece, np.flatnonzero((off & thin) | ~many | within))


def _only(piece: Piece, which: IntArray) -> Piece:
    fit = piece.fit
    noise = fit.noise.only(which)
    kept = {name: getattr(fit, name)[which] for name in ("t", "distances_mm", "scatters_mm2",
                                                         "weights")}  # fmt: skip
    return Piece(replace(fit, noise=noise, **kept), piece.rows[which])


def _smoothed(
    rough: Fit, cells: ArcCells, rows: IntArray, noise: Noise, *, still: float = _STILL
) -> Piece | None:
    try:
        again = smooth(
            cells.only(rows), rough.control_mm, rough.t, noise.only(rows), closed=False,
            log_stiffness=rough.log_stiffness, still=still,
        )  # fmt: skip
    except ReconstructionError:
        return None
    return Piece(again, rows)


def _trimmed(fit: Fit, start: float, end: float) -> FloatArray:
    return reknotted(
        fit.control_mm, max(int(_FINER * (end - start)), 4), closed=False, within=(start, end)
    )


def _corner(before: Piece, after: Piece) -> Corner | None:
    """Where the end of one piece crosses the start of the next."""
    one, other = before.fit, after.fit
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
    end, start = t[i] + s[i, j] * (t[1] - t[0]), u[j] + r[i, j] * (u[1] - u[0])
    return Corner(before, after, float(end), float(start))


def preferred(
    fit: Fit, cells: ArcCells, pieces: list[Piece], noise: Noise, worse: float = 0.0
) -> bool:
    """Whether the pieces explain the points, at the noise they show, with less than the curve.

    `worse` is what the points beside the cuts, which no cell tells of, add to their cost.
    """
    price = _price(cells, noise)
    smooth_cost = fit.edf * price
    cost = len(pieces) * corner_cost(cells, noise) + worse / noise.inflation
    for piece in pieces:
        rows, own = piece.rows, piece.fit
        counts, among = cells.counts[rows], noise.only(rows)
        cost += own.edf * price
        cost += _misfit(counts, own.distances_mm, own.scatters_mm2, own.weights, among)
        smooth_cost += _misfit(
            counts, fit.distances_mm[rows], fit.scatters_mm2[rows], fit.weights[rows], among
        )
    return cost < smooth_cost


def corner_cost(cells: ArcCells, noise: Noise) -> float:
    """What a corner must save, in squared standard deviations of independent points."""
    return _DEAR * _price(cells, noise)


def _price(cells: ArcCells, noise: Noise) -> float:
    """Of a degree of freedom."""
    return math.log(max(cells.total / noise.inflation, 2.0))


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
