"""The paper's Fig. 6 as an experiment: one band of points, many seeds, four cell sizes, two walks.

The circle is exact and known here, so everything is measured against it, never against what the
reconstruction says of itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import Curve, clamped_uniform, evaluate_curve, periodic_uniform
from reconstruction.ordering import Contour, Walk, walk_contour
from reconstruction.reduction import Cells, reduce_points

RADIUS_MM = 50.0
WIDTH_MM = 2.0
POINTS_A_MM = 40.0
SEEDS = range(50)
COARSE_MM = 4.0  # the paper's right resolution, Fig. 6b
FINE_MM = 0.8  # its wrong one, Fig. 6a
CELLS_MM = (FINE_MM, 2.0, COARSE_MM, 8.0)
_STEPS_A_SPAN = 32


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One cloud, reduced and walked; the curve has the walk's centres of mass as control points."""

    points_mm: FloatArray  # (n, 3)
    corner_mm: FloatArray  # (3,) of the random grid
    cells: Cells
    contour: Contour
    curve: Curve  # periodic where the walk closed, else clamped

    @property
    def polyline_mm(self) -> FloatArray:
        """The curve, finely, (k, 2)."""
        start, end = self.curve.domain
        steps = _STEPS_A_SPAN * len(self.curve.control_points_mm)
        return evaluate_curve(self.curve, np.linspace(start, end, steps + 1))

    @property
    def deviations_mm(self) -> FloatArray:
        """Signed distance of the curve from the true circle, outwards positive, (k,)."""
        return np.asarray(np.linalg.norm(self.polyline_mm[:-1], axis=1) - RADIUS_MM)

    @property
    def turning_rad(self) -> float:
        """Total absolute turning of the curve's tangent; 2 pi for any convex closed curve."""
        return total_turning(self.polyline_mm)

    @property
    def swept_rad(self) -> float:
        """The angle about the circle's centre that the curve covers."""
        return float(np.ptp(np.unwrap(np.arctan2(*self.polyline_mm.T[::-1]))))

    @property
    def is_ring(self) -> bool:
        """Whether the walk closed after one full turn about the circle's centre.

        About the circle's centre, not its own: a curl of five cells goes once round itself too.
        """
        return self.contour.closed and abs(winding(self.contour.points_mm)) == 1


def total_turning(polyline_mm: FloatArray) -> float:
    """Sum of the absolute turns at the corners of a fine polyline (k, 2), in rad."""
    steps = np.diff(polyline_mm, axis=0)
    before, after = steps[:-1], steps[1:]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return float(np.abs(np.arctan2(cross, (before * after).sum(axis=1))).sum())


def winding(polygon_mm: FloatArray) -> int:
    """How often a closed polygon (m, 2) goes round the origin, counter-clockwise positive."""
    rays = polygon_mm[:, 0] + 1j * polygon_mm[:, 1]
    return round(float(np.angle(np.roll(rays, -1) / rays).sum() / math.tau))


def make_band(rng: np.random.Generator, *, points_a_mm: float = POINTS_A_MM) -> FloatArray:
    """Points of a ring, uniform in angle and in radius over the band's width, (n, 3)."""
    count = round(points_a_mm * math.tau * RADIUS_MM)
    angle = rng.uniform(0.0, math.tau, count)
    radius = rng.uniform(RADIUS_MM - WIDTH_MM / 2, RADIUS_MM + WIDTH_MM / 2, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(count)])


def run_trial(seed: int, cell_mm: float, walk: Walk, *, points_a_mm: float = POINTS_A_MM) -> Trial:
    """Reduce and walk the cloud of a seed on a grid whose offset is the seed's, too."""
    rng = np.random.default_rng(seed)
    points = make_band(rng, points_a_mm=points_a_mm)
    corner = np.append(rng.uniform(0.0, cell_mm, 2), 0.0)
    cells = reduce_points(points, size_mm=(cell_mm, cell_mm, math.inf), origin_mm=corner)
    contour = walk_contour(cells, walk=walk)
    through = periodic_uniform if contour.closed else clamped_uniform
    return Trial(points, corner, cells, contour, through(contour.points_mm))


@dataclass(frozen=True, slots=True)
class Row:
    """What all seeds of one cell size and one walk gave."""

    cell_mm: float
    walk: Walk
    seeds: int
    rings: int  # closed after one full turn
    curls: int  # closed, but not round the circle
    centres: float  # mean count on the contour, rings only, as the next three
    bias_mm: float  # mean deviation from the true circle
    rms_mm: float  # over all curves together
    worst_rms_mm: float  # of the worst curve
    ring_turning_rad: float  # median over the rings; nan without any
    waviness: float  # turning over angle swept, all seeds together; 1 for a circle
    least_waviness: float  # of one seed
    most_waviness: float
    bridges: float  # gaps that a walk crossed, mean over all seeds


def study_walks() -> list[Row]:
    """Every cell size with both walks."""
    return [study(cell_mm, walk) for walk in Walk for cell_mm in CELLS_MM]


def study(cell_mm: float, walk: Walk) -> Row:
    """All seeds of one cell size and one walk."""
    trials = [run_trial(seed, cell_mm, walk) for seed in SEEDS]
    rings = [trial for trial in trials if trial.is_ring]
    deviations = [trial.deviations_mm for trial in rings]
    rms = [math.sqrt(float((each**2).mean())) for each in deviations]
    turning = np.array([trial.turning_rad for trial in trials])
    swept = np.array([trial.swept_rad for trial in trials])
    return Row(
        cell_mm=cell_mm,
        walk=walk,
        seeds=len(trials),
        rings=len(rings),
        curls=sum(trial.contour.closed for trial in trials) - len(rings),
        centres=_mean(len(trial.contour.points_mm) for trial in rings),
        bias_mm=_mean(each.mean() for each in deviations),
        rms_mm=math.sqrt(_mean(each**2 for each in rms)),
        worst_rms_mm=max(rms, default=math.nan),
        ring_turning_rad=float(np.median([trial.turning_rad for trial in rings] or [math.nan])),
        waviness=float(turning.sum() / swept.sum()),
        least_waviness=float((turning / swept).min()),
        most_waviness=float((turning / swept).max()),
        bridges=_mean(_bridges(trial.contour) for trial in trials),
    )


def _bridges(contour: Contour) -> int:
    """Gaps crossed; the last segment of an open walk is none, nothing was crossed there."""
    return int(contour.bridged.sum()) - (not contour.closed)


def _mean(values: Iterable[float]) -> float:
    listed = [float(value) for value in values]
    return float(np.mean(listed)) if listed else math.nan
