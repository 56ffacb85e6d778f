"""A run of slabs becomes a row of nodes in the middle of its band.

The points are laid along the polyline through the slabs' middles and a parabola is fitted to them
at every half reach, a few times over: a principal curve (Hastie, Stuetzle 1989) with local
polynomials, so that neither a bend nor an end draws it inward. Lengths along a row are in reaches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.regression import EXACT, FAR, STEP, WINDOW, regress

_ROUNDS = 2
_HOLE = 1.5  # reaches without a point: no node is put there, where it would hang in the air
_GAP = 3.0  # reaches between nodes beside a hole ...
_BESIDE = 8  # points on either side of a hole tell how far apart they usually are ...
_SILENT = 4.0  # ... and it is a gap from so many times the widest of these ways but one, ...
_SILENCE = 7.0  # ... or the way that three quarters of them do not exceed
_THICK = 5.0  # standard deviations: no reach is shorter, or noise would bend the row
_PLENTY = 3.0  # points in a reach: a shorter one will do where there are more
_BROAD = 10.0  # standard deviations: nor sees a parabola less far to either side
_MERGED = 1.5  # times what the places around each scatter: farther off, another run is mixed in
_SUPPORT = 4  # points close by, with which a node may lie anywhere; with fewer, ...
_SCANT = 6.0  # ... or that many times fewer than usual around, ...
_COMPANY = 4.0  # times fewer than usual: no company at the edge of a gap
_BULGE = 2.5  # ... no more standard deviations than this from the nodes beside it
_LEAD = 4  # supported nodes that lead to one beyond them
_UNSTEADY = 4.0  # times the usual deviation: more is a bad fit
_STEADY = 15  # nodes over whose spreads the median is taken


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Nodes in order."""

    nodes: FloatArray  # (m, 2)
    sigma: FloatArray  # (m,), standard deviation of the points across
    reach: FloatArray  # (m,)
    closed: bool
    gaps: tuple[int, ...] = ()  # after which nodes there is one that no point supports

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
    return row, _far_off(places, row, at, scatter)


def thin_again(places: FloatArray, row: Row) -> Row:
    """Thin the places (k, 2) of a row anew, where it was put together of several."""
    return _thinned(places, row, np.asarray(cKDTree(row.nodes).query(places)[1]))[0]


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
    grid, gaps = _grid_between(along[order], thick, period)
    spread, reach = (np.interp(grid, ups, values) for values in knots)
    nodes, sigma, close = regress(
        along[order], places[order], grid, spread, _windows(spread, reach), period
    )
    # A stray beside a few nodes does not make the band wide there.
    sigma = median_filter(sigma, size=_STEADY, mode="wrap" if row.closed else "nearest")
    sigma = np.minimum(sigma, _UNSTEADY * np.median(sigma))
    usual = median_filter(close, size=_STEADY, mode="wrap" if row.closed else "nearest")
    reach = np.maximum(reach * np.minimum(1.0, _PLENTY / np.maximum(usual, 1.0)), _THICK * sigma)
    supported = close >= np.maximum(np.minimum(_SUPPORT, usual / 2.0), usual / _SCANT)
    nodes, kept = _levelled(nodes, sigma, grid, supported, close, usual, period)
    gaps = _gaps_among(kept, gaps, closed=row.closed)
    new = Row(nodes[kept], sigma[kept], reach[kept], row.closed, gaps)
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


def _levelled(
    nodes: FloatArray,
    sigma: FloatArray,
    grid: FloatArray,
    supported: BoolArray,
    close: FloatArray,
    usual: FloatArray,
    period: float,
) -> tuple[FloatArray, BoolArray]:
    """Put what bulges out for a point or two back between the supported nodes beside it.

    At the edge of a gap there is nothing beside it on one side: it is kept if it lies ahead, in
    company.
    """
    company = close >= np.maximum(1.0, usual / _COMPANY)
    if supported.mean() < 0.5 or supported.all():
        return nodes, np.ones(len(nodes), np.bool_)
    at, columns = grid[supported], nodes[supported]
    if period < np.inf:
        at = np.concatenate([at - period, at, at + period])
        columns = np.concatenate([columns, columns, columns])
    following = np.searchsorted(at, grid)
    inner = (following > 0) & (following < len(at))
    following = np.clip(following, 1, len(at) - 1)
    # Not across a gap: there nobody knows where the middle runs.
    inner &= at[following] - at[following - 1] <= _GAP
    between = np.stack([np.interp(grid, at, column) for column in columns.T], axis=1)
    bulges = np.linalg.norm(nodes - between, axis=1) > _BULGE * sigma + EXACT
    kept = supported | inner
    kept |= _substantial(~kept, close, usual, wrapped=period < np.inf)
    for lost in np.flatnonzero(~kept & company):
        kept[lost] = _lies_ahead(nodes[lost], float(sigma[lost]), float(grid[lost]), at, columns)
    return np.where((bulges & ~supported & inner)[:, None], between, nodes), kept


