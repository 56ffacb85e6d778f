"""Closed meshes of branches become one solid: united, and cavities taken out.

Branches that meet end in flat caps in the plane of their joint, so their solids touch, face on
face. The Boolean operations of manifold3d (decision 0006) decide such contact consistently: what
is united grows together, what is taken out opens what it touches. They do so where the faces lie
at exactly one height: the stack is turned upright, and heights that differ by rounding are made
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.manifolds import manifold_of, mesh_of
from reconstruction.meshing import Mesh
from reconstruction.skinning.slivers import without_slivers

_ROUNDING = 1e-11  # of the size: heights closer than that are meant to be one


def join_solids(
    parts: Sequence[Mesh],
    holes: Sequence[bool],
    *,
    within_mm: float,
    normal: ArrayLike = (0.0, 0.0, 1.0),
) -> Mesh:
    """Unite solids and take out cavities, one after the other.

    Parameters
    ----------
    parts
        Closed meshes, faces outwards (those of cavities, too), in the order of
        `branching.Branching.branches`: a solid that lies in a cavity comes after it.
    holes
        Which of them are cavities.
    within_mm
        Triangles less high than that are removed; the surface moves by less than that.
    normal
        (3,) of the cutting planes, to which the caps are parallel.

    Raises
    ------
    NotLoftable
        A part is not closed, or inside out, or nothing is left; `indices` has the part's number.
    """
    if len(parts) != len(holes):
        raise ValueError(f"holes: one for each of {len(parts)} parts expected, got {len(holes)}")
    upright = _upright(np.asarray(normal, dtype=np.float64))
    places = _levelled([each.vertices_mm @ upright.T for each in parts])
    bodies = [_body(number, *each) for number, each in enumerate(zip(parts, places, strict=True))]
    solid = manifold3d.Manifold()
    for hole, run in groupby(zip(holes, bodies, strict=True), key=lambda each: bool(each[0])):
        operation = manifold3d.OpType.Subtract if hole else manifold3d.OpType.Add
        operands = [solid, *(body for _, body in run)]
        solid = manifold3d.Manifold.batch_boolean(operands, operation)
    if solid.is_empty():
        raise NotLoftable(f"{len(parts)} parts leave no solid: {sum(holes)} of them are cavities")
    made = mesh_of(solid)
    back = Mesh(made.vertices_mm @ upright, made.faces, made.synthetic)
    return without_slivers(back, within_mm=within_mm)


def _upright(normal: FloatArray) -> FloatArray:
    """Orthonormal rows, the last along the normal; exact for coordinate axes."""
    up = normal / np.linalg.norm(normal)
    aside = np.eye(3)[np.argmin(np.abs(up))]
    aside = aside - (aside @ up) * up
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(up, aside), up])


def _levelled(places: list[FloatArray]) -> list[FloatArray]:
    """Make heights that differ by no more than rounding exactly one."""
    if not places:
        return []
    every = np.concatenate(places)
    order = np.argsort(every[:, 2])
    heights = every[order, 2]
    new = np.diff(heights, prepend=-np.inf) > _ROUNDING * float(np.abs(every).max(initial=0.0))
    every[order, 2] = heights[np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))]
    return np.split(every, np.cumsum([len(each) for each in places])[:-1])


def _body(number: int, part: Mesh, places: FloatArray) -> manifold3d.Manifold:
    body = manifold_of(Mesh(places, part.faces, part.synthetic), marked=True)
    fault = body.status()
    if fault != manifold3d.Error.NoError:
        raise NotLoftable(
            f"part {number} is no closed mesh of finite vertices ({fault.name})", indices=(number,)
        )
    if not body.volume() > 0.0:
        raise NotLoftable(f"part {number} is flat or inside out", indices=(number,))
    return body
