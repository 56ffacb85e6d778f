"""The paper's method, section by section, in its own words.

    acquired points -> plane by least squares -> regions and centres of mass -> macro-region walk
    -> numbering from the reference line -> NURBS of the CMs -> equidistant knots, 25 % rule
    -> patches, pair connections, mesh

It is streamed: a slice becomes a section as soon as it arrives, because the 25 % rule looks only
back. Where the paper leaves a choice open, the choice is a named setting here or a line of decision
record 0002.

References
----------
"Three-dimensional surface reconstruction using NURBS", sections 2.1 to 2.4.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.distances import polygon_distances
from reconstruction.errors import TooFewPoints
from reconstruction.numbering import number_contour
from reconstruction.nurbs import Curve, evaluate_curve, periodic_uniform
from reconstruction.ordering import Contour, Walk, walk_contour
from reconstruction.reduction import Box, bounding_box, reduce_points
from reconstruction.reknotting import map_gaps, measure_lengths, reknot
from reconstruction.resolution import Resolution, choose_resolution
from reconstruction.sections import Section, Skipped, lift_curve, measure_residual
from reconstruction.slices import Frame, Slice
from reconstruction.thickness import Thickness, estimate_thickness

_FEWEST_POINTS = 8
_FEWEST_CELLS = 4
_STEPS_A_SPAN = 8  # of the polygon that stands for a curve when residuals are measured
_GAP_CELLS = 2.5  # a bridged segment longer than this many cells is a gap
_BLOB_WIDTHS = 2.0  # a slice narrower than this many cloud widths is a blob, as at an apex
LEFT_OUT_CELLS = 3.0  # farther than this many cells a point belongs to something else
_LEFT_OUT_DRAWN = 2_000


class PlaneRule(Enum):
    """How a slice's points are put into one plane by least squares."""

    LEVEL = "level"  # perpendicular to the stacking axis, at the mean height
    TILTED = "tilted"  # the plane nearest to the points


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """What the paper lets the operator choose, and what it leaves open."""

    resolution_mm: float | None = None  # dx = dy; None: the rule of section 2.2
    walk: Walk = Walk.WIDENING
    reach_mm: float | None = None  # widest gap to cross; None: half the slice
    plane: PlaneRule = PlaneRule.LEVEL
    base_share: float = 0.25  # lengths within this share of the base curve keep its count
    intermediate: int = 0  # rows between sections, for a soft surface
    residual_range_mm: float = 5.0  # of the histogram


@dataclass(frozen=True, slots=True)
class Base:
    """The base curve: what later sections are measured against."""

    count: int
    length_mm: float
    reference_x_mm: float


def draw_sections(slices: Iterable[Slice], settings: PaperSettings) -> Iterator[Section | Skipped]:
    """Turn slices into sections, one by one, as they come."""
    base: Base | None = None
    for piece in slices:
        try:
            section, base = draw_section(piece, settings, base)
        except TooFewPoints as reason:
            yield Skipped(piece.index, len(piece.points_mm), str(reason))
        else:
            yield section


def draw_section(piece: Slice, settings: PaperSettings, base: Base | None) -> tuple[Section, Base]:
    """Turn one slice into a section.

    Parameters
    ----------
    piece : Slice
    settings : PaperSettings
    base : Base, optional
        The base curve so far; None for the first section, which becomes it.

    Returns
    -------
    section, base
        The base is the old one while the section's length is within 25 % of it.

    Raises
    ------
    TooFewPoints
        Below 8 points, or 4 centres of mass on the contour.
    """
    if len(piece.points_mm) < _FEWEST_POINTS:
        raise TooFewPoints(f"{len(piece.points_mm)} points, a section needs {_FEWEST_POINTS}")
    frame, planar = lay_plane(piece, settings.plane)
    up = piece.frame.axes[2]
    thickness, resolution, contour = draw_contour(planar, settings, within=_known_box(piece, frame))
    reference_x = base.reference_x_mm if base else float(contour.points_mm[:, 0].mean())
    contour = number_contour(contour, reference_x_mm=reference_x)
    flat = draw_curve(contour)
    length = float(measure_lengths(flat)[1][-1])
    own = len(contour.points_mm)
    count, kept = _apply_base_rule(own, length, reference_x, base, settings)
    final = reknot(flat, count)
    gaps, gap_mm = map_gaps(flat, find_gaps(contour, resolution), count)
    distances = _distances(planar[:, :2], final)
    far = np.abs(distances) > LEFT_OUT_CELLS * resolution.cell_mm
    width = settings.residual_range_mm
    section = Section(
        index=piece.index,
        frame=frame,
        # Of the middle, not of the origin: a tilted plane is at its height only where the part is.
        height_mm=float(frame.to_part(contour.points_mm.mean(axis=0)[None])[0] @ up),
        points=len(piece.points_mm),
        thickness=thickness,
        resolution=resolution,
        contour=contour,
        curve=lift_curve(final, frame),
        knot_points_mm=frame.to_part(evaluate_curve(final, np.arange(count, dtype=np.float64))),
        synthetic=_mark(count, gaps),
        gaps=gaps,
        length_mm=length,
        gap_mm=gap_mm,
        base=kept is not base,
        residual=measure_residual(distances[~far], range_mm=width),
        residual_all=measure_residual(distances, range_mm=width),
        left_out_mm=piece.points_mm[far][:_LEFT_OUT_DRAWN],
        left_out=int(far.sum()),
    )
    return section, kept


