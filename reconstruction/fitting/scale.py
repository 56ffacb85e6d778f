"""How far to look for neighbours: the smallest reach with which the places make clean runs.

Too small a reach breaks a band to pieces and finds holes in it, too large a one joins what is
apart. Nobody need give it: from small to large, the first that leaves next to no flaws is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.frames import frames
from reconstruction.fitting.linking import Runs, link
from reconstruction.fitting.places import Places
from reconstruction.fitting.spanning import span

_REACHES = (0.65, 0.9, 1.25, 1.75, 2.5, 3.5, 5.0)  # spacings
_REACHES_CELLS = (1.75, 2.5, 3.5, 5.0)
HOODS = (6, 9, 13, 19, 27)
_SLENDERNESS = 1.5
_AHEAD = 3.0
_THROUGH = 1.2  # thicknesses: a reach must look through the band
_FLAWED = 0.01  # flaws a slab up to which a reach is taken for the right one
_COARSE = 8  # slabs a run below which the reach may have been too large
_LOST = 0.02  # share of the points that may be strays
_SPARSE = 12.0  # times the usual spacing: who is lonelier does not look for neighbours farther off
_SPARSE_CELLS = 5.0
_SLENDER = 0.02  # A run with no more than this share of the points ...
_THIN = 1 / 12  # ... and this share of the usual number of them in a slab is a row of strays.
_FEW = 600  # places that may go in single file
_EVEN = 7  # steps over which the median is taken, in single file
LEAST_SLABS = 3  # of a run: fewer have no order
_LEAST_LOOP = 4  # slabs


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """Runs of places, and which of them are none."""

    runs: Runs
    reach: FloatArray  # (m,), of every place
    ordered: BoolArray  # (runs,), False: too short or too thin to be one


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
    return Order(runs, reach, np.ones(len(files), np.bool_))


def _banded(places: Places) -> Order:
    """Link with the smallest reach that leaves hardly a flaw; failing that, the fewest flaws."""
    in_cells = places.heaps is not None
    cap = (_SPARSE_CELLS if in_cells else _SPARSE) * _middling(places.spacing, places.counts)
    best, fewest = None, np.inf
    seen = _seen(places)
    for factor in _REACHES_CELLS if in_cells else _REACHES:
        reach = np.maximum(factor * np.minimum(places.spacing, cap), _THROUGH * places.thickness)
        runs = link(places.at, reach, seen)
        found = Order(runs, reach * (1.0 + seen[:, 2]) / 2.0, _are_runs(places, runs))
        share = _flaw_share(places, found)
        if share < fewest:
            best, fewest = found, share
        if share <= _FLAWED:
            break
    assert best is not None
    return best


def _seen(places: Places) -> FloatArray:
    neighbours = cKDTree(places.at).query(places.at, k=min(HOODS[-1], len(places.at)))[1]
    found = frames(places.at, np.asarray(neighbours), np.array(HOODS))
    found[:, 2] = np.clip(found[:, 3] / _SLENDERNESS, 1.0, _AHEAD)
    return np.ascontiguousarray(found[:, :3])


def _points_of(places: Places, runs: Runs) -> FloatArray:
    """How many points each run holds."""
    held = runs.run_of_place >= 0
    counts = np.bincount(runs.run_of_place[held], places.counts[held], len(runs.lengths))
    return np.asarray(counts, dtype=np.float64)


def _are_runs(places: Places, runs: Runs) -> BoolArray:
    points = _points_of(places, runs)
    density = points / runs.lengths
    # By points, not by slabs: strays may make more slabs than a band.
    thin = (density < _THIN * _middling(density, points)) & (points < _SLENDER * points.sum())
    least = np.where(runs.closed, _LEAST_LOOP, LEAST_SLABS)
    return np.asarray((runs.lengths >= least) & ~thin)


def _flaw_share(places: Places, found: Order) -> float:
    """Flaws and needless pieces a slab, and the points that are lost beyond what strays explain."""
    points = _points_of(places, found.runs)
    slabs = int(found.runs.lengths[found.ordered].sum())
    pieces = int(found.ordered.sum())
    lost = 1.0 - float(points[found.ordered].sum()) / float(places.counts.sum())
    # One piece, or one flaw, too many is no sign of a wrong scale; runs of a few slabs are.
    flaws = max(found.runs.flaws + pieces - 2, 0) + (pieces if slabs < _COARSE * pieces else 0)
    return flaws / max(slabs, 1) + max(lost - _LOST, 0.0)


def _middling(values: FloatArray, weights: IntArray | FloatArray) -> float:
    """Weighted median."""
    order = np.argsort(values)
    heights = weights[order].cumsum()
    return float(values[order][np.searchsorted(heights, heights[-1] / 2)])
