"""A mesh made ready to be measured against: the tree and the pseudo-normals, built once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.comparison.nearest import Triangles, nearest, prepare
from reconstruction.comparison.signs import PseudoNormals, pseudo_normals
from reconstruction.meshing import Mesh


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What measuring against a mesh needs."""

    triangles: Triangles
    normals: PseudoNormals


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """What was measured at each point."""

    distances_mm: FloatArray  # (n,), positive outside
    feet_mm: FloatArray  # (n, 3), the nearest points
    faces: IntArray  # (n,)
    parts: IntArray  # (n,), corner 0-2, edge 3-5, or 6 for the inside
    on_border: BoolArray  # (n,)


def reference(mesh: Mesh) -> Reference:
    """Build the tree and the pseudo-normals of a mesh.

    Raises
    ------
    ValueError
        The mesh has no faces, or a vertex in use is not finite.
    """
    if len(mesh.faces) == 0:
        raise ValueError("a mesh without faces has no distance to anything")
    corners_mm = mesh.vertices_mm[mesh.faces]
    if not np.all(np.isfinite(corners_mm)):
        raise ValueError("mesh: vertices must be finite")
    return Reference(prepare(corners_mm), pseudo_normals(corners_mm))


def measure(points_mm: FloatArray, against: Reference) -> Readings:
    """Measure each of (n, 3) points against the mesh.

    Raises
    ------
    ValueError
        The points are not of shape (n, 3), or one is not finite.
    """
    points_mm = np.ascontiguousarray(points_mm, dtype=np.float64)
    if points_mm.ndim != 2 or points_mm.shape[1] != 3:
        raise ValueError(f"points of shape (n, 3) expected, got {points_mm.shape}")
    if not np.all(np.isfinite(points_mm)):
        raise ValueError("points must be finite; drop the missing ones first")
    found = nearest(points_mm, against.triangles)
    away = points_mm - found.points_mm
    directions = against.normals.directions[found.triangles, found.parts]
    outward = np.einsum("ij,ij->i", away, directions) >= 0
    lengths = np.sqrt(np.einsum("ij,ij->i", away, away))
    on_border = against.normals.border[found.triangles, found.parts]
    distances = np.where(outward, lengths, -lengths)
    return Readings(distances, found.points_mm, found.triangles, found.parts, on_border)
