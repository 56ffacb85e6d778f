"""How far to look for neighbours: the smallest reach with which the places make clean runs.

Too small a reach breaks a band to pieces and finds holes in it, too large a one joins what is
apart. Nobody need give it: from small to large, the first that leaves next to no flaws is taken;
failing that, the one with the fewest. A flaw is a spur, a hole or a junction, an end so near
another that the band must go on there, and a point that is lost, or far from the row of its run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.linking import Runs, apart, link, neighbours_of
from reconstruction.fitting.places import Places, middling
from reconstruction.fitting.sight import Sight, look_around
from reconstruction.fitting.spanning import span
from reconstruction.fitting.thinning import Row, thin

_REACHES = (0.65, 0.9, 1.25, 1.75, 2.5, 3.5, 5.0)  # spacings
_REACHES_CELLS = (1.75, 2.5, 3.5, 5.0)
_FARTHER = 1.05  # times as far as before: nearly the same need not be tried
_THROUGH = 1.0  # thicknesses: a reach must look through the band, ...
_THROUGH_CELLS = 1.2  # ... and a little farther from the middle of a cell
_SPARSE = 12.0  # times the usual spacing: who is lonelier does not look for neighbours farther off
_SPARSE_CELLS = 5.0
_LONELY = 20.0  # times fewer points in sight than usual: no neighbour of those in the band
_FLAWED = 0.01  # flaws a slab, or points far off their rows, up to which a reach is the right one
_EXCUSED = 2  # flaws and breaks, and points far off their rows, that are no sign of anything
_NEAR = 2.5  # reaches between two ends: a break and no gap
_TINY = 8  # slabs of a loop: it may run around a hole in a band
_COARSE = 8  # slabs a run below which the reach may have been too large, ...
_COARSEST = 16  # ... and slabs altogether
_LOST = 0.02  # share of the points that may be strays
_MIXED = 0.1  # share of points far off by how those around scatter: then that tells nothing
_LATER = 0.015  # what a longer reach is worse by
_SCATTERED = 1 / 8  # A run with so few of the usual points on its length, of places with ...
_ROUND = 2.0  # ... no more than this slenderness on the average, is a cloud of strays.
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
    patches: BoolArray  # (runs,), whether a run is a patch, much wider than the bands
    off: FloatArray  # (2,), share of the points far from their rows, by either measure of far


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """Runs that a reach makes."""

    runs: Runs
    reach: FloatArray  # (m,), of every place, on the average over the directions
    ordered: BoolArray  # (runs,), False: too short or too thin to be one
    share: float  # of flaws among the slabs, and of points lost


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
    every = np.ones(len(files), np.bool_)
    rows, off = _rows(places, runs, reach, np.full(len(reach), np.inf), every)
    return Order(runs, rows, ~every, off)


def _banded(places: Places) -> Order:
    """Link with the smallest reach that leaves hardly a flaw; failing that, the fewest flaws."""
    sight = look_around(places)
    trials = []
    for trial in _trials(places, sight):
        trials.append(trial)
        if trial.share <= _FLAWED:
            found = _thinned(places, trial, sight)
            if found.off.max() <= _FLAWED:
                return found
    return _least_flawed(places, trials, sight)


def _least_flawed(places: Places, trials: list[_Trial], sight: Sight) -> Order:
    """Thin those trials that may still be the best: it takes longer than linking."""
    best = _thinned(places, trials[0], sight)
    usual = best.off[1]

    def worth(found: Order) -> float:
        return float(found.off[0] if usual > _MIXED else max(found.off[1] - usual, 0.0))

    least = trials[0].share + worth(best)
    shares = [trial.share + rank * _LATER for rank, trial in enumerate(trials)]
    for rank in np.argsort(shares, kind="stable").tolist():
        if rank and shares[rank] < least:
            found = _thinned(places, trials[rank], sight)
            if shares[rank] + worth(found) < least:
                best, least = found, shares[rank] + worth(found)
    return best


def _trials(places: Places, sight: Sight) -> Iterator[_Trial]:
    """Runs by longer and longer reaches."""
    in_cells = places.heaps is not None
    cap = (_SPARSE_CELLS if in_cells else _SPARSE) * middling(places.spacing, places.counts)
    through = _THROUGH_CELLS * places.thickness if in_cells else _THROUGH * sight.width
    last = 0.0
    for factor in _REACHES_CELLS if in_cells else _REACHES:
        reach = np.maximum(factor * np.minimum(places.spacing, cap), through)
        typical = middling(reach, places.counts)
        if typical > _FARTHER * last:
            yield _linked(places, reach, sight)
            last = typical


def _linked(places: Places, reach: FloatArray, sight: Sight) -> _Trial:
    """The runs that a reach across makes, and what is wrong with them."""
    starts, neighbours = neighbours_of(places.at, reach, sight.frames)
    in_sight = places.counts + _sums(places.counts, starts, neighbours)
    lonely = in_sight < middling(in_sight, places.counts) / _LONELY
    kind = np.where(sight.in_patch, 2, lonely)
    if kind.any():
        starts, neighbours = apart(starts, neighbours, kind)
    runs = link(places.at, starts, neighbours)
    along = reach * (1.0 + sight.frames[:, 2]) / 2.0
    ordered = _are_runs(places, runs, along, sight) & ~_patches(runs, sight)
    return _Trial(runs, along, ordered, _flaw_share(places, runs, along, ordered, kind == 0))


def _sums(values: IntArray, starts: IntArray, neighbours: IntArray) -> IntArray:
    """Sum of the values of each place's neighbours."""
    sums = np.concatenate([[0], values[neighbours].cumsum()])
    return np.asarray(sums[starts[1:]] - sums[starts[:-1]])


