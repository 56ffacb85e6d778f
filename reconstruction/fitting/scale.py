"""How far to look for neighbours: the smallest reach with which the places make clean runs.

Too small a reach breaks a band to pieces and finds holes in it, too large a one joins what is
apart. Nobody need give it: from small to large, the first that leaves next to no flaws is taken.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.frames import frames
from reconstruction.fitting.linking import Runs, apart, link, neighbours_of
from reconstruction.fitting.places import Places
from reconstruction.fitting.spanning import span
from reconstruction.fitting.thinning import Row, thin

_REACHES = (0.65, 0.9, 1.25, 1.75, 2.5, 3.5, 5.0)  # spacings
_REACHES_CELLS = (1.75, 2.5, 3.5, 5.0)
_HOODS = (6, 9, 13, 19, 27)  # neighbours that may tell a direction
_SLENDER_HOOD = 1.5  # slenderness up to which a place sees no farther along than across ...
_AHEAD = 3.0  # ... and how much farther at most
_THROUGH = 1.2  # thicknesses: a reach must look through the band in cells ...
_ACROSS = 1.0  # ... and of points
_FARTHER = 1.05  # times as far as before: nearly the same need not be tried
_FLAWED = 0.01  # flaws a slab up to which a reach is taken for the right one
_TINY = 8  # slabs of a loop: it may run around a hole in a band
_NEAR = 2.5  # reaches between two ends: a break and no gap
_EXCUSED = 2  # points far off their rows are no sign of anything
_LATER = 0.015  # what a longer reach is worse by
_MIXED = 0.1  # share of points off by how those around scatter: then that tells nothing
_COARSE = 8  # slabs a run below which the reach may have been too large, ...
_COARSEST = 16  # ... and slabs altogether
_LOST = 0.02  # share of the points that may be strays
_SPARSE = 12.0  # times the usual spacing: who is lonelier does not look for neighbours farther off
_SPARSE_CELLS = 5.0
_LONELY = 20.0  # times fewer points in sight than usual: no neighbour of those in the band
_SCATTERED = 1 / 8  # of the usual number of points on a length, and ...
_ALIKE = 9  # places that share what they scatter
_BAND = 1.7  # slenderness from which they lie in a band
_HEAPED = 0.4  # share of the points in heaps from which they are a band wider than can be seen
_LEAST_HEAP = 10  # places
_WIDE_HEAP = 2.5  # times as far as bands, heaps scatter across, ...
_FULL = 0.5  # ... of the places that a heap has in its middle, ...
_COMPACT = 3.0  # ... and not so many times as far along
_ROUND = 2.0  # ... a slenderness on the average no more than this: a cloud of strays
_SLENDER = 0.02  # A run with no more than this share of the points ...
_THIN = 1 / 12  # ... and this share of the usual number of them in a slab is a row of strays.
_FEW = 600  # places that may go in single file
_EVEN = 7  # steps over which the median is taken, in single file
_LEAST_POINTS = 5  # in a run
_LEAST_SLABS = 3  # of a run: fewer have no order
_LEAST_LOOP = 4  # slabs


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Runs of places, and the rows of those that are some."""

    runs: Runs
    rows: tuple[Row | None, ...]  # of each run; None: too short or too thin to be one
    heaps: BoolArray  # (runs,), whether a run is a heap, much wider than the bands
    off: FloatArray  # (2,), share of the points that lie far from their rows, by either measure


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """What each place sees around it."""

    frames: FloatArray  # (m, 3), a direction, and how many times as far it sees along it
    slenderness: FloatArray  # (m,)
    scatter: FloatArray  # (m,), standard deviation across; infinite where there is no direction
    heaped: BoolArray  # (m,), of a heap, much wider than the band and hardly longer
    width: float  # of the band, if it is a few places wide; else too small


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    runs: Runs
    reach: FloatArray  # (m,), of every place
    ordered: BoolArray  # (runs,), False: too short or too thin to be one
    share: float