def lay_plane(piece: Slice, rule: PlaneRule) -> tuple[Frame, FloatArray]:
    """Fit the slice's plane by least squares; return its frame and the points in it, (n, 3)."""
    planar = piece.frame.to_plane(piece.points_mm)
    if rule is PlaneRule.LEVEL:
        rise = np.array([float(planar[:, 2].mean()), 0.0, 0.0])
    else:
        design = np.column_stack([np.ones(len(planar)), planar[:, :2]])
        rise = np.linalg.lstsq(design, planar[:, 2], rcond=None)[0]
    normal = np.array([-rise[1], -rise[2], 1.0]) / math.sqrt(1.0 + rise[1] ** 2 + rise[2] ** 2)
    x = np.array([1.0, 0.0, rise[1]])
    x /= np.linalg.norm(x)
    local = np.stack([x, np.cross(normal, x), normal])
    axes = local @ piece.frame.axes
    origin = piece.frame.origin_mm + rise[0] * piece.frame.axes[2]
    frame = Frame(origin, axes)
    return frame, frame.to_plane(piece.points_mm)


def _known_box(piece: Slice, frame: Frame) -> Box | None:
    """The slice's box as the plane sees it, where axes only change places; else it is none."""
    if piece.corners_mm is None or np.count_nonzero(frame.axes) != len(frame.axes):
        return None
    corners = frame.to_plane(piece.corners_mm)
    return Box(corners.min(axis=0), corners.max(axis=0))


def draw_contour(
    planar_mm: FloatArray, settings: PaperSettings, *, within: Box | None = None
) -> tuple[Thickness, Resolution, Contour]:
    """Reduce the points of a plane (n, 3) to centres of mass and order those of the contour.

    Their bounding box, where it is known, saves one reading of all points.
    """
    box = within or bounding_box(planar_mm)
    thickness = estimate_thickness(planar_mm[:, :2])
    resolution = choose_resolution(
        thickness,
        sampling_mm=thickness.spacing_mm,
        size_mm=float(box.sides_mm[:2].max()),
        given_mm=settings.resolution_mm,
    )
    size_mm = float(box.sides_mm[:2].max())
    if size_mm == 0.0 or resolution.cell_mm <= 0.0:
        raise TooFewPoints(f"all {len(planar_mm)} points lie in one place")
    if size_mm < _BLOB_WIDTHS * thickness.width_mm:
        raise TooFewPoints(
            f"the slice is {size_mm:.3g} mm wide and its cloud {thickness.width_mm:.3g} mm thick: "
            "no contour can be told from the noise"
        )
    side = resolution.cell_mm
    cells = reduce_points(
        planar_mm, size_mm=(side, side, math.inf), origin_mm=np.zeros(3), within=box
    )
    contour = walk_contour(cells, walk=settings.walk, reach_mm=settings.reach_mm)
    if len(contour.points_mm) < _FEWEST_CELLS:
        raise TooFewPoints(
            f"{len(contour.points_mm)} centres of mass on the contour at {side:.3g} mm resolution, "
            f"a section needs {_FEWEST_CELLS}"
        )
    return thickness, resolution, contour


def draw_curve(contour: Contour) -> Curve:
    """Draw the NURBS curve that has the centres of mass as its control points (Fig. 3), in 2D.

    A uniform cubic of weights one, closed on itself. The curve at parameter k is nearest to
    centre k: (P[k-1] + 4 P[k] + P[k+1]) / 6.
    """
    # A periodic cubic begins at its second control point; so the last centre is put first.
    return periodic_uniform(np.roll(contour.points_mm, 1, axis=0))


def find_gaps(contour: Contour, resolution: Resolution) -> BoolArray:
    """Which segments are gaps, (m,): bridged by the walk, and wider than one empty cell.

    A step over a single empty cell is a hole in the lattice, not in the measurement.
    """
    return contour.bridged & (contour.segments_mm > _GAP_CELLS * resolution.cell_mm)


def _apply_base_rule(
    own_count: int,
    length_mm: float,
    reference_x_mm: float,
    base: Base | None,
    settings: PaperSettings,
) -> tuple[int, Base]:
    """The 25 % rule: near the base's length its count, else the own count and a new base."""
    if base and abs(length_mm / base.length_mm - 1.0) <= settings.base_share:
        return base.count, base
    return own_count, Base(own_count, length_mm, reference_x_mm)


def _distances(planar_mm: FloatArray, curve: Curve) -> FloatArray:
    """Signed distances of unreduced points to a curve, as a polygon of 8 steps a span."""
    start, end = curve.domain
    steps = _STEPS_A_SPAN * len(curve.control_points_mm)
    parameters = np.linspace(start, end, steps, endpoint=False)
    return polygon_distances(planar_mm, evaluate_curve(curve, parameters))


def _mark(count: int, gaps: tuple[tuple[float, float], ...]) -> BoolArray:
    knots = np.arange(count)
    marked = np.zeros(count, dtype=np.bool_)
    for u0, u1 in gaps:
        for turn in (-count, 0, count):
            # Strictly inside: the ends of a gap are measured points.
            marked |= (knots + turn > u0 + 0.25) & (knots + turn < u1 - 0.25)
    return marked
