r"""Where a horizontal sheet of light can meet a part: one segment a face that crosses its height.

A segment ends on two edges of its face. Faces that share an edge compute its end from the same
two vertices in the same order, so that their segments meet to the last bit, and no beam passes
between them::

            up
            /\           one vertex of three is alone on its side of the sheet:
    -------*--*-------   both ends lie on the edges that meet there
          /    \
       down----down
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from sim.arrays import FaceArray, FloatArray, SingleArray
from sim.solids import Part

# The sheet passes this far under its height, so that none goes along an edge or a cap: a ring at
# the very top sees the wall, one at z = 0 sees nothing.
_UNDER_MM = 1e-6

Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part's segments at one height, in the part's frame; in any order, of any topology."""

    ends_mm: FloatArray  # (s, 2, 2)
    normals: FloatArray  # (s, 2), horizontal part of the face's unit normal
    reflectance: SingleArray  # (s,)

    def __post_init__(self) -> None:
        for array in (self.ends_mm, self.normals, self.reflectance):
            array.flags.writeable = False


class Slicer:
    """Cuts one part at any height."""

    def __init__(self, part: Part) -> None:
        self._part = part
        z_mm = part.vertices_mm[:, 2][part.faces]
        self._spans_mm = np.column_stack([z_mm.min(axis=1), z_mm.max(axis=1)])

    def at(self, height_mm: float) -> Section:
        """Cut at a height over z = 0."""
        return cut(self._part.vertices_mm, self._spans_mm, height_mm, self._part)


def cut(vertices_mm: FloatArray, spans_mm: FloatArray, height_mm: float, part: Part) -> Section:
    """Cut a part whose vertices (v, 3) stand so, and whose faces span heights (f, 2)."""
    count = len(part.faces)
    ends_mm, normals, faces = np.empty((count, 2, 2)), np.empty((count, 2)), np.empty(count, "i4")
    found = _cut(vertices_mm, part.faces, spans_mm, height_mm, ends_mm, normals, faces)
    reflectance = part.reflectance[faces[:found]]
    return Section(ends_mm[:found].copy(), normals[:found].copy(), reflectance)


@njit(cache=True, nogil=True)
def _cut(
    vertices_mm: FloatArray,
    faces: FaceArray,
    spans_mm: FloatArray,
    height_mm: float,
    ends_mm: FloatArray,
    normals: FloatArray,
    found: FaceArray,
) -> int:
    """Write ends, normals and numbers of the faces that cross; return how many they are."""
    count = 0
    for face in range(faces.shape[0]):
        if not spans_mm[face, 0] - height_mm <= -_UNDER_MM < spans_mm[face, 1] - height_mm:
            continue
        a = _corner(vertices_mm, faces[face, 0], height_mm)
        b = _corner(vertices_mm, faces[face, 1], height_mm)
        c = _corner(vertices_mm, faces[face, 2], height_mm)
        normals[count, 0], normals[count, 1] = _normal(a, b, c)
        if (a[2] > 0.0) == (b[2] > 0.0):  # a comes first: the corner that is alone on its side
            a, b, c = c, a, b
        elif (a[2] > 0.0) == (c[2] > 0.0):
            a, b, c = b, c, a
        ends_mm[count, 0, 0], ends_mm[count, 0, 1] = _end(a, b)
        ends_mm[count, 1, 0], ends_mm[count, 1, 1] = _end(a, c)
        found[count] = face
        count += 1
    return count


@njit(cache=True, nogil=True)
def _corner(vertices_mm: FloatArray, vertex: int, height_mm: float) -> Corner:
    above_mm = vertices_mm[vertex, 2] - height_mm
    if abs(above_mm) < _UNDER_MM:
        above_mm = _UNDER_MM
    return vertices_mm[vertex, 0], vertices_mm[vertex, 1], above_mm


@njit(cache=True, nogil=True)
def _normal(a: Corner, b: Corner, c: Corner) -> tuple[float, float]:
    """Return the horizontal part of the unit normal; none if the face has no area."""
    x1, y1, z1 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    x2, y2, z2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length) if length > 0.0 else (0.0, 0.0)


@njit(cache=True, nogil=True)
def _end(one: Corner, other: Corner) -> tuple[float, float]:
    """Where an edge passes z = 0, from its lower corner up: whichever face asks."""
    low, high = (one, other) if one[2] < other[2] else (other, one)
    share = low[2] / (low[2] - high[2])
    return low[0] + share * (high[0] - low[0]), low[1] + share * (high[1] - low[1])
