"""The paper's two solids, badly acquired on purpose, and what the method makes of them.

Both are exact here; the clouds come from formulas and seeds, and every error is measured against
the formula. Axis z, lengths in mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.cleanup import CleanupSettings
from reconstruction.ordering import Contour, Walk
from reconstruction.paper import PaperSettings, PlaneRule, draw_contour, lay_plane
from reconstruction.pipeline import Reconstruction, reconstruct_paper
from reconstruction.sections import Section
from reconstruction.slices import Slice
from reconstruction.slicing import Cutting, cut_cloud
from reconstruction.survey import Axis

RADIUS_MM = 50.0
HEIGHT_MM = 100.0
WIDTH_MM = 2.0
CYLINDER_SLICES = 5
CYLINDER_STEP_MM = HEIGHT_MM / (CYLINDER_SLICES - 1)
CONE_STEP_MM = 5.0
_CYLINDER_SEED, _CONE_SEED = 7, 11
_POINTS_A_MM = 8.0
_HOLES = 6
_HOLE_DEG = (6.0, 32.0)
_TILT_DEG = 1.0
_HEIGHT_NOISE_MM = 0.5
_LEVEL_NOISE_MM = 0.3
_STEPS_A_SPAN = 16
_PULL = 2.0  # knots: a control point of a cubic reaches this far to either side
_SMOOTH_ROWS = 4  # intermediate sections of the renderings


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A cloud and what became of it, plain and with intermediate sections."""

    cloud_mm: FloatArray
    cutting: Cutting
    plain: Reconstruction
    smooth: Reconstruction


@dataclass(frozen=True, slots=True)
class Deviation:
    """Radial deviation of a curve from the true solid, outwards positive."""

    mean_mm: float
    rms_mm: float
    max_mm: float  # absolute


def deviation_of(errors_mm: FloatArray) -> Deviation:
    """Sum up errors (n,); nan without any."""
    if len(errors_mm) == 0:
        return Deviation(math.nan, math.nan, math.nan)
    rms = math.sqrt(float((errors_mm**2).mean()))
    return Deviation(float(errors_mm.mean()), rms, float(np.abs(errors_mm).max()))


def sample_section(section: Section) -> tuple[FloatArray, BoolArray, BoolArray]:
    """The section's curve, finely, (k, 3); what lies in a bridged gap, (k,); what beside one, (k,).

    Beside: within two knots of a gap, where control points from its other side still pull.
    """
    start, end = section.curve.domain
    count = len(section.curve.control_points_mm)
    u = np.linspace(start, end, _STEPS_A_SPAN * count, endpoint=False)
    inside, near = np.zeros((2, len(u)), dtype=np.bool_)
    for first, last in section.gaps:
        inside |= (u - first) % count < last - first
        near |= (u - first + _PULL) % count < last - first + 2 * _PULL
    return np.asarray(section.curve(u)), inside, near & ~inside


def reconstruct(cloud_mm: FloatArray, settings: PaperSettings, *, step_mm: float) -> Made:
    """Slice an unorganised cloud and run the paper's method over it."""
    cutting = cut_cloud(lambda: [cloud_mm], Axis.Z, spacing_mm=step_mm)
    plain = _finish(cutting, settings)
    soft = PaperSettings(plane=settings.plane, intermediate=_SMOOTH_ROWS)
    return Made(cloud_mm, cutting, plain, _finish(cutting, soft))


def _finish(cutting: Cutting, settings: PaperSettings) -> Reconstruction:
    *_, done = reconstruct_paper(cutting.slices(), settings, CleanupSettings())
    assert isinstance(done, Reconstruction)
    return done


# -- the cylinder of Figs. 7 and 8 ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Acquisition:
    """How one slice of the cylinder was taken."""

    tilt: tuple[float, float]  # rise in z over x and over y
    holes_rad: tuple[tuple[float, float], ...]  # middle and width of each region without points

    def sees(self, angle_rad: FloatArray) -> BoolArray:
        """Which angles (n,) lie in no hole."""
        seen = np.ones(len(angle_rad), dtype=np.bool_)
        for middle, width in self.holes_rad:
            away = np.abs((angle_rad - middle + math.pi) % math.tau - math.pi)
            seen &= away > width / 2
        return seen


