"""Every method under one roof: ours by its public verb, the peers as their libraries offer them.

A method is a function that imports what it needs and returns the work, so that imports are not
counted. One set of parameters each, the same for all cases, none tuned to one of them:

screened Poisson    depth 8, point weight 4, all else as the library has it; one thread
normals             "true": of the surface the point was drawn on; "30": estimated by the same
                    library from 30 neighbours, their signs taken from the true ones
ball pivoting       open3d, true normals; cloud reduced to cells of one pitch, balls of 0.75, 1.5
                    and 3 pitches (raw clouds came out worse; pymeshlab's took over 240 s on them)
APSS                pymeshlab, true normals, marching cubes of 150 cells; cloud reduced to cells of
                    one pitch (raw clouds came out worse); "scale 4": twice its usual filter scale

The pitch is the distance of the slices, or 1 mm on the cylinder.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import open3d

    from reconstruction.nurbs import Surface

Array = NDArray[np.float64]

DEPTH, WEIGHT, NEIGHBOURS = 8, 4.0, 30
APSS_CELLS = 150
BALLS = (0.75, 1.5, 3.0)  # in pitches


@dataclass(frozen=True, slots=True)
class Task:
    """Where a cloud lies, and what may be known of it."""

    points_file: Path  # .npy, (n, 3)
    normals_file: Path  # .npy, (n, 3)
    axis: str
    pitch_mm: float

    def points(self) -> Array:
        """The cloud, (n, 3)."""
        return np.load(self.points_file)

    def normals(self) -> Array:
        """The true normals, (n, 3)."""
        return np.load(self.normals_file)


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A mesh, and the patches of a method that has some."""

    vertices_mm: Array  # (n, 3)
    faces: NDArray[np.int64]  # (m, 3)
    patches: tuple[Surface | dict[str, Array], ...] = ()  # dictionaries once read back


Work = Callable[[Task], Made]


def ours(method: str, **options: str) -> Work:
    """`loftscan.reconstruct` with everything left to its defaults but the axis."""
    from loftscan import reconstruct

    def work(task: Task) -> Made:
        result = reconstruct(task.points_file, axis=task.axis, method=method, **options)
        surface = result.surface
        patches = tuple(surface) if isinstance(surface, Sequence) else (surface,)
        return Made(result.mesh.vertices_mm, result.mesh.faces, patches)

    return work


def pymeshlab_poisson(*, estimated: bool) -> Work:
    """Screened Poisson by pymeshlab."""
    import pymeshlab

    def work(task: Task) -> Made:
        points, normals = task.points(), task.normals()
        meshes = pymeshlab.MeshSet(verbose=False)
        if estimated:
            meshes.add_mesh(pymeshlab.Mesh(points))
            meshes.compute_normal_for_point_clouds(k=NEIGHBOURS)
            normals = signed_like(meshes.current_mesh().vertex_normal_matrix(), normals)
            meshes.clear()
        meshes.add_mesh(pymeshlab.Mesh(points, v_normals_matrix=normals))
        meshes.generate_surface_reconstruction_screened_poisson(
            depth=DEPTH, pointweight=WEIGHT, threads=1
        )
        made = meshes.current_mesh()
        return Made(made.vertex_matrix(), made.face_matrix().astype(np.int64))

    return work


def open3d_poisson(*, estimated: bool) -> Work:
    """Screened Poisson by open3d."""
    import open3d

    def work(task: Task) -> Made:
        cloud = _open3d_cloud(task, with_normals=not estimated)
        if estimated:
            cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
            normals = signed_like(np.asarray(cloud.normals), task.normals())
            cloud.normals = open3d.utility.Vector3dVector(normals)
        mesh, _ = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=DEPTH, point_weight=WEIGHT, n_threads=1
        )
        return _from_open3d(mesh)

    return work


