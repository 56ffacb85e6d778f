"""All slices of a scan to one solid: branches, a surface each, closed, joined.

outlines of every slice -> branches -> a surface each -> closed meshes -> one watertight solid
           `drawing`       `branching`    `skin`          `closing`       `joining`
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.meshing import Mesh
from reconstruction.skinning.beyond import seen_beyond
from reconstruction.skinning.branching import Branching, find_branches
from reconstruction.skinning.closing import closed_mesh
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.folding import fold
from reconstruction.skinning.joining import join_solids
from reconstruction.skinning.outlines import Moments, Outline, lifted
from reconstruction.skinning.skin import Skin, skin_branch
from reconstruction.skinning.wrapping import Swarm, share_apart, share_far, wrapped

_THICK = 2.0  # times the usual scatter
_CHORD = 0.1  # of the scatter of the points: what a facet may stand off the surface
_LEAST_CHORD = 2e-5  # of the part's size
_SLIVER = 0.05  # of the chord
_FAR_SHARE = 0.02  # of the points: more of them off the branches' surfaces are no outliers
_BETTER = 0.5  # of that share at most is left by a mesh that takes their place
_AS_GOOD = 0.002
_APART = 0.015  # of the area: on less, two surfaces through the same points differ anyhow
_NEAR_END = 4  # outlines
_JUMP = 5.0  # times the usual way from outline to outline
_JUMPING = 0.02  # of an outline


@dataclass(frozen=True, slots=True, eq=False)
class Skinned:
    """The surface of a scan."""

    branching: Branching
    skins: tuple[Skin, ...]  # one a branch, from the outside in
    mesh: Mesh  # watertight
    tolerance_mm: float  # between mesh and surfaces
    wrapping: str = ""  # why the mesh is not that of the skins, but wrapped around all points


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
    branches = [seen_beyond(branch, stack) for branch in fold(branching.branches)]
    skins = tuple(skin_branch(branch, loose) for branch in branches)
    within = tolerance_mm or _chord(skins)
    parts = [closed_mesh(skin, within) for skin in skins]
    holes = [skin.branch.hole for skin in skins]
    axis = stack[0].frame.axes[2]
    mesh = join_solids(parts, holes, within_mm=_SLIVER * within, normal=axis)
    return _wrapped_if_better(Skinned(branching, skins, mesh, within), stack)


def _wrapped_if_better(skinned: Skinned, stack: Sequence[SliceOutlines]) -> Skinned:
    """Keep the branches' mesh where it follows the points; else wrap one around them all."""
    swarm = swarm_of(stack)
    far = share_far(skinned.mesh, swarm)
    jumps = sorted(index for skin in skinned.skins for index in _jumps(skin))
    joints = skinned.branching.joints
    if far <= _FAR_SHARE and not jumps and not joints:
        return skinned
    mesh = wrapped(swarm)
    if mesh is None:
        return skinned
    left = share_far(mesh, swarm)
    why = ""
    if far > _FAR_SHARE and left <= _BETTER * far:
        why = f"{far:.1%} of the points lie farther from them than their noise explains"
    elif (jumps or joints) and _parted(skinned, mesh, swarm, left - far):
        if jumps:
            why = f"above slice {jumps[0]} a contour changes at once, where they cannot follow"
        else:
            why = f"where branches meet, as at {joints[0].height_mm:.4g} mm, they part from them"
    if not why:
        return skinned
    words = f"the branches' NURBS surfaces do not follow the points: {why}"
    instead = f"one mesh around all points, {left:.1%} of which it misses, is the part instead"
    return replace(skinned, mesh=mesh, wrapping=f"{words}; {instead}")


def _parted(skinned: Skinned, mesh: Mesh, swarm: Swarm, worse: float) -> bool:
    """Whether a wrapped mesh is about as near to the points, and yet another surface."""
    return worse <= _AS_GOOD and share_apart(skinned.mesh, mesh, swarm) > _APART


def _jumps(skin: Skin) -> list[int]:
    """Slices above which part of a branch's outline jumps far beyond its neighbours.

    Not at the ends: towards a dome's top, outlines shrink fast.
    """
    steps = np.linalg.norm(np.diff(skin.stations.places_mm, axis=0), axis=2)
    if len(steps) <= 2 * _NEAR_END:
        return []
    inner = steps[_NEAR_END:-_NEAR_END]
    jumping = (inner > _JUMP * float(np.median(inner))).mean(axis=1) > _JUMPING
    outlines = skin.branch.outlines
    return [outlines[_NEAR_END + int(k)].slice_index for k in np.flatnonzero(jumping)]


def swarm_of(stack: Sequence[SliceOutlines]) -> Swarm:
    """All points of slices, from low to high, and their noise."""
    sigmas = [each.fitted.sigma_mm for piece in stack for each in piece.outlines]
    heights = np.array([each.height_mm for each in stack])
    return Swarm(
        np.concatenate([piece.grains.points_mm for piece in stack]),
        np.concatenate([piece.grains.counts for piece in stack]),
        float(np.median(sigmas)),
        float(np.median(np.diff(heights))),
        stack[0].frame.axes[2],
    )


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
