"""Sections into surfaces and rows: tensor patches where counts agree, rows for the mesh always.

Consecutive sections of equal count make a run, and a run of two or more one tensor patch that
contains its sections. Between runs there is no tensor: those bands are pair-connected triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.correspondence import counts_between
from reconstruction.errors import NotLoftable
from reconstruction.meshing import Mesh, Row, mesh_rows
from reconstruction.nurbs import Surface, evaluate_surface, loft_sections
from reconstruction.reknotting import reknot
from reconstruction.sections import Section

_MOST_MISSING = 50  # rows that stand for missing slices between two sections


def split_runs(sections: Sequence[Section]) -> list[list[Section]]:
    """Group consecutive sections of equal control-point count."""
    runs: list[list[Section]] = []
    for section in sections:
        if runs and _count(runs[-1][-1]) == _count(section):
            runs[-1].append(section)
        else:
            runs.append([section])
    return runs


def _count(section: Section) -> int:
    return len(section.curve.control_points_mm)


def loft_run(run: Sequence[Section]) -> Surface | None:
    """Skin a run with one patch, v being the height in mm; None for a run of one section."""
    if len(run) < 2:
        return None
    first = run[0].curve
    return loft_sections(
        np.stack([section.curve.control_points_mm for section in run]),
        degree_u=first.degree,
        knots_u=first.knots,
        periodic_u=True,
        parameters=np.array([section.height_mm for section in run]),
        degree_v=min(3, len(run) - 1),
    )


def lay_rows(
    runs: Sequence[Sequence[Section]], patches: Sequence[Surface | None], *, intermediate: int
) -> list[Row]:
    """Lay the rows of the mesh: knot points of every section, and rows between them.

    Parameters
    ----------
    runs, patches
        As from `split_runs` and `loft_run`, one patch (or None) a run.
    intermediate : int
        Rows between two sections (more where slices between them gave no section: one for each,
        marked synthetic), from the patch inside a run and blended between runs. Between
        runs there are as many more as connecting in pairs demands.

    Raises
    ------
    NotLoftable
        For fewer than two sections.
    """
    if sum(len(run) for run in runs) < 2:
        indices = tuple(section.index for run in runs for section in run)
        raise NotLoftable("one section alone makes no surface: two are needed", indices=indices)
    rows: list[Row] = []
    for number, (run, patch) in enumerate(zip(runs, patches, strict=True)):
        if number > 0:
            rows.extend(_blend(runs[number - 1][-1], run[0], intermediate))
        rows.append(_row(run[0]))
        for before, after in pairwise(run):
            if patch is not None:
                rows.extend(_rows_on(patch, before, after, intermediate))
            rows.append(_row(after))
    return rows


def mesh_sections(sections: Sequence[Section]) -> Mesh:
    """Mesh two sections or more, closed by a cap at either end."""
    runs = split_runs(sections)
    rows = lay_rows(runs, [loft_run(run) for run in runs], intermediate=0)
    return mesh_rows(rows, np.asarray(sections[0].frame.axes[:2]))


def _row(section: Section) -> Row:
    return Row(section.knot_points_mm, section.synthetic)


def _missing(before: Section, after: Section) -> int:
    """Slices between two sections that gave none: each gets a row of its own, marked synthetic."""
    return min(after.index - before.index - 1, _MOST_MISSING)


def _rows_on(patch: Surface, before: Section, after: Section, intermediate: int) -> list[Row]:
    missing = _missing(before, after)
    wanted = max(intermediate, missing)
    if wanted == 0:
        return []
    heights = np.linspace(before.height_mm, after.height_mm, wanted + 2)[1:-1]
    knots = np.arange(_count(before), dtype=np.float64)
    grid = evaluate_surface(patch, knots, heights)
    either = before.synthetic | after.synthetic | (missing > 0)
    return [Row(grid[:, k], either) for k in range(len(heights))]


def _blend(before: Section, after: Section, intermediate: int) -> list[Row]:
    """Rows between two runs, their counts in a row that pairs can connect."""
    counts = counts_between(_count(before), _count(after))
    missing = _missing(before, after)
    if len(counts) < max(intermediate, missing):
        counts = _spread_counts(_count(before), _count(after), max(intermediate, missing))
    rows = []
    for k, count in enumerate(counts, start=1):
        share = k / (len(counts) + 1)
        points = (1.0 - share) * _resample(before, count) + share * _resample(after, count)
        marks = _carry_marks(before, count) | _carry_marks(after, count) | (missing > 0)
        rows.append(Row(points, marks))
    return rows


def _carry_marks(section: Section, count: int) -> BoolArray:
    """Marks of the nearest knot point for each of `count` points around the section."""
    own = _count(section)
    return np.asarray(section.synthetic[np.rint(np.arange(count) * own / count).astype(int) % own])


def _spread_counts(before: int, after: int, rows: int) -> tuple[int, ...]:
    return tuple(round(before * (after / before) ** (k / (rows + 1))) for k in range(1, rows + 1))


def _resample(section: Section, count: int) -> FloatArray:
    if count == _count(section):
        return section.knot_points_mm
    knots = np.arange(count, dtype=np.float64)
    curve = reknot(section.curve, count)
    return np.asarray(curve(knots))
