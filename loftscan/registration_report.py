"""A registration as a report: where the views meet, how well, what they share, how sure it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from loftscan import figures
from loftscan.registering import Merged
from loftscan.rendering import PointLayer, Scene, camera_around, render_scene
from loftscan.rendering.scene import ByteArray
from loftscan.report import Fact, Finding, MetricGroup, Picture, Report, Severity, write_report
from reconstruction.arrays import FloatArray

_SIZE_PX = (1100, 825)
_DRAWN = 150_000
_FIRST, _SECOND = (0, 114, 178), (230, 159, 0)


def write_registration_report(path: Path, merged: Merged) -> None:
    """Write report.html of a registration."""
    found = merged.registration
    turn_deg, shift_mm = np.degrees(found.sd[:3]), found.sd[3:]
    sure = (
        f"The turn is known to {turn_deg.max():.2g} deg and the shift to {shift_mm.max():.2g} mm"
        " (one standard deviation about the worst axis), told from the residuals."
    )
    shared = (
        f"The second view sees {found.overlap[0]:.0%} of what the first sees, the first"
        f" {found.overlap[1]:.0%} of the second's; {int((~found.counted).sum())} of"
        f" {len(found.counted)} places were left out as strays."
    )
    write_report(
        path,
        Report(
            title=f"{merged.second.name} laid on {merged.first.name}",
            subtitle="patch against patch; all lengths in mm, in the frame of the first",
            headline=(
                Fact("residual rms", found.rms_mm, "mm"),
                Fact("places", int(found.counted.sum())),
                Fact("overlap", min(found.overlap)),
                Fact("turn, sd", float(turn_deg.max()), "deg"),
                Fact("shift, sd", float(shift_mm.max()), "mm"),
            ),
            findings=(Finding(Severity.NOTE, sure), Finding(Severity.NOTE, shared)),
            pictures=_pictures(merged),
            metrics=(_table(merged),),
        ),
    )


def _pictures(merged: Merged) -> tuple[Picture, ...]:
    found = merged.registration
    kept = found.residuals_mm[found.counted]
    limit = max(float(np.quantile(np.abs(kept), 0.95)), 1e-6)
    sites = found.sites_mm[found.counted]
    map_px = _dots(sites, figures.deviation_colours(kept, limit), 9.0)
    title = "Residual where both views see the part"
    both = figures.picture_figure(_both(merged), title="Both views")
    return (
        Picture(
            figures.png(figures.deviation_figure(map_px, limit_mm=limit, title=title)), title,
            "How far the second view's surface lies over the first's; colours end at 95 %.",
        ),
        Picture(figures.png(both), "Both views", "The first is blue, the second orange."),
        Picture(
            figures.png(figures.histogram_figure(kept, tolerance_mm=None)),
            "Distribution of the residuals", "One a place; strays are left out.",
        ),
    )  # fmt: skip


def _both(merged: Merged) -> ByteArray:
    points_mm = merged.points_mm
    colours = np.empty((len(points_mm), 3), np.uint8)
    colours[:], colours[: len(merged.first.view.points_mm)] = _SECOND, _FIRST
    rows = np.random.default_rng(0).permutation(len(points_mm))[:_DRAWN]
    return _dots(points_mm[rows], colours[rows], figures.bead_radius_px(len(rows), _SIZE_PX))


def _dots(points_mm: FloatArray, colours: ByteArray, radius_px: float) -> ByteArray:
    scene = Scene(points=(PointLayer(points_mm, colours, radius_px),))
    return render_scene(scene, camera=camera_around(points_mm), size_px=_SIZE_PX)


def _table(merged: Merged) -> MetricGroup:
    numbers = merged.metrics
    names = (
        ("turn_deg", "deg"), ("residual_rms_mm", "mm"), ("residual_max_mm", "mm"), ("places", ""),
        ("places_left_out", ""), ("patch_radius_mm", "mm"), ("overlap_of_first", ""),
        ("overlap_of_second", ""),
    )  # fmt: skip
    facts = [Fact(name, numbers[name], unit) for name, unit in names]  # type: ignore[arg-type]
    found = merged.registration
    facts += [
        Fact(f"sd of the {what} {axis}", float(value), unit)
        for what, unit, values in (
            ("turn about", "deg", np.degrees(found.sd[:3])),
            ("shift along", "mm", found.sd[3:]),
        )
        for axis, value in zip("xyz", values, strict=True)
    ]
    return MetricGroup("Registration", tuple(facts))
