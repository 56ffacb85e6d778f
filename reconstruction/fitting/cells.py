"""Points of a slice become few: the points themselves, or the centres of mass of cells.

Where a slice is dense, every cell of a third of its thickness that holds points stands for them;
the order of the points is not needed and no point is looked at twice but to be told where it went.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, IntArray, frozen

_MOST_BOXES = 1 << 18  # of the lattice, occupied or not: 6.3 MB of counts and sums at most

Int32Array = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Square boxes over a slice."""

    corner_mm: FloatArray  # (2,)
    edge_mm: float
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Heaps:
    """Occupied boxes of a lattice."""

    lattice: Lattice
    places_mm: FloatArray  # (m, 2), centres of mass
    counts: IntArray  # (m,)
    heap_of_box: Int32Array  # (boxes,), -1: nothing there

    def __post_init__(self) -> None:
        object.__setattr__(self, "places_mm", frozen(self.places_mm))

    def of_points(self, points_mm: FloatArray, values: IntArray) -> Int32Array:
        """The value of the heap each point belongs to; (n, 2), (m,) -> (n,)."""
        lattice = self.lattice
        found: Int32Array = _look_up(
            points_mm, lattice.corner_mm, lattice.edge_mm, lattice.shape, self.heap_of_box, values
        )
        return found

    def coarsened(self, times: int) -> Heaps:
        """The same in boxes `times` as wide."""
        lattice = self.lattice
        rows = -(-lattice.shape[1] // times)
        boxes = np.flatnonzero(self.heap_of_box >= 0)
        columns, within = np.divmod(boxes, lattice.shape[1])
        _, group = np.unique(columns // times * rows + within // times, return_inverse=True)
        counts = np.bincount(group, self.counts)
        sums = [np.bincount(group, self.counts * column) for column in self.places_mm.T]
        heap_of_box = np.full(len(self.heap_of_box), -1, np.int32)
        heap_of_box[boxes] = group
        return Heaps(lattice, np.stack(sums, axis=1) / counts[:, None], counts.astype(np.int64),
                     heap_of_box)  # fmt: skip


def bounds(points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner of (n, 2) points; NaN or infinite if any coordinate is."""
    low_x, low_y, high_x, high_y, total = _bounds(points_mm)
    if not math.isfinite(total):
        return np.full(2, -np.inf), np.full(2, np.inf)
    return np.array([low_x, low_y]), np.array([high_x, high_y])


def heap_up(points_mm: FloatArray, low: FloatArray, high: FloatArray, edge_mm: float) -> Heaps:
    """Sort points (n, 2) into boxes of about `edge_mm`, wider where that would be too many."""
    sides = np.maximum(high - low, 1e-300)
    edge = max(edge_mm, math.sqrt(float(sides[0]) * float(sides[1]) / _MOST_BOXES),
               float(sides.max()) / _MOST_BOXES)  # fmt: skip
    shape = (int(sides[0] / edge) + 1, int(sides[1] / edge) + 1)
    records = np.zeros((shape[0] * shape[1], 3))
    _accumulate(points_mm, low, edge, shape, records)
    occupied, heap_of_box = _occupied(records)
    held = records[occupied]
    places = held[:, 1:] / held[:, :1] + low
    return Heaps(Lattice(low, edge, shape), places, held[:, 0].astype(np.int64), heap_of_box)


@njit(cache=True, nogil=True)
def _bounds(points: FloatArray) -> tuple[float, float, float, float, float]:
    low_x = high_x = points[0, 0]
    low_y = high_y = points[0, 1]
    total = 0.0
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
        total += x * 0.0 + y * 0.0
    return low_x, low_y, high_x, high_y, total


@njit(cache=True, nogil=True, inline="always")
def _box(x: float, y: float, inverse: float, nx: int, ny: int) -> int:
    """Row of the box of a place above the corner; -1 outside (and for what is no number)."""
    fx, fy = x * inverse, y * inverse
    if not (0.0 <= fx < nx and 0.0 <= fy < ny):
        return -1
    return int(fx) * ny + int(fy)


@njit(cache=True, nogil=True, error_model="numpy")
def _accumulate(
    points: FloatArray, low: FloatArray, edge: float, shape: tuple[int, int], records: FloatArray
) -> None:
    """Count and sums about the corner for every box; points outside are passed over."""
    low_x, low_y, inverse = low[0], low[1], 1.0 / edge
    for n in range(len(points)):
        x, y = points[n, 0] - low_x, points[n, 1] - low_y
        box = _box(x, y, inverse, shape[0], shape[1])
        if box < 0:
            continue
        record = records[box]
        record[0] += 1.0
        record[1] += x
        record[2] += y


@njit(cache=True, nogil=True)
def _occupied(records: FloatArray) -> tuple[IntArray, Int32Array]:
    heap_of_box = np.full(len(records), -1, np.int32)
    boxes = np.empty(len(records), np.int64)
    found = 0
    for box in range(len(records)):
        if records[box, 0] > 0.0:
            boxes[found] = box
            heap_of_box[box] = found
            found += 1
    return boxes[:found].copy(), heap_of_box


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(
    points: FloatArray,
    low: FloatArray,
    edge: float,
    shape: tuple[int, int],
    heap_of_box: Int32Array,
    values: IntArray,
) -> Int32Array:
    low_x, low_y, inverse = low[0], low[1], 1.0 / edge
    found = np.empty(len(points), np.int32)
    for n in range(len(points)):
        x, y = points[n, 0] - low_x, points[n, 1] - low_y
        box = _box(x, y, inverse, shape[0], shape[1])
        heap = heap_of_box[box] if box >= 0 else -1
        found[n] = values[heap] if heap >= 0 else -1
    return found
