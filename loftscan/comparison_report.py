"""A comparison as a report."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from loftscan import figures
from loftscan.comparing import Comparison
from loftscan.rendering import MeshLayer, PointLayer, Scene, camera_around, render_scene
from loftscan.rendering.scene import ByteArray
from loftscan.report import Fact, Finding, MetricGroup, Picture, Report, Severity, write_report
from reconstruction.meshing import Mesh

_SIZE_PX = (1100, 825)


def write_comparison_report(path: Path, comparison: Comparison) -> None:
    """Write report.html of a comparison."""
    numbers = comparison.deviation.statistics
    write_report(
        path,
        Report(
            title=f"{comparison.measured.name} against {comparison.reference.name}",
            subtitle=f"{comparison.deviation.method.value}; all lengths in mm",
            headline=(
                Fact("rms", numbers.rms_mm, "mm"),
                Fact("mean", numbers.mean_mm, "mm"),
                Fact("95 % within", numbers.absolute_95_mm, "mm"),
                Fact("largest", max(-numbers.min_mm, numbers.max_mm), "mm"),
                Fact("points", numbers.count),
            ),
            findings=_findings(comparison),
            pictures=_pictures(comparison),
            metrics=(_table(comparison),),
        ),
    )


def _findings(comparison: Comparison) -> tuple[Finding, ...]:
    found: list[Finding] = []
    verdict, alignment = comparison.deviation.verdict, comparison.deviation.alignment
    if verdict is not None:
        word = "In" if verdict.within else "Out of"
        sentence = (
            f"{word} tolerance: {verdict.share_within:.2%} of the points lie within "
            f"{verdict.tolerance_mm:g} mm; {verdict.rule}."
        )
        severity = Severity.GOOD if verdict.within else Severity.FAILURE
        found.append(Finding(severity, sentence))
    if alignment is None:
        found.append(Finding(Severity.NOTE, "Compared as they lie, without an alignment."))
    else:
        sentence = (
            f"Aligned by best fit: turned by {math.degrees(alignment.rotation_rad):.4g}° and moved "
            f"by {alignment.translation_mm:.4g} mm; {alignment.held_freedoms} of 6 freedoms are "
            "held by the shape."
        )
        found.append(Finding(Severity.NOTE, sentence))
    return tuple(found)


def _pictures(comparison: Comparison) -> tuple[Picture, ...]:
    deviation = comparison.deviation
    # A flat zero deviation still needs a colour bar with two different ends.
    limit = max(deviation.statistics.absolute_95_mm, 1e-6)
    title = "Deviation"
    map_png = figures.png(
        figures.deviation_figure(_image(comparison, limit), limit_mm=limit, title=title)
    )
    tolerance = deviation.verdict.tolerance_mm if deviation.verdict else None
    histogram = figures.histogram_figure(deviation.distances_mm, tolerance_mm=tolerance)
    return (
        Picture(map_png, title, "Colours end at the 95 % deviation."),
        Picture(figures.png(histogram), "Distribution of the deviation", "Every measured point."),
    )


def _image(comparison: Comparison, limit_mm: float) -> ByteArray:
    points = comparison.points_mm
    distances = np.where(comparison.deviation.beyond, np.nan, comparison.deviation.distances_mm)
    colours = figures.deviation_colours(distances, limit_mm)
    camera = camera_around(points, up=comparison.up)
    measured = comparison.measured.mesh
    if measured is not None:
        moved = Mesh(points, measured.faces, measured.synthetic)
        scene = Scene(meshes=(MeshLayer(moved, colours),))
    else:
        radius = figures.bead_radius_px(len(points), _SIZE_PX)
        scene = Scene(points=(PointLayer(points, colours, radius),))
    return render_scene(scene, camera=camera, size_px=_SIZE_PX)


def _table(comparison: Comparison) -> MetricGroup:
    plain = {k: v for k, v in comparison.metrics.items() if isinstance(v, (str, int, float))}
    facts = (
        Fact(k.removesuffix("_mm").replace("_", " "), v, "mm" if k.endswith("_mm") else "")
        for k, v in plain.items()
    )
    return MetricGroup("Deviation", tuple(facts))
