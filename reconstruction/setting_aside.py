"""Stray clusters and the table plate: found in a coarse grid, set aside, never deleted in silence.

The cloud is counted into boxes. Boxes that touch make a cluster; a cluster with fewer than 1 % of
the points of the largest one is stray, as is everything far outside the part's core; but the last
outlines of a dome stand apart from those below, and are the part. The plate is a layer at the very
bottom that sticks out beyond what stands on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from scipy import ndimage

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.reduction import Box
from reconstruction.survey import Axis, Pass, Survey

_FINEST = 128  # boxes along the longest side
_POINTS_A_BOX = 4.0  # a surface is connected when a typical point shares its box with this many
_STRAY_SHARE = 0.01
_MOST_STRAY = 0.05  # of all points: if more look stray, the grid is too fine, not the cloud bad
_FEWEST = 8  # points in a layer: fewer are no outline of a dome
_BESIDE = 3  # layers that together enclose what lies above or below: each may have gaps
_BRIDGED = 3  # boxes: half an opening of an outline, whose points are sparse
_PLATE_OVERHANG = 1.15  # how much wider than the part the plate must be, in both directions
_PLATE_FULL = 2.0  # and how many times more boxes than a typical layer it must fill
_PLATE_AREA = 0.35  # and how much of its own rectangle: a ring of points is no plate
_PLATE_ZONE = 0.2  # the plate lies within this share of the height from the bottom


class Aside(IntEnum):
    """Why a point is not used."""

    CROPPED = 1
    STRAY = 2
    PLATE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Keep:
    """Which places belong to the part: boxes of a grid, above the plate."""

    corner_mm: FloatArray  # (3,)
    edge_mm: float
    boxes: BoolArray  # (i, j, k) True where the part is
    plate_top_mm: float  # heights at or below are plate; -inf without one

    def __post_init__(self) -> None:
        object.__setattr__(self, "corner_mm", frozen(self.corner_mm))
        object.__setattr__(self, "boxes", frozen(self.boxes, np.bool_))


def find_part(points: Pass, survey: Survey, axis: Axis) -> Keep:
    """Tell the part from stray clusters and from the table plate; one pass over the points."""
    counts, corner, edge = _count_boxes(points, survey.core)
    counts, edge = _coarsen_until_connected(counts, edge)
    plate_top = _find_plate(counts, corner, edge, axis, survey)
    if math.isfinite(plate_top):
        layers = np.arange(counts.shape[axis.column]) + 0.5
        below = corner[axis.column] + layers * edge <= plate_top
        counts = counts * ~np.expand_dims(below, tuple({0, 1, 2} - {axis.column}))
    boxes = _large_clusters(counts)
    for _ in range(3):
        # Rows that stand apart where the rest was scanned densely are part of the part.
        if not boxes.any() or counts[~boxes].sum() <= _MOST_STRAY * counts.sum():
            break
        counts, edge = _halve(counts), 2.0 * edge
        boxes = _large_clusters(counts)
    return Keep(corner, edge, _with_domes(boxes, counts, axis), plate_top)


def _count_boxes(points: Pass, core: Box) -> tuple[IntArray, FloatArray, float]:
    edge = float(core.sides_mm.max()) / _FINEST
    # One empty box all round; a multiple of 8, so that halving the grid thrice is exact.
    shape = [8 * math.ceil((int(side / edge) + 3) / 8) for side in core.sides_mm]
    corner = core.low_mm - edge
    counts = np.zeros(shape, dtype=np.int64)
    for chunk in points():
        _count(np.ascontiguousarray(chunk), corner, 1.0 / edge, counts)
    return counts, corner, edge


@njit(cache=True)
def _count(points: FloatArray, corner: FloatArray, inverse: float, counts: IntArray) -> None:
    nx, ny, nz = counts.shape
    for n in range(len(points)):
        i = math.floor((points[n, 0] - corner[0]) * inverse)
        j = math.floor((points[n, 1] - corner[1]) * inverse)
        k = math.floor((points[n, 2] - corner[2]) * inverse)
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            counts[int(i), int(j), int(k)] += 1


def _coarsen_until_connected(counts: IntArray, edge: float) -> tuple[IntArray, float]:
    for _ in range(3):
        total = counts.sum()
        # Mean over points, not over boxes: the few lonely points must not decide.
        typical = float((counts.astype(float) ** 2).sum() / max(1, total))
        if typical >= _POINTS_A_BOX:
            break
        counts = _halve(counts)
        edge *= 2.0
    return counts, edge


def _halve(counts: IntArray) -> IntArray:
    """The same counts in boxes of twice the edge; an odd side gets an empty box at its end."""
    even = np.pad(counts, [(0, side % 2) for side in counts.shape])
    i, j, k = (side // 2 for side in even.shape)
    return np.asarray(even.reshape(i, 2, j, 2, k, 2).sum(axis=(1, 3, 5)))


def _large_clusters(counts: IntArray) -> BoolArray:
    labels, found = ndimage.label(counts > 0, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(labels.ravel(), weights=counts.ravel(), minlength=found + 1)
    sizes[0] = 0
    large = sizes >= max(2.0, _STRAY_SHARE * sizes.max())
    large[0] = False
    return np.asarray(large[labels])


def _with_domes(boxes: BoolArray, counts: IntArray, axis: Axis) -> BoolArray:
    """Add outlines that lie within those of the layers on one side, and of no layer on the other.

    What lies within outlines on both sides is stray inside of the part.
    """
    if (counts[~boxes] == 0).all():
        return boxes
    kept = np.moveaxis(boxes, axis.column, 0).copy()
    points = np.moveaxis(counts, axis.column, 0)
    for one_way in (slice(None), slice(None, None, -1)):
        part, held = kept[one_way], points[one_way]
        for k in range(1, len(part)):
            apart = (held[k] > 0) & ~part[k]
            if not apart.any():
                continue
            apart &= _enclosed(part[max(k - _BESIDE, 0) : k])
            apart &= ~_enclosed(part[k + 1 : k + 1 + _BESIDE])
            if held[k][apart].sum() >= _FEWEST:
                part[k] |= apart
    return np.asarray(np.moveaxis(kept, 0, axis.column))


def _enclosed(layers: BoolArray) -> BoolArray:
    """What layers (k, i, j) hold or enclose together, (i, j); openings are bridged."""
    held = np.pad(np.asarray(layers.any(axis=0)), _BRIDGED)
    wide = np.asarray(ndimage.binary_dilation(held, iterations=_BRIDGED))
    wide = np.asarray(ndimage.binary_fill_holes(wide))
    narrow = np.asarray(ndimage.binary_erosion(wide, iterations=_BRIDGED))
    return narrow[_BRIDGED:-_BRIDGED, _BRIDGED:-_BRIDGED]


def _find_plate(
    counts: IntArray, corner: FloatArray, edge: float, axis: Axis, survey: Survey
) -> float:
    """Height of the plate's upper side, -inf if the part stands on none."""
    stack = np.moveaxis(counts > 0, axis.column, 0)
    filled = stack.sum(axis=(1, 2))
    layers = np.flatnonzero(filled)
    if len(layers) < 8:
        return -math.inf
    low, zone = layers[0], layers[0] + max(2, int(_PLATE_ZONE * len(layers)))
    thick = low + int(np.argmax(filled[low:zone]))
    above = [k for k in layers if k > thick + 1]
    if len(above) < 4 or filled[thick] < _PLATE_FULL * np.median(filled[above]):
        return -math.inf
    wide = np.max([_extent(stack[k]) for k in above[2:]], axis=0)
    sides = _extent(stack[thick])
    if (sides < _PLATE_OVERHANG * wide).any() or filled[thick] < _PLATE_AREA * sides.prod():
        return -math.inf
    return _upper_side(survey.sample_mm[:, axis.column], corner[axis.column] + thick * edge, edge)


def _extent(layer: BoolArray) -> IntArray:
    rows, columns = np.nonzero(layer)
    return np.array([np.ptp(rows) + 1, np.ptp(columns) + 1])


def _upper_side(heights_mm: FloatArray, layer_mm: float, edge_mm: float) -> float:
    """Where the crowd of heights in and beside a layer ends: its median plus 4 robust sigma."""
    near = heights_mm[np.abs(heights_mm - layer_mm - edge_mm / 2.0) <= 1.5 * edge_mm]
    middle = float(np.median(near))
    spread = 1.4826 * float(np.median(np.abs(near - middle)))
    return middle + max(4.0 * spread, 0.05 * edge_mm)
