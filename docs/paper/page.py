"""The page beside the pictures: every number in it comes from the run that made them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from string import Template

from circles import COARSE_MM, FINE_MM, POINTS_A_MM, Row, Trial
from solids import (
    CONE_STEP_MM,
    CYLINDER_SLICES,
    HEIGHT_MM,
    RADIUS_MM,
    WIDTH_MM,
    ConeRow,
    CylinderRow,
    Deviation,
    Made,
    cylinder_volume_mm3,
    frustum_mm3,
)

from reconstruction.ordering import Walk

RMS_BOUND_MM = 0.18
WAVINESS_BOUND = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that the page tells."""

    walks: list[Row]
    shown: tuple[Trial, Trial]  # the fine and the coarse trial of Fig. 6
    pairs: int  # of Fig. 5
    cylinder: Made
    cylinder_rows: list[CylinderRow]
    cone: Made
    cone_rows: list[ConeRow]
    scattered: Made
    scattered_rows: list[ConeRow]

    def walk(self, cell_mm: float, walk: Walk) -> Row:
        """The row of one cell size and one walk."""
        return next(row for row in self.walks if row.cell_mm == cell_mm and row.walk is walk)


def check(found: Findings) -> list[tuple[str, bool]]:
    """The bounds that must hold, and whether they do."""
    fine, coarse = (found.walk(cell_mm, Walk.PURE) for cell_mm in (FINE_MM, COARSE_MM))
    ratio = fine.waviness / coarse.waviness
    solids = (found.cylinder, found.cone)
    return [
        (
            f"at {COARSE_MM:g} mm every walk closes with one full turn "
            f"({coarse.rings} of {coarse.seeds})",
            coarse.rings == coarse.seeds,
        ),
        (
            f"at {COARSE_MM:g} mm the curves lie within {RMS_BOUND_MM} mm rms of the true circle "
            f"({coarse.rms_mm:.3f} mm over all of them)",
            coarse.rms_mm <= RMS_BOUND_MM,
        ),
        (
            f"at {FINE_MM} mm the curve is at least {WAVINESS_BOUND:g} times as wavy as at "
            f"{COARSE_MM:g} mm ({ratio:.1f} times)",
            ratio >= WAVINESS_BOUND,
        ),
        (
            f"fifteen control points connect to ten by five pairs ({found.pairs})",
            found.pairs == 5,
        ),
        (
            f"all {CYLINDER_SLICES} slices of the cylinder become sections "
            f"({len(found.cylinder_rows)})",
            len(found.cylinder_rows) == CYLINDER_SLICES,
        ),
        (
            "both solids come out closed, oriented and manifold",
            all(
                made.plain.cleaned.after.sound and made.smooth.cleaned.after.sound
                for made in solids
            ),
        ),
    ]


def compose(found: Findings) -> str:
    """Write the page."""
    values = _walk_values(found) | _cylinder_values(found) | _cone_values(found)
    values["checks"] = "\n".join(
        f"- {'holds' if holds else '**does not hold**'}: {words}" for words, holds in check(found)
    )
    template = Path(__file__).with_name("page.template.md").read_text(encoding="utf-8")
    return Template(template).substitute(values)


def _walk_values(found: Findings) -> dict[str, str]:
    fine, coarse = (found.walk(cell_mm, Walk.PURE) for cell_mm in (FINE_MM, COARSE_MM))
    shown = found.shown
    return {
        "walk_table": _walk_table(found.walks),
        "points_a_mm": f"{POINTS_A_MM:g}",
        "seeds": f"{fine.seeds}",
        "fine_rings": f"{fine.rings}",
        "fine_curls": f"{fine.curls}",
        "fine_open": f"{fine.seeds - fine.rings - fine.curls}",
        "wide_rings": f"{found.walk(FINE_MM, Walk.WIDENING).rings}",
        "coarse_rms": f"{coarse.rms_mm:.3f}",
        "coarse_worst": f"{coarse.worst_rms_mm:.3f}",
        "coarse_inside": f"{-coarse.bias_mm:.3f}",
        "coarsest_inside": f"{-found.walk(8.0, Walk.PURE).bias_mm:.3f}",
        "ratio": f"{fine.waviness / coarse.waviness:.1f}",
        "least_ratio": f"{fine.least_waviness / coarse.most_waviness:.1f}",
        "shown_fine": f"{shown[0].turning_rad:.0f} rad = {shown[0].turning_rad / math.tau:.1f}",
        "shown_coarse": f"{shown[1].turning_rad:.2f} rad = {shown[1].turning_rad / math.tau:.2f}",
        "pairs": f"{found.pairs}",
    }


