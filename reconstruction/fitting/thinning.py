"""A run of slabs becomes a row of nodes in the middle of its band.

The points are laid along the polyline through the slabs' middles and a parabola is fitted to them
at every half reach, a few times over: a principal curve (Hastie, Stuetzle 1989) with local
polynomials, so that neither a bend nor an end draws it inward. Lengths along a row are in reaches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.hooks import without_hooks
from reconstruction.fitting.regression import EXACT, FAR, STEP, WINDOW, regress
from reconstruction.fitting.stretches import gaps_among, grid_between
from reconstruction.fitting.support import Nodes, levelled

_ROUNDS = 2
_PLENTY = 3.0  # points in a reach: a shorter one will do where there are more
_THICK = 5.0  # standard deviations: no reach is shorter, or noise would bend the row
_BROAD = 10.0  # standard deviations: nor sees a parabola less far to either side
_EXACTLY = 0.03  # times the way to the next: points that scatter less are exact
_EVEN = 7  # steps over which the median is taken, among exact points
_UNSTEADY = 4.0  # times the usual deviation: more is a bad fit
_MOST_PIECES = 64  # of a way, at the ends of which it is looked for
_MERGED = 1.5  # times what the places around each scatter: farther off, another run is mixed in


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Nodes in order."""

    nodes: FloatArray  # (m, 2)
    sigma: FloatArray  # (m,), standard deviation of the points across
    reach: FloatArray  # (m,)
    closed: bool
    gaps: tuple[int, ...] = ()  # after which nodes there is one that no point supports
    exact: bool = False  # the nodes are the points themselves

    @property
    def length(self) -> float:
        """Along the nodes, not back to the first."""
        return float(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1).sum())


def thin(
    places: FloatArray,
    slots: IntArray,
    reach: FloatArray,
    scatter: FloatArray,
    count: int,
    *,
    closed: bool,
) -> tuple[Row, IntArray]:
    """Thin the places (k, 2) of one run, each in one of `count` slabs in order, to nodes.

    And say how many places lie far from where their row then runs, by how its places scatter, and
    by how those around each do.
    """
    held = np.bincount(slots, minlength=count)
    used = held > 0
    sums = [np.bincount(slots, v, count)[used] for v in (places[:, 0], places[:, 1], reach)]
    x, y, scale = (column / held[used] for column in sums)
    row = Row(np.stack([x, y], axis=1), np.full(len(x), np.inf), scale, closed)
    at = (np.cumsum(used) - 1)[slots]
    for _ in range(_ROUNDS):
        row, at = _thinned(places, row, at)
    if count == len(places) and _is_exact(places, row):
        at = np.argsort(slots)
        return _as_they_are(places[at], row), np.zeros(2, np.int64)
    return _unhooked(row), _far_off(places, row, at, scatter)


def thin_again(places: FloatArray, row: Row) -> Row:
    """Thin the places (k, 2) of a row anew, where it was put together of several."""
    at = _nearest_ways(places, row)
    if row.exact:
        return _as_they_are(places[np.argsort(_lay_along(places, row, at)[0], kind="stable")], row)
    return _unhooked(_thinned(places, row, at)[0])


def _unhooked(row: Row) -> Row:
    """A row without the hooks at its ends and beside its gaps."""
    kept = without_hooks(row.nodes, row.sigma, row.reach, row.gaps, closed=row.closed)
    gaps = _gaps_among(kept, row.gaps, closed=row.closed)
    return Row(row.nodes[kept], row.sigma[kept], row.reach[kept], row.closed, gaps)


def _nearest_ways(places: FloatArray, row: Row) -> IntArray:
    """After which node the nearest way from node to node begins, for every place, (k,).

    Also where that way is a long bridge, and a node of another stretch is nearer than both its own.
    """
    ring = np.vstack([row.nodes, row.nodes[:1]]) if row.closed else row.nodes
    arms = np.diff(ring, axis=0)
    steps = np.linalg.norm(arms, axis=1) / np.maximum(STEP * row.reach[: len(arms)], 1e-300)
    pieces = np.clip(np.ceil(steps), 1, _MOST_PIECES).astype(np.int64)
    way = np.repeat(np.arange(len(arms)), pieces)
    share = (np.arange(len(way)) - np.repeat(pieces.cumsum() - pieces, pieces)) / pieces[way]
    at = np.vstack([ring[way] + share[:, None] * arms[way], ring[-1:]])
    return np.append(way, max(len(arms) - 1, 0))[np.asarray(cKDTree(at).query(places)[1])]


def _is_exact(places: FloatArray, row: Row) -> bool:
    """Whether places in order, as many as slabs, hardly scatter beside the way to the next."""
    return float(np.quantile(row.sigma, 0.9)) < _EXACTLY * row.length / len(places)


def _as_they_are(places: FloatArray, row: Row) -> Row:
    """A row of places in order, and the gaps among them."""
    nearest = np.asarray(cKDTree(row.nodes).query(places)[1])
    steps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
    usual = 2.0 * median_filter(steps, size=_EVEN, mode="wrap" if row.closed else "nearest")
    along = np.concatenate([[0.0], (steps / np.maximum(usual, 1e-300)).cumsum()])
    gaps = gaps_among(along[:-1], float(along[-1]) if row.closed else np.inf)
    return Row(places, row.sigma[nearest], usual, row.closed, gaps, exact=True)


