"""Points closed in a cell become one, at their centre of mass (the paper's section 2.2, eq. 4).

The space is cut into boxes of dx by dy by dz; every box that holds points is replaced by the mean
of its points, considered as unit masses, and their number. An infinite side means one layer: a
slice is reduced with ``dz = inf``. The kernels read each point once and write one 32-byte record
(count, sum x, sum y, sum z), so that a cell costs one cache line, not four.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray, frozen

# Above this many boxes (256 MB of records) the dense grid gives way to sorted keys.
_DENSE_BOXES = 8_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The occupied cells of a reduction, in order of their lattice indices."""

    size_mm: tuple[float, float, float]
    lattice: IntArray  # (m, 3), which box: floor((point - origin) / size)
    centres_mm: FloatArray  # (m, 3), centres of mass, not centres of boxes
    counts: IntArray  # (m,), points in the cell

    def __post_init__(self) -> None:
        object.__setattr__(self, "lattice", frozen(self.lattice, np.int64))
        object.__setattr__(self, "centres_mm", frozen(self.centres_mm))
        object.__setattr__(self, "counts", frozen(self.counts, np.int64))

    def __len__(self) -> int:
        return len(self.counts)


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An axis-aligned box, corner to corner; it holds its own faces."""

    low_mm: FloatArray  # (3,)
    high_mm: FloatArray  # (3,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "low_mm", frozen(self.low_mm))
        object.__setattr__(self, "high_mm", frozen(self.high_mm))

    @property
    def sides_mm(self) -> FloatArray:
        """Its three side lengths, (3,)."""
        return self.high_mm - self.low_mm


def bounding_box(points_mm: FloatArray) -> Box:
    """Return the smallest box around (n, 3) points, n > 0; ValueError if any is not finite."""
    low, high, total = _bounds(np.ascontiguousarray(points_mm, dtype=np.float64))
    if not math.isfinite(total):
        raise ValueError("points must be finite: set NaN and infinity aside first")
    return Box(low, high)


def reduce_points(
    points_mm: FloatArray,
    *,
    size_mm: tuple[float, float, float],
    origin_mm: FloatArray | None = None,
    within: Box | None = None,
) -> Cells:
    """Replace the points of every cell by their centre of mass.

    Parameters
    ----------
    points_mm : (n, 3) float64, finite
        Points in any frame; the cells are aligned with its axes.
    size_mm : (dx, dy, dz)
        Sides of a cell, each positive; ``math.inf`` makes one layer of that axis.
    origin_mm : (3,), optional
        A corner of the lattice; by default the low corner of the box.
    within : Box, optional
        A box known to hold all points; without it the points are read twice.

    Returns
    -------
    Cells
        The occupied cells; their counts add up to n.

    Raises
    ------
    ValueError
        For a side that is not positive, points not of shape (n, 3), not finite, or a cell or more
        outside `within`.

    References
    ----------
    paper, section 2.2, eq. 4.
    """
    points = np.ascontiguousarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    if not all(side > 0 for side in size_mm):
        raise ValueError(f"the sides of a cell must be positive, got {size_mm} mm")
    if len(points) == 0:
        nothing = np.empty(0, np.int64)
        return Cells(size_mm, nothing.reshape(0, 3), np.empty((0, 3)), nothing)
    lattice = _lay_lattice(within or bounding_box(points), size_mm, origin_mm)
    if math.prod(lattice.shape) <= _DENSE_BOXES:
        boxes, records = _reduce_dense(points, lattice)
    else:
        boxes, records = _reduce_sorted(points, lattice)
    counts = records[:, 0].astype(np.int64)
    if counts.sum() != len(points) or not np.isfinite(records).all():
        raise ValueError("points must be finite and lie within the box that was given")
    return Cells(size_mm, boxes + lattice.first, records[:, 1:] / counts[:, None], counts)


@dataclass(frozen=True, slots=True, eq=False)
class _Lattice:
    corner_mm: FloatArray  # (3,), at or below every point
    inverse: FloatArray  # (3,), cells per mm; 0 for one layer
    first: IntArray  # (3,), lattice index of the first cell
    shape: tuple[int, int, int]


def _lay_lattice(
    box: Box, size_mm: tuple[float, float, float], origin_mm: FloatArray | None
) -> _Lattice:
    origin = box.low_mm if origin_mm is None else np.asarray(origin_mm, dtype=np.float64)
    inverse = np.array([0.0 if math.isinf(side) else 1.0 / side for side in size_mm])
    sides = np.where(inverse > 0, size_mm, 0.0)
    first = np.floor((box.low_mm - origin) * inverse).astype(np.int64)
    last = np.floor((box.high_mm - origin) * inverse).astype(np.int64)
    corner = np.where(inverse > 0, np.minimum(origin + first * sides, box.low_mm), box.low_mm)
    # One cell to spare an axis: rounding may push the highest point over its edge.
    shape = np.where(inverse > 0, last - first + 2, 1)
    return _Lattice(corner, inverse, first, (int(shape[0]), int(shape[1]), int(shape[2])))


def _reduce_dense(points: FloatArray, lattice: _Lattice) -> tuple[IntArray, FloatArray]:
    records = np.zeros((math.prod(lattice.shape), 4))
    if lattice.shape[2] == 1:
        _accumulate_layer(points, lattice.corner_mm, lattice.inverse, lattice.shape, records)
    else:
        _accumulate_boxes(points, lattice.corner_mm, lattice.inverse, lattice.shape, records)
    occupied = _occupied(records)
    return np.stack(np.unravel_index(occupied, lattice.shape), axis=1), records[occupied]


def _reduce_sorted(points: FloatArray, lattice: _Lattice) -> tuple[IntArray, FloatArray]:
    with np.errstate(invalid="ignore"):  # an infinity in the one layer: refused below
        boxes = np.floor((points - lattice.corner_mm) * lattice.inverse)
    inside = ((boxes >= 0) & (boxes < lattice.shape)).all(axis=1)
    occupied, box_of_point = np.unique(boxes[inside].astype(np.int64), axis=0, return_inverse=True)
    where = box_of_point.ravel()
    weights = (None, *points[inside].T)
    columns = [np.bincount(where, weights=w, minlength=len(occupied)) for w in weights]
    return occupied, np.stack(columns, axis=1).astype(np.float64)


@njit(cache=True)
def _bounds(points: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Least and greatest coordinates, and a sum that is finite only if every coordinate is."""
    low_x = high_x = points[0, 0]
    low_y = high_y = points[0, 1]
    low_z = high_z = points[0, 2]
    total = 0.0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
        low_z, high_z = min(low_z, z), max(high_z, z)
        total += x + y + z
    return np.array([low_x, low_y, low_z]), np.array([high_x, high_y, high_z]), total