def _substantial(
    lost: BoolArray, close: FloatArray, usual: FloatArray, *, wrapped: bool
) -> BoolArray:
    """Which of the lost nodes lie in stretches with points enough not to be of strays."""
    if not lost.any() or lost.all():
        return np.zeros(len(lost), np.bool_)
    first = int(np.argmin(lost)) if wrapped else 0  # no stretch over the seam
    lost, close, usual = (np.roll(values, -first) for values in (lost, close, usual))
    stretch = np.cumsum(np.diff(lost, prepend=False)) * lost
    points, expected, nodes = (
        np.bincount(stretch, values, stretch.max() + 1) for values in (close, usual, lost)
    )
    # A point is close to two nodes.
    held = (points >= 2 * _SUPPORT) & (points >= expected / _COMPANY) & (nodes > 1)
    return np.asarray(np.roll(held[stretch] & lost, first))


def _lies_ahead(
    node: FloatArray, sigma: float, place: float, at: FloatArray, supported: FloatArray
) -> bool:
    """Whether a node lies where the supported nodes on the nearer side of it lead."""
    nearest = int(np.argmin(np.abs(at - place)))
    ahead = 1 if place > at[nearest] else -1
    back = nearest - ahead * min(_LEAD, nearest if ahead > 0 else len(at) - 1 - nearest)
    run = abs(float(at[nearest] - at[back]))
    beyond = abs(place - float(at[nearest]))
    if not 0.0 < run <= 2.0 * _LEAD or beyond > _GAP:
        return False
    aim = supported[nearest] + beyond / run * (supported[nearest] - supported[back])
    return float(np.linalg.norm(node - aim)) <= _BULGE * sigma * (1.0 + beyond / run) + EXACT


def _windows(spread: FloatArray, reach: FloatArray) -> FloatArray:
    """Half window of each parabola, in reaches; a spread not known yet is infinite."""
    known = np.where(np.isfinite(spread), spread, 0.0)
    return np.clip(_BROAD * known / np.maximum(reach, 1e-300), WINDOW, 2.0 * WINDOW)


def _grid_between(
    along: FloatArray, thick: FloatArray, period: float
) -> tuple[FloatArray, tuple[int, ...]]:
    """Steps along the stretches that points support, and after which of them a gap follows."""
    closed = period < np.inf
    breaks, wide = _holes(along, thick, period)
    if closed and not len(breaks):
        return np.linspace(0.0, period, max(round(period / STEP), 4), endpoint=False), ()
    if closed:  # from one hole to its repetition
        along = np.concatenate([along[breaks[0] + 1 :], along[: breaks[0] + 1] + period])
        breaks, wide = breaks[1:] - breaks[0] - 1, np.roll(wide, -1)
    else:
        along, beyond = _without_tails(along)
        inner = (breaks >= beyond) & (breaks < beyond + len(along) - 1)
        breaks, wide = breaks[inner] - beyond, wide[inner]
    starts, ends = along[np.append(0, breaks + 1)], along[np.append(breaks, len(along) - 1)]
    pieces = [
        np.linspace(start, end, max(round((end - start) / STEP), 1) + 1)
        for start, end in zip(starts, ends, strict=True)
    ]
    grid = np.concatenate(pieces)
    last = np.cumsum([len(piece) for piece in pieces]) - 1
    if not closed:
        return grid, tuple(last[:-1][wide].tolist())
    grid = np.mod(grid, period)
    first = int(np.argmin(grid))
    return np.roll(grid, -first), tuple(sorted(((last[wide] - first) % len(grid)).tolist()))


def _holes(along: FloatArray, thick: FloatArray, period: float) -> tuple[IntArray, BoolArray]:
    """After which points there is a hole, and which are gaps.

    A gap is thicker than the band, and wider than the ways around it explain.
    """
    ways = np.diff(along, append=along[0] + period if period < np.inf else -np.inf)
    holes = np.flatnonzero(ways > np.minimum(_HOLE, thick))
    most = min(_BESIDE, (len(ways) - 1) // 2)
    beside = np.concatenate([np.arange(-most, 0), np.arange(1, most + 1)])
    around = np.sort(ways[(holes[:, None] + beside) % len(ways)], axis=1)
    usual = (
        np.minimum(_SILENT * around[:, -2], _SILENCE * around[:, -1 - most // 2]) if most else 0.0
    )
    gaps = ways[holes] > usual
    kept = gaps | (ways[holes] > _HOLE)
    return holes[kept], gaps[kept]


def _without_tails(along: FloatArray) -> tuple[FloatArray, int]:
    """Without the first and last two of many points, and how many are left out.

    They may be strays beyond the ends.
    """
    beyond = min(2, len(along) // 100)
    inner = along[beyond : len(along) - beyond]
    if not inner[-1] > inner[0]:
        return np.array([inner[0], inner[0] + STEP]), beyond
    return inner, beyond


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
