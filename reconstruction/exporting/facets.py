"""A closed mesh as a solid of planar facets: for parts whose NURBS faces make no valid solid.

A surface that crosses itself bounds nothing, however it is sewn; the mesh, which a Boolean
operation has cleared of that, does. It is thinned first, within a tolerance, because CAD programs
take a planar face for dearer than a triangle. ::

    mesh -> fewer triangles, the surface moved by less than a tolerance -> planes with shared edges
"""

from __future__ import annotations

from typing import Any

import manifold3d
import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.manifolds import manifold_of, mesh_of
from reconstruction.meshing import Mesh

MOST_FACETS = 12_000
_FIRST_MM = 1e-4  # of the size: the first tolerance tried
_COARSER = 1.5
_VOLUME_LOST = 0.01  # of the volume: a mesh thinned farther is not the same part
_SLIVER = 1e-6  # of the volume: a part of less was pinched off by thinning, and is no solid
_MOST_TRIES = 24


def thinned(mesh: Mesh, *, most: int = MOST_FACETS) -> Mesh:
    """Take triangles out of a closed mesh until `most` are left; its volume stays.

    The surface moves by less than a tolerance that grows from 0.01 % of the size; what thinning
    cuts off, an even shift along the normals gives back. A mesh that is no manifold is returned as
    it is.
    """
    body = manifold_of(mesh)
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        return mesh
    volume, best = body.volume(), body
    tolerance = _FIRST_MM * float(np.linalg.norm(np.ptp(mesh.vertices_mm, axis=0)))
    for _ in range(_MOST_TRIES):
        if best.num_tri() <= most:
            break
        found = body.simplify(tolerance)
        if found.is_empty() or abs(found.volume() - volume) > _VOLUME_LOST * abs(volume):
            break
        best = found
        tolerance *= _COARSER
    return _refilled(_without_slivers(mesh_of(best), volume), volume)


def _without_slivers(mesh: Mesh, volume_mm3: float) -> Mesh:
    """Without the parts that enclose next to nothing, and are not the only one."""
    corners = mesh.vertices_mm[mesh.faces]
    sixths = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    parts = _components(mesh.faces)
    whole = [each for each in parts if abs(sixths[each].sum()) / 6.0 > _SLIVER * abs(volume_mm3)]
    if len(whole) in (0, len(parts)):
        return mesh
    used, faces = np.unique(mesh.faces[np.sort(np.concatenate(whole))], return_inverse=True)
    synthetic = mesh.synthetic[used]
    return Mesh(mesh.vertices_mm[used], faces.reshape(-1, 3), synthetic)


def _refilled(mesh: Mesh, volume_mm3: float) -> Mesh:
    """Move all vertices by one length along their normals, so that the mesh holds a volume."""
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    doubled = np.cross(b - a, c - a)
    middle = mesh.vertices_mm.mean(axis=0)
    held = float(np.einsum("ij,ij->", a - middle, np.cross(b - middle, c - middle))) / 6.0
    normals = np.zeros_like(mesh.vertices_mm)
    for corner in range(3):
        np.add.at(normals, mesh.faces[:, corner], doubled)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    # The rate at which the volume grows with the shift: every face's area along its corners.
    around = sum(normals[mesh.faces[:, corner]] for corner in range(3))
    rate = float(np.einsum("ij,ij->", doubled, around)) / 6.0
    shifted = mesh.vertices_mm + (volume_mm3 - held) / rate * normals
    return Mesh(shifted, mesh.faces, mesh.synthetic)


def facet_solids(mesh: Mesh) -> list[Any]:
    """Solids of planar faces within a closed manifold mesh: cavities belong to what is around."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid

    shells = facet_shells(mesh)
    outer = sorted((each for each in shells if each[1] > 0.0), key=lambda each: each[1])
    solids = [BRepBuilderAPI_MakeSolid(shell) for shell, _, _ in outer]
    for shell, volume, box in shells:
        if volume > 0.0:
            continue
        for number, (_, _, around) in enumerate(outer):
            if (around[0] <= box[0]).all() and (box[1] <= around[1]).all():
                solids[number].Add(shell)
                break
    return [each.Solid() for each in solids]


def facet_shells(mesh: Mesh) -> list[tuple[Any, float, FloatArray]]:
    """One closed shell a component of a closed mesh, of planar faces that share edges.

    With each its volume, negative for a cavity, and its box (2, 3).
    """
    from OCP.BRep import BRep_Builder, BRep_Tool
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.gp import gp_Pnt
    from OCP.TopoDS import TopoDS_Shell

    corners = [BRepBuilderAPI_MakeVertex(gp_Pnt(*p)).Vertex() for p in mesh.vertices_mm.tolist()]
    edges: dict[tuple[int, int], Any] = {}
    builder, shells = BRep_Builder(), []
    for numbers in _components(mesh.faces):
        shell = TopoDS_Shell()
        builder.MakeShell(shell)
        for face in mesh.faces[numbers].tolist():
            builder.Add(shell, _facet(face, mesh.vertices_mm, corners, edges))
        shell.Closed(BRep_Tool.IsClosed_s(shell))
        corner = mesh.vertices_mm[mesh.faces[numbers]]
        volume = float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))) / 6
        box = np.stack([corner.min(axis=(0, 1)), corner.max(axis=(0, 1))])
        shells.append((shell, volume, box))
    return shells


def _facet(
    face: list[int],
    places: FloatArray,
    corners: list[Any],
    edges: dict[tuple[int, int], Any],
) -> Any:  # noqa: ANN401
    """A plane within three edges, each made once, and run backwards by its other face."""
    from OCP.BRep import BRep_Builder
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace
    from OCP.gp import gp_Dir, gp_Pln, gp_Pnt
    from OCP.TopoDS import TopoDS, TopoDS_Wire

    builder, wire = BRep_Builder(), TopoDS_Wire()
    builder.MakeWire(wire)
    for tail, head in zip(face, face[1:] + face[:1], strict=True):
        key = (min(tail, head), max(tail, head))
        if key not in edges:
            edges[key] = BRepBuilderAPI_MakeEdge(corners[key[0]], corners[key[1]]).Edge()
        edge = edges[key] if tail < head else TopoDS.Edge_s(edges[key].Reversed())
        builder.Add(wire, edge)
    wire.Closed(True)  # noqa: FBT003 (Open CASCADE's own call)
    a, b, c = places[face]
    normal = np.cross(b - a, c - a)
    plane = gp_Pln(gp_Pnt(*a.tolist()), gp_Dir(*(normal / np.linalg.norm(normal)).tolist()))
    return BRepBuilderAPI_MakeFace(plane, wire, True).Face()  # noqa: FBT003


def _components(faces: IntArray) -> list[IntArray]:
    """Numbers of the faces that hang together, component by component."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    size = int(faces.max()) + 1
    graph = coo_array((np.ones(len(tails), dtype=np.int8), (tails, heads)), shape=(size, size))
    labels = connected_components(graph, directed=False)[1][faces[:, 0]]
    return [np.flatnonzero(labels == each) for each in np.unique(labels)]
