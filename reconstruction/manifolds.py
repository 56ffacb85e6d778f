"""Meshes as manifold3d's bodies, and back (decision 0006)."""

from __future__ import annotations

import manifold3d
import numpy as np

from reconstruction.meshing import Mesh

_MARKED = 0.5  # of the way from a measured vertex to a synthetic one


def manifold_of(mesh: Mesh, *, marked: bool = False) -> manifold3d.Manifold:
    """A mesh in double precision; one that is not closed has a `status` that says so.

    Parameters
    ----------
    marked
        Take the marks of synthetic vertices along, as a property that operations interpolate.
    """
    rows = np.array(mesh.vertices_mm, dtype=np.float64)
    if marked:
        rows = np.column_stack([rows, mesh.synthetic])
    return manifold3d.Manifold(manifold3d.Mesh64(rows, mesh.faces.astype(np.uint64)))


def mesh_of(body: manifold3d.Manifold) -> Mesh:
    """A body's triangles; vertices that differ only in their marks are one, and marked."""
    made = body.to_mesh64()
    rows = np.asarray(made.vert_properties)
    target = np.arange(len(rows))
    target[np.asarray(made.merge_from_vert, dtype=np.int64)] = made.merge_to_vert
    kept, numbers = np.unique(target, return_inverse=True)
    synthetic = np.zeros(len(kept), dtype=np.bool_)
    if rows.shape[1] > 3:
        np.logical_or.at(synthetic, numbers, rows[:, 3] >= _MARKED)
    faces = numbers[np.asarray(made.tri_verts).astype(np.int64)]
    return Mesh(rows[kept, :3], faces, synthetic)