def _walk_table(rows: Sequence[Row]) -> str:
    head = [
        "walk", "cell mm", "rings", "curls", "CM", "bias mm", "rms mm", "worst rms mm",
        "turning rad", "/ 2 pi", "waviness (least, most)", "gaps crossed",
    ]  # fmt: skip
    return _table(head, [_walk_cells(row) for row in rows])


def _walk_cells(row: Row) -> list[str]:
    return [
        "3 x 3" if row.walk is Walk.PURE else "widening",
        f"{row.cell_mm:g}",
        f"{row.rings} of {row.seeds}",
        f"{row.curls}",
        f"{row.centres:.0f}",
        f"{row.bias_mm:+.3f}",
        f"{row.rms_mm:.3f}",
        f"{row.worst_rms_mm:.3f}",
        f"{row.ring_turning_rad:.1f}",
        f"{row.ring_turning_rad / math.tau:.2f}",
        f"{row.waviness:.2f} ({row.least_waviness:.2f}, {row.most_waviness:.2f})",
        f"{row.bridges:.1f}",
    ]


def _cylinder_values(found: Findings) -> dict[str, str]:
    made, rows = found.cylinder, found.cylinder_rows
    after = made.plain.cleaned.after
    true = cylinder_volume_mm3()
    widest = max(row.widest_deg for row in rows)
    return {
        "cylinder_points": f"{len(made.cloud_mm)}",
        "cylinder_table": _cylinder_table(rows),
        "cylinder_pure": f"{sum(row.pure.closed for row in rows)}",
        "cylinder_wide": f"{sum(row.section.contour.closed for row in rows)}",
        "cylinder_slices": f"{len(rows)}",
        "cylinder_empty": _span([100.0 * row.empty for row in rows], 0),
        "cylinder_cells": _span([row.section.resolution.cell_mm for row in rows], 2),
        "cylinder_width": _span([row.section.thickness.width_mm for row in rows], 2),
        "cylinder_tilt": f"{max(row.tilt_error_deg for row in rows):.2f}",
        "cylinder_runs": f"{len(made.plain.runs)}",
        "cylinder_count": f"{len(rows[0].section.curve.control_points_mm)}",
        "cylinder_faces": f"{after.faces}",
        "cylinder_sound": _yes(after.sound),
        "cylinder_volume": f"{after.volume_mm3 / 1000.0:.1f}",
        "cylinder_true": f"{true / 1000.0:.1f}",
        "cylinder_lost": f"{100.0 * (after.volume_mm3 / true - 1.0):+.1f}",
        "cylinder_measured": _span([row.measured.rms_mm for row in rows], 2),
        "cylinder_beside": _span([row.beside.rms_mm for row in rows], 2),
        "cylinder_bridged": _span([row.bridged.rms_mm for row in rows], 1),
        "cylinder_worst": f"{max(row.bridged.max_mm for row in rows):.1f}",
        "widest": f"{widest:.0f}",
        "sagitta": f"{RADIUS_MM * (1.0 - math.cos(math.radians(widest / 2.0))):.1f}",
    }


def _cylinder_table(rows: Sequence[CylinderRow]) -> str:
    head = [
        "slice", "points", "empty %", "widest hole", "cell mm", "CM", "CP", "3 x 3 walk",
        "widening walk", "error, measured mm", "error, beside a gap mm", "error, in gaps mm",
    ]  # fmt: skip
    return _table(head, [_cylinder_cells(row) for row in rows])


def _cylinder_cells(row: CylinderRow) -> list[str]:
    section = row.section
    walked = f"{len(section.contour.points_mm)}"
    return [
        f"{section.index + 1}",
        f"{section.points}",
        f"{100.0 * row.empty:.0f}",
        f"{row.widest_deg:.0f}°",
        f"{section.resolution.cell_mm:.2f}",
        walked,
        f"{len(section.curve.control_points_mm)}",
        "closes" if row.pure.closed else f"stops after {len(row.pure.points_mm)} CM",
        "closes" if section.contour.closed else f"open after {walked} CM",
        _error(row.measured),
        _error(row.beside),
        _error(row.bridged),
    ]