def _far_off(places: FloatArray, row: Row, at: IntArray, scatter: FloatArray) -> IntArray:
    """How many places lie farther from a row than they should, by either measure."""
    if len(row.nodes) < 2:
        return np.zeros(2, np.int64)
    away = _lay_along(places, row, at)[2]
    spread = row.sigma[np.clip(at, 0, len(row.sigma) - 1)]
    limits = np.stack([spread, np.minimum(spread, _MERGED * scatter)])
    return np.asarray((away > FAR * limits + EXACT).sum(axis=1))


def _thinned(places: FloatArray, row: Row, at: IntArray) -> tuple[Row, IntArray]:
    """One round: new nodes, and after which of them each place lies."""
    along, ups, _ = _lay_along(places, row, at)
    period = float(ups[-1]) if row.closed else np.inf
    order = np.argsort(along, kind="stable")
    knots = [np.append(v, v[0]) if row.closed else v for v in (row.sigma, row.reach)]
    thick = np.interp(along[order], ups, _THICK * knots[0] / knots[1])
    grid, gaps = grid_between(along[order], thick, period)
    spread, reach = (np.interp(grid, ups, values) for values in knots)
    widest = _windows(spread, reach)
    middles, sigma, close = regress(along[order], places[order], grid, spread, widest, period)
    nodes = Nodes(middles, sigma, close, grid, period)
    # A stray beside a few nodes does not make the band wide there.
    sigma = nodes.steadied(sigma)
    sigma = np.minimum(sigma, _UNSTEADY * np.median(sigma))
    enough = np.minimum(1.0, _PLENTY / np.maximum(nodes.steadied(close), 1.0))
    reach = np.maximum(reach * enough, _THICK * sigma)
    middles, kept = levelled(replace(nodes, sigma=sigma))
    gaps = _gaps_among(kept, gaps, closed=row.closed)
    new = Row(middles[kept], sigma[kept], reach[kept], row.closed, gaps)
    return new, np.searchsorted(grid[kept], along, side="right") - 1


def _gaps_among(kept: BoolArray, gaps: tuple[int, ...], *, closed: bool) -> tuple[int, ...]:
    """After which of the kept nodes a gap follows: after the last one kept before it.

    Beyond the ends of an open row there is nothing to be apart from.
    """
    places, count = np.cumsum(kept) - 1, int(kept.sum())
    found = {int(places[gap]) for gap in gaps}
    if closed:
        return tuple(sorted({place % count for place in found}))
    return tuple(sorted(place for place in found if 0 <= place < count - 1))


def _windows(spread: FloatArray, reach: FloatArray) -> FloatArray:
    """Half window of each parabola, in reaches; a spread not known yet is infinite."""
    known = np.where(np.isfinite(spread), spread, 0.0)
    return np.clip(_BROAD * known / np.maximum(reach, 1e-300), WINDOW, 2.0 * WINDOW)


def _lay_along(
    places: FloatArray, row: Row, at: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where each place lies along the row, in reaches; the row's nodes; and how far off it lies."""
    ring = np.vstack([row.nodes, row.nodes[:1]]) if row.closed else row.nodes
    scales = np.append(row.reach, row.reach[0]) if row.closed else row.reach
    steps = np.linalg.norm(np.diff(ring, axis=0), axis=1)
    steps = 2.0 * steps / np.maximum(scales[1:] + scales[:-1], 1e-300)
    ups = np.concatenate([[0.0], np.cumsum(np.maximum(steps, 1e-9))])
    if len(ring) == 1:
        away = np.linalg.norm(places - ring[0], axis=1)
        return np.zeros(len(places)), ups, away
    along, away = _project(places, ring, ups, at, closed=row.closed)
    return along, ups, away


@njit(cache=True, nogil=True, error_model="numpy")
def _project(
    places: FloatArray, ring: FloatArray, ups: FloatArray, at: IntArray, *, closed: bool
) -> tuple[FloatArray, FloatArray]:
    """Foot of each place on the segments around the one it is said to be at, and how far off."""
    segments = len(ring) - 1
    along, off = np.empty(len(places)), np.empty(len(places))
    for n in range(len(places)):
        best = np.inf
        middle = min(max(at[n], 0), segments - 1)
        for offset in range(-3, 4):
            k = middle + offset
            if closed:
                k = (k + 3 * segments) % segments
            elif k < 0 or k >= segments:
                continue
            ax, ay = ring[k, 0], ring[k, 1]
            dx, dy = ring[k + 1, 0] - ax, ring[k + 1, 1] - ay
            square = max(dx * dx + dy * dy, 1e-300)
            f = ((places[n, 0] - ax) * dx + (places[n, 1] - ay) * dy) / square
            # An open row's ends reach beyond their last nodes.
            low = -2.0 if not closed and k == 0 else 0.0
            high = 3.0 if not closed and k == segments - 1 else 1.0
            f = min(max(f, low), high)
            ex, ey = places[n, 0] - ax - f * dx, places[n, 1] - ay - f * dy
            away = ex * ex + ey * ey
            if away < best:
                best = away
                along[n] = ups[k] + f * (ups[k + 1] - ups[k])
        off[n] = math.sqrt(best)
    return along, off
