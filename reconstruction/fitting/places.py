"""A slice seen through few places: its points, or the centres of mass of cells.

Up to a few thousand points stand for themselves. Beyond, cells a little narrower than the band is
thick do: narrow enough that a band is one or two reaches wide, wide enough to be few. Lengths are
in units of the slice's size, about its corner, so that no square overflows or cancels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.cells import Heaps, Int32Array, heap_up
from reconstruction.fitting.frames import frames
from reconstruction.fitting.nearness import medians_of, nearest_few

_SINGLY = 3000  # points up to which each is a place of its own
_SAMPLE = 5000  # points that tell the middle and the thickness of a band
_PROBES = 128  # of them, at which the thickness is looked for ...
_PROBED = np.array([8, 12, 18, 27, 40, 60, 90, 128])  # ... among so many neighbours
_NARROW = 1.6  # cells to a thickness
_MOST_PLACES = 10_000
_LEAST_PLACES = 4
_KNOWN = 27  # neighbours of each place, itself included, that are known
_NEIGHBOUR = 4  # the neighbour whose distance is the spacing
_AROUND = 24  # places that share their spacing; the more even cells need fewer
_AROUND_CELLS = 6
_FINEST = 4096  # cells along the longer side of a slice
_TAIL = 0.01  # share of the points on either side that the box need not hold ...
_MARGIN = 0.6  # ... unless they lie within this share of the box


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """What stands for the points."""

    origin_mm: FloatArray  # (2,)
    unit_mm: float
    at: FloatArray  # (m, 2), in units from the origin
    counts: IntArray  # (m,), points each stands for
    neighbours: IntArray  # (m, k), the nearest, each place the first of its own
    spacing: FloatArray  # (m,), to the fourth neighbour, evened out
    thickness: float  # of the band, roughly; 0 where nothing had to be known of it
    sample: FloatArray  # (k, 2), points themselves
    place_of_sample: IntArray  # (k,)
    place_of_point: IntArray  # (n,), empty where there are heaps
    heaps: Heaps | None

    def of_points(self, points_mm: FloatArray, values: IntArray) -> Int32Array:
        """For every point the value of its place; (n, 2), (m,) -> (n,). Outside the box: -1."""
        if self.heaps is None:
            return values[self.place_of_point].astype(np.int32)
        return self.heaps.of_points(points_mm, values)


def look_at(points_mm: FloatArray, low: FloatArray, high: FloatArray) -> Places:
    """Find the places of finite points (n, 2) in the box from low to high.

    Raises
    ------
    TooFewPoints
        Points in fewer than 4 places.
    """
    size = float((high - low).max())
    largest = max(float(np.abs(low).max()), float(np.abs(high).max()))
    if not size > 1e-12 * largest or size < 1e-200:
        raise TooFewPoints(f"all {len(points_mm)} points lie in one place; a curve needs 4")
    singly = len(points_mm) <= _SINGLY
    places = _singly(points_mm, low, size) if singly else _in_cells(points_mm)
    if len(places.at) < _LEAST_PLACES:
        raise TooFewPoints(
            f"{len(points_mm)} points in {len(places.at)} places; a curve needs {_LEAST_PLACES}"
        )
    return places


def _singly(points: FloatArray, low: FloatArray, size: float) -> Places:
    at, place_of_point, counts = np.unique(
        (points - low) / size, axis=0, return_inverse=True, return_counts=True
    )
    each = np.arange(len(at))  # a point that was measured twice says nothing twice
    nearest, spacing = _nearest(at, _AROUND)
    return Places(
        low, size, at, counts, nearest, spacing, 0.0, at, each, place_of_point.ravel(), None
    )


def _in_cells(points: FloatArray) -> Places:
    rng = np.random.default_rng(0)
    chosen = points[np.unique(rng.integers(0, len(points), _SAMPLE))]
    width = _thickness(chosen)
    low, high = _box_of(chosen)
    heaps = heap_up(points, low, high, max(width / _NARROW, float((high - low).max()) / _FINEST))
    if len(heaps.counts) > _MOST_PLACES:
        heaps = heaps.coarsened(-(-len(heaps.counts) // _MOST_PLACES))
    unit = max(float(np.ptp(heaps.places_mm, axis=0).max()), 1e-300)
    at = (heaps.places_mm - low) / unit
    nearest, spacing = _nearest(at, _AROUND_CELLS)
    place_of_sample = heaps.of_points(chosen, np.arange(len(at))).astype(np.int64)
    inside = place_of_sample >= 0
    return Places(
        low, unit, at, heaps.counts, nearest, spacing, width / unit,
        (chosen[inside] - low) / unit, place_of_sample[inside], np.empty(0, np.int64), heaps,
    )  # fmt: skip


def _thickness(chosen: FloatArray) -> float:
    """Full width of the band, the median over some of the points (k, 2)."""
    probes = chosen[:: max(len(chosen) // _PROBES, 1)]
    neighbours = cKDTree(chosen).query(probes, k=min(int(_PROBED[-1]), len(chosen)))[1]
    found = frames(chosen, np.asarray(neighbours), _PROBED)
    return math.sqrt(12.0) * float(np.median(found[:, 2]))


def _box_of(chosen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The box of nearly all points: one of them far away does not make the cells coarse."""
    ordered = np.sort(chosen, axis=0)
    tail = int(_TAIL * len(chosen))
    core_low, core_high = ordered[tail], ordered[-1 - tail]
    margin = _MARGIN * float((core_high - core_low).max())
    low = np.maximum(ordered[0] - 0.05 * margin, core_low - margin)
    return low, np.minimum(ordered[-1] + 0.05 * margin, core_high + margin)


def _nearest(at: FloatArray, most: int) -> tuple[IntArray, FloatArray]:
    """Neighbours of each place, and the distance to the fourth: the median over the places around.

    (m, 2) -> (m, k), (m,)
    """
    count = len(at)
    if count < 2:
        return np.zeros((count, 1), np.int64), np.zeros(count)
    distances, neighbours = nearest_few(at, _KNOWN)
    around = min(max(_NEIGHBOUR, count // 12), most, count - 1)
    k = min(_NEIGHBOUR, around)
    spacing = medians_of(distances[:, k : k + 1].copy(), neighbours[:, : around + 1])[:, 0]
    return neighbours, spacing * (_NEIGHBOUR / k)


def middling(values: FloatArray | IntArray, weights: FloatArray | IntArray) -> float:
    """Weighted median."""
    order = np.argsort(values)
    heights = weights[order].cumsum()
    return float(values[order][np.searchsorted(heights, heights[-1] / 2)])