# In both kernels one unsigned comparison an axis refuses what lies below or above the lattice
# (a NaN converts to the least integer).


@njit(cache=True, error_model="numpy")
def _accumulate_layer(
    points: FloatArray,
    corner: FloatArray,
    inverse: FloatArray,
    shape: tuple[int, int, int],
    records: FloatArray,
) -> None:
    corner_x, corner_y = corner[0], corner[1]
    inverse_x, inverse_y = inverse[0], inverse[1]
    shape_x, shape_y = np.uint64(shape[0]), np.uint64(shape[1])
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = np.uint64(np.int64(np.floor((x - corner_x) * inverse_x)))
        j = np.uint64(np.int64(np.floor((y - corner_y) * inverse_y)))
        if i < shape_x and j < shape_y:
            record = records[i * shape_y + j]
            record[0] += 1.0
            record[1] += x
            record[2] += y
            record[3] += z


@njit(cache=True, error_model="numpy")
def _accumulate_boxes(
    points: FloatArray,
    corner: FloatArray,
    inverse: FloatArray,
    shape: tuple[int, int, int],
    records: FloatArray,
) -> None:
    shape_x, shape_y, shape_z = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = np.uint64(np.int64(np.floor((x - corner[0]) * inverse[0])))
        j = np.uint64(np.int64(np.floor((y - corner[1]) * inverse[1])))
        k = np.uint64(np.int64(np.floor((z - corner[2]) * inverse[2])))
        if i < shape_x and j < shape_y and k < shape_z:
            record = records[(i * shape_y + j) * shape_z + k]
            record[0] += 1.0
            record[1] += x
            record[2] += y
            record[3] += z


@njit(cache=True)
def _occupied(records: FloatArray) -> IntArray:
    boxes = np.empty(len(records), np.int64)
    found = 0
    for box in range(len(records)):
        # Stored always, kept if occupied: no branch to mispredict on a ragged ring of cells.
        boxes[found] = box
        found += records[box, 0] > 0.0
    return boxes[:found].copy()
