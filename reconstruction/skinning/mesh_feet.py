"""Feet of points on a mesh: of the triangles nearby that look where a point looks, the nearest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray

_VERTICES = 6  # nearest ones, whose triangles are tried
_SAME_SIDE = 0.3  # cosine: points that look elsewhere are of another wall
_EMPTY = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class MeshFeet:
    """Of m points, those that have a foot."""

    which: IntArray  # (m,), of all points
    corners: IntArray  # (m, 3), vertices of the triangle
    shares: FloatArray  # (m, 3), barycentric
    normals: FloatArray  # (m, 3), between those of the vertices
    rises_mm: FloatArray  # (m,), of the point above its foot along the normal
    away_mm: FloatArray  # (m,)


def mesh_feet(
    points_mm: FloatArray, outward: FloatArray, vertices_mm: FloatArray, faces: IntArray
) -> MeshFeet:
    """Feet of points (n, 3) that look outward (n, 3) on a closed mesh."""
    a, b, c = (vertices_mm[faces[:, k]] for k in range(3))
    crossed = np.cross(b - a, c - a)
    across = crossed / np.maximum(np.linalg.norm(crossed, axis=1, keepdims=True), _EMPTY)
    order = np.argsort(faces.ravel(), kind="stable")
    starts = np.searchsorted(faces.ravel()[order], np.arange(len(vertices_mm) + 1))
    _, near = cKDTree(vertices_mm).query(points_mm, k=min(_VERTICES, len(vertices_mm)))
    face, shares, away = _nearest(
        points_mm,
        outward,
        np.asarray(near, np.int64),
        vertices_mm,
        faces,
        across,
        starts,
        order // 3,
    )
    which = np.flatnonzero(face >= 0)
    corners, held = faces[face[which]], shares[which]
    normals = np.einsum("mk,mkd->md", held, vertex_normals(vertices_mm, faces)[corners])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), _EMPTY)
    arms = points_mm[which] - np.einsum("mk,mkd->md", held, vertices_mm[corners])
    rises = np.einsum("md,md->m", arms, normals)
    return MeshFeet(which, corners, held, normals, rises, away[which])


def vertex_normals(vertices_mm: FloatArray, faces: IntArray) -> FloatArray:
    """Of a closed mesh, weighed by area, (v, 3)."""
    a, b, c = (vertices_mm[faces[:, k]] for k in range(3))
    crossed, count = np.cross(b - a, c - a), len(vertices_mm)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(column, 3), count) for column in crossed.T], axis=1
    )
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), _EMPTY))


@njit(cache=True, nogil=True)
def _nearest(
    points: FloatArray, outward: FloatArray, near: IntArray, vertices: FloatArray, faces: IntArray,
    across: FloatArray, starts: IntArray, faces_of: IntArray,
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    count = len(points)
    found, shares = np.full(count, -1, np.int64), np.zeros((count, 3))
    away = np.full(count, np.inf)
    for m in range(count):
        for k in range(near.shape[1]):
            for place in range(starts[near[m, k]], starts[near[m, k] + 1]):
                f = faces_of[place]
                alike = 0.0
                for d in range(3):
                    alike += across[f, d] * outward[m, d]
                if alike < _SAME_SIDE:
                    continue
                a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
                p, q, r = closest_in(points[m], a, b, c)
                square = 0.0
                for d in range(3):
                    foot = p * a[d] + q * b[d] + r * c[d]
                    square += (points[m, d] - foot) ** 2
                if square < away[m]:
                    away[m], found[m] = square, f
                    shares[m, 0], shares[m, 1], shares[m, 2] = p, q, r
    return found, shares, np.sqrt(away)


@njit(cache=True, nogil=True)
def closest_in(
    point: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[float, float, float]:
    """Barycentric place of the point of a triangle that is nearest (Ericson 2005, 5.1.5)."""
    ab, ac = b - a, c - a
    from_a, from_b, from_c = point - a, point - b, point - c
    d1, d2 = (ab * from_a).sum(), (ac * from_a).sum()
    d3, d4 = (ab * from_b).sum(), (ac * from_b).sum()
    d5, d6 = (ab * from_c).sum(), (ac * from_c).sum()
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return 1.0 - d1 / (d1 - d3), d1 / (d1 - d3), 0.0
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 1.0 - d2 / (d2 - d6), 0.0, d2 / (d2 - d6)
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        share = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 0.0, 1.0 - share, share
    whole = va + vb + vc
    return 1.0 - (vb + vc) / whole, vb / whole, vc / whole