def order(places: Places) -> Order:
    """Single file where the places go in one, else the runs of a band."""
    files = span(places.at) if len(places.at) <= _FEW else None
    return _banded(places) if files is None else _single_file(places, files)


def _single_file(places: Places, files: list[IntArray]) -> Order:
    """Every place is a slab of its own, and reaches over the next."""
    run_of_place, slot_of_place = np.full((2, len(places.at)), -1)
    reach = np.ones(len(places.at))
    for number, file in enumerate(files):
        steps = np.linalg.norm(np.diff(places.at[file], axis=0), axis=1)
        steps = median_filter(steps, size=_EVEN, mode="nearest")
        reach[file] = 2.0 * np.maximum(np.append(steps, steps[-1]), np.append(steps[0], steps))
        run_of_place[file], slot_of_place[file] = number, np.arange(len(file))
    lengths = np.array([len(file) for file in files])
    runs = Runs(run_of_place, slot_of_place, lengths, (False,) * len(files))
    all_of_them = np.ones(len(files), np.bool_)
    rows, off = _rows(places, runs, reach, np.full(len(reach), np.inf), all_of_them)
    return Order(runs, rows, ~all_of_them, off)


def _banded(places: Places) -> Order:
    """Link with the smallest reach that leaves hardly a flaw; failing that, the fewest flaws."""
    sight = _looked_around(places)
    rest: list[tuple[_Trial, float]] = []
    for trial in _trials(places, sight):
        rest.append((trial, trial.share + _LATER * len(rest)))
        if trial.share <= _FLAWED:
            found = _order(places, trial, sight)
            if found.off.max() <= _FLAWED:
                return found
    # Thinning takes longer than linking: only those that may still be the best.
    best, least, usual = None, np.inf, _order(places, rest[0][0], sight).off[1]
    for trial, share in sorted(rest, key=lambda each: each[1]):
        if share < least:
            found = _order(places, trial, sight)
            share += found.off[0] if usual > _MIXED else max(found.off[1] - usual, 0.0)
            best, least = (found, share) if share < least else (best, least)
    assert best is not None
    return best


def _trials(places: Places, sight: _Sight) -> Iterator[_Trial]:
    in_cells = places.heaps is not None
    cap = (_SPARSE_CELLS if in_cells else _SPARSE) * _middling(places.spacing, places.counts)
    through = _THROUGH * places.thickness if in_cells else _ACROSS * sight.width
    last = 0.0
    for factor in _REACHES_CELLS if in_cells else _REACHES:
        reach = np.maximum(factor * np.minimum(places.spacing, cap), through)
        typical = _middling(reach, places.counts)
        if typical > _FARTHER * last:
            yield _linked(places, reach, sight)
            last = typical


def _linked(places: Places, reach: FloatArray, sight: _Sight) -> _Trial:
    """The runs that a reach makes, and what is wrong with them."""
    starts, neighbours = neighbours_of(places.at, reach, sight.frames)
    in_sight = places.counts + _sums(places.counts, starts, neighbours)
    lonely = in_sight < _middling(in_sight, places.counts) / _LONELY
    kind = np.where(sight.heaped, 2, lonely)
    lonely |= sight.heaped
    if lonely.any():
        starts, neighbours = apart(starts, neighbours, kind)
    runs = link(places.at, starts, neighbours)
    along = reach * (1.0 + sight.frames[:, 2]) / 2.0
    ordered = _are_runs(places, runs, along, sight.slenderness)
    ordered &= ~_heaps(runs, sight)
    return _Trial(runs, along, ordered, _flaw_share(places, runs, along, ordered, lonely))


def _order(places: Places, trial: _Trial, sight: _Sight) -> Order:
    rows, off = _rows(places, trial.runs, trial.reach, sight.scatter, trial.ordered)
    return Order(trial.runs, rows, _heaps(trial.runs, sight), off)


def _heaps(runs: Runs, sight: _Sight) -> BoolArray:
    """Which runs are of heaps."""
    held = runs.run_of_place[sight.heaped]
    return np.asarray(np.bincount(held[held >= 0], minlength=len(runs.lengths)) > 0)