def _cone_values(found: Findings) -> dict[str, str]:
    made, rows = found.cone, found.cone_rows
    after = made.plain.cleaned.after
    low, top = rows[0].section.height_mm, rows[-1].section.height_mm
    patched = sum(len(run) - 1 for run in made.plain.runs)
    first_fine = next(row for row in rows if row.section.resolution.reason == "the width")
    return {
        "diameter": f"{2.0 * RADIUS_MM:g}",
        "height": f"{HEIGHT_MM:g}",
        "width": f"{WIDTH_MM:g}",
        "cone_points": f"{len(made.cloud_mm)}",
        "cone_aside": f"{sum(made.cutting.aside.values())}",
        "cone_frustum_lost": f"{100.0 * (after.volume_mm3 / frustum_mm3(low, top) - 1.0):+.1f}",
        "cone_table": _cone_table(rows),
        "cone_sections": f"{len(rows)}",
        "cone_bases": f"{sum(row.section.base for row in rows)}",
        "cone_patched": f"{patched}",
        "cone_paired": f"{len(rows) - 1 - patched}",
        "cone_patches": f"{len(made.plain.patches)}",
        "cone_upward": _counts_upward(rows),
        "cone_switch": f"{first_fine.radius_mm:.1f}",
        "cone_faces": f"{after.faces}",
        "cone_sound": _yes(after.sound),
        "cone_volume": f"{after.volume_mm3 / 1000.0:.2f}",
        "cone_true": f"{frustum_mm3(0.0, HEIGHT_MM) / 1000.0:.2f}",
        "cone_lost": f"{100.0 * (after.volume_mm3 / frustum_mm3(0.0, HEIGHT_MM) - 1.0):+.1f}",
        "cone_top": f"{top:.1f}",
        "cone_missing": f"{HEIGHT_MM - top:.1f}",
        "cone_blunt": f"{rows[-1].radius_mm:.1f}",
        "cone_tip": f"{frustum_mm3(top, HEIGHT_MM):.0f}",
        "cone_skipped": "; ".join(
            f"slice {each.index + 1} ({each.points} points): {each.reason}"
            for each in made.plain.skipped
        ) or "none",
        "cone_errors": _span([row.errors.rms_mm for row in rows], 2),
        "cone_relative": _span([100.0 * row.errors.rms_mm / row.radius_mm for row in rows], 1),
        "step": f"{CONE_STEP_MM:g}",
        "scatter_table": _scatter_table(found),
    }  # fmt: skip


def _counts_upward(rows: Sequence[ConeRow]) -> str:
    runs = groupby(rows, key=lambda row: row.control_points)
    return ", ".join(f"{count} ({len(list(group))})" for count, group in runs)


def _cone_table(rows: Sequence[ConeRow]) -> str:
    head = [
        "section", "height mm", "true radius mm", "cell mm", "CM", "length mm", "of the base",
        "base?", "CP", "connected to the one below", "bias mm", "rms mm",
    ]  # fmt: skip
    return _table(head, [_cone_cells(row, first=row is rows[0]) for row in rows])


def _cone_cells(row: ConeRow, *, first: bool) -> list[str]:
    section = row.section
    share = f"{100.0 * (section.length_mm / row.base_mm - 1.0):+.1f} %"
    joint = f"{row.pairs} pairs" if row.pairs else "one to one"
    return [
        f"{section.index + 1}",
        f"{section.height_mm:.1f}",
        f"{row.radius_mm:.1f}",
        f"{section.resolution.cell_mm:.2f}",
        f"{row.centres}",
        f"{section.length_mm:.1f}",
        "" if first else share,
        "**base**" if section.base else "",
        f"{row.control_points}",
        "" if first else joint,
        f"{row.errors.mean_mm:+.2f}",
        f"{row.errors.rms_mm:.2f}",
    ]


def _scatter_table(found: Findings) -> str:
    kinds = (
        ("points in bands (Figs. 9 to 11)", found.cone, found.cone_rows),
        ("points all over the side", found.scattered, found.scattered_rows),
    )
    head = [
        "cloud", "points", "sections", "cloud width mm", "cell mm", "rms mm", "ends at mm",
        "volume",
    ]  # fmt: skip
    return _table(head, [_scatter_cells(*kind) for kind in kinds])


def _scatter_cells(name: str, made: Made, rows: Sequence[ConeRow]) -> list[str]:
    volume = made.plain.cleaned.after.volume_mm3
    low, top = rows[0].section.height_mm, rows[-1].section.height_mm
    return [
        name,
        f"{len(made.cloud_mm)}",
        f"{len(rows)}",
        _span([row.section.thickness.width_mm for row in rows], 1),
        _span([row.section.resolution.cell_mm for row in rows], 1),
        _span([row.errors.rms_mm for row in rows], 2),
        f"{low:.1f} and {top:.1f}",
        f"{100.0 * (volume / frustum_mm3(0.0, HEIGHT_MM) - 1.0):+.1f} %",
    ]


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _error(error: Deviation) -> str:
    return f"{error.rms_mm:.2f} (most {error.max_mm:.2f})"


def _span(values: Sequence[float], digits: int) -> str:
    return f"{min(values):.{digits}f} to {max(values):.{digits}f}"


def _yes(holds: bool) -> str:  # noqa: FBT001
    return "closed, oriented and manifold" if holds else "**no sound solid**"
