"""Topological facts of a mesh: what is closed, oriented and manifold, and what is not.

Everything is counted from the half-edges, sorted once. A vertex is manifold when the faces around
it hang together through edges they share at that vertex, in one fan; two cones that touch with
their tips are closed and edge-manifold, but no solid a CAD program accepts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.meshing import Mesh


@dataclass(frozen=True, slots=True)
class Soundness:
    """What can be said of a mesh as a solid; the counts are of violations, 0 is good."""

    vertices: int  # that a face uses
    unused_vertices: int
    faces: int
    components: int  # of faces, through shared edges
    euler_number: int  # used vertices - edges + faces; 2 for a sphere
    boundary_edges: int  # in one face only
    nonmanifold_edges: int  # in more than two faces
    nonmanifold_vertices: int  # whose faces make more than one fan
    misdirected_edges: int  # that two faces run along in the same direction
    degenerate_faces: int  # a repeated vertex, or no height
    area_mm2: float
    volume_mm3: float  # positive when faces look outward; nan unless closed and oriented

    @property
    def watertight(self) -> bool:
        """Whether there are faces, and every edge lies in exactly two of them."""
        return self.faces > 0 and self.boundary_edges == 0 and self.nonmanifold_edges == 0

    @property
    def oriented(self) -> bool:
        """Whether no two faces run along an edge in the same direction."""
        return self.misdirected_edges == 0

    @property
    def manifold(self) -> bool:
        """Whether every edge has at most two faces and every vertex one fan."""
        return self.nonmanifold_edges == 0 and self.nonmanifold_vertices == 0

    @property
    def sound(self) -> bool:
        """Whether this is a solid: closed, oriented, manifold, no flat face, inside inside."""
        solid = self.watertight and self.oriented and self.manifold
        return solid and self.degenerate_faces == 0 and self.volume_mm3 > 0.0


def soundness(mesh: Mesh, *, flat_below_mm: float = 1e-9) -> Soundness:
    """Count what keeps `mesh` from being a solid, and measure it.

    Parameters
    ----------
    flat_below_mm
        A face whose height over its longest edge is not above this counts as degenerate.

    Raises
    ------
    ValueError
        A face names a vertex that is not there, or a vertex is not finite.
    """
    _check(mesh)
    faces = mesh.faces
    half_edges, group, forward = _edges(faces, len(mesh.vertices_mm))
    sizes = np.bincount(group)
    used = np.zeros(len(mesh.vertices_mm), dtype=np.bool_)
    used[faces.ravel()] = True
    misdirected = _misdirected(group, forward)
    closed = len(sizes) > 0 and bool(np.all(sizes == 2)) and misdirected == 0
    area_mm2, heights_mm = _areas(mesh)
    return Soundness(
        vertices=int(used.sum()),
        unused_vertices=int(np.sum(~used)),
        faces=len(faces),
        components=_components(half_edges, group, len(faces)),
        euler_number=int(used.sum()) - len(sizes) + len(faces),
        boundary_edges=int(np.sum(sizes == 1)),
        nonmanifold_edges=int(np.sum(sizes > 2)),
        nonmanifold_vertices=_split_vertices(faces, half_edges, group),
        misdirected_edges=misdirected,
        degenerate_faces=int(np.sum(~(heights_mm > flat_below_mm))),
        area_mm2=area_mm2,
        volume_mm3=_volume(mesh) if closed else float("nan"),
    )


def _check(mesh: Mesh) -> None:
    if mesh.vertices_mm.ndim != 2 or mesh.vertices_mm.shape[1] != 3:
        raise ValueError(f"mesh: vertices of shape (n, 3) expected, got {mesh.vertices_mm.shape}")
    if mesh.faces.ndim != 2 or mesh.faces.shape[1] != 3:
        raise ValueError(f"mesh: faces of shape (m, 3) expected, got {mesh.faces.shape}")
    if not np.all(np.isfinite(mesh.vertices_mm)):
        raise ValueError("mesh: vertices must be finite")
    count = len(mesh.vertices_mm)
    if mesh.faces.size and (mesh.faces.min() < 0 or mesh.faces.max() >= count):
        raise ValueError(f"mesh: faces name vertices outside 0 .. {count - 1}")


def _edges(faces: IntArray, vertices: int) -> tuple[IntArray, IntArray, BoolArray]:
    """Half-edges, edge by edge.

    Half-edge h of (m, 3) faces is number 3 * face + corner and runs from that corner to the next.

    Returns
    -------
    half_edges
        (3 m,) half-edges in an order that puts those of one edge side by side.
    group
        (3 m,) the edge of each of them, 0, 0, 1, 1, 2, ...
    forward
        (3 m,) whether it runs from the lower to the higher vertex.
    """
    tails = faces.ravel()
    heads = np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(tails, heads) * vertices + np.maximum(tails, heads)
    order = np.argsort(keys)
    keys = keys[order]
    starts = np.ones(len(keys), dtype=np.bool_)
    starts[1:] = keys[1:] != keys[:-1]
    return order, np.cumsum(starts) - 1, (tails < heads)[order]


def _misdirected(group: IntArray, forward: BoolArray) -> int:
    """Count the edges with two half-edges of the same direction."""
    edges = int(group[-1]) + 1 if len(group) else 0
    ahead = np.bincount(group[forward], minlength=edges)
    back = np.bincount(group[~forward], minlength=edges)
    return int(np.sum((ahead > 1) | (back > 1)))


def _components(half_edges: IntArray, group: IntArray, faces: int) -> int:
    """Faces that hang together through edges."""
    same = group[1:] == group[:-1]
    return _labels(half_edges[:-1][same] // 3, half_edges[1:][same] // 3, faces)[0]


def _split_vertices(faces: IntArray, half_edges: IntArray, group: IntArray) -> int:
    """Vertices whose corners fall into more than one fan when shared edges tie corners together."""
    if len(faces) == 0:
        return 0
    same = group[1:] == group[:-1]
    one, other = half_edges[:-1][same], half_edges[1:][same]
    corner = faces.ravel()
    along = corner[one] == corner[other]  # both run the same way: tail meets tail
    ahead_one, ahead_other = _next(one), _next(other)
    links_a = np.concatenate([one, ahead_one])
    links_b = np.concatenate(
        [np.where(along, other, ahead_other), np.where(along, ahead_other, other)]
    )
    fans, labels = _labels(links_a, links_b, len(corner))
    vertex_of_fan = np.empty(fans, dtype=np.int64)
    vertex_of_fan[labels] = corner
    return int(np.sum(np.bincount(vertex_of_fan) > 1))


def _next(half_edges: IntArray) -> IntArray:
    """Go from each half-edge to the next around its face."""
    return np.where(half_edges % 3 == 2, half_edges - 2, half_edges + 1)


def _labels(a: IntArray, b: IntArray, nodes: int) -> tuple[int, IntArray]:
    """Components of an undirected graph of `nodes` nodes with links a-b."""
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(nodes, nodes))
    count, labels = connected_components(graph, directed=False)
    return int(count), np.asarray(labels, dtype=np.int64)


def _areas(mesh: Mesh) -> tuple[float, FloatArray]:
    """Total area, and each face's height over its longest edge in mm (0 for a repeated vertex)."""
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.stack([b - a, c - b, a - c])
    longest = np.sqrt(np.einsum("kij,kij->ki", edges, edges).max(axis=0))
    heights = np.divide(doubled, longest, out=np.zeros_like(doubled), where=longest > 0)
    return float(doubled.sum() / 2), heights


def _volume(mesh: Mesh) -> float:
    """Signed volume by the divergence theorem, about the centroid against cancellation."""
    shifted = mesh.vertices_mm - mesh.vertices_mm.mean(axis=0)
    a, b, c = (shifted[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
