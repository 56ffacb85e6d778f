"""Where a horizontal sheet of light can meet a part: the band of faces that cross its height.

Embree answers in float32 which face a beam meets first; where it meets it is worked out again in
float64 from that face's plane. In the sheet z = 0, and a face's plane is a line::

    a x + b y = c        (a, b) the horizontal part of the face's unit normal

so a beam E + t D has t = (c - a Ex - b Ey) / (a Dx + b Dy), and the denominator over |D| is the
cosine of incidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from sim.arrays import FaceArray, FloatArray, SingleArray
from sim.solids import Part

# The sheet passes this far under its height, so that none goes along an edge or a cap: a ring at
# the very top sees the wall, one at z = 0 sees nothing.
_UNDER_MM = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The faces that cross one height; the last of each array is no face, for beams that miss."""

    scene: EmbreeScene | None  # its z is relative to the sheet; None where nothing crosses
    a: FloatArray  # (f + 1,)
    b: FloatArray
    c_mm: FloatArray
    reflectance: SingleArray

    def first_faces(self, origins_mm: SingleArray, directions: SingleArray) -> NDArray[np.intp]:
        """Which face each beam meets first, -1 for none: (n, 3), (n, 3) -> (n,)."""
        if self.scene is None:
            return np.full(len(origins_mm), -1, np.intp)
        faces = self.scene.run(origins_mm, directions)
        return np.asarray(faces, np.intp)  # as numpy indexes: converted once, not at each use


def cut(part: Part, height_mm: float) -> Sheet:
    """Find the band of a part's faces at a height over z = 0."""
    above_mm = part.vertices_mm[:, 2] - height_mm
    above_mm = np.where(np.abs(above_mm) < _UNDER_MM, _UNDER_MM, above_mm)
    up = (above_mm > 0.0)[part.faces].sum(axis=1)
    crossing = np.flatnonzero((up > 0) & (up < 3))
    vertices_mm = np.column_stack([part.vertices_mm[:, :2], above_mm])
    corners_mm = vertices_mm[part.faces[crossing]]
    normals = np.cross(corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    c_mm = np.einsum("ij,ij->i", normals, corners_mm[:, 0])
    return Sheet(
        scene=make_scene(vertices_mm, part.faces[crossing]) if len(crossing) else None,
        a=np.append(normals[:, 0], 0.0),
        b=np.append(normals[:, 1], 0.0),
        c_mm=np.append(c_mm, 0.0),
        reflectance=np.append(part.reflectance[crossing], np.float32(0.0)),
    )


def make_scene(vertices_mm: FloatArray, faces: FaceArray) -> EmbreeScene:
    """Hand a mesh to embree."""
    scene = EmbreeScene()
    TriangleMesh(
        scene=scene, vertices=vertices_mm.astype(np.float32), indices=faces.astype(np.int32)
    )
    return scene
