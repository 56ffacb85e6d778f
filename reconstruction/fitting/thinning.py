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

_ROUNDS = 2
_STEP = 0.5  # reaches from node to node
_HOLE = 1.5  # reaches without a point: no node is put there, where it would hang in the air
_GAP = 3.0  # reaches between nodes beside a hole ...
_BESIDE = 8  # points on either side of a hole tell how far apart they usually are ...
_SILENT = 4.0  # ... and it is a gap from so many times that
_THICK = 5.0  # standard deviations: no reach is shorter, or noise would bend the row
_BROAD = 10.0  # standard deviations: nor sees a parabola less far to either side
_WINDOW = 1.25  # reaches to either side of a node that its parabola sees; at most twice that
_ENOUGH = 24  # points in a window: more need no wider one
_LEAST_POINTS = 4  # in a window; it grows until it has them
_PARABOLA = 5.0  # points; fewer in a window get a line
_LOOSE = 0.6  # variances of a point: a parabola known no better in its middle gives way to a line
_FAR = 4.0  # standard deviations: farther across, a point has no say
_MERGED = 1.5  # times what the places around each scatter: farther off, another run is mixed in
_FEW = 16  # places in a window, among which a stray must be looked for one by one ...
_WORSE = 1.25  # ... and how much farther than far it must be from the others' fit
_EXACT = 1e-9  # of the slice's size: noise of the arithmetic
_SUPPORT = 4  # points close by, with which a node may lie anywhere; with fewer, ...
_SCANT = 6.0  # times fewer than usual around
_BULGE = 2.5  # ... no more standard deviations than this from the nodes beside it
_LEAD = 4  # supported nodes that lead to one beyond them
_STEADY = 15  # nodes over whose spreads the median is taken

