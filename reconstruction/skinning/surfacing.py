"""All slices of a scan to one solid: branches, a surface each, closed, joined.

outlines of every slice -> branches -> a surface each -> closed meshes -> one watertight solid
           `drawing`       `branching`    `skin`          `closing`       `joining`
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.meshing import Mesh
from reconstruction.skinning.branching import Branching, find_branches
from reconstruction.skinning.closing import closed_mesh
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.folding import fold
from reconstruction.skinning.joining import join_solids
from reconstruction.skinning.outlines import Moments, Outline, lifted
from reconstruction.skinning.skin import Skin, skin_branch

_THICK = 2.0  # times the usual scatter
_CHORD = 0.1  # of the scatter of the points: what a facet may stand off the surface
_LEAST_CHORD = 2e-5  # of the part's size
_SLIVER = 0.05  # of the chord


@dataclass(frozen=True, slots=True, eq=False)
class Skinned:
    """The surface of a scan."""

    branching: Branching
    skins: tuple[Skin, ...]  # one a branch, from the outside in
    mesh: Mesh  # watertight
    tolerance_mm: float  # between mesh and surfaces


def skin_slices(slices: Sequence[SliceOutlines], *, tolerance_mm: float | None = None) -> Skinned:
    """Fit, close and join the surfaces of slices, given in any order.

    Raises
    ------
    NotLoftable
        Fewer than two slices with outlines, or none that follow each other.
    """
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
    skins = tuple(skin_branch(branch, loose) for branch in fold(branching.branches))
    within = tolerance_mm or _chord(skins)
    parts = [closed_mesh(skin, within) for skin in skins]
    holes = [skin.branch.hole for skin in skins]
    axis = stack[0].frame.axes[2]
    mesh = join_solids(parts, holes, within_mm=_SLIVER * within, normal=axis)
    return Skinned(branching, skins, mesh, within)


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


def _chord(skins: Sequence[Skin]) -> float:
    sigma = float(np.median([skin.fit.noise.level_mm2**0.5 for skin in skins]))
    places = np.concatenate([skin.fit.net.control_mm.reshape(-1, 3) for skin in skins])
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    return max(_CHORD * sigma, _LEAST_CHORD * size)
