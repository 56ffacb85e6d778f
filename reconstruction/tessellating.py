"""Tessellated patches into one mesh: borders that were given the same points are joined.

Patches meet without a gap when both were tessellated with the same parameters along the border
that they share (`nurbs.tessellate`): then their points are the same, and become one vertex each.
Openings that are left can be closed by flat caps, which use the border's own vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.caps import triangulate_polygon
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Border, Tessellation


class Openings(Enum):
    """What becomes of borders that nothing joins."""

    LEFT = "left open"
    CAPPED = "closed by flat caps"


@dataclass(frozen=True, slots=True)
class Seam:
    """A border of one patch that is a border of another (or of the same), either way round."""

    one: tuple[int, Border]  # number of the patch, and its border
    other: tuple[int, Border]


def mesh_patches(
    patches: Sequence[Tessellation],
    *,
    seams: Sequence[Seam] = (),
    openings: Openings = Openings.LEFT,
    meet_within_mm: float = 1e-6,
) -> Mesh:
    """Join tessellations to one mesh; vertices keep the patches' order, joined ones the first's.

    Parameters
    ----------
    meet_within_mm
        How far the points of two borders of a seam may be apart.

    Raises
    ------
    ValueError
        Two borders of a seam that have other numbers of points, or points that do not meet.
    """
    starts = np.concatenate([[0], np.cumsum([len(patch.points_mm) for patch in patches])])
    points = np.concatenate([patch.points_mm for patch in patches])
    same = np.arange(len(points))
    for seam in seams:
        one, other = (starts[k] + patches[k].borders[side] for k, side in (seam.one, seam.other))
        _join(same, one, _matched(seam, points, one, other, meet_within_mm))
    faces = same[np.concatenate([patch.faces + starts[k] for k, patch in enumerate(patches)])]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if openings is Openings.CAPPED:
        caps = [_cap(points, loop) for loop in _loops(faces)]
        faces = np.concatenate([faces, *caps])
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(points[used], faces.reshape(-1, 3), np.zeros(len(used), dtype=np.bool_))


def _matched(
    seam: Seam, points: FloatArray, one: IntArray, other: IntArray, within_mm: float
) -> IntArray:
    """The other border's points in the order of the first one's."""
    if len(one) != len(other):
        raise ValueError(
            f"{_named(seam)}: {len(one)} and {len(other)} points; give both the same parameters"
        )
    ways = [other, other[::-1]]
    apart = [float(np.linalg.norm(points[one] - points[way], axis=1).max()) for way in ways]
    best = int(np.argmin(apart))
    if apart[best] > within_mm:
        raise ValueError(f"{_named(seam)}: {apart[best]:.3g} mm apart, {within_mm:g} mm allowed")
    return ways[best]


def _named(seam: Seam) -> str:
    (k, side), (m, along) = seam.one, seam.other
    return f"patch {k} at {side.value} and patch {m} at {along.value} do not meet"


def _join(same: IntArray, one: IntArray, other: IntArray) -> None:
    """Let both name the lower of the vertices they name, and all that named the higher one."""
    for a, b in zip(same[one], same[other], strict=True):
        kept, dropped = sorted((same[a], same[b]))
        same[same == dropped] = kept


def _loops(faces: IntArray) -> list[IntArray]:
    """Closed chains of vertices along the edges that only one face has, against its direction."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    alone = ~np.isin(heads * count + tails, tails * count + heads)
    following = dict(zip(heads[alone].tolist(), tails[alone].tolist(), strict=True))
    loops = []
    while following:
        start, here = next(iter(following.items()))
        del following[start]
        loop = [start]
        while here != start:
            loop.append(here)
            here = following.pop(here)
        loops.append(np.array(loop))
    return loops


def _cap(points: FloatArray, loop: IntArray) -> IntArray:
    """Triangles (n - 2, 3) over a loop, counter-clockwise along it, in its mean plane."""
    corners = points[loop] - points[loop].mean(axis=0)
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    normal /= np.linalg.norm(normal)
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    plane = np.stack([across, np.cross(normal, across)])
    return loop[triangulate_polygon(corners @ plane.T)]
