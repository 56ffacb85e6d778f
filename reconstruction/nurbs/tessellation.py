"""A surface as triangles within a tolerance, watertight with its neighbours.

The points are laid out by second derivatives (`layout`), the triangles then measured at many places
(`chordal_error`), and laid out again more or less densely until they are just good enough. Seams of
closed directions and poles are one vertex each, so a closed surface comes out closed; along a
border that was given its points, a neighbour that was given the same has the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.nurbs.chordal_error import Placed, chordal_error
from reconstruction.nurbs.layout import Border, Layout, Sheet, lay, sheet_of
from reconstruction.nurbs.surface_evaluation import evaluate_surface_at
from reconstruction.nurbs.values import Surface

_ONE_POINT = 1e-12  # of the surface's extent: a border so short is a pole
_AIMED, _GOOD = 0.93, 0.85  # parts of the tolerance: aimed at, and near enough to stop
_ALLOWED = 0.97  # the worst place of an edge or a face is not quite one that is measured
_TRIES = 12


@dataclass(frozen=True, slots=True, eq=False)
class Tessellation:
    """Triangles with their corners on a surface, counter-clockwise against its normals S_u x S_v.

    `borders` names the vertices along each border of an open direction, by growing parameter; at a
    pole that is one vertex.
    """

    parameters: FloatArray  # (n, 2)
    points_mm: FloatArray  # (n, 3)
    faces: IntArray  # (m, 3)
    borders: Mapping[Border, IntArray]
    measured_mm: float  # how far the triangles are off where they were measured

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", frozen(self.parameters))
        object.__setattr__(self, "points_mm", frozen(self.points_mm))
        object.__setattr__(self, "faces", frozen(self.faces, np.int64))


def tessellate(
    surface: Surface,
    *,
    tolerance_mm: float,
    borders: Mapping[Border, ArrayLike] | None = None,
) -> Tessellation:
    """Cut a surface into triangles that lie within a tolerance of it, and it of them.

    Parameters
    ----------
    borders
        For some borders the parameters, growing from the domain's start to its end, at which they
        have their points. Between coarse ones the tolerance cannot be kept: triangles that stand on
        them are not measured.

    Raises
    ------
    ValueError
        The tolerance is not positive or too fine, or parameters of a border that do not grow from
        the start to the end of the domain, or of one that a closed surface does not have.
    """
    sheet = sheet_of(surface, borders or {})
    best: _Filled | None = None
    allowed_mm = tolerance_mm
    for tried in range(_TRIES):
        made = _filled(sheet, allowed_mm)
        good = made.off_mm <= _ALLOWED * tolerance_mm
        if good and (best is None or len(made.faces) < len(best.faces)):
            best = made
        if best is not None and (made.off_mm >= _GOOD * tolerance_mm or tried >= _TRIES // 2):
            return _finished(sheet, best)
        aim = _AIMED * tolerance_mm / max(made.off_mm, 1e-300)
        allowed_mm *= float(np.clip(aim, 0.25, 4.0))
    raise ValueError(f"triangles within {tolerance_mm:g} mm of this surface were not found")


@dataclass(frozen=True, slots=True, eq=False)
class _Filled:
    """A layout filled with triangles."""

    turned: bool  # u and v are exchanged
    layout: Layout
    placed: Placed
    faces: IntArray  # (m, 3), none without area
    off_mm: float


def _filled(sheet: Sheet, tolerance_mm: float) -> _Filled:
    """Fill the sheet, its rows along u or along v, whichever needs fewer points."""
    layouts = [lay(each, tolerance_mm=tolerance_mm) for each in (sheet, sheet.turned)]
    turned = bool(layouts[1].kept.sum() < layouts[0].kept.sum())
    layout, lying = layouts[int(turned)], sheet.turned if turned else sheet
    placed = _placed(lying, layout)
    strips = layout.strips()
    faces = np.concatenate([each.triangles(placed.parameters, lying.flat) for each in strips])
    a, b, c = placed.same[faces].T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return _Filled(turned, layout, placed, faces, chordal_error(lying, placed, faces))


def _placed(sheet: Sheet, layout: Layout) -> Placed:
    """Evaluate the points, and tell which are one: across seams, and at poles."""
    numbers, kept = layout.numbers, layout.kept
    loose = np.zeros((*kept.shape, 2), dtype=np.bool_)
    if sheet.closed[0]:
        numbers[:, -1] = numbers[:, 0]
    if sheet.closed[1]:
        numbers[-1] = numbers[0]
    net = sheet.surface.control_points_mm
    for end in (0, -1):
        if not sheet.closed[1] and _is_point(net, net[:, end]):
            numbers[end, kept[end]] = numbers[end, 0]
            loose[end, :, 0] = True
        if not sheet.closed[0] and _is_point(net, net[end]):
            numbers[kept[:, end], end] = numbers[0, end]
            loose[:, end, 1] = True
    parameters = layout.parameters
    points = evaluate_surface_at(sheet.surface, *parameters.T)
    held = np.zeros(len(points), dtype=np.int64)
    for bit, side in enumerate(layout.listed):
        held[layout.border(side)] |= 1 << bit
    return Placed(parameters, points, numbers[kept], loose[kept], held)


def _is_point(net_mm: FloatArray, border_mm: FloatArray) -> bool:
    """Whether a border is a pole: all its control points are one."""
    extent = float(np.ptp(net_mm, axis=(0, 1)).max())
    return float(np.ptp(border_mm, axis=0).max()) <= _ONE_POINT * extent


def _finished(sheet: Sheet, made: _Filled) -> Tessellation:
    """Number the vertices that are left, and turn everything back to u and v."""
    placed = made.placed
    faces = placed.same[made.faces]
    used = np.zeros(len(placed.points_mm), dtype=np.bool_)
    used[faces.ravel()] = True
    number = np.cumsum(used) - 1
    parameters, faces = placed.parameters[used], number[faces]
    lying = sheet.closed[::-1] if made.turned else sheet.closed
    open_sides = [
        *((Border.U_START, Border.U_END) if not lying[0] else ()),
        *((Border.V_START, Border.V_END) if not lying[1] else ()),
    ]
    borders = {side: _once(number[placed.same[made.layout.border(side)]]) for side in open_sides}
    if made.turned:
        parameters, faces = parameters[:, ::-1], faces[:, ::-1]
        borders = {side.across: ids for side, ids in borders.items()}
    return Tessellation(parameters, placed.points_mm[used], faces, borders, made.off_mm)


def _once(ids: IntArray) -> IntArray:
    """Leave out a vertex that stands beside itself, as at a pole."""
    apart: BoolArray = np.concatenate([[True], np.diff(ids) != 0])
    return frozen(ids[apart], np.int64)