def _sums(values: IntArray, starts: IntArray, neighbours: IntArray) -> IntArray:
    """Sum of the values of each place's neighbours."""
    sums = np.concatenate([[0], values[neighbours].cumsum()])
    return np.asarray(sums[starts[1:]] - sums[starts[:-1]])


def _looked_around(places: Places) -> _Sight:
    neighbours = np.asarray(
        cKDTree(places.at).query(places.at, k=min(_HOODS[-1], len(places.at)))[1]
    )
    found = frames(places.at, neighbours, np.array(_HOODS))
    width = math.sqrt(12.0) * _middling(found[:, 2], places.counts)
    across, slender = np.median(found[neighbours[:, :_ALIKE], 2:], axis=1).T
    seen = found[:, :3].copy()
    seen[:, 2] = np.clip(found[:, 3] / _SLENDER_HOOD, 1.0, _AHEAD)
    scatter = np.where(slender > _BAND, across, np.inf)
    heaped = _heaped(places, neighbours, scatter)
    return _Sight(seen, found[:, 3], scatter, heaped, width)


def _heaped(places: Places, neighbours: IntArray, scatter: FloatArray) -> BoolArray:
    """Which places are of heaps, where most are of bands."""
    round_ = np.isinf(scatter)
    heaped = np.zeros(len(round_), np.bool_)
    if not round_.any() or float(places.counts[round_].sum()) > _HEAPED * places.counts.sum():
        return heaped
    wide = _WIDE_HEAP * _middling(scatter[~round_], places.counts[~round_])
    pairs = neighbours[round_][:, :_ALIKE]
    own = np.repeat(np.flatnonzero(round_), pairs.shape[1])
    kept = round_[pairs.ravel()]
    graph = coo_array((np.ones(kept.sum()), (own[kept], pairs.ravel()[kept])), (len(round_),) * 2)
    label = np.where(round_, connected_components(graph, directed=False)[1], -1)
    for number in np.unique(label[round_]):
        mine = label == number
        if mine.sum() >= _LEAST_HEAP and _is_heap(places, mine, wide):
            heaped |= mine
    return heaped


def _is_heap(places: Places, mine: BoolArray, wide: float) -> bool:
    """Whether places are wider than the band, full, not much longer, and not of a wider band."""
    at, middle = places.at, places.at[mine].mean(axis=0)
    shorter, longer = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(at[mine].T)), 0.0))
    if shorter < wide or longer > _COMPACT * shorter:
        return False
    apart = np.linalg.norm(at - middle, axis=1)
    # Four neighbours lie within a spacing.
    full = 4.0 * (shorter / max(float(np.median(places.spacing[mine])), 1e-300)) ** 2
    if (apart < shorter).sum() < _FULL * full:
        return False
    beside = at[(apart > 2.0 * longer) & (apart < 5.0 * longer) & ~mine]
    if len(beside) < _LEAST_HEAP:
        return True
    found = frames(beside, np.asarray(cKDTree(beside).query(beside, k=min(_HOODS[-1], len(beside)))[1]),
                   np.array(_HOODS))
    return float(np.median(found[:, 2])) < shorter / _WIDE_HEAP


def _rows(
    places: Places, runs: Runs, reach: FloatArray, scatter: FloatArray, ordered: BoolArray
) -> tuple[tuple[Row | None, ...], FloatArray]:
    """Thin each run to a row; the share of the points that lie far from the row of their run."""
    run, slot, scale, across = (
        values[places.place_of_sample]
        for values in (runs.run_of_place, runs.slot_of_place, reach, scatter)
    )
    by_run = np.argsort(run, kind="stable")
    borders = np.searchsorted(run[by_run], np.arange(len(runs.lengths) + 1))
    rows: list[Row | None] = []
    off = np.zeros(2, np.int64)
    for number, (count, closed) in enumerate(zip(runs.lengths, runs.closed, strict=True)):
        mine = by_run[borders[number] : borders[number + 1]]
        row = None
        if ordered[number] and len(mine) >= _LEAST_POINTS:
            row, far = thin(places.sample[mine], slot[mine], scale[mine], across[mine], int(count),
                            closed=closed)  # fmt: skip
            off += far
        rows.append(row)
    return tuple(rows), np.maximum(off - _EXCUSED, 0) / max(len(run), 1)