def _patches(runs: Runs, sight: Sight) -> BoolArray:
    """Which runs are of patches."""
    held = runs.run_of_place[sight.in_patch]
    return np.asarray(np.bincount(held[held >= 0], minlength=len(runs.lengths)) > 0)


def _thinned(places: Places, trial: _Trial, sight: Sight) -> Order:
    rows, off = _rows(places, trial.runs, trial.reach, sight.scatter, trial.ordered)
    return Order(trial.runs, rows, _patches(trial.runs, sight), off)


def _rows(
    places: Places, runs: Runs, reach: FloatArray, scatter: FloatArray, ordered: BoolArray
) -> tuple[tuple[Row | None, ...], FloatArray]:
    """Thin each run to a row; the share of the points that lie far from the row of their run."""
    of = places.place_of_sample
    run, slot, reach, scatter = (
        runs.run_of_place[of],
        runs.slot_of_place[of],
        reach[of],
        scatter[of],
    )
    by_run = np.argsort(run, kind="stable")
    borders = np.searchsorted(run[by_run], np.arange(len(runs.lengths) + 1))
    rows: list[Row | None] = []
    off = np.zeros(2, np.int64)
    for number, (count, closed) in enumerate(zip(runs.lengths, runs.closed, strict=True)):
        mine = by_run[borders[number] : borders[number + 1]]
        row = None
        if ordered[number] and len(mine) >= _LEAST_POINTS:
            sample = places.sample[mine]
            row, far = thin(
                sample, slot[mine], reach[mine], scatter[mine], int(count), closed=closed
            )
            off += far
        rows.append(row)
    return tuple(rows), np.maximum(off - _EXCUSED, 0) / max(len(run), 1)


def _points_of(places: Places, runs: Runs, among: BoolArray) -> FloatArray:
    """How many points each run holds among some places."""
    held = (runs.run_of_place >= 0) & among
    counts = np.bincount(runs.run_of_place[held], places.counts[held], len(runs.lengths))
    return np.asarray(counts, dtype=np.float64)


def _are_runs(places: Places, runs: Runs, reach: FloatArray, sight: Sight) -> BoolArray:
    """Whether a run is long enough, and no row of strays."""
    held = runs.run_of_place >= 0

    def mean(values: FloatArray) -> FloatArray:
        of, count = runs.run_of_place[held], len(runs.lengths)
        size = np.maximum(np.bincount(of, minlength=count), 1)
        return np.asarray(np.bincount(of, values[held], count) / size)

    points = _points_of(places, runs, held)
    in_slabs = points / runs.lengths
    on_length = in_slabs / mean(reach)
    # By points, not by slabs: strays may make more slabs than a band.
    few = (in_slabs < _THIN * middling(in_slabs, points)) & (points < _SLENDER * points.sum())
    scattered = on_length < _SCATTERED * middling(on_length, points)
    scattered &= mean(np.minimum(sight.slenderness, 2.0 * _ROUND)) < _ROUND
    least = np.where(runs.closed, _LEAST_LOOP, _LEAST_SLABS)
    return np.asarray((runs.lengths >= least) & ~few & ~scattered)


def _flaw_share(
    places: Places, runs: Runs, reach: FloatArray, ordered: BoolArray, sociable: BoolArray
) -> float:
    """Flaws and breaks a slab, and the points that are lost beyond what strays explain."""
    points = _points_of(places, runs, sociable)
    slabs, pieces = int(runs.lengths[ordered].sum()), int(ordered.sum())
    lost = 1.0 - float(points[ordered].sum()) / max(float(places.counts[sociable].sum()), 1.0)
    flaws = max(runs.flaws + _breaks(places, runs, reach, ordered) - _EXCUSED, 0)
    flaws += pieces if slabs < max(_COARSE * pieces, _COARSEST) else 0
    return flaws / max(slabs, 1) + max(lost - _LOST, 0.0)


def _breaks(places: Places, runs: Runs, reach: FloatArray, ordered: BoolArray) -> int:
    """How many ends are so near to others that a longer reach would have gone on there.

    Tiny loops beside others count as well: they run around holes in a band.
    """
    closed = np.array(runs.closed, np.bool_)
    beside = runs.lengths < runs.lengths[ordered].sum() / 2
    tiny = int((ordered & closed & beside & (runs.lengths <= _TINY)).sum())
    run, slot = runs.run_of_place, runs.slot_of_place
    of_open = np.append(ordered & ~closed, [False])[run]
    last = slot == np.append(runs.lengths, [0])[run] - 1
    at_end = of_open & ((slot == 0) | last)
    end, number = np.unique(2 * run[at_end] + last[at_end], return_inverse=True)
    if len(end) < 2:
        return tiny
    held = np.bincount(number)
    x, y, sight = (
        np.bincount(number, values) / held for values in (*places.at[at_end].T, reach[at_end])
    )
    ends = np.stack([x, y], axis=1)
    nearest = np.asarray(cKDTree(ends).query(ends, k=2)[0])[:, 1]
    return tiny + int((nearest <= _NEAR * sight).sum()) // 2