def ball_pivoting() -> Work:
    """Ball pivoting by open3d."""
    import open3d

    def work(task: Task) -> Made:
        cloud = _open3d_cloud(task, with_normals=True)
        cloud = cloud.voxel_down_sample(task.pitch_mm)
        cloud.normalize_normals()
        radii = open3d.utility.DoubleVector([share * task.pitch_mm for share in BALLS])
        mesh = open3d.geometry.TriangleMesh.create_from_point_cloud_ball_pivoting(cloud, radii)
        return _from_open3d(mesh)

    return work


def apss(*, filter_scale: float) -> Work:
    """Algebraic point set surfaces by pymeshlab."""
    import pymeshlab

    def work(task: Task) -> Made:
        points, normals = reduced(task.points(), task.normals(), task.pitch_mm)
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(points, v_normals_matrix=normals))
        meshes.generate_marching_cubes_apss(resolution=APSS_CELLS, filterscale=filter_scale)
        made = meshes.current_mesh()
        return Made(made.vertex_matrix(), made.face_matrix().astype(np.int64))

    return work


METHODS: dict[str, Callable[[], Work]] = {
    "paper": lambda: ours("paper"),
    "fit": lambda: ours("fit"),
    "fit, exact never": lambda: ours("fit", exact="never"),
    "Poisson pymeshlab, true": lambda: pymeshlab_poisson(estimated=False),
    "Poisson pymeshlab, 30": lambda: pymeshlab_poisson(estimated=True),
    "Poisson open3d, true": lambda: open3d_poisson(estimated=False),
    "Poisson open3d, 30": lambda: open3d_poisson(estimated=True),
    "ball pivoting": ball_pivoting,
    "APSS": lambda: apss(filter_scale=2.0),
    "APSS, scale 4": lambda: apss(filter_scale=4.0),
}


def missing_methods() -> Iterator[tuple[str, str]]:
    """Names of methods that cannot run here, and why."""
    from importlib.util import find_spec

    from loftscan import reconstruct
    from loftscan.reconstructing import Method

    if "fit" not in {each.value for each in Method}:
        yield from (
            (name, "loftscan has no method fit yet") for name in ("fit", "fit, exact never")
        )
    elif "exact" not in inspect.signature(reconstruct).parameters:
        yield "fit, exact never", "reconstruct takes no exact= yet"
    if find_spec("open3d") is None:
        for name in ("Poisson open3d, true", "Poisson open3d, 30", "ball pivoting"):
            yield name, "open3d is not installed: pip install --group bench"


def signed_like(normals: Array, true: Array) -> Array:
    """Turn normals (n, 3) to the side of the true ones."""
    return np.where(np.einsum("ij,ij->i", normals, true)[:, None] < 0.0, -normals, normals)


def reduced(points: Array, normals: Array, cell_mm: float) -> tuple[Array, Array]:
    """One mean point and unit normal for every cell of a cubic grid."""
    keys = np.floor((points - points.min(axis=0)) / cell_mm).astype(np.int64)
    sizes = keys.max(axis=0) + 1
    flat = (keys[:, 0] * sizes[1] + keys[:, 1]) * sizes[2] + keys[:, 2]
    _, cell, counts = np.unique(flat, return_inverse=True, return_counts=True)
    sums = [np.bincount(cell, column) for column in np.concatenate([points, normals], axis=1).T]
    means = np.stack(sums, axis=1) / counts[:, None]
    lengths = np.linalg.norm(means[:, 3:], axis=1, keepdims=True)
    return means[:, :3], means[:, 3:] / np.maximum(lengths, 1e-300)


def _open3d_cloud(task: Task, *, with_normals: bool) -> open3d.geometry.PointCloud:
    import open3d

    cloud = open3d.geometry.PointCloud()
    cloud.points = open3d.utility.Vector3dVector(task.points())
    if with_normals:
        cloud.normals = open3d.utility.Vector3dVector(task.normals())
    return cloud


def _from_open3d(mesh: open3d.geometry.TriangleMesh) -> Made:
    return Made(np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int64))