def plan_cylinder() -> list[Acquisition]:
    """The five slices: tilted by up to a degree about x and y, six holes each."""
    rng = np.random.default_rng(_CYLINDER_SEED)
    plans = []
    for _ in range(CYLINDER_SLICES):
        tilt = np.tan(np.radians(rng.uniform(-_TILT_DEG, _TILT_DEG, 2)))
        middles = rng.uniform(0.0, math.tau, _HOLES)
        widths = np.radians(rng.uniform(*_HOLE_DEG, _HOLES))
        holes = tuple(zip(middles.tolist(), widths.tolist(), strict=True))
        plans.append(Acquisition((float(tilt[0]), float(tilt[1])), holes))
    return plans


def make_cylinder() -> FloatArray:
    """The badly acquired cylinder: five noisy bands with many empty regions, in no order."""
    rng = np.random.default_rng(_CYLINDER_SEED + 1)
    pieces = []
    for number, plan in enumerate(plan_cylinder()):
        angle = rng.uniform(0.0, math.tau, round(_POINTS_A_MM * math.tau * RADIUS_MM))
        angle = angle[plan.sees(angle)]
        radius = RADIUS_MM + rng.uniform(-WIDTH_MM / 2, WIDTH_MM / 2, len(angle))
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        rise = plan.tilt[0] * x + plan.tilt[1] * y
        z = number * CYLINDER_STEP_MM + rise + rng.normal(0.0, _HEIGHT_NOISE_MM, len(angle))
        pieces.append(np.column_stack([x, y, z]))
    return rng.permutation(np.concatenate(pieces))


def reconstruct_cylinder() -> Made:
    """Slice by slice as in the paper: the plane of each slice by least squares."""
    settings = PaperSettings(plane=PlaneRule.TILTED)
    return reconstruct(make_cylinder(), settings, step_mm=CYLINDER_STEP_MM)


@dataclass(frozen=True, slots=True, eq=False)
class CylinderRow:
    """One slice of the cylinder."""

    section: Section
    empty: float  # share of the circumference without points, as it was made
    widest_deg: float  # empty stretch
    tilt_error_deg: float
    measured: Deviation  # of the curve where there were points
    beside: Deviation  # there, too, but within two knots of a gap
    bridged: Deviation  # of the curve inside gaps
    pure: Contour  # what the 3 x 3 walk makes of the same slice


def tabulate_cylinder(made: Made) -> list[CylinderRow]:
    """Measure every section against the true cylinder."""
    rows = []
    pieces = list(made.cutting.slices())
    plans = plan_cylinder()
    for section in made.plain.sections:
        plan = plans[section.index]
        points, inside, beside = sample_section(section)
        errors = np.hypot(points[:, 0], points[:, 1]) - RADIUS_MM
        empty, widest = _emptiness(plan)
        row = CylinderRow(
            section=section,
            empty=empty,
            widest_deg=widest,
            tilt_error_deg=_tilt_error_deg(section, plan),
            measured=deviation_of(errors[~inside & ~beside]),
            beside=deviation_of(errors[beside]),
            bridged=deviation_of(errors[inside]),
            pure=_walk_pure(pieces[section.index]),
        )
        rows.append(row)
    return rows


def _walk_pure(piece: Slice) -> Contour:
    _, planar = lay_plane(piece, PlaneRule.TILTED)
    return draw_contour(planar, PaperSettings(walk=Walk.PURE))[2]


def _emptiness(plan: Acquisition) -> tuple[float, float]:
    """Share of the circumference that is hidden, and its widest stretch in degrees."""
    hidden = ~plan.sees(np.radians(np.arange(0.0, 360.0, 0.05)))
    edges = np.flatnonzero(np.diff(np.concatenate([hidden, hidden]).astype(int)))
    runs = np.diff(edges)[0 if not hidden[edges[0]] else 1 :: 2]
    return float(hidden.mean()), float(runs.max() * 0.05)