def _points_of(places: Places, runs: Runs, among: BoolArray) -> FloatArray:
    """How many points each run holds among some places."""
    held = (runs.run_of_place >= 0) & among
    counts = np.bincount(runs.run_of_place[held], places.counts[held], len(runs.lengths))
    return np.asarray(counts, dtype=np.float64)


def _are_runs(places: Places, runs: Runs, reach: FloatArray, slender: FloatArray) -> BoolArray:
    """Whether a run is long enough, and no row of strays."""
    held = runs.run_of_place >= 0

    def mean(values: FloatArray) -> FloatArray:
        sums = np.bincount(runs.run_of_place[held], values[held], len(runs.lengths))
        return np.asarray(sums / np.maximum(np.bincount(runs.run_of_place[held]), 1))

    points = _points_of(places, runs, np.ones(len(places.at), np.bool_))
    in_slabs = points / runs.lengths
    on_length = in_slabs / mean(reach)
    # By points, not by slabs: strays may make more slabs than a band.
    few = (in_slabs < _THIN * _middling(in_slabs, points)) & (points < _SLENDER * points.sum())
    scattered = on_length < _SCATTERED * _middling(on_length, points)
    scattered &= mean(np.minimum(slender, 2.0 * _ROUND)) < _ROUND
    least = np.where(runs.closed, _LEAST_LOOP, _LEAST_SLABS)
    return np.asarray((runs.lengths >= least) & ~few & ~scattered)


def _flaw_share(
    places: Places, runs: Runs, reach: FloatArray, ordered: BoolArray, lonely: BoolArray
) -> float:
    """Flaws and breaks a slab, and the points that are lost beyond what strays explain."""
    points = _points_of(places, runs, ~lonely)
    slabs, pieces = int(runs.lengths[ordered].sum()), int(ordered.sum())
    lost = 1.0 - float(points[ordered].sum()) / float(places.counts[~lonely].sum())
    # A break or two, or flaws, are no sign of a wrong scale; runs of a few slabs are.
    flaws = max(runs.flaws + _breaks(places, runs, reach, ordered) - 2, 0)
    flaws += pieces if slabs < max(_COARSE * pieces, _COARSEST) else 0
    return flaws / max(slabs, 1) + max(lost - _LOST, 0.0)


def _breaks(places: Places, runs: Runs, reach: FloatArray, ordered: BoolArray) -> int:
    """How many ends are so near to others that a longer reach would have gone on there.

    Tiny loops count as well: they run around holes in a band.
    """
    closed = np.array(runs.closed, np.bool_)
    tiny = int((ordered & closed & (runs.lengths <= _TINY)).sum())
    run, slot = runs.run_of_place, runs.slot_of_place
    of_open = np.append(ordered & ~closed, False)[run]
    first, last = of_open & (slot == 0), of_open & (slot == np.append(runs.lengths, 0)[run] - 1)
    end = np.where(first, 2 * run, 2 * run + 1)[first | last]
    if not len(end):
        return tiny
    _, number, held = np.unique(end, return_inverse=True, return_counts=True)
    at, far = places.at[first | last], reach[first | last]
    x, y, sight = (np.bincount(number, values) / held for values in (*at.T, far))
    ends = np.stack([x, y], axis=1)
    near = np.asarray(cKDTree(ends).query(ends, k=2)[0])[:, 1] if len(ends) > 1 else np.full(1, np.inf)
    return tiny + int((near <= _NEAR * sight).sum()) // 2


def _middling(values: FloatArray | IntArray, weights: IntArray | FloatArray) -> float:
    """Weighted median."""
    order = np.argsort(values)
    heights = weights[order].cumsum()
    return float(values[order][np.searchsorted(heights, heights[-1] / 2)])
