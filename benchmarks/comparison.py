"""Signed distance of 1 000 000 points to a mesh of 200 000 faces, beside pymeshlab's.

    python benchmarks/comparison.py [points]

One core for both. The part is a wavy barrel whose ends are fans of needles, the noise 0.1 mm. Where
the signs differ, at the sharp rim of the fans, the winding number decides who is right.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import pymeshlab

from reconstruction.comparison import measure, reference, sample_surface
from reconstruction.meshing import Mesh
from reconstruction.soundness import soundness


def barrel(around: int = 500, along: int = 201) -> Mesh:
    """Build the part: about 2 * around * along faces, closed, the normals outward."""
    turns = np.arange(around) / around * 2 * np.pi
    heights = np.linspace(0, 100, along)
    radii = 50 + 5 * np.sin(heights / 14)[:, None] + 2 * np.sin(5 * turns)
    x, y = radii * np.cos(turns), radii * np.sin(turns)
    rings = np.stack([x, y, np.broadcast_to(heights[:, None], x.shape)], -1).reshape(-1, 3)
    here, there = np.arange(around), np.roll(np.arange(around), -1)
    rows = np.arange(along - 1)[:, None] * around
    one = np.stack([rows + here, rows + there, rows + around + there], -1).reshape(-1, 3)
    two = np.stack([rows + here, rows + around + there, rows + around + here], -1).reshape(-1, 3)
    top, last = (along - 1) * around, len(rings)
    bottom_fan = np.stack([np.full(around, last), there, here], 1)
    top_fan = np.stack([np.full(around, last + 1), top + here, top + there], 1)
    vertices = np.vstack([rings, [[0, 0, 0], [0, 0, 100]]])
    faces = np.vstack([one, two, bottom_fan, top_fan])
    return Mesh(vertices, faces, np.zeros(len(vertices), dtype=np.bool_))


def ours(points_mm: np.ndarray, mesh: Mesh) -> tuple[np.ndarray, float, float]:
    """Measure; distances, seconds to prepare, seconds to query."""
    began = time.process_time()
    against = reference(mesh)
    prepared = time.process_time()
    readings = measure(points_mm, against)
    return readings.distances_mm, prepared - began, time.process_time() - prepared


def pymeshlabs(points_mm: np.ndarray, mesh: Mesh) -> tuple[np.ndarray, float]:
    """Measure with pymeshlab; distances, seconds."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(points_mm))
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices_mm, mesh.faces))
    began = time.process_time()
    meshes.compute_scalar_by_distance_from_another_mesh_per_vertex(
        measuremesh=0, refmesh=1, signeddist=True
    )
    return meshes.mesh(0).vertex_scalar_array(), time.process_time() - began


def winding_number(point_mm: np.ndarray, mesh: Mesh) -> float:
    """Sum the solid angles of all faces over 4 pi: 1 inside, 0 outside (Van Oosterom 1983)."""
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] - point_mm for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", *pair) for pair in ((a, b), (b, c), (c, a)))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c))
    angles = np.arctan2(volumes, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angles.sum() / (2 * np.pi))


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    mesh = barrel()
    points_mm = sample_surface(mesh, count, seed=0)
    points_mm += np.random.default_rng(1).normal(0, 0.1, points_mm.shape)
    ours(points_mm[:100], mesh)  # compiles
    rounds = [ours(points_mm, mesh) for _ in range(3)]
    theirs, their_s = pymeshlabs(points_mm, mesh)
    mine = rounds[0][0]
    prepare_s, query_s = (float(np.median([r[k] for r in rounds])) for k in (1, 2))
    print(f"{count} points, {len(mesh.faces)} faces, processor time")
    print(f"  ours       {1e9 * query_s / count:8.0f} ns/point, and {prepare_s:.2f} s to prepare")
    print(f"  pymeshlab  {1e9 * their_s / count:8.0f} ns/point, its preparation included")
    print(f"  rms {np.sqrt(np.mean(mine**2)):.6f} mm")
    print(f"  largest difference of |d| {np.abs(np.abs(mine) - np.abs(theirs)).max():.2e} mm")
    differ = np.flatnonzero(mine * theirs < 0)[:200]
    right = sum((mine[i] < 0) == (winding_number(points_mm[i], mesh) > 0.5) for i in differ)
    print(
        f"  signs that differ {int(np.sum(mine * theirs < 0))}; ours right {right} of {len(differ)}"
    )
    began = time.process_time()
    soundness(mesh)
    seconds = time.process_time() - began
    print(f"  soundness  {1e9 * seconds / len(mesh.faces):8.0f} ns/face")


if __name__ == "__main__":
    main()
