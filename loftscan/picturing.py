"""The pictures of a result: mesh, cloud, sections, deviation, residual, some slices."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from loftscan import figures
from loftscan.certainty import draw_certainty
from loftscan.methods import AnySection
from loftscan.rendering import (
    Axis,
    Camera,
    Edges,
    MeshLayer,
    Scene,
    camera_around,
    encode_png,
    render_scene,
)
from loftscan.rendering.scene import ByteArray
from loftscan.report import Picture
from loftscan.result import Result
from loftscan.section_view import SliceView, fitted_figure
from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.fitted_sections import FittedSection
from reconstruction.nurbs import evaluate_curve
from reconstruction.sections import Section

_SIZE_PX = (1100, 760)
_CLAY = (188, 196, 206)
_BRIDGED = (222, 135, 40)
_STEPS_A_SPAN = 6
_LEAST_STEPS = 120
_SECTIONS_SHOWN = 3
_POINTS_DRAWN = 20_000
_HISTOGRAM_BINS = 61
_NEAREST = 8  # points whose deviation a vertex shows ...
_REACH_STEPS = 0.75  # ... no farther away than that many distances between slices


def draw_pictures(result: Result) -> tuple[Picture, ...]:
    """The pictures of the report, in order."""
    camera = view_of(result)
    left_out = np.concatenate([np.empty((0, 3)), *(s.left_out_mm for s in result.sections)])
    mesh = encode_png(draw_mesh(result, camera))
    deviation = draw_deviation(result, camera)
    return (
        Picture(mesh, "The mesh", "Orange: gaps and end caps, which stand on no measured point."),
        _cloud(result, camera, left_out),
        _sections(result, camera, left_out),
        Picture(deviation, "Deviation of the points from the mesh", _rule(result)),
        *_certainty(result, camera),
        _residual(result),
        *_section_pictures(result),
    )


def _cloud(result: Result, camera: Camera, left_out_mm: FloatArray) -> Picture:
    title = "The cloud"
    aside = np.concatenate([left_out_mm, *result.cutting.aside_mm.values()])
    figure = figures.cloud_figure(result.sample_mm, aside, title=title, camera=camera)
    caption = f"A sample of {len(result.sample_mm)} points, and what was set aside or left out."
    return Picture(figures.png(figure), title, caption)


def _sections(result: Result, camera: Camera, left_out_mm: FloatArray) -> Picture:
    title = "The sections"
    lines = [line for section in result.sections for line in polylines(section)]
    figure = figures.sections_figure(lines, title=title, camera=camera, left_out_mm=left_out_mm)
    fitted = isinstance(result.reconstruction, FittedReconstruction)
    caption = "One NURBS curve a contour." if fitted else "One closed NURBS curve a slice."
    return Picture(figures.png(figure), title, caption)


def _residual(result: Result) -> Picture:
    title = "Distribution of the residual"
    figure = figures.histogram_figure(binned=_histogram(result), title=title)
    caption = (
        f"In-plane distance of {result.reconstruction.residual_all.count} unreduced points to "
        "their sections; the outer bins hold everything beyond."
    )
    return Picture(figures.png(figure), title, caption)


def view_of(result: Result) -> Camera:
    """One camera for all pictures, so that they can be compared.

    It looks across what was left out, if anything was, so that a handle is seen from its side.
    """
    left_out = np.concatenate([np.empty((0, 3)), *(s.left_out_mm for s in result.sections)])
    points = (result.mesh.vertices_mm, left_out)
    if len(left_out) == 0:
        return camera_around(*points, up=_up(result))
    planar = list(result.cutting.axis.planar[:2])
    away = left_out[:, planar].mean(axis=0) - result.mesh.vertices_mm[:, planar].mean(axis=0)
    azimuth = math.atan2(away[1], away[0]) + math.radians(70)
    return camera_around(*points, azimuth_rad=azimuth, up=_up(result))


def _up(result: Result) -> Axis:
    letters: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    return letters[result.cutting.axis.column]


def draw_mesh(result: Result, camera: Camera, size_px: tuple[int, int] = _SIZE_PX) -> ByteArray:
    """The mesh in clay, bridged vertices and caps in orange."""
    colours = np.where(synthetic_faces(result)[:, None], _BRIDGED, _CLAY).astype(np.uint8)
    edges = Edges.DRAWN if len(result.mesh.faces) < 60_000 else Edges.HIDDEN
    layer = MeshLayer(result.mesh, colours, edges=edges)
    return render_scene(Scene(meshes=(layer,)), camera=camera, size_px=size_px)


def synthetic_faces(result: Result) -> BoolArray:
    """Faces that stand on no measured point, (m,): in a bridged gap, or on a cap."""
    mesh = result.mesh
    heights = mesh.vertices_mm @ result.reconstruction.normal
    flagged = mesh.synthetic[mesh.faces].sum(axis=1) >= 2
    for cap in result.reconstruction.cap_heights_mm:
        flagged |= (np.abs(heights - cap) < 1e-6)[mesh.faces].all(axis=1)
    return np.asarray(flagged)


def polylines(section: AnySection) -> list[FloatArray]:
    """A section's curves as polylines, (k, 3) each; a closed one ends where it begins."""
    lines = []
    for drawn in section.curves:
        steps = max(_STEPS_A_SPAN * len(drawn.curve.control_points_mm), _LEAST_STEPS) + 1
        lines.append(evaluate_curve(drawn.curve, np.linspace(*drawn.curve.domain, steps)))
    return lines


