"""Contours of 500 slices followed, and branches joined to one solid, beside pymeshlab's Boolean.

    python benchmarks/branching.py

The part is a row of tubes on a plate: tubes are united with the plate, their bores taken out.
pymeshlab unites with exact arithmetic (libigl, CGAL); both solids are judged by trimesh.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np
import pymeshlab
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.meshing import Mesh, Row, mesh_rows
from reconstruction.skinning.branching import find_branches
from reconstruction.skinning.joining import join_solids
from reconstruction.skinning.outlines import Outline
from tests.reconstruction.skinning_cases import outline, ring

SLICES = 500
CORNERS = 200
ROWS = 100
RUNS = 5


def main() -> None:
    """Print both tables."""
    print(f"| contours in each of {SLICES} slices | ms |\n|---|---|")
    for tubes in (1, 2, 3):
        slices, heights = stack(tubes)
        find_branches(slices[:5], heights[:5])
        print(f"| {2 * tubes} | {seconds(lambda: find_branches(slices, heights)) * 1e3:.0f} |")  # noqa: B023
    print("\n| parts, triangles | joined by | ms | closed, Euler number, mm3 |\n|---|---|---|---|")
    for tubes in (1, 2, 3):
        parts, holes = solids(tubes)
        size = f"{len(parts)}, {sum(len(each.faces) for each in parts)}"
        peers = [("pymeshlab", by_pymeshlab, 1)] if tubes == 1 else []  # minutes for more
        for name, join, runs in [("manifold3d", by_manifold, RUNS), *peers]:
            taken = seconds(lambda: join(parts, holes), runs)  # noqa: B023
            print(f"| {size} | {name} | {taken * 1e3:.0f} | {judged(*join(parts, holes))} |")


def seconds(work: Callable[[], object], runs: int = RUNS) -> float:
    """Median process time."""
    taken = []
    for _ in range(runs):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return statistics.median(taken)


def stack(tubes: int) -> tuple[list[list[Outline]], FloatArray]:
    """Contours of tubes side by side, a little aside in every slice."""
    rng = np.random.default_rng(0)
    heights = 0.5 * np.arange(SLICES)
    slices = [
        [
            outline(
                ring(radius + 2 * math.sin(index / 40), (25.0 * tube, 0.0))
                + rng.normal(0.0, 0.05, 2),
                height,
                index=index,
                hole=hole,
            )
            for tube in range(tubes)
            for radius, hole in ((8.0, False), (5.0, True))
        ]
        for index, height in enumerate(heights)
    ]
    return slices, heights


def solids(tubes: int) -> tuple[list[Mesh], list[bool]]:
    """A plate, tubes on it that touch it, and their bores through both."""
    plate = column(ring(40.0 * tubes, (12.5 * (tubes - 1), 0.0), CORNERS), 0.0, 5.0, rows=2)
    outer = [column(ring(8.0, (25.0 * k, 0.0), CORNERS), 5.0, 60.0) for k in range(tubes)]
    bores = [column(ring(5.0, (25.0 * k, 0.0), CORNERS), 0.0, 60.0) for k in range(tubes)]
    return [plate, *outer, *bores], [False] * (tubes + 1) + [True] * tubes


def column(shape: FloatArray, low: float, high: float, *, rows: int = ROWS) -> Mesh:
    """An upright solid of rows of corners."""
    made = [
        Row(np.column_stack([shape, np.full(len(shape), height)]), np.zeros(len(shape)))
        for height in np.linspace(low, high, rows)
    ]
    return mesh_rows(made, np.eye(3)[:2])


def by_manifold(parts: list[Mesh], holes: list[bool]) -> tuple[FloatArray, FloatArray]:
    """What the project does."""
    made = join_solids(parts, holes, within_mm=1e-6)
    return made.vertices_mm, made.faces


def by_pymeshlab(parts: list[Mesh], holes: list[bool]) -> tuple[FloatArray, FloatArray]:
    """One part after the other."""
    meshes = pymeshlab.MeshSet(verbose=False)
    for part, hole in zip(parts, holes, strict=True):
        before = meshes.current_mesh_id() if meshes.mesh_number() else None
        meshes.add_mesh(pymeshlab.Mesh(part.vertices_mm, part.faces.astype(np.int32)))
        if before is not None:
            join = meshes.generate_boolean_difference if hole else meshes.generate_boolean_union
            join(first_mesh=before, second_mesh=meshes.current_mesh_id())
    return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()


def judged(vertices: FloatArray, faces: FloatArray) -> str:
    """What trimesh says."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return f"{'yes' if mesh.is_watertight else 'no'}, {mesh.euler_number}, {mesh.volume:.1f}"


if __name__ == "__main__":
    main()
