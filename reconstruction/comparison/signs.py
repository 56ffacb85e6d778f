"""Inside or outside of a mesh, from the nearest point alone.

The side is the sign of (p - nearest point) . pseudo-normal, where the pseudo-normal of a face is
its normal, of an edge the sum of the normals of its two faces, and of a vertex the sum of the
normals of its faces weighted by their angles there. With any other weights of the vertex the sign
comes out wrong near sharp tips; with these it is proven for closed meshes (Baerentzen and Aanaes
2005, doi:10.1109/TVCG.2005.49).

At an open border there is no inside. An edge that does not lie in exactly two faces of opposite
direction is such a border, and so are its two ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.comparison.nearest import unit_normals


@dataclass(frozen=True, slots=True, eq=False)
class PseudoNormals:
    """One outward direction for each part of each face: corners 0-2, edges 3-5, inside 6."""

    directions: FloatArray  # (m, 7, 3), not of unit length
    border: BoolArray  # (m, 7)


def pseudo_normals(corners_mm: FloatArray) -> PseudoNormals:
    """Build them for triangles (m, 3, 3); corners at the same place are one vertex.

    So the seams of a mesh whose pieces were never welded (an STL file) are no borders.
    """
    faces, vertices = _welded(corners_mm)
    normals = unit_normals(corners_mm)
    directions, border = np.empty((len(faces), 7, 3)), np.zeros((len(faces), 7), dtype=np.bool_)
    directions[:, :3] = _at_vertices(faces, vertices, normals, corners_mm)
    directions[:, 3:6], border[:, 3:6] = _at_edges(faces, vertices, normals)
    directions[:, 6] = normals
    open_vertices = np.zeros(vertices, dtype=np.bool_)
    open_edges = border[:, 3:6]
    open_vertices[faces[open_edges]] = True
    open_vertices[np.roll(faces, -1, axis=1)[open_edges]] = True
    border[:, :3] = open_vertices[faces]
    return PseudoNormals(directions, border)


def _welded(corners_mm: FloatArray) -> tuple[IntArray, int]:
    """Give each distinct corner position a number; (m, 3) numbers and how many there are."""
    flat = np.ascontiguousarray(corners_mm.reshape(-1, 3) + 0.0)  # + 0.0 makes -0.0 and 0.0 one
    as_bytes = flat.view(np.dtype((np.void, 24)))[:, 0]
    distinct, numbers = np.unique(as_bytes, return_inverse=True)
    return np.asarray(numbers, dtype=np.int64).reshape(-1, 3), len(distinct)


def _at_vertices(
    faces: IntArray, vertices: int, normals: FloatArray, corners_mm: FloatArray
) -> FloatArray:
    """Angle-weighted sums of face normals, for each corner of each face, (m, 3, 3)."""
    ahead = np.roll(corners_mm, -1, axis=1) - corners_mm
    back = np.roll(corners_mm, 1, axis=1) - corners_mm
    sines = np.linalg.norm(np.cross(ahead, back), axis=2)
    angles = np.arctan2(sines, np.einsum("ijk,ijk->ij", ahead, back))
    weighted = angles[..., None] * normals[:, None]
    sums = np.stack(
        [
            np.bincount(faces.ravel(), weighted[..., k].ravel(), minlength=vertices)
            for k in range(3)
        ],
        axis=1,
    )
    return np.asarray(sums[faces])


def _at_edges(faces: IntArray, vertices: int, normals: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Add the normals along each edge of each face (m, 3, 3), and tell whether it is a border."""
    heads = np.roll(faces, -1, axis=1)
    low, high = np.minimum(faces, heads).ravel(), np.maximum(faces, heads).ravel()
    _, edge = np.unique(low * vertices + high, return_inverse=True)
    sides = np.where((faces < heads).ravel(), 1, -1)
    paired = (np.bincount(edge) == 2) & (np.bincount(edge, sides) == 0)
    spread = np.repeat(normals, 3, axis=0)
    sums = np.stack([np.bincount(edge, spread[:, k]) for k in range(3)], axis=1)
    at_edges = np.asarray(sums[edge].reshape(-1, 3, 3), dtype=np.float64)
    return at_edges, ~np.asarray(paired[edge].reshape(-1, 3), dtype=np.bool_)
