"""Mesh files: STL, PLY and GLB, written from whole arrays.

STL has no place for a unit, so its header text says it; PLY says it in a comment; glTF fixes the
metre and y upwards, so a GLB keeps our millimetres in the vertices and carries the change in its
root node::

    part frame, mm                       glTF, m
        z  y                              y
        | /        scale 0.001            |
        |/___ x    turn -90 deg about x   |___ x      (z towards the viewer is our -y)
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.exporting import provenance as origins
from reconstruction.exporting.atomic import replacing
from reconstruction.meshing import Mesh

_MM = 1e-3  # in metres
_QUARTER_TURN = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # quaternion x, y, z, w: our z becomes y
_MEASURED = (176, 184, 190, 255)  # neutral grey
_SYNTHETIC = (222, 120, 30, 255)  # orange: stands on no measured point
_FLOAT, _UINT, _UBYTE = 5126, 5125, 5121  # glTF component types
_VERTICES, _INDICES = 34962, 34963  # glTF buffer targets
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PLY_VERTEX = np.dtype([("point", "<f8", 3), ("synthetic", "u1")])
_PLY_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_stl(path: Path | str, mesh: Mesh, *, name: str) -> None:
    """Write binary STL; coordinates become 32-bit floats (0.01 um on a part of 100 mm).

    The header is ``loftscan NAME unit: mm``, the name cut to fit its 80 bytes.

    Raises
    ------
    OSError
        The file cannot be written; then it is not there.
    """
    triangles = np.zeros(len(mesh.faces), dtype=_STL_TRIANGLE)
    triangles["corners"] = mesh.vertices_mm.astype("<f4")[mesh.faces]
    triangles["normal"] = _unit(_face_normals(mesh)).T
    end = " unit: mm"
    label = _ascii(name)[: 80 - len("loftscan ") - len(end)]
    header = f"loftscan {label}{end}".encode("ascii").ljust(80)
    with replacing(path) as file:
        file.write(header + np.uint32(len(triangles)).astype("<u4").tobytes())
        file.write(triangles.data)


def write_ply(path: Path | str, mesh: Mesh, *, name: str, provenance: Mapping[str, object]) -> None:
    """Write binary PLY: double vertices, ``synthetic`` 0 or 1 a vertex, triangles.

    Raises
    ------
    OSError
        The file cannot be written; then it is not there.
    """
    vertices = np.empty(len(mesh.vertices_mm), dtype=_PLY_VERTEX)
    vertices["point"], vertices["synthetic"] = mesh.vertices_mm, mesh.synthetic
    faces = np.empty(len(mesh.faces), dtype=_PLY_FACE)
    faces["count"], faces["corners"] = 3, mesh.faces
    with replacing(path) as file:
        file.write(_ply_header(mesh, name, provenance).encode("ascii"))
        file.write(vertices.data)
        file.write(faces.data)


def write_glb(path: Path | str, mesh: Mesh, *, name: str, provenance: Mapping[str, object]) -> None:
    """Write glTF 2.0 in one file: normals, a neutral material, synthetic vertices in orange.

    Coordinates become 32-bit floats; in the buffer they are still millimetres in the part frame.

    Raises
    ------
    ValueError
        A mesh without vertices or faces: glTF has no empty accessors.
    OSError
        The file cannot be written; then it is not there.
    """
    if not len(mesh.vertices_mm) or not len(mesh.faces):
        raise ValueError(f"{path}: GLB cannot hold a mesh without faces")
    blocks = _blocks(mesh)
    binary_length = sum(block.nbytes for block in blocks.values())
    text = json.dumps(_gltf(mesh, blocks, name, provenance), allow_nan=False).encode()
    text = text.ljust(-(-len(text) // 4) * 4)
    total = 12 + 8 + len(text) + 8 + binary_length
    with replacing(path) as file:
        file.write(b"glTF" + np.array([2, total, len(text)], "<u4").tobytes() + b"JSON" + text)
        file.write(np.uint32(binary_length).astype("<u4").tobytes() + b"BIN\0")
        for block in blocks.values():
            file.write(block.data)


def _ply_header(mesh: Mesh, name: str, provenance: Mapping[str, object]) -> str:
    comments = (f"loftscan {name}", "unit: mm", *origins.lines(provenance))
    return "\n".join(
        (
            "ply",
            "format binary_little_endian 1.0",
            *(f"comment {_ascii(comment)}" for comment in comments),
            f"element vertex {len(mesh.vertices_mm)}",
            *(f"property double {axis}" for axis in "xyz"),
            "property uchar synthetic",
            f"element face {len(mesh.faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        )
    )


def _blocks(mesh: Mesh) -> dict[str, NDArray[np.generic]]:
    """Lay out the binary part, in order; every row is a multiple of 4 bytes."""
    colours = np.array([_MEASURED, _SYNTHETIC], dtype=np.uint8)
    return {
        "POSITION": mesh.vertices_mm.astype("<f4"),
        "NORMAL": _vertex_normals(mesh).astype("<f4"),
        "COLOR_0": colours[mesh.synthetic.astype(np.intp)],
        "indices": mesh.faces.astype("<u4").reshape(-1),
    }


def _gltf(
    mesh: Mesh,
    blocks: Mapping[str, NDArray[np.generic]],
    name: str,
    provenance: Mapping[str, object],
) -> dict[str, object]:
    count, corners = len(mesh.vertices_mm), mesh.faces.size
    position = blocks["POSITION"]
    bounds = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    pbr = {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0.0, "roughnessFactor": 0.7}
    node = {"name": name, "mesh": 0, "rotation": _QUARTER_TURN, "scale": [_MM] * 3}
    return {
        "asset": {
            "version": "2.0",
            "generator": "loftscan",
            "extras": {"unit": "mm", "provenance": origins.plain(provenance)},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "materials": [{"name": "part", "pbrMetallicRoughness": pbr, "doubleSided": True}],
        "meshes": [
            {
                "name": name,
                "primitives": [{"attributes": attributes, "indices": 3, "material": 0}],
            }
        ],
        "accessors": [
            _accessor(0, _FLOAT, count, "VEC3") | bounds,
            _accessor(1, _FLOAT, count, "VEC3"),
            _accessor(2, _UBYTE, count, "VEC4") | {"normalized": True},
            _accessor(3, _UINT, corners, "SCALAR"),
        ],
        "bufferViews": _buffer_views(blocks),
        "buffers": [{"byteLength": sum(block.nbytes for block in blocks.values())}],
    }


def _accessor(view: int, component: int, count: int, kind: str) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _buffer_views(blocks: Mapping[str, NDArray[np.generic]]) -> list[dict[str, int]]:
    views, offset = [], 0
    for name, block in blocks.items():
        target = _INDICES if name == "indices" else _VERTICES
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": block.nbytes, "target": target}
        )
        offset += block.nbytes
    return views


def _face_normals(mesh: Mesh) -> FloatArray:
    """(3, m), as long as twice the face's area; by coordinate, which is the faster order here."""
    x, y, z = np.ascontiguousarray(mesh.vertices_mm.T)
    a, b, c = np.ascontiguousarray(mesh.faces.T)
    x1, y1, z1 = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    x2, y2, z2 = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    return np.stack([y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2])


def _vertex_normals(mesh: Mesh) -> FloatArray:
    """Weight unit normals (n, 3) by the faces' areas; along z where no face says otherwise."""
    corners, count = mesh.faces.T.reshape(-1), len(mesh.vertices_mm)
    summed = [np.bincount(corners, np.tile(row, 3), count) for row in _face_normals(mesh)]
    unit = _unit(np.stack(summed).astype(np.float64))
    # glTF demands unit length of every normal, so that of an unused vertex, too.
    unit[2, ~unit.any(axis=0)] = 1.0
    return np.ascontiguousarray(unit.T)


def _unit(vectors: FloatArray) -> FloatArray:
    """Columns (3, n) of length 1; a zero column (a degenerate face) stays zero."""
    length = np.sqrt((vectors**2).sum(axis=0))
    return np.asarray(vectors / np.where(length > 0, length, 1.0))


def _ascii(text: str) -> str:
    """One line of ASCII, which is all that STL and PLY headers know."""
    return " ".join(text.encode("ascii", "replace").decode().split())
