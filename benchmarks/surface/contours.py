"""A plane through a solid: its closed outlines, places drawn along them, and the gaps in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_SAME_MM = 1e-7  # ends of two segments on one edge of the mesh differ by rounding only


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """One closed polyline on a solid, without a repeated corner."""

    corners_mm: Array  # (k, 3)
    faces: Ints  # (k,), the face under the segment from each corner to the next

    @property
    def marks_mm(self) -> Array:
        """Arc length at every corner, and at the first one again, (k + 1,)."""
        steps = np.roll(self.corners_mm, -1, axis=0) - self.corners_mm
        return np.concatenate([[0.0], np.linalg.norm(steps, axis=1).cumsum()])


def outlines(solid: trimesh.Trimesh, normal: Array, height_mm: float) -> list[Outline]:
    """Cut a solid by the plane of points p with p . normal = height."""
    segments, faces = trimesh.intersections.mesh_plane(
        solid, normal, normal * height_mm, return_faces=True
    )
    ends = _numbered(segments.reshape(-1, 3)).reshape(-1, 2)
    real = ends[:, 0] != ends[:, 1]
    segments, faces, ends = segments[real], faces[real], ends[real]
    found = []
    for chain in _chains(ends):
        rows, sides = np.array(chain).T
        found.append(Outline(segments[rows, sides], faces[rows]))
    return found


def draw(
    found: list[Outline],
    count: int,
    rng: np.random.Generator,
    *,
    lost_share: float = 0.0,
) -> tuple[Array, Ints]:
    """Draw places uniform in arc length over all outlines, and the faces that they lie on.

    Parameters
    ----------
    lost_share
        The places in one arc of each outline are lost: it begins anywhere, and is this share of
        the outline's length. About as many of the `count` are missing then.
    """
    lengths = np.array([each.marks_mm[-1] for each in found])
    ends = np.cumsum(lengths)
    at = rng.uniform(0.0, ends[-1], count)
    which = np.minimum(np.searchsorted(ends, at, side="right"), len(found) - 1)
    places, faces = [], []
    for number, (each, end, length) in enumerate(zip(found, ends, lengths, strict=True)):
        along = at[which == number] - (end - length)
        begun = rng.uniform(0.0, length)
        kept = along[np.mod(along - begun, length) >= lost_share * length]
        corners = np.concatenate([each.corners_mm, each.corners_mm[:1]])
        places.append(np.stack([np.interp(kept, each.marks_mm, c) for c in corners.T], axis=1))
        segment = np.searchsorted(each.marks_mm, kept, side="right") - 1
        faces.append(each.faces[np.clip(segment, 0, len(each.faces) - 1)])
    return np.concatenate(places), np.concatenate(faces)


def _numbered(ends_mm: Array) -> Ints:
    """Give ends at one place one number."""
    pairs = cKDTree(ends_mm).query_pairs(_SAME_MM, output_type="ndarray")
    shape = (len(ends_mm), len(ends_mm))
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=shape)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _chains(ends: Ints) -> Iterator[list[tuple[int, int]]]:
    """Walk segments (m, 2) of end numbers; yields (segment, the end it is entered by)."""
    at: dict[int, list[int]] = {}
    for segment, (one, other) in enumerate(ends.tolist()):
        at.setdefault(one, []).append(segment)
        at.setdefault(other, []).append(segment)
    if any(len(each) != 2 for each in at.values()):
        raise ValueError("the plane's outlines are not simple closed curves; move it a little")
    left = set(range(len(ends)))
    while left:
        segment, side = min(left), 0
        chain = []
        while segment in left:
            left.remove(segment)
            chain.append((segment, side))
            end = int(ends[segment, 1 - side])
            one, other = at[end]
            segment = other if segment == one else one
            side = 0 if ends[segment, 0] == end else 1
        yield chain
