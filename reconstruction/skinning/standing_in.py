"""Whether the branches' surfaces are the part, or a mesh around all points must stand in for them.

Branches that follow the points are the part, and CAD gets their NURBS. Where contours ran into each
other, or changed at once, they do not; then one mesh is wrapped around all points, if that follows
them, and there are no NURBS that would be true.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from reconstruction.meshing import Mesh
from reconstruction.skinning.branch import Joint
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.exact_skins import AnySkin
from reconstruction.skinning.skin import Skin
from reconstruction.skinning.wrapping import Swarm, share_apart, share_far, wrapped

_FAR_SHARE = 0.02  # of the points: more of them off the branches' surfaces are no outliers
_BETTER = 0.5  # of that share at most is left by a mesh that takes their place
_AS_GOOD = 0.002
_APART = 0.015  # of the area: on less, two surfaces through the same points differ anyhow
_NEAR_END = 4  # outlines
_JUMP = 5.0  # times the usual way from outline to outline
_JUMPING = 0.02  # of an outline


class Nurbs(Enum):
    """Whether the part is always that of its branches' NURBS surfaces."""

    AUTO = "auto"  # a mesh stands in where it follows the points and they do not
    ALWAYS = "always"


def part_of(
    mesh: Mesh, skins: Sequence[AnySkin], joints: Sequence[Joint], stack: Sequence[SliceOutlines]
) -> tuple[Mesh, str]:
    """The mesh of the part: the branches', or one around all points and why that is.

    Parameters
    ----------
    mesh
        Of the branches.
    stack
        Slices from low to high.
    """
    joints = [joint for joint in joints if not joint.shoulder]  # walls end there as they are
    if not any(isinstance(skin, Skin) for skin in skins):
        joints = []  # between walls that are all exact shapes, tested against their points
    jumps = sorted(index for skin in skins for index in _jumps(skin))
    doubtful = bool(jumps or joints)
    if not doubtful and _share_left(skins, stack) <= _FAR_SHARE:
        return mesh, ""
    swarm = swarm_of(stack)
    far = share_far(mesh, swarm)
    if not doubtful and far <= _FAR_SHARE:
        return mesh, ""
    other = wrapped(swarm)
    if other is None:
        return mesh, ""
    left = share_far(other, swarm)
    why = ""
    if far > _FAR_SHARE and left <= _BETTER * far:
        why = f"{far:.1%} of the points lie farther from them than their noise explains"
    elif doubtful and left - far <= _AS_GOOD and share_apart(mesh, other, swarm) > _APART:
        why = (
            f"above slice {jumps[0]} a contour changes at once, where they cannot follow"
            if jumps
            else f"where branches meet, as at {joints[0].height_mm:.4g} mm, they part from them"
        )
    if not why:
        return mesh, ""
    return other, (
        f"the branches' NURBS surfaces do not follow the points: {why}; one mesh around all points,"
        f" {left:.1%} of which it misses, is the part (--nurbs always keeps the surfaces)"
    )


def swarm_of(stack: Sequence[SliceOutlines]) -> Swarm:
    """All points of slices, from low to high, and their noise."""
    sigmas = [each.fitted.sigma_mm for piece in stack for each in piece.outlines]
    heights = np.array([each.height_mm for each in stack])
    return Swarm(
        np.concatenate([piece.grains.points_mm for piece in stack]),
        np.concatenate([piece.grains.counts for piece in stack]),
        np.repeat(np.arange(len(stack)), [len(piece.grains.counts) for piece in stack]),
        float(np.median(sigmas)),
        float(np.median(np.diff(heights))),
        stack[0].frame.axes[2],
    )


def _share_left(skins: Sequence[AnySkin], stack: Sequence[SliceOutlines]) -> float:
    """The share of all points that no branch's surface goes through, as its fit saw them."""
    held = sum(
        float(skin.moments.counts[skin.fit.weights > 0.0].sum())
        if isinstance(skin, Skin)
        else float(skin.shape.moments.counts.sum())
        for skin in skins
    )
    return 1.0 - held / max(sum(float(piece.grains.counts.sum()) for piece in stack), 1.0)


def _jumps(skin: AnySkin) -> list[int]:
    """Slices above which part of a branch's outline jumps far beyond its neighbours.

    Not at the ends: towards a dome's top, outlines shrink fast.
    """
    if not isinstance(skin, Skin):
        return []
    assert skin.stations is not None, "a skin of closed outlines"
    steps = np.linalg.norm(np.diff(skin.stations.places_mm, axis=0), axis=2)
    if len(steps) <= 2 * _NEAR_END:
        return []
    inner = steps[_NEAR_END:-_NEAR_END]
    jumping = (inner > _JUMP * float(np.median(inner))).mean(axis=1) > _JUMPING
    outlines = skin.branch.outlines
    return [outlines[_NEAR_END + int(k)].slice_index for k in np.flatnonzero(jumping)]
