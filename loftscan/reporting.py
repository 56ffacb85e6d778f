"""A result as a report: which pictures, which numbers, in which order."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from loftscan import figures
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
from loftscan.report import Fact, Finding, MetricGroup, Picture, Report, Severity, write_report
from loftscan.result import Result
from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.nurbs import evaluate_curve
from reconstruction.sections import Section

_SIZE_PX = (1100, 760)
_CLAY = (188, 196, 206)
_BRIDGED = (222, 135, 40)
_STEPS_A_SPAN = 6
_SECTIONS_SHOWN = 3
_POINTS_DRAWN = 20_000
_HISTOGRAM_BINS = 61


def write_result_report(path: Path, result: Result) -> None:
    """Write report.html of a result."""
    write_report(path, compose(result))


def compose(result: Result) -> Report:
    """Put a result into words, pictures and tables."""
    numbers = result.metrics
    return Report(
        title=result.name,
        subtitle=_subtitle(result),
        headline=(
            Fact("residual rms", _number(numbers["residual_rms_mm"]), "mm"),
            Fact("cloud width", _number(numbers["thickness_mm"]), "mm"),
            Fact("sections", _number(numbers["sections"])),
            Fact("bridged", 100.0 * _number(numbers["gap_fraction"]), "%"),
            Fact("volume", _number(numbers["volume_mm3"]) / 1000.0, "cm³"),
            Fact("watertight", "yes" if numbers["watertight"] else "no"),
        ),
        findings=_findings(result),
        pictures=draw_pictures(result),
        left_out=_explain_left_out(result),
        metrics=_tables(result),
        provenance=tuple((key, str(value)) for key, value in _flat(result.provenance)),
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else float("nan")


def _subtitle(result: Result) -> str:
    settings = result.provenance["settings"]
    method = settings["method"] if isinstance(settings, dict) else ""
    points = f"{result.metrics['points_in']:,}".replace(",", "\u202f")
    return f"{points} points, method {method}; all lengths in mm"


def _findings(result: Result) -> tuple[Finding, ...]:
    sound = result.reconstruction.cleaned.after
    if sound.sound:
        state = "The mesh is closed, manifold and oriented; its two ends are flat caps."
        findings = [Finding(Severity.GOOD, state)]
    else:
        state = f"The mesh is no sound solid: {sound.boundary_edges} open edges."
        findings = [Finding(Severity.FAILURE, state)]
    verdict = result.deviation.verdict
    if verdict is not None:
        severity = Severity.GOOD if verdict.within else Severity.FAILURE
        sentence = (
            f"{verdict.share_within:.2%} of the points lie within {verdict.tolerance_mm:g} mm "
            f"of the mesh; {verdict.rule}."
        )
        findings.append(Finding(severity, sentence))
    findings += [
        Finding(Severity.WARNING, f"{text[0].upper()}{text[1:]}.") for text in result.warnings
    ]
    return tuple(findings)


def _explain_left_out(result: Result) -> tuple[str, ...]:
    done = result.reconstruction
    left_out, every = done.residual_all.count - done.residual.count, done.residual_all.count
    aside = ", ".join(
        f"{count} {reason.name.lower()}" for reason, count in result.cutting.aside.items() if count
    )
    return (
        f"{left_out} of {every} points in the sections ({left_out / max(1, every):.2%}) lie "
        "farther than three cells from their section's curve. They are drawn in red and are in no "
        f"residual but the one named so (rms {done.residual_all.rms_mm:.3g} mm over all points).",
        f"Set aside before slicing: {aside or 'nothing'}.",
        "Caps are not measured: slices parallel to a flat end never sample it.",
    )


# -- pictures ------------------------------------------------------------------------------------


def draw_pictures(result: Result) -> tuple[Picture, ...]:
    """The pictures of the report, in order."""
    camera = view_of(result)
    left_out = np.concatenate([np.empty((0, 3)), *(s.left_out_mm for s in result.sections)])
    aside = np.concatenate([np.empty((0, 3)), *result.cutting.aside_mm.values()])
    return (
        Picture(
            encode_png(draw_mesh(result, camera)),
            "The mesh",
            "Orange: bridged gaps and end caps, which stand on no measured point.",
        ),
        Picture(
            figures.png(
                figures.cloud_figure(
                    result.sample_mm,
                    np.concatenate([aside, left_out]),
                    title="The cloud",
                    camera=camera,
                )
            ),
            "The cloud",
            f"A sample of {len(result.sample_mm)} points, and what was set aside or left out.",
        ),
        Picture(
            figures.png(
                figures.sections_figure(
                    [polyline(section) for section in result.sections],
                    title="The sections",
                    camera=camera,
                    left_out_mm=left_out,
                )
            ),
            "The sections",
            "One closed NURBS curve a slice.",
        ),
        Picture(
            draw_deviation(result, camera), "Deviation of the points from the mesh", _rule(result)
        ),
        Picture(
            figures.png(
                figures.histogram_figure(
                    binned=_histogram(result), title="Distribution of the residual"
                )
            ),
            "Distribution of the residual",
            f"In-plane distance of {result.reconstruction.residual_all.count} unreduced points to "
            "their sections; the outer bins hold everything beyond.",
        ),
        *_section_pictures(result),
    )


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
    mesh, ends = result.mesh, (result.sections[0], result.sections[-1])
    flagged = mesh.synthetic[mesh.faces].sum(axis=1) >= 2
    for end in ends:
        heights = (mesh.vertices_mm - end.frame.origin_mm) @ end.frame.axes[2]
        flagged |= (np.abs(heights) < 1e-6)[mesh.faces].all(axis=1)
    return np.asarray(flagged)


def polyline(section: Section) -> FloatArray:
    """A section's curve as a closed polyline, (k, 3)."""
    start, end = section.curve.domain
    steps = _STEPS_A_SPAN * len(section.curve.control_points_mm) + 1
    return evaluate_curve(section.curve, np.linspace(start, end, steps))


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
    """Mean signed deviation of the sample points nearest to each vertex, nan without any."""
    vertices = result.mesh.vertices_mm
    _, nearest = cKDTree(vertices).query(result.sample_mm)
    counts = np.bincount(nearest, minlength=len(vertices))
    sums = np.bincount(nearest, weights=result.deviation.distances_mm, minlength=len(vertices))
    with np.errstate(invalid="ignore"):
        return np.asarray(sums / np.where(counts, counts, np.nan))


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


