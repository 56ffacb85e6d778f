"""An outline: one contour of one slice, with the moments of its points where they truly lie.

The curve lies in the cutting plane; the moments keep the true height of every point, because a
slab that is flattened fattens a sloping wall by its slope times the slab's thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.moments import ArcCells
from reconstruction.slices import Frame

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


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """One contour of one slice."""

    slice_index: int
    frame: Frame  # of the cutting plane
    fitted: FittedCurve  # (x, y) of the frame; loops counter-clockwise, holes clockwise
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
