"""The numbers of a result: metrics.json, one flat object, millimetres throughout."""

from __future__ import annotations

import math
import resource
import sys
from collections.abc import Mapping, Sequence

import numpy as np

from drivers.profiler import Reason
from loftscan.gathering import Gathered
from loftscan.methods import AnyReconstruction
from loftscan.shape_findings import apexes_said, shapes_said
from loftscan.sliced import Counted, Sliced
from reconstruction.comparison import Deviation
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.pipeline import Reconstruction
from reconstruction.setting_aside import Aside


def gather(
    source: Counted, cutting: Sliced, done: AnyReconstruction, deviation: Deviation
) -> dict[str, object]:
    """Collect what metrics.json says; docs/result-folder.md explains every name."""
    return {
        **_points(source, cutting, done),
        **_sections(cutting, done),
        **_residuals(done),
        **_surface(done, deviation),
    }


def of_scan(gathered: Gathered) -> dict[str, object]:
    """Collect what metrics.json says besides of slices that a scan delivered.

    docs/scan-folder.md explains these names.
    """
    reasons = {reason.name.lower(): int(gathered.reasons[reason]) for reason in Reason}
    del reasons["measured"]
    damaged = sum(absent.damage is not None for absent in gathered.absent)
    return {
        "points_invalid_by_reason": reasons,
        "points_lost": reasons["lost"],
        "profiles": gathered.profiles,
        "slices_missing": len(gathered.absent) - damaged,
        "slices_damaged": damaged,
    }


def lag(lags_s: Sequence[float], appeared_s: Sequence[float]) -> dict[str, object]:
    """How long sections came after their slices, and how long the slices after one another.

    Nothing where no slice was waited for.
    """
    if not lags_s:
        return {}
    steps_s = np.diff(np.sort(appeared_s))
    return {
        "lag_median_s": float(np.median(lags_s)),
        "lag_max_s": max(lags_s),
        "lag_slices": len(lags_s),
        "slice_period_median_s": float(np.median(steps_s)) if len(steps_s) else None,
    }


def _points(source: Counted, cutting: Sliced, done: AnyReconstruction) -> dict[str, object]:
    aside = {reason.name.lower(): cutting.aside.get(reason, 0) for reason in Aside}
    in_skipped = sum(each.points for each in done.skipped)
    return {
        "points_in": source.points,
        "points_invalid": source.invalid,
        "points_set_aside": sum(aside.values()),
        "points_set_aside_by_reason": aside,
        "points_in_sections": sum(section.points for section in done.sections),
        "points_in_skipped_slices": in_skipped,
        "points_left_out": sum(section.left_out for section in done.sections),
    }


def _sections(cutting: Sliced, done: AnyReconstruction) -> dict[str, object]:
    sections = done.sections
    length = sum(section.length_mm for section in sections)
    curves = [drawn.curve for section in sections for drawn in section.curves]
    own = _of_paper(done) if isinstance(done, Reconstruction) else _of_fit(done)
    return {
        "slices": len(cutting.counts),
        "sections": len(sections),
        "slices_skipped": len(done.skipped),
        "spacing_mm": cutting.spacing.step_mm,
        "spacing_rule": cutting.spacing.rule.value,
        "patches": len(done.patches),
        "control_points": sum(len(curve.control_points_mm) for curve in curves),
        "patch_control_points": sum(patch.weights.size for patch in done.patches),
        "thickness_mm": float(np.median([section.width_mm for section in sections])),
        "thickness_definition": f"median over sections of 4 sigma, {done.SIGMA_RULE}",
        "radius_mm": _finite(float(np.median([section.radius_mm for section in sections]))),
        "gap_fraction": sum(section.gap_mm for section in sections) / length,
        "sections_open": sum(not section.closed for section in sections),
        **own,
    }


def _of_paper(done: Reconstruction) -> dict[str, object]:
    sections = done.sections
    return {
        "cell_mm": float(np.median([s.resolution.cell_mm for s in sections])),
        "cell_by_rule_mm": float(np.median([s.resolution.rule_mm for s in sections])),
        "sections_not_simple": sum(
            not is_one_turn(section.contour.rotations) for section in sections
        ),
    }


def _of_fit(done: FittedReconstruction) -> dict[str, object]:
    branching, skins = done.skinned.branching, done.skinned.skins
    return {
        "layout": done.skinned.layout.value,
        "surface_open": done.skinned.open,
        "contours": sum(len(section.outlines.outlines) for section in done.sections),
        "contours_left_out": len(branching.left_out),
        "contours_open": sum(len(section.outlines.runs) for section in done.sections),
        "branches": len(branching.branches),
        "joints": len(branching.joints),
        "cavities": sum(branch.hole for branch in branching.branches),
        "mesh_tolerance_mm": done.skinned.tolerance_mm,
        "branches_exact": sum(shape is not None for shape in done.skinned.shapes),
        "shapes": shapes_said(done),
        "apexes": apexes_said(done),
        "surface_sigma_mm": float(np.median([skin.noise.level_mm2**0.5 for skin in skins])),
    }


def is_one_turn(rotations: float) -> bool:
    """Whether a contour's direction turns round once: a contour that does not crosses itself."""
    return math.isclose(abs(rotations), 1.0, abs_tol=1e-6)


def _residuals(done: AnyReconstruction) -> dict[str, object]:
    near, every = done.residual, done.residual_all
    return {
        "residual_rms_mm": _finite(near.rms_mm),
        "residual_max_mm": near.max_mm,
        "residual_mean_mm": _finite(near.mean_mm),
        "residual_points": near.count,
        "residual_rule": (
            "in-plane distance of every unreduced point to its section's curve; points farther "
            f"than {done.REACH} belong to something the section does not describe and are left out"
        ),
        "residual_all_rms_mm": _finite(every.rms_mm),
        "residual_all_max_mm": every.max_mm,
        "residual_all_points": every.count,
    }


def _surface(done: AnyReconstruction, deviation: Deviation) -> dict[str, object]:
    sound = done.cleaned.after
    statistics, verdict = deviation.statistics, deviation.verdict
    return {
        "surface_deviation_rms_mm": statistics.rms_mm,
        "surface_deviation_95_mm": statistics.absolute_95_mm,
        "surface_deviation_max_mm": max(-statistics.min_mm, statistics.max_mm),
        "surface_deviation_points": statistics.count,
        "tolerance_mm": verdict and verdict.tolerance_mm,
        "share_within_tolerance": verdict and verdict.share_within,
        "within_tolerance": verdict and verdict.within,
        "vertices": sound.vertices,
        "faces": sound.faces,
        "watertight": sound.watertight,
        "oriented": sound.oriented,
        "manifold": sound.manifold,
        "euler_number": sound.euler_number,
        "components": sound.components,
        "volume_mm3": _finite(sound.volume_mm3),
        "area_mm2": sound.area_mm2,
    }


def resources(seconds: Mapping[str, float]) -> dict[str, object]:
    """Seconds by stage and in all, and the peak memory of this process and of its children."""
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    unit = 1024.0 if sys.platform != "darwin" else 1024.0 * 1024.0
    return {
        "seconds": sum(seconds.values()),
        "seconds_by_stage": dict(seconds),
        "peak_memory_mb": own / unit,
        "peak_memory_children_mb": children / unit,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