def _section_picture(result: Result, section: Section) -> Picture:
    frame = section.frame
    measured = result.cutting.slice_at(section.index).points_mm
    thinned = measured[:: max(1, len(measured) // _POINTS_DRAWN)]
    points = frame.to_plane(thinned)[:, :2]
    curve = frame.to_plane(polyline(section))[:, :2]
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


# -- tables --------------------------------------------------------------------------------------

_SECTION_NAMES = "slices sections spacing patch control thickness radius cell gap"
_MESH_NAMES = "vertices faces watertight oriented manifold euler components volume area"
_GROUPS = {
    "Points": ("points_", "profiles"),
    "Sections": tuple(_SECTION_NAMES.split()),
    "Residuals": ("residual", "surface_deviation", "tolerance", "share_within", "within"),
    "Mesh": tuple(_MESH_NAMES.split()),
    "Effort": ("seconds", "peak", "lag", "slice_period"),
}
_UNITS = {"_mm": "mm", "_mm2": "mm²", "_mm3": "mm³", "_mb": "MB", "seconds": "s", "_s": "s"}


def _tables(result: Result) -> tuple[MetricGroup, ...]:
    facts = list(_flat(result.metrics))
    return tuple(
        MetricGroup(
            title,
            tuple(_fact(key, value) for key, value in facts if key.startswith(prefixes)),
        )
        for title, prefixes in _GROUPS.items()
    )


def _fact(key: str, value: object) -> Fact:
    ending = next((ending for ending in _UNITS if key.endswith(ending)), "")
    label = key.removesuffix(ending) if ending.startswith("_") else key
    shown = value if isinstance(value, (str, int, float)) else "-" if value is None else str(value)
    return Fact(label.replace("_", " "), shown, _UNITS.get(ending, ""))


def _flat(content: dict[str, object], prefix: str = "") -> list[tuple[str, object]]:
    rows: list[tuple[str, object]] = []
    for key, value in content.items():
        name = f"{prefix}{key}"
        rows += _flat(value, f"{name} ") if isinstance(value, dict) else [(name, value)]
    return rows
