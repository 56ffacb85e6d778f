"""All slices of a scan to one solid, or to one open surface.

outlines of every slice -> branches -> a surface each -> closed meshes -> one watertight solid
           `drawing`       `branching`    `skin`          `closing`       `joining`
                                       or `exact_skins`
open sections of every slice -> one surface -> its mesh, closed if it goes all round
                       `sheets`
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.fitting.curve import Exact
from reconstruction.meshing import Mesh
from reconstruction.skinning.beyond import seen_beyond
from reconstruction.skinning.branch import Branch
from reconstruction.skinning.branching import Branching, find_branches
from reconstruction.skinning.closing import affordable_mm, closed_mesh, open_mesh
from reconstruction.skinning.doubt import Doubt
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.exact_ends import Levels
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.exact_skins import (
    AnySkin,
    exact_in_place_of,
    exact_of_meridians,
    exact_skin,
)
from reconstruction.skinning.folding import fold
from reconstruction.skinning.joining import join_solids
from reconstruction.skinning.layout import Layout, fan_of, layout_of
from reconstruction.skinning.outlines import Moments, Outline, lifted
from reconstruction.skinning.primitives import Cone, Cylinder
from reconstruction.skinning.sheets import Sheet, fit_meridians, fit_stripes
from reconstruction.skinning.skin import Skin, skin_branch
from reconstruction.skinning.standing_in import Nurbs, part_of

_THICK = 2.0  # times the usual scatter
_CHORD = 0.05  # of the scatter of the points: what a facet may stand off the surface
_LEAST_CHORD = 2e-5  # of the part's size
_FINER = 0.2  # of that, on cylinders and cones: narrow facets follow them at little cost
_LEAST_FINER = 0.4
_SLIVER = 0.05  # of the chord


@dataclass(frozen=True, slots=True, eq=False)
class Skinned:
    """The surface of a scan."""

    branching: Branching
    skins: tuple[AnySkin, ...]  # one a branch, from the outside in
    mesh: Mesh  # watertight, unless the surface is open
    tolerance_mm: float  # between mesh and surfaces
    wrapping: str = ""  # why the mesh is not that of the skins, but one around all points
    layout: Layout = Layout.RINGS

    @property
    def open(self) -> bool:
        """Whether the surface has borders and encloses nothing."""
        return any(skin.open for skin in self.skins)

    @property
    def shown(self) -> tuple[AnySkin, ...]:
        """The skins whose surfaces are the part: none where a mesh stands in for them."""
        return () if self.wrapping else self.skins

    @property
    def shapes(self) -> tuple[Shape | None, ...]:
        """The exact shape of every shown skin; None where its surface is a free one."""
        return tuple(skin.shape for skin in self.shown)


def skin_slices(
    slices: Sequence[SliceOutlines],
    *,
    tolerance_mm: float | None = None,
    exact: Exact = Exact.AUTO,
    nurbs: Nurbs = Nurbs.AUTO,
    layout: Layout = Layout.AUTO,
) -> Skinned:
    """Fit, close and join the surfaces of slices, given in any order.

    Sections that are open, in parallel planes or about an axis, are given one surface.

    Parameters
    ----------
    layout
        What the slices are sections of; by default as they show themselves.
    tolerance_mm
        Between mesh and surfaces; by default a share of the scatter of the points, less where a
        surface is exact.
    exact
        Whether a branch whose points are one exact shape is given its surface.
    nurbs
        Whether a mesh may stand in for surfaces that do not follow the points.

    Raises
    ------
    NotLoftable
        Fewer than two slices with outlines, or none that follow each other.
    Unfittable
        Open sections whose points do not hold a surface.
    """
    found = layout_of(slices, layout)
    # Matrices are small or come one after the other: threads of BLAS would only wait.
    with threadpool_limits(1, "blas"):
        if found is Layout.RINGS:
            return _skin_rings(slices, tolerance_mm=tolerance_mm, exact=exact, nurbs=nurbs)
        return _skin_open(slices, found, tolerance_mm=tolerance_mm, exact=exact)


def _skin_open(
    slices: Sequence[SliceOutlines], found: Layout, *, tolerance_mm: float | None, exact: Exact
) -> Skinned:
    """One surface through stripes or meridians."""
    sheet = _sheet(slices, found)
    skin = _exact_in_place_of(sheet.skin) if exact is Exact.AUTO else sheet.skin
    chord = tolerance_mm or affordable_mm(skin, _chord(skin, (skin,)))
    if isinstance(skin, Skin) and skin.open:
        mesh = open_mesh(skin, chord)
    else:
        mesh = closed_mesh(skin, chord)
    left_out = tuple(outline for piece in slices for outline in piece.outlines)
    doubts = [Doubt(each, "stands out from both neighbours: left out") for each in sheet.wild]
    doubts += [
        Doubt(each.slice_index, "a closed contour among open sections: left out")
        for each in left_out
    ]
    branching = Branching((skin.branch,), (), tuple(doubts), left_out)
    return Skinned(branching, (skin,), mesh, chord, layout=found)


def _sheet(slices: Sequence[SliceOutlines], layout: Layout) -> Sheet:
    """The one surface of stripes or meridians."""
    fan = fan_of([piece.frame for piece in slices])
    if layout is Layout.STRIPES:
        if fan is not None:
            raise NotLoftable("the slices' planes are not parallel: they are meridians, no stripes")
        return fit_stripes(sorted(slices, key=lambda each: each.height_mm))
    if fan is None:
        raise NotLoftable("the slices' planes are parallel: they are no meridians about an axis")
    return fit_meridians(slices, fan)


def _exact_in_place_of(skin: Skin) -> AnySkin:
    return exact_of_meridians(skin) or skin


def _skin_rings(
    slices: Sequence[SliceOutlines],
    *,
    tolerance_mm: float | None,
    exact: Exact,
    nurbs: Nurbs,
) -> Skinned:
    """Branches, a surface each, joined."""
    stack = sorted(slices, key=lambda each: each.height_mm)
    heights = np.array([each.height_mm for each in stack])
    thick = _thick(stack)
    outlines = [[each for each in piece.outlines if id(each) not in thick] for piece in stack]
    unresolved = [
        each.unresolved or any(id(outline) in thick for outline in each.outlines) for each in stack
    ]
    indices = [each.index for each in stack]
    branching = find_branches(outlines, heights, indices=indices, unresolved=unresolved)
    loose = _loose(stack, branching, thick.values())
    heaps = [doubt and not held for doubt, held in zip(unresolved, outlines, strict=True)]
    levels = Levels(heights, np.array(heaps))
    skins = tuple(_skin(branch, loose, levels, stack, exact) for branch in fold(branching.branches))
    chords = [tolerance_mm or affordable_mm(skin, _chord(skin, skins)) for skin in skins]
    mesh = _united(skins, chords, stack[0].frame.axes[2])
    instead = ""
    if nurbs is Nurbs.AUTO:
        mesh, instead = part_of(mesh, skins, branching.joints, stack)
    return Skinned(branching, skins, mesh, max(chords), instead)


def _united(skins: Sequence[AnySkin], chords: Sequence[float], axis: FloatArray) -> Mesh:
    """One closed mesh of all branches."""
    parts = [closed_mesh(skin, chord) for skin, chord in zip(skins, chords, strict=True)]
    holes = [skin.branch.hole for skin in skins]
    if len(parts) == 1 and not holes[0]:  # closed already, without the slivers that unions leave
        return parts[0]
    return join_solids(parts, holes, within_mm=_SLIVER * min(chords), normal=axis)


def _skin(
    branch: Branch,
    loose: Moments | None,
    levels: Levels,
    stack: Sequence[SliceOutlines],
    exact: Exact,
) -> AnySkin:
    found = None if exact is Exact.NEVER else exact_skin(branch, loose, levels)
    if found is not None:
        return found
    free = skin_branch(seen_beyond(branch, stack), loose)
    return free if exact is Exact.NEVER else exact_in_place_of(free, levels) or free


def _thick(stack: Sequence[SliceOutlines]) -> dict[int, Outline]:
    """Contours far thicker than is usual: two walls too near each other to be told apart."""
    every = [outline for piece in stack for outline in piece.outlines]
    usual = float(np.median([each.fitted.sigma_mm for each in every])) if every else 0.0
    return {id(each): each for each in every if each.fitted.sigma_mm > _THICK * usual}


def _loose(
    stack: Sequence[SliceOutlines], branching: Branching, thick: Iterable[Outline]
) -> Moments | None:
    """Points of contours that no branch follows, and of open runs: they lie on some surface.

    One by one: what a cell of such a contour holds need not lie on one wall.
    """
    runs = [run for piece in stack for run in piece.runs]
    parts = [
        lifted(each.fitted.cells.only(np.flatnonzero(each.fitted.cells.counts == 1.0)), each.frame)
        for each in (*branching.left_out, *thick, *runs)
    ]
    return Moments.together(parts) if parts else None


def _chord(skin: AnySkin, skins: Sequence[AnySkin]) -> float:
    sigma = float(np.median([each.noise.level_mm2**0.5 for each in skins]))
    places = np.concatenate([each.surface.control_points_mm.reshape(-1, 3) for each in skins])
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    if skin.shape is not None and isinstance(skin.shape.form, Cylinder | Cone):
        return max(_FINER * _CHORD * sigma, _LEAST_FINER * _LEAST_CHORD * size)
    return max(_CHORD * sigma, _LEAST_CHORD * size)
