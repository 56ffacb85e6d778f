r"""Triangles almost without height, as Boolean operations leave them, are taken out of a mesh.

::

    c close to a-b: the edge turns        a close to b: they become one

       a ---c--- b      a ---c--- b            c              c
        \       /        \   |   /            / \     ->      |
          \   /      ->    \ | /             a---b            a
            d                d

Either way the surface stays within the height of the sliver, or the length of the edge.
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.meshing import Mesh

_MOST_PASSES = 10


def without_slivers(mesh: Mesh, *, within_mm: float) -> Mesh:
    """Remove triangles less high than `within_mm`; one that topology needs is left.

    A vertex that two became keeps the place of one of them, and is synthetic if one of them was.
    """
    vertices, faces = mesh.vertices_mm, mesh.faces.copy()
    synthetic = mesh.synthetic.copy()
    for _ in range(_MOST_PASSES):
        heights = _heights(vertices[faces])
        bad = np.flatnonzero(heights < within_mm)
        touched = np.zeros(len(vertices), dtype=np.bool_)
        edges = _Edges(faces, len(vertices)) if len(bad) else None
        done = 0
        for face in bad[np.argsort(heights[bad])]:
            if edges is None or touched[faces[face]].any():
                continue
            done += _flip(vertices, faces, face, heights[face], edges, touched) or _merge(
                vertices, faces, face, within_mm, synthetic, touched
            )
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        if not done:
            break
    used, numbers = np.unique(faces, return_inverse=True)
    return Mesh(vertices[used], numbers.reshape(faces.shape), synthetic[used])


def _heights(corners: FloatArray) -> FloatArray:
    """Of triangles (m, 3, 3), over their longest edges."""
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    return np.asarray(doubled / np.maximum(longest, 1e-300))


class _Edges:
    """The face on the left of every directed edge."""

    def __init__(self, faces: IntArray, count: int) -> None:
        keys = (faces * count + np.roll(faces, -1, axis=1)).ravel()
        self._order = np.argsort(keys)
        self._keys, self._count = keys[self._order], count

    def left_of(self, tail: int, head: int) -> int | None:
        """Number of the face, None without one."""
        key = tail * self._count + head
        at = int(np.searchsorted(self._keys, key))
        if at == len(self._keys) or self._keys[at] != key:
            return None
        return int(self._order[at]) // 3


def _flip(
    vertices: FloatArray,
    faces: IntArray,
    face: int,
    height: float,
    edges: _Edges,
    touched: BoolArray,
) -> bool:
    """Turn the longest edge, if the two triangles that come of it are higher than the sliver."""
    corners = faces[face]
    sides = vertices[np.roll(corners, -1)] - vertices[corners]
    first = int(np.argmax(np.linalg.norm(sides, axis=1)))
    a, b, c = np.roll(corners, -first)
    beyond = edges.left_of(b, a)
    if beyond is None or touched[faces[beyond]].any():
        return False
    (d,) = set(faces[beyond].tolist()) - {int(a), int(b)}
    if edges.left_of(c, d) is not None or edges.left_of(d, c) is not None:
        return False
    turned = np.array([[c, a, d], [d, b, c]])
    if not _heights(vertices[turned]).min() > 2.0 * height:
        return False
    faces[[face, beyond]] = turned
    touched[[a, b, c, d]] = True
    return True


def _merge(
    vertices: FloatArray,
    faces: IntArray,
    face: int,
    within_mm: float,
    synthetic: BoolArray,
    touched: BoolArray,
) -> bool:
    """Make one of the ends of the shortest edge, if it is short and nothing else is pinched."""
    corners = faces[face]
    lengths = np.linalg.norm(vertices[np.roll(corners, -1)] - vertices[corners], axis=1)
    first = int(np.argmin(lengths))
    keep, drop = corners[first], corners[(first + 1) % 3]
    around = (faces == keep).any(axis=1), (faces == drop).any(axis=1)
    rings = [set(faces[each].ravel().tolist()) - {int(keep), int(drop)} for each in around]
    if lengths[first] > within_mm or len(rings[0] & rings[1]) != 2:
        return False
    if touched[faces[around[0] | around[1]]].any():
        return False
    touched[faces[around[0] | around[1]]] = True
    faces[faces == drop] = keep
    synthetic[keep] |= synthetic[drop]
    return True