def _tilt_error_deg(section: Section, plan: Acquisition) -> float:
    true = np.array([-plan.tilt[0], -plan.tilt[1], 1.0])
    cosine = float(section.frame.axes[2] @ true / np.linalg.norm(true))
    return math.degrees(math.acos(min(1.0, cosine)))


def cylinder_volume_mm3() -> float:
    """Between the two end planes, tilted or not: the axis is cut at its ends."""
    return math.pi * RADIUS_MM**2 * HEIGHT_MM


# -- the cone of Figs. 9 to 11 -------------------------------------------------------------------


def make_cone() -> FloatArray:
    """Irregular points in bands 5 mm apart, up to the apex, sparse on two sides; in no order."""
    rng = np.random.default_rng(_CONE_SEED)
    pieces = []
    for height in np.arange(0.0, HEIGHT_MM + 1e-9, CONE_STEP_MM):
        radius = cone_radius_mm(np.array([height]))[0]
        angle = rng.uniform(0.0, math.tau, max(24, round(_POINTS_A_MM * math.tau * radius)))
        # A density that wanders: on two sides a third of the points of the two others.
        likely = 0.675 + 0.325 * np.cos(2.0 * angle + rng.uniform(0.0, math.tau))
        angle = angle[rng.random(len(angle)) < likely]
        radii = radius + rng.uniform(-WIDTH_MM / 2, WIDTH_MM / 2, len(angle))
        z = height + rng.normal(0.0, _LEVEL_NOISE_MM, len(angle))
        pieces.append(np.column_stack([radii * np.cos(angle), radii * np.sin(angle), z]))
    return rng.permutation(np.concatenate(pieces))


def make_scattered_cone(count: int) -> FloatArray:
    """The same cone without any slices in its cloud: points all over its side."""
    rng = np.random.default_rng(_CONE_SEED + 1)
    height = HEIGHT_MM * (1.0 - np.sqrt(rng.random(count)))
    angle = rng.uniform(0.0, math.tau, count)
    radius = cone_radius_mm(height) + rng.uniform(-WIDTH_MM / 2, WIDTH_MM / 2, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def cone_radius_mm(height_mm: FloatArray) -> FloatArray:
    """Radius of the true cone at heights (n,)."""
    return np.asarray(RADIUS_MM * (1.0 - height_mm / HEIGHT_MM))


def reconstruct_cone(cloud_mm: FloatArray) -> Made:
    """Level planes: a tilt fitted to the smallest sections would be noise."""
    return reconstruct(cloud_mm, PaperSettings(), step_mm=CONE_STEP_MM)


@dataclass(frozen=True, slots=True, eq=False)
class ConeRow:
    """One section of the cone, with the base curve that it was compared to."""

    section: Section
    radius_mm: float  # of the true cone at the section's height
    base_mm: float  # length of the base curve before this section
    pairs: int  # connected to the section below
    errors: Deviation

    @property
    def centres(self) -> int:
        """Centres of mass on the contour."""
        return len(self.section.contour.points_mm)

    @property
    def control_points(self) -> int:
        """Control points after the 25 % rule."""
        return len(self.section.curve.control_points_mm)


def tabulate_cone(made: Made) -> list[ConeRow]:
    """Follow the 25 % rule up the cone and measure every section against it."""
    rows: list[ConeRow] = []
    base_mm = made.plain.sections[0].length_mm
    for section in made.plain.sections:
        points, _, _ = sample_section(section)
        radius = float(cone_radius_mm(points[:, 2]).mean())
        errors = np.hypot(points[:, 0], points[:, 1]) - cone_radius_mm(points[:, 2])
        count = len(section.curve.control_points_mm)
        pairs = abs(count - rows[-1].control_points) if rows else 0
        rows.append(ConeRow(section, radius, base_mm, pairs, deviation_of(errors)))
        base_mm = section.length_mm if section.base else base_mm
    return rows


def frustum_mm3(low_mm: float, high_mm: float) -> float:
    """Volume of the true cone between two heights."""
    radii = cone_radius_mm(np.array([low_mm, high_mm]))
    return float(math.pi / 3.0 * (high_mm - low_mm) * ((radii**2).sum() + radii.prod()))
