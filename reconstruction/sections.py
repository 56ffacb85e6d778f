"""A section: what one slice has become, and how well it stands for its points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.nurbs import Curve
from reconstruction.ordering import Contour
from reconstruction.resolution import Resolution
from reconstruction.slices import Frame
from reconstruction.thickness import Thickness

_BINS = 2001  # fine, because the range that will matter is not known beforehand


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """Signed distances of unreduced points to what represents them; sums, so that they add up."""

    count: int
    total_mm: float
    squares_mm2: float
    max_mm: float
    edges_mm: FloatArray  # (b + 1,) the outer bins hold everything beyond
    bins: IntArray  # (b,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "edges_mm", frozen(self.edges_mm))
        object.__setattr__(self, "bins", frozen(self.bins, np.int64))

    @property
    def rms_mm(self) -> float:
        """Root mean square; nan without points."""
        return math.sqrt(self.squares_mm2 / self.count) if self.count else math.nan

    @property
    def mean_mm(self) -> float:
        """Mean signed distance, positive outside; nan without points."""
        return self.total_mm / self.count if self.count else math.nan

    def plus(self, other: Residual) -> Residual:
        """Both together; their bins must be the same."""
        if not np.array_equal(self.edges_mm, other.edges_mm):
            raise ValueError("residuals with different bins do not add up")
        return Residual(
            self.count + other.count,
            self.total_mm + other.total_mm,
            self.squares_mm2 + other.squares_mm2,
            max(self.max_mm, other.max_mm),
            self.edges_mm,
            self.bins + other.bins,
        )


def measure_residual(distances_mm: FloatArray, *, range_mm: float) -> Residual:
    """Sum up signed distances (n,); the histogram spans -range to range in 2001 bins."""
    edges, bins = _edges(range_mm), np.zeros(_BINS, np.int64)
    total, squares, most = _sum_up(distances_mm, edges, bins)
    return Residual(len(distances_mm), total, squares, most, edges, bins)


@njit(cache=True, nogil=True)
def _sum_up(values: FloatArray, edges: FloatArray, bins: IntArray) -> tuple[float, float, float]:
    """Sum, sum of squares and largest size of values, which are counted in even bins."""
    last = len(bins) - 1
    low, high = edges[0], edges[last + 1]
    scale = len(bins) / (high - low)
    total = squares = most = 0.0
    for value in values:
        total += value
        squares += value * value
        most = max(most, abs(value))
        inside = min(max(value, low), high)
        at = min(int((inside - low) * scale), last)
        while at > 0 and inside < edges[at]:  # rounding, at an edge
            at -= 1
        while at < last and inside >= edges[at + 1]:
            at += 1
        bins[at] += 1
    return total, squares, most


@lru_cache(maxsize=8)
def _edges(range_mm: float) -> FloatArray:
    """Of the histograms of all sections, once."""
    return frozen(np.linspace(-range_mm, range_mm, _BINS + 1))


@dataclass(frozen=True, slots=True, eq=False)
class SectionCurve:
    """One curve of a section as it is handed over, and what it stands for."""

    curve: Curve  # 3D, in the part frame
    gaps: tuple[tuple[float, float], ...]  # as in `exporting.SectionRecord`
    residual_rms_mm: float
    residual_max_mm: float
    points: int  # that the residuals are of


def lift_curve(curve: Curve, frame: Frame) -> Curve:
    """Turn a curve in a cutting plane into one in the part frame."""
    points = frame.to_part(curve.control_points_mm)
    return Curve(curve.degree, curve.knots, points, curve.weights, curve.periodic)


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """One slice's contour as a closed NURBS curve, with its knot points and its residual."""

    index: int
    frame: Frame  # the plane of the section
    height_mm: float  # of the section's middle, along the stacking axis
    points: int  # measured points of the slice
    thickness: Thickness
    resolution: Resolution
    contour: Contour
    curve: Curve  # periodic, 3D, in the part frame
    knot_points_mm: FloatArray  # (n, 3) on the curve at its knots, counter-clockwise
    synthetic: BoolArray  # (n,) knot points inside a bridged gap
    gaps: tuple[tuple[float, float], ...]  # intervals of the curve's parameter that are synthetic
    length_mm: float
    gap_mm: float  # length of the curve inside gaps
    base: bool  # this section set the count of control points
    residual: Residual  # of the points that the curve stands for
    residual_all: Residual  # of every point of the slice, those left out too
    left_out_mm: FloatArray  # (k, 3) a bounded sample of points farther away than that
    left_out: int  # how many those are

    def __post_init__(self) -> None:
        object.__setattr__(self, "knot_points_mm", frozen(self.knot_points_mm))
        object.__setattr__(self, "synthetic", frozen(self.synthetic, np.bool_))
        object.__setattr__(self, "left_out_mm", frozen(self.left_out_mm))

    @property
    def curves(self) -> tuple[SectionCurve, ...]:
        """Its one curve, with what it stands for."""
        near = self.residual
        return (SectionCurve(self.curve, self.gaps, near.rms_mm, near.max_mm, near.count),)

    @property
    def closed(self) -> bool:
        """Whether the contour was closed without being bridged."""
        return self.contour.closed

    @property
    def width_mm(self) -> float:
        """Thickness of the cloud, 4 sigma."""
        return self.thickness.width_mm

    @property
    def radius_mm(self) -> float:
        """Local radius of curvature."""
        return self.thickness.radius_mm


@dataclass(frozen=True, slots=True)
class Skipped:
    """A slice that became no section, and why."""

    index: int
    points: int
    reason: str