def _certainty(result: Result, camera: Camera) -> list[Picture]:
    done = result.reconstruction
    if not isinstance(done, FittedReconstruction) or not done.skinned.shown:
        return []
    return [draw_certainty(done, camera, _SIZE_PX)]


def draw_deviation(result: Result, camera: Camera) -> bytes:
    """The signed deviation on the mesh, each vertex with the mean of the points nearest to it."""
    limit = max(result.deviation.statistics.absolute_95_mm, 1e-9)
    values = deviation_at_vertices(result)
    # By face, so that a cap does not take the colour of its rim.
    by_face = values[result.mesh.faces].mean(axis=1)
    colours = figures.deviation_colours(by_face, limit, synthetic=synthetic_faces(result))
    image = render_scene(
        Scene(meshes=(MeshLayer(result.mesh, colours),)), camera=camera, size_px=_SIZE_PX
    )
    title = "Deviation of the points from the mesh"
    return figures.png(figures.deviation_figure(image, limit_mm=limit, title=title))


def deviation_at_vertices(result: Result) -> FloatArray:
    """Mean signed deviation of the sample points nearest to each vertex, nan without any near."""
    if not len(result.sample_mm):
        return np.full(len(result.mesh.vertices_mm), np.nan)
    count = min(_NEAREST, len(result.sample_mm))
    tree, each = cKDTree(result.sample_mm), np.arange(1, count + 1)
    away, nearest = (np.asarray(v) for v in tree.query(result.mesh.vertices_mm, k=each))
    values = result.deviation.distances_mm[nearest]
    # Half-way between two slices a vertex is farthest from all points.
    reach = _REACH_STEPS * result.cutting.spacing.step_mm
    held = away <= np.maximum(reach, 2.0 * np.median(away[:, 0]))
    with np.errstate(invalid="ignore"):
        counts = np.where(held[:, 0], held.sum(axis=1), np.nan)
        return np.asarray((values * held).sum(axis=1) / counts)


def _rule(result: Result) -> str:
    statistics = result.deviation.statistics
    return (
        f"Signed distance of {statistics.count} measured points to the mesh, outwards positive: "
        f"rms {statistics.rms_mm:.3g} mm, 95 % within {statistics.absolute_95_mm:.3g} mm. "
        "The colours end there. Grey: no measured point."
    )


