"""`--method fit`, slice by slice: contours fitted to the raw points, and how far those lie off.

slice -> outlines (`skinning.drawing`) -> a section that says what it stands for, and how well
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.distances import distances_to_nearest
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.cells import bounds
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.sections import Residual, SectionCurve, lift_curve, measure_residual
from reconstruction.skinning.drawing import SliceOutlines, draw_outlines
from reconstruction.slices import Frame, Slice

_STEPS_A_SPAN = 8  # of the polygon that stands for a curve when residuals are measured ...
_LEAST_STEPS = 720  # ... and on an exact circle, which has few control points
LEFT_OUT_SIGMAS = 6.0  # farther than this many standard deviations a point belongs elsewhere
_EXACT = 1e-7  # of a slice's size: scatter below it is none
_LEFT_OUT_DRAWN = 2_000
_RESIDUAL_RANGE_MM = 5.0  # of the histogram


@dataclass(frozen=True, slots=True, eq=False)
class FittedSection:
    """One slice's contours as NURBS curves, with their residual."""

    index: int
    points: int  # measured points of the slice
    outlines: SliceOutlines
    length_mm: float  # of all curves
    gap_mm: float  # of it inside gaps
    residual: Residual  # of the points that the curves stand for
    residual_all: Residual  # of every point of the slice, those left out too
    left_out_mm: FloatArray  # (k, 3) a bounded sample of points farther away than that
    left_out: int  # how many those are

    def __post_init__(self) -> None:
        object.__setattr__(self, "left_out_mm", frozen(self.left_out_mm))

    @property
    def frame(self) -> Frame:
        """The cutting plane."""
        return self.outlines.frame

    @property
    def height_mm(self) -> float:
        """Of the cutting plane along its normal."""
        return self.outlines.height_mm

    @property
    def fitted(self) -> tuple[FittedCurve, ...]:
        """Loops by area, then open runs by length, in the plane."""
        drawn = (*self.outlines.outlines, *self.outlines.runs)
        return tuple(each.fitted for each in drawn)

    @property
    def curves(self) -> tuple[SectionCurve, ...]:
        """The same in the part frame, with what each stands for."""
        return tuple(
            SectionCurve(
                curve=lift_curve(each.curve, self.frame),
                gaps=each.gap_intervals,
                residual_rms_mm=each.residual_rms_mm,
                residual_max_mm=each.residual_max_mm,
                points=each.points_used,
            )
            for each in self.fitted
        )

    @property
    def closed(self) -> bool:
        """Whether any contour is a loop."""
        return bool(self.outlines.outlines)

    @property
    def width_mm(self) -> float:
        """Thickness of the cloud, 4 sigma, pooled over the curves by their points."""
        return 4.0 * _sigma_mm(self.fitted)

    @property
    def radius_mm(self) -> float:
        """Median radius of curvature over the curves; inf on straight ones."""
        grid = np.linspace(0.0, 1.0, 64, endpoint=False)
        bends = [np.abs(each.curvature(grid)) for each in self.fitted]
        middle = float(np.median(np.concatenate(bends)))
        return 1.0 / middle if middle > 0.0 else float("inf")


def draw_fitted_section(
    piece: Slice, *, exact: Exact = Exact.AUTO, solid: bool = True
) -> tuple[SliceOutlines, FittedSection | None]:
    """Fit the contours of a slice.

    Parameters
    ----------
    solid
        The slice is one all through a solid: what may be closed or open is closed.

    Returns
    -------
    outlines, section
        Without any curve there is no section; `explain_nothing` says why.
    """
    drawn = draw_outlines(piece, exact=exact, solid=solid)
    fitted = tuple(each.fitted for each in (*drawn.outlines, *drawn.runs))
    if not fitted:
        return drawn, None
    planar = np.ascontiguousarray(piece.frame.to_plane(piece.points_mm)[:, :2])
    distances = _distances(planar, fitted)
    low, high = bounds(planar)
    size_mm = float((high - low).max())
    far = np.abs(distances) > LEFT_OUT_SIGMAS * max(_sigma_mm(fitted), _EXACT * size_mm)
    every = measure_residual(distances, range_mm=_RESIDUAL_RANGE_MM)
    near = measure_residual(distances[~far], range_mm=_RESIDUAL_RANGE_MM) if far.any() else every
    section = FittedSection(
        index=piece.index,
        points=len(piece.points_mm),
        outlines=drawn,
        length_mm=sum(_length_mm(each, *each.domain) for each in fitted),
        gap_mm=sum(_length_mm(each, *gap) for each in fitted for gap in each.gap_intervals),
        residual=near,
        residual_all=every,
        left_out_mm=piece.points_mm[far][:_LEFT_OUT_DRAWN],
        left_out=int(far.sum()),
    )
    return drawn, section


def explain_nothing(drawn: SliceOutlines, points: int) -> TooFewPoints:
    """Why a slice of so many points became no section."""
    why = "; ".join(drawn.notes) or f"no curve in {points} points: {drawn.unordered} unordered"
    return TooFewPoints(why)


def _sigma_mm(fitted: tuple[FittedCurve, ...]) -> float:
    points = np.array([each.points_used for each in fitted], dtype=np.float64)
    variances = np.array([each.sigma_mm**2 for each in fitted])
    return float(np.sqrt(points @ variances / max(points.sum(), 1.0)))


def _distances(planar_mm: FloatArray, fitted: tuple[FittedCurve, ...]) -> FloatArray:
    """Signed distance of every point (n, 2) to the nearest curve, negative on its left.

    Loops run counter-clockwise and holes clockwise, so that inside the material is negative.
    """
    polygons = []
    for each in fitted:
        steps = max(_LEAST_STEPS, _STEPS_A_SPAN * len(each.curve.control_points_mm))
        polygon = each(np.linspace(*each.domain, steps, endpoint=not each.closed))
        polygons.append((polygon, each.closed))
    return distances_to_nearest(planar_mm, polygons)


def _length_mm(curve: FittedCurve, start: float, end: float) -> float:
    steps = _STEPS_A_SPAN * len(curve.curve.control_points_mm) + 1
    u, (first, last) = np.linspace(start, end, steps), curve.domain
    places = curve(first + np.mod(u - first, last - first) if end > last else u)
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())
