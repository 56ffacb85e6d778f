"""The fit's result: a NURBS curve that knows how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, frozen
from reconstruction.fitting.moments import ArcCells
from reconstruction.fitting.recognition import Shape
from reconstruction.fitting.smoothing import Fit
from reconstruction.fitting.spline import nurbs_of
from reconstruction.fitting.uncertainty import deviations_along
from reconstruction.nurbs import Curve, curve_derivatives


class Exact(Enum):
    """Whether circles, ellipses, arcs and lines are returned as such."""

    AUTO = "auto"
    NEVER = "never"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FittedCurve:
    """A section with its noise, its uncertainty, its gaps, and the moments it was fitted to."""

    curve: Curve
    kind: str  # "free", "circle", "ellipse", "arc" or "line"
    sigma_mm: float  # of one point across the curve, pooled
    edf: float  # degrees of freedom spent on the shape
    inflation: float  # 1: independent points; k: as good as n / k independent ones
    residual_rms_mm: float  # normal distances of the points used, unreduced
    residual_max_mm: float
    points_used: int
    outliers: int  # of the points given: too far across, not used
    deviations_mm: FloatArray  # (k,), posterior standard deviation across, evenly spaced in u
    gaps: tuple[tuple[float, float], ...]  # in u; start > end: runs across the seam
    creases: tuple[float, ...]  # in u: corners, where the curve is continuous and no more
    ambiguous: bool  # the points cannot tell whether it is closed
    cells: ArcCells
    u: FloatArray  # (m,), where each cell belongs

    def __post_init__(self) -> None:
        object.__setattr__(self, "deviations_mm", frozen(self.deviations_mm))
        object.__setattr__(self, "u", frozen(self.u))

    def __repr__(self) -> str:
        gaps, corners = len(self.gaps), len(self.creases)
        words = [
            f"{self.kind}, {'closed' if self.closed else 'open'}",
            *(["ambiguous"] if self.ambiguous else []),
            f"{len(self.curve.control_points_mm)} control points",
            f"{self.points_used} points, sigma {self.sigma_mm:.3g} mm",
            *([f"{gaps} gap{'s' * (gaps > 1)}"] if gaps else []),
            *([f"{corners} corner{'s' * (corners > 1)}"] if corners else []),
        ]
        return f"<FittedCurve: {', '.join(words)}>"

    def __call__(self, u: ArrayLike) -> FloatArray:
        """Points (m, 2) in mm at parameters (m,), or one point (2,) at a scalar."""
        return self.curve(u)

    @property
    def domain(self) -> tuple[float, float]:
        """The interval of u, (0, 1)."""
        return self.curve.domain

    @property
    def closed(self) -> bool:
        """Whether it runs back into its start."""
        return self.curve.closed

    @property
    def gap_intervals(self) -> tuple[tuple[float, float], ...]:
        """The gaps in order; one that runs across the seam ends beyond the domain."""
        start, end = self.domain
        turned = [(a, b if a < b else b + end - start) for a, b in self.gaps if a != b]
        return tuple(sorted(turned))

    def deviation_mm(self, u: ArrayLike) -> FloatArray:
        """Posterior standard deviation across the curve; (m,) -> (m,). 1.96 of it is the band."""
        start, end = self.domain
        at = np.asarray(u, dtype=np.float64)
        if self.closed:
            at = start + np.mod(at - start, end - start)
        grid = np.linspace(start, end, len(self.deviations_mm))
        return np.asarray(np.interp(at, grid, self.deviations_mm))

    def covariance(self, u: ArrayLike) -> FloatArray:
        """Posterior covariance in mm2: across the curve only, as along it is gauge.

        (m, 2, 2) at parameters (m,), or (2, 2) at a scalar.
        """
        normals = self.normals(u)
        products = normals[..., :, None] * normals[..., None, :]
        return np.asarray(self.deviation_mm(u)[..., None, None] ** 2 * products)

    def normals(self, u: ArrayLike) -> FloatArray:
        """Unit left normals (m, 2), or one (2,) at a scalar."""
        tangents = curve_derivatives(self.curve, np.atleast_1d(np.asarray(u, float)), 1)[1]
        lengths = np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-300)
        normals = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1) / lengths
        return np.asarray(normals[0] if np.ndim(u) == 0 else normals)

    def curvature(self, u: ArrayLike) -> FloatArray:
        """Curvature in 1/mm, (m,) -> (m,), positive to the left; its inverse is the local radius.

        Of a free curve it is as smooth as the noise allows, and no less certain than it looks only
        where the band is narrow beside the radius.
        """
        _, first, second = curve_derivatives(self.curve, np.atleast_1d(np.asarray(u, float)), 2)
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        bends = cross / np.maximum(np.linalg.norm(first, axis=1) ** 3, 1e-300)
        return np.asarray(bends[0] if np.ndim(u) == 0 else bends)


def finished(
    fit: Fit,
    cells: ArcCells,
    shape: Shape | None,
    gap_ends_mm: FloatArray,
    far: int,
    *,
    ambiguous: bool,
) -> FittedCurve:
    """Put a fit and what was recognised in it into the value that is handed out.

    Parameters
    ----------
    gap_ends_mm
        (k, 2, 2): the places between which nothing was measured.
    far
        How many points lay too far off to be in the cells.
    """
    curve = nurbs_of(fit.control_mm, closed=fit.closed) if shape is None else shape.curve
    distances = fit.distances_mm if shape is None else shape.distances_mm
    scatters = fit.scatters_mm2 if shape is None else shape.scatters_mm2
    noise = fit.noise if shape is None or shape.noise is None else shape.noise
    held = cells.counts * (fit.weights > 0)
    square = float((held * (distances**2 + scatters)).sum())
    u = fit.t / fit.spans if shape is None else shape.u
    return FittedCurve(
        curve=curve,
        kind="free" if shape is None else shape.kind,
        sigma_mm=float(np.sqrt(noise.variance_mm2)),
        edf=fit.edf if shape is None else float(shape.freedom),
        inflation=noise.inflation,
        residual_rms_mm=float(np.sqrt(square / max(held.sum(), 1.0))),
        residual_max_mm=_farthest(curve, u[held > 0], cells.extremes_mm[held > 0]),
        points_used=round(float(held.sum())),
        outliers=far + round(float((cells.counts * (fit.weights <= 0)).sum())),
        deviations_mm=deviations_along(fit) if shape is None else shape.deviations_mm,
        gaps=_gaps(curve, gap_ends_mm),
        creases=() if shape is None else shape.creases,
        ambiguous=ambiguous,
        cells=cells,
        u=u,
    )


def _farthest(curve: Curve, u: FloatArray, extremes: FloatArray) -> float:
    """Largest normal distance: that of an extreme point from the curve beside its cell."""
    if not len(u):
        return 0.0
    places, tangents = curve_derivatives(curve, u, 1)
    arms = extremes - places[:, None, :]
    lengths = np.maximum(np.linalg.norm(tangents, axis=1), 1e-300)
    across = arms[:, :, 1] * tangents[:, None, 0] - arms[:, :, 0] * tangents[:, None, 1]
    return float(np.abs(across / lengths[:, None]).max())


def _gaps(curve: Curve, ends_mm: FloatArray) -> tuple[tuple[float, float], ...]:
    """The stretches between the two ends of each gap, in u."""
    if not len(ends_mm):
        return ()
    grid = np.linspace(*curve.domain, 2049)
    places = curve(grid)
    return tuple((_nearest(grid, places, a), _nearest(grid, places, b)) for a, b in ends_mm)


def _nearest(grid: FloatArray, places: FloatArray, node: FloatArray) -> float:
    return float(grid[np.argmin(((places - node) ** 2).sum(axis=1))])