def _histogram(result: Result) -> tuple[FloatArray, IntArray]:
    """Bins of the residual over the range that holds 99 % of the points.

    The outer bins take in what lies beyond, so that nothing leaves the count.
    """
    residual = result.reconstruction.residual_all
    middle = len(residual.bins) // 2
    outwards = residual.bins[middle:].astype(float)
    outwards[1:] += residual.bins[:middle][::-1]
    within = np.cumsum(outwards) >= 0.99 * residual.count
    reach = max(_HISTOGRAM_BINS // 2, int(np.argmax(within)))
    group = -(-(2 * reach + 1) // _HISTOGRAM_BINS)
    reach = min((group * _HISTOGRAM_BINS) // 2, middle)
    places = np.clip(np.arange(len(residual.bins)) - middle, -reach, reach) + reach
    counts = np.bincount(places // group, weights=residual.bins).astype(np.int64)
    first = residual.edges_mm[middle - reach]
    step = group * float(residual.edges_mm[1] - residual.edges_mm[0])
    return first + step * np.arange(len(counts) + 1), counts


def _section_pictures(result: Result) -> list[Picture]:
    sections = result.sections
    places = np.linspace(0, len(sections) - 1, _SECTIONS_SHOWN + 2).astype(int)[1:-1]
    worst = int(np.argmax([section.left_out for section in sections]))
    chosen = sorted({*places.tolist(), worst})
    return [_section_picture(result, sections[k]) for k in chosen]


def _section_picture(result: Result, section: AnySection) -> Picture:
    if isinstance(section, FittedSection):
        return _fitted_picture(result, section)
    return _reduced_picture(result, section)


def _fitted_picture(result: Result, section: FittedSection) -> Picture:
    measured = section.frame.to_plane(result.cutting.slice_at(section.index).points_mm)[:, :2]
    away = section.frame.to_plane(section.left_out_mm)[:, :2]
    points = np.concatenate([measured, away])
    view = SliceView(
        points_mm=points,
        curves=section.fitted,
        nodes_mm=(),
        strays=np.arange(len(measured), len(points)),
        unordered=np.arange(0),
        measured=section.points,
    )
    title = f"Slice {section.index}, {section.height_mm:.2f} mm"
    curves = ", ".join(f"{each.kind} ({each.points_used} points)" for each in section.fitted)
    caption = f"{section.points} points; {curves}; residual rms {section.residual.rms_mm:.3g} mm."
    return Picture(figures.png(fitted_figure(view, title=title)), title, caption)


def _reduced_picture(result: Result, section: Section) -> Picture:
    frame = section.frame
    measured = result.cutting.slice_at(section.index).points_mm
    thinned = measured[:: max(1, len(measured) // _POINTS_DRAWN)]
    points = frame.to_plane(thinned)[:, :2]
    (line,) = polylines(section)
    curve = frame.to_plane(line)[:, :2]
    cell = section.resolution.cell_mm
    contour = section.contour
    title = f"Slice {section.index}, {section.height_mm:.2f} mm"
    figure = figures.section_figure(
        points,
        title=title,
        cells=figures.CellGrid(contour.points_mm, contour.counts, (cell, cell)),
        contour_mm=np.vstack([contour.points_mm, contour.points_mm[:1]]),
        curve_mm=curve,
        gaps_mm=[_gap(section, u0, u1) for u0, u1 in section.gaps],
        left_out_mm=frame.to_plane(section.left_out_mm)[:, :2],
        measured=section.points,
    )
    caption = (
        f"{section.points} points, {len(contour.points_mm)} centres of mass in cells of "
        f"{cell:.3g} mm ({section.resolution.reason}), "
        f"residual rms {section.residual.rms_mm:.3g} mm."
    )
    return Picture(figures.png(figure), title, caption)


def _gap(section: Section, u0: float, u1: float) -> FloatArray:
    parameters = np.linspace(u0, u1, 33)
    return section.frame.to_plane(evaluate_curve(section.curve, parameters))[:, :2]