# Place, slope and bend of a window's parabola: x + sx u + bx u^2, y + sy u + by u^2.
Parabola = tuple[float, float, float, float, float, float]


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
) -> tuple[Row, int]:
    """Thin the places (k, 2) of one run, each in one of `count` slabs in order, to nodes.

    And say how many places lie farther from where their row then runs than they scatter.
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


def _far_off(places: FloatArray, row: Row, at: IntArray, scatter: FloatArray) -> int:
    """How many places lie farther from a row than they should."""
    if len(row.nodes) < 2:
        return 0
    away = _lay_along(places, row, at)[2]
    spread = row.sigma[np.clip(at, 0, len(row.sigma) - 1)]
    return int((away > _FAR * np.minimum(spread, _MERGED * scatter) + _EXACT).sum())


def _thinned(places: FloatArray, row: Row, at: IntArray) -> tuple[Row, IntArray]:
    """One round: new nodes, and after which of them each place lies."""
    along, ups, _ = _lay_along(places, row, at)
    period = float(ups[-1]) if row.closed else np.inf
    order = np.argsort(along, kind="stable")
    grid, gaps = _grid_between(along[order], period)
    knots = [np.append(v, v[0]) if row.closed else v for v in (row.sigma, row.reach)]
    spread, reach = (np.interp(grid, ups, values) for values in knots)
    nodes, sigma = _regress(
        along[order], places[order], grid, spread, _windows(spread, reach), period
    )
    # A stray beside a few nodes does not make the band wide there.
    sigma = median_filter(sigma, size=_STEADY, mode="wrap" if row.closed else "nearest")
    reach = np.maximum(reach, _THICK * sigma)
    supported = _supported(along[order], grid, period)
    nodes, kept = _levelled(nodes, sigma, grid, supported, period)
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


def _supported(along: FloatArray, grid: FloatArray, period: float) -> BoolArray:
    """Whether more than a point or two lie close to each place of the grid, and not far fewer
    than around."""
    closed = period < np.inf
    if closed:
        along = np.concatenate([along - period, along, along + period])
    held = np.searchsorted(along, grid + _STEP, "right") - np.searchsorted(along, grid - _STEP)
    usual = median_filter(held, size=_STEADY, mode="wrap" if closed else "nearest")
    return np.asarray(held >= np.maximum(np.minimum(_SUPPORT, usual / 2.0), usual / _SCANT))


def _levelled(
    nodes: FloatArray, sigma: FloatArray, grid: FloatArray, supported: BoolArray, period: float
) -> tuple[FloatArray, BoolArray]:
    """Put what bulges out for a point or two back between the supported nodes beside it.

    At the edge of a gap there is nothing beside it on one side: it is kept if it lies ahead.
    """
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
    bulges = np.linalg.norm(nodes - between, axis=1) > _BULGE * sigma + _EXACT
    kept = supported | inner
    for lost in np.flatnonzero(~kept):
        kept[lost] = _lies_ahead(nodes[lost], float(sigma[lost]), float(grid[lost]), at, columns)
    return np.where((bulges & ~supported & inner)[:, None], between, nodes), kept


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
    return float(np.linalg.norm(node - aim)) <= _BULGE * sigma * (1.0 + beyond / run) + _EXACT


def _windows(spread: FloatArray, reach: FloatArray) -> FloatArray:
    """Half window of each parabola, in reaches; a spread not known yet is infinite."""
    known = np.where(np.isfinite(spread), spread, 0.0)
    return np.clip(_BROAD * known / np.maximum(reach, 1e-300), _WINDOW, 2.0 * _WINDOW)


def _grid_between(along: FloatArray, period: float) -> tuple[FloatArray, tuple[int, ...]]:
    """Steps along the stretches that points support, and after which of them a gap follows."""
    closed = period < np.inf
    if closed:
        breaks = np.flatnonzero(np.diff(along, append=along[0] + period) > _HOLE)
        if not len(breaks):
            return np.linspace(0.0, period, max(round(period / _STEP), 4), endpoint=False), ()
        # From one hole to its repetition.
        along = np.concatenate([along[breaks[0] + 1 :], along[: breaks[0] + 1] + period])
    else:
        along = _without_tails(along)
    breaks = np.flatnonzero(np.diff(along) > _HOLE)
    starts, ends = along[np.append(0, breaks + 1)], along[np.append(breaks, len(along) - 1)]
    pieces = [
        np.linspace(start, end, max(round((end - start) / _STEP), 1) + 1)
        for start, end in zip(starts, ends, strict=True)
    ]
    grid = np.concatenate(pieces)
    wide = _are_gaps(along, np.append(breaks, len(along) - 1), period)
    gaps = (np.cumsum([len(piece) for piece in pieces]) - 1)[wide]
    if not closed:
        return grid, tuple(gaps[:-1].tolist())
    grid = np.mod(grid, period)
    first = int(np.argmin(grid))
    return np.roll(grid, -first), tuple(sorted(((gaps - first) % len(grid)).tolist()))


def _are_gaps(along: FloatArray, breaks: IntArray, period: float) -> BoolArray:
    """Whether the holes after these points are wider than their neighbours' ways explain."""
    ways = np.diff(along, append=along[0] + period if period < np.inf else np.inf)
    most = min(_BESIDE, (len(ways) - 1) // 2)
    if not most:
        return np.ones(len(breaks), np.bool_)
    beside = np.concatenate([np.arange(-most, 0), np.arange(1, most + 1)])
    around = ways[(breaks[:, None] + beside) % len(ways)]
    usual = np.sort(np.where(np.isfinite(around), around, 0.0), axis=1)[:, -2]
    return np.asarray(ways[breaks] > _SILENT * usual)


def _without_tails(along: FloatArray) -> FloatArray:
    """Without the first and last two of many points: they may be strays beyond the ends."""
    beyond = min(2, len(along) // 100)
    inner = along[beyond : len(along) - beyond]
    return inner if inner[-1] > inner[0] else np.array([inner[0], inner[0] + _STEP])


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


@njit(cache=True, nogil=True, error_model="numpy")
def _regress(
    along: FloatArray,
    places: FloatArray,
    grid: FloatArray,
    spread: FloatArray,
    windows: FloatArray,
    period: float,
) -> tuple[FloatArray, FloatArray]:
    """Middle of the band and standard deviation across it at every place of the grid.

    Places are in order of `along`; those of a closed row repeat after a period.
    """
    count = len(along)
    middles, sigma = np.empty((len(grid), 2)), np.empty(len(grid))
    for g in range(len(grid)):
        window = _WINDOW
        first, last = _within(along, grid[g], window, period)
        while last - first < _ENOUGH and window < windows[g]:
            window = min(1.25 * window, windows[g])
            first, last = _within(along, grid[g], window, period)
        while last - first < min(_LEAST_POINTS, count) and window < 1e6:
            window *= 1.5
            first, last = _within(along, grid[g], window, period)
        # About one of the places, that differences of large coordinates do not cancel.
        origin = places[first % count]
        nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        fit = _parabola(
            along, places, origin, grid[g], window, first, last, last, nothing, np.inf, period
        )
        if spread[g] < np.inf:
            far = _FAR * spread[g] + _EXACT
            if last - first <= _FEW:
                fit = _without_the_worst(
                    along, places, origin, grid[g], window, first, last, fit, far, period
                )
            fit = _parabola(
                along, places, origin, grid[g], window, first, last, last, fit, far, period
            )
        else:
            far = np.inf
        middles[g, 0], middles[g, 1] = origin[0] + fit[0], origin[1] + fit[1]
        sigma[g] = _scatter(along, places, origin, grid[g], first, last, fit, far, period)
    return middles, sigma


@njit(cache=True, nogil=True, inline="always")
def _within(along: FloatArray, at: float, window: float, period: float) -> tuple[int, int]:
    """First and last + 1 of the places in a window; below 0 and from count on they repeat."""
    count = len(along)
    first = np.searchsorted(along, at - window)
    last = np.searchsorted(along, at + window)
    if period < np.inf:
        if at - window < 0.0:
            before = np.searchsorted(along, at - window + period)
            first = (before if before > last else last) - count
        if at + window > period:
            last = np.searchsorted(along, at + window - period) + count
        if last > first + count:
            last = first + count
    return int(first), int(last)


@njit(cache=True, nogil=True, inline="always")
def _wrapped(m: int, count: int, period: float) -> tuple[int, float]:
    """Row of a repeated place, and how far its repetition is moved along."""
    if m < 0:
        return m + count, -period
    if m >= count:
        return m - count, period
    return m, 0.0


@njit(cache=True, nogil=True, inline="always")
def _across(fit: Parabola, u: float, x: float, y: float) -> float:
    """Distance of a place from the parabola, across its slope in the middle."""
    ex = x - fit[0] - (fit[2] + fit[4] * u) * u
    ey = y - fit[1] - (fit[3] + fit[5] * u) * u
    slope = math.sqrt(fit[2] * fit[2] + fit[3] * fit[3])
    return float((ex * fit[3] - ey * fit[2]) / max(slope, 1e-300))


@njit(cache=True, nogil=True, error_model="numpy")
def _without_the_worst(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    window: float,
    first: int,
    last: int,
    fit: Parabola,
    far: float,
    period: float,
) -> Parabola:
    """The fit to all but the place that lies farthest from the fit to the others, if it is far.

    Among few, a stray draws the fit so near that it does not look like one.
    """
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    worst = _WORSE * far
    for m in range(first, last):
        n, moved = _wrapped(m, len(along), period)
        others = _parabola(
            along, places, origin, at, window, first, last, m, nothing, np.inf, period
        )
        x, y = places[n, 0] - origin[0], places[n, 1] - origin[1]
        across = abs(_across(others, along[n] + moved - at, x, y))
        if across > worst:
            worst, fit = across, others
    return fit


@njit(cache=True, nogil=True, error_model="numpy")
def _parabola(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    window: float,
    first: int,
    last: int,
    left_out: int,
    before: Parabola,
    far: float,
    period: float,
) -> Parabola:
    """Weighted fit in a window, without what lies far from the fit before; at ends a line.

    `left_out` is the position of a place that has no say; `last` is nobody's.
    """
    s0 = s1 = s2 = s3 = s4 = x0 = x1 = x2 = y0 = y1 = y2 = 0.0
    held = left = right = 0.0
    for m in range(first, last):
        if m == left_out:
            continue
        n, moved = _wrapped(m, len(along), period)
        u = along[n] + moved - at
        z = u / window
        weight = 1.0 - z * z
        if weight <= 0.0:
            continue
        weight *= weight
        x, y = places[n, 0] - origin[0], places[n, 1] - origin[1]
        if far < np.inf and abs(_across(before, u, x, y)) > far:
            continue
        held += 1.0
        left, right = min(left, z), max(right, z)
        w1 = weight * u
        w2 = w1 * u
        s0, s1, s2, s3, s4 = s0 + weight, s1 + w1, s2 + w2, s3 + w2 * u, s4 + w2 * u * u
        x0, x1, x2 = x0 + weight * x, x1 + w1 * x, x2 + w2 * x
        y0, y1, y2 = y0 + weight * y, y1 + w1 * y, y2 + w2 * y
    if s0 <= 0.0:
        return before
    mean, square = s1 / s0, s2 / s0
    a11, a12, a22 = s2 - s1 * mean, s3 - s2 * mean, s4 - s2 * square
    if a11 <= 1e-12 * s0:
        return x0 / s0, y0 / s0, 0.0, 0.0, 0.0, 0.0
    bx = by = 0.0
    determinant = a11 * a22 - a12 * a12
    known = held >= _PARABOLA and left < -0.4 and right > 0.4 and determinant > 1e-9 * a11 * a22
    if known:
        variance = mean * mean * a22 - 2.0 * mean * square * a12 + square * square * a11
        known = 1.0 / s0 + variance / determinant < _LOOSE
    if known:
        bx = (a11 * (x2 - square * x0) - a12 * (x1 - mean * x0)) / determinant
        by = (a11 * (y2 - square * y0) - a12 * (y1 - mean * y0)) / determinant
    sx = (x1 - mean * x0 - bx * a12) / a11
    sy = (y1 - mean * y0 - by * a12) / a11
    return (x0 - sx * s1 - bx * s2) / s0, (y0 - sy * s1 - by * s2) / s0, sx, sy, bx, by


@njit(cache=True, nogil=True, error_model="numpy")
def _scatter(
    along: FloatArray,
    places: FloatArray,
    origin: FloatArray,
    at: float,
    first: int,
    last: int,
    fit: Parabola,
    far: float,
    period: float,
) -> float:
    """Standard deviation of a window's places across its parabola."""
    squares = held = 0.0
    for m in range(first, last):
        n, moved = _wrapped(m, len(along), period)
        across = _across(
            fit, along[n] + moved - at, places[n, 0] - origin[0], places[n, 1] - origin[1]
        )
        if abs(across) <= far:
            squares += across * across
            held += 1.0
    freedom = held - (3.0 if fit[4] != 0.0 or fit[5] != 0.0 else 2.0)
    return math.sqrt(squares / max(freedom, 1.0))
