r"""What stands on the table: a mesh in mm, and how it is made from rings or read from a file.

A solid of rings is a stack of closed polygons of equal count, closed by a fan at either end::

        top  ----*----      fan around the top's centre (an apex is a ring of radius 0: its own fan)
            /|\  |  /|\
           o-o-o-o-o-o      ring j + 1     two triangles a cell, seen from outside
           |/|/|/|/|/|
           o-o-o-o-o-o      ring j
                 *          fan around the bottom's centre
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim.arrays import FaceArray, FloatArray, SingleArray, frozen

RadiusLaw = Callable[[FloatArray, FloatArray], FloatArray]  # (angle_rad, height_mm) -> radius_mm


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A part in its own frame: z up, standing on z = 0, the table's axis through the origin."""

    name: str
    vertices_mm: FloatArray  # (v, 3)
    faces: FaceArray  # (f, 3), counter-clockwise seen from outside
    radius_mm: RadiusLaw | None = None  # the truth, where a formula knows it
    reflectance: SingleArray = field(
        default_factory=lambda: np.empty(0, np.float32)
    )  # (f,), 0 to 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_mm", frozen(self.vertices_mm, np.float64))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))
        given = self.reflectance if len(self.reflectance) else np.ones(len(self.faces))
        object.__setattr__(self, "reflectance", frozen(given, np.float32))
        if not len(self.faces) or not np.isfinite(self.vertices_mm).all():
            raise ValueError(f"part {self.name}: no faces, or vertices that are not finite")
        if len(self.reflectance) != len(self.faces):
            raise ValueError(
                f"part {self.name}: {len(self.reflectance)} reflectances, {len(self.faces)} faces"
            )

    @property
    def size_mm(self) -> float:
        """The diagonal of the box around it."""
        return float(np.linalg.norm(np.ptp(self.vertices_mm, axis=0)))


def radial_solid(name: str, radius_mm: RadiusLaw, heights_mm: FloatArray, around: int) -> Part:
    """Mesh a solid that every horizontal plane cuts in a contour around the axis.

    Parameters
    ----------
    radius_mm : law
        Vectorised; 0 at the last height makes an apex.
    heights_mm : (levels,) increasing, the first is 0
    around : vertices of a ring
    """
    angle_rad = np.arange(around) * (math.tau / around)
    angles, heights = np.meshgrid(angle_rad, heights_mm)
    radii = np.asarray(radius_mm(angles, heights), np.float64)
    rings_mm = np.stack([radii * np.cos(angles), radii * np.sin(angles), heights], axis=-1)
    if np.all(radii[-1] == 0.0):
        vertices_mm, faces = stack_rings(rings_mm[:-1], top_mm=rings_mm[-1, 0])
    else:
        vertices_mm, faces = stack_rings(rings_mm)
    return Part(name, vertices_mm, faces, radius_mm)


def stack_rings(
    rings_mm: FloatArray, top_mm: FloatArray | None = None
) -> tuple[FloatArray, FaceArray]:
    """Close a stack of rings (levels, around, 3) into vertices and outward faces.

    The fans meet on the axis at the height of the last ring, or in `top_mm` (3,).
    """
    levels, around, _ = rings_mm.shape
    low = np.array([0.0, 0.0, rings_mm[0, 0, 2]])
    high = np.array([0.0, 0.0, rings_mm[-1, 0, 2]]) if top_mm is None else top_mm
    vertices_mm = np.concatenate([rings_mm.reshape(-1, 3), [low, high]])
    here = np.arange(around)
    following = np.roll(here, -1)
    base = around * np.arange(levels - 1)[:, None]
    a, b = (base + here).ravel(), (base + following).ravel()
    last = around * (levels - 1)
    faces = [
        np.column_stack([a, b, b + around]),
        np.column_stack([a, b + around, a + around]),
        np.column_stack([following, here, np.full(around, levels * around)]),
        np.column_stack([last + here, last + following, np.full(around, levels * around + 1)]),
    ]
    return vertices_mm, np.concatenate(faces).astype(np.int32)


def read_mesh(path: Path, *, mm_per_unit: float = 1.0) -> Part:
    """Read a mesh file (.obj .stl .ply), merge its vertices and stand it on the table.

    The middle of its box comes onto the table's axis, its lowest point to z = 0.

    Raises
    ------
    ValueError
        Not a mesh that trimesh reads, or one without faces.
    OSError
        The file cannot be read.
    """
    import trimesh  # takes longer to import than all else here; the built-in parts need none of it

    with path.open("rb") as stream:
        try:
            mesh = trimesh.load(stream, file_type=path.suffix.lstrip(".").lower(), force="mesh")
        except (ValueError, KeyError, IndexError, TypeError, NotImplementedError) as bad:
            raise ValueError(
                f"{path}: no mesh that can be read ({bad}); give .stl .ply .obj"
            ) from bad
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError(f"{path}: no triangles in it; a point cloud cannot be scanned")
    # Normals and texture split what is one vertex of the surface.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    vertices_mm = np.asarray(mesh.vertices, np.float64) * mm_per_unit
    low, high = vertices_mm.min(axis=0), vertices_mm.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Part(path.stem, vertices_mm - foot, np.asarray(mesh.faces, np.int32))
