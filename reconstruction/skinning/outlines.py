"""An outline: one contour of one slice, with the moments of its points where they truly lie.

The curve lies in the cutting plane; the moments keep the true height of every point, because a
slab that is flattened fattens a sloping wall by its slope times the slab's thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.moments import ArcCells
from reconstruction.slices import Frame

_CELLS_A_FREEDOM = 12.0  # of the curve
_LEAST_CELLS = 100
_OUTLYING = 4.0  # standard deviations
_PLANE = ((0, 0, 0), (1, 0, 1), (2, 1, 1))  # of (m, 3) planar covariances: column, row, column
_RISE = ((0, 0, 2), (1, 1, 2), (2, 2, 2))  # of (m, 3) covariances with the height


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Points gathered in cells, in the part frame."""

    counts: FloatArray  # (m,), positive
    means_mm: FloatArray  # (m, 3)
    covariances_mm2: FloatArray  # (m, 3, 3), about the mean

    def __post_init__(self) -> None:
        for name in self.__slots__:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def total(self) -> int:
        """How many points the cells hold."""
        return round(float(self.counts.sum()))

    def merged(self, groups: IntArray, count: int) -> Moments:
        """Cells of equal group (m,) as one, exactly; groups without a cell are left out."""
        counts = np.asarray(np.bincount(groups, self.counts, count), dtype=np.float64)
        used = counts > 0.0
        shares = self.counts / np.maximum(counts[groups], 1e-300)
        means = _sums(groups, shares[:, None] * self.means_mm, count)
        arms = self.means_mm - means[groups]
        spread = self.covariances_mm2 + arms[:, :, None] * arms[:, None, :]
        spread = _sums(groups, shares[:, None] * spread.reshape(-1, 9), count)
        return Moments(counts[used], means[used], spread[used].reshape(-1, 3, 3))

    @staticmethod
    def together(parts: Sequence[Moments]) -> Moments:
        """All cells of several, or of none."""
        if not parts:
            return Moments(np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3)))
        columns = [
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("counts", "means_mm", "covariances_mm2")
        ]
        return Moments(*columns)


def _sums(groups: IntArray, values: FloatArray, count: int) -> FloatArray:
    return np.stack([np.bincount(groups, column, count) for column in values.T], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """One contour of one slice."""

    slice_index: int
    frame: Frame  # of the cutting plane
    fitted: FittedCurve  # (x, y) of the frame; of its cells only those of single points are kept
    hole: bool  # material lies outside of it
    moments: Moments
    u: FloatArray  # (m,), where on the curve each cell belongs

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", frozen(self.u))

    @property
    def height_mm(self) -> float:
        """Of the cutting plane along its normal."""
        return float(self.frame.origin_mm @ self.frame.axes[2])

    def polygon_mm(self, count: int) -> FloatArray:
        """Points (count, 2) of the curve in the plane, evenly in its parameter."""
        start, end = self.fitted.domain
        return self.fitted(np.linspace(start, end, count, endpoint=not self.fitted.closed))


def outline_of(slice_index: int, frame: Frame, fitted: FittedCurve, *, hole: bool) -> Outline:
    """What a surface needs of a fitted curve: cells no finer than it can follow, outliers out."""
    cells, u = fitted.cells, fitted.u
    near = np.flatnonzero(_deviations(fitted) <= _OUTLYING)
    moments = lifted(cells.only(near), frame)
    most = int(_CELLS_A_FREEDOM * fitted.edf) + _LEAST_CELLS
    kept = _with_single_points(fitted)
    if len(near) <= most:
        return Outline(slice_index, frame, kept, hole, moments, u[near])
    start, end = fitted.domain
    groups = np.clip(((u[near] - start) / (end - start) * most).astype(np.int64), 0, most - 1)
    used = np.flatnonzero(np.bincount(groups, minlength=most))
    held = np.bincount(groups, cells.counts[near] * u[near], most)[used]
    merged = moments.merged(groups, most)
    return Outline(slice_index, frame, kept, hole, merged, held / merged.counts)


def _with_single_points(fitted: FittedCurve) -> FittedCurve:
    """The curve without its cells of many points: the outline has them, and a scan is long."""
    single = np.flatnonzero(fitted.cells.counts == 1.0)
    return replace(fitted, cells=fitted.cells.only(single), u=fitted.u[single])


def _deviations(fitted: FittedCurve) -> FloatArray:
    """How far single points lie from the curve, in standard deviations; cells of many do not."""
    arms = fitted.cells.means_mm - fitted(fitted.u)
    across = np.abs((arms * fitted.normals(fitted.u)).sum(axis=1))
    alone = fitted.cells.counts == 1.0
    return np.where(alone, across / max(fitted.sigma_mm, 1e-300), 0.0)


def lifted(cells: ArcCells, frame: Frame) -> Moments:
    """Cells of a cutting plane to moments in the part frame; without heights, in the plane."""
    count = len(cells)
    means, spread = np.zeros((count, 3)), np.zeros((count, 3, 3))
    means[:, :2] = cells.means_mm
    for column, i, j in _PLANE:
        spread[:, i, j] = spread[:, j, i] = cells.covariances_mm2[:, column]
    if len(cells.heights_mm):
        means[:, 2] = cells.heights_mm
        for column, i, j in _RISE:
            spread[:, i, j] = spread[:, j, i] = cells.height_covariances_mm2[:, column]
    turned = np.einsum("ia,mij,jb->mab", frame.axes, spread, frame.axes)
    return Moments(cells.counts, frame.to_part(means), turned)
