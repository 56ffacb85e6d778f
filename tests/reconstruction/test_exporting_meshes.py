"""STL, PLY and GLB read back by trimesh and by readers of our own."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from reconstruction.exporting import write_glb, write_ply, write_stl
from reconstruction.meshing import Mesh

PROVENANCE = {"input": Path("/somewhere/secret/UHU.pcd"), "settings": {"cell_mm": 4.0}}

CENTRE_MM = np.array([100.0, 20.0, 3.0])


def ball(radius_mm: float = 10.0) -> Mesh:
    """A closed sphere, off the origin; its upper part counts as synthetic."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=radius_mm)
    vertices = np.asarray(sphere.vertices, dtype=np.float64) + CENTRE_MM
    return Mesh(vertices, sphere.faces, vertices[:, 2] > 8.0)


def naive_normal(a, b, c):
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal)


# --- STL ------------------------------------------------------------------------------------------


def naive_stl(data: bytes):
    """Header, and for each triangle its normal and corners, one after another."""
    (count,) = struct.unpack_from("<I", data, 80)
    triangles = []
    for index in range(count):
        numbers = struct.unpack_from("<12fH", data, 84 + 50 * index)
        triangles.append((numbers[:3], np.reshape(numbers[3:12], (3, 3)), numbers[12]))
    assert len(data) == 84 + 50 * count
    return data[:80], triangles


def test_stl_holds_every_triangle_with_its_outward_normal(tmp_path: Path) -> None:
    mesh = ball()
    write_stl(tmp_path / "a.stl", mesh, name="ball")
    header, triangles = naive_stl((tmp_path / "a.stl").read_bytes())
    assert header.startswith(b"loftscan ball unit: mm ")
    for face, (normal, corners, attribute) in zip(mesh.faces, triangles, strict=True):
        expected = mesh.vertices_mm[face]
        np.testing.assert_array_equal(corners, expected.astype(np.float32))
        np.testing.assert_allclose(normal, naive_normal(*expected), atol=1e-6)
        assert attribute == 0


def test_trimesh_reads_the_stl_as_the_same_closed_body(tmp_path: Path) -> None:
    mesh = ball()
    write_stl(tmp_path / "a.stl", mesh, name="ball")
    again = trimesh.load(tmp_path / "a.stl")
    assert again.is_watertight
    assert again.volume == pytest.approx(
        trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).volume, rel=1e-5
    )


@pytest.mark.parametrize("name", ["solid", "x" * 500, "Käfer\nvase", ""])
def test_an_stl_header_is_80_bytes_and_always_says_the_unit(name: str, tmp_path: Path) -> None:
    write_stl(tmp_path / "a.stl", ball(), name=name)
    header, _ = naive_stl((tmp_path / "a.stl").read_bytes())
    assert header.decode("ascii").rstrip().endswith("unit: mm")
    assert header.startswith(b"loftscan ")
    assert b"\n" not in header


def test_a_degenerate_stl_triangle_has_a_zero_normal(tmp_path: Path) -> None:
    write_stl(tmp_path / "a.stl", Mesh(np.eye(3), [[0, 0, 1]], np.zeros(3)), name="a")
    _, [(normal, _, _)] = naive_stl((tmp_path / "a.stl").read_bytes())
    assert normal == (0.0, 0.0, 0.0)


# --- PLY ------------------------------------------------------------------------------------------


def naive_ply(data: bytes):
    header, _, body = data.partition(b"end_header\n")
    lines = header.decode("ascii").splitlines()
    counts = {line.split()[1]: int(line.split()[2]) for line in lines if "element" in line}
    stream = io.BytesIO(body)
    vertices = [struct.unpack("<3dB", stream.read(25)) for _ in range(counts["vertex"])]
    faces = [struct.unpack("<B3i", stream.read(13)) for _ in range(counts["face"])]
    assert stream.read() == b""
    return lines, vertices, faces


def test_ply_holds_double_vertices_their_origin_and_the_faces(tmp_path: Path) -> None:
    mesh = ball()
    write_ply(tmp_path / "a.ply", mesh, name="ball", provenance=PROVENANCE)
    lines, vertices, faces = naive_ply((tmp_path / "a.ply").read_bytes())
    np.testing.assert_array_equal([v[:3] for v in vertices], mesh.vertices_mm)
    np.testing.assert_array_equal([v[3] for v in vertices], mesh.synthetic)
    np.testing.assert_array_equal(faces, [(3, *face) for face in mesh.faces])
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    comments = [line for line in lines if line.startswith("comment")]
    assert comments == [
        "comment loftscan ball",
        "comment unit: mm",
        "comment input: UHU.pcd",
        "comment settings.cell_mm: 4.0",
    ]


def test_trimesh_reads_the_ply_to_the_same_doubles(tmp_path: Path) -> None:
    mesh = ball()
    write_ply(tmp_path / "a.ply", mesh, name="ball", provenance=PROVENANCE)
    again = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(again.vertices, mesh.vertices_mm)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    read = again.metadata["_ply_raw"]["vertex"]["data"]["synthetic"]
    np.testing.assert_array_equal(np.ravel(read).astype(bool), mesh.synthetic)


def test_a_comment_cannot_end_the_ply_header(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", ball(), name="a", provenance={"note": "x\nend_header\ny"})
    lines, vertices, _ = naive_ply((tmp_path / "a.ply").read_bytes().replace(b"x end_header", b""))
    assert len(vertices) == len(ball().vertices_mm)
    assert sum(line.startswith("end_header") for line in lines) == 0


@pytest.mark.parametrize("write", [write_stl, write_ply])
def test_an_empty_mesh_is_a_valid_file(write, tmp_path: Path) -> None:
    nothing = Mesh(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    more = {} if write is write_stl else {"provenance": {}}
    write(tmp_path / "a", nothing, name="nothing", **more)
    data = (tmp_path / "a").read_bytes()
    found = naive_stl(data)[1] if write is write_stl else naive_ply(data)[2]
    assert found == []


# --- GLB ------------------------------------------------------------------------------------------


def naive_glb(data: bytes):
    """The JSON part and each accessor as an array, by the specification's chunks."""
    magic, version, length, text_length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    assert text_length % 4 == 0
    gltf = json.loads(data[20 : 20 + text_length])
    size, kind = struct.unpack_from("<I4s", data, 20 + text_length)
    binary = data[28 + text_length :]
    assert kind == b"BIN\0"
    assert len(binary) == size == gltf["buffers"][0]["byteLength"]
    types = {5126: "<f4", 5125: "<u4", 5121: "u1"}
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
    found = []
    for accessor in gltf["accessors"]:
        view = gltf["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        part = binary[view["byteOffset"] :][: view["byteLength"]]
        rows = np.frombuffer(part, types[accessor["componentType"]])
        found.append(rows.reshape(accessor["count"], widths[accessor["type"]]))
    return gltf, found


def test_a_viewer_sees_the_glb_in_metres_with_y_upwards(tmp_path: Path) -> None:
    mesh = ball()
    write_glb(tmp_path / "a.glb", mesh, name="ball", provenance=PROVENANCE)
    scene = trimesh.load_scene(tmp_path / "a.glb")
    x, y, z = mesh.vertices_mm.T / 1000.0
    seen = scene.to_geometry()
    low, high = seen.bounds
    np.testing.assert_allclose(low, [x.min(), z.min(), (-y).min()], atol=1e-7)
    np.testing.assert_allclose(high, [x.max(), z.max(), (-y).max()], atol=1e-7)
    assert seen.is_watertight
    assert seen.volume > 0  # not turned inside out by the root node


def test_glb_keeps_millimetres_normals_and_the_synthetic_colour(tmp_path: Path) -> None:
    mesh = ball()
    write_glb(tmp_path / "a.glb", mesh, name="ball", provenance=PROVENANCE)
    gltf, (position, normal, colour, indices) = naive_glb((tmp_path / "a.glb").read_bytes())
    np.testing.assert_array_equal(position, mesh.vertices_mm.astype(np.float32))
    np.testing.assert_array_equal(indices.reshape(-1, 3), mesh.faces)
    outward = (mesh.vertices_mm - CENTRE_MM) / 10.0
    np.testing.assert_allclose(normal, outward, atol=0.03)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-6)
    measured, synthetic = colour[~mesh.synthetic], colour[mesh.synthetic]
    assert len(np.unique(measured, axis=0)) == len(np.unique(synthetic, axis=0)) == 1
    assert not np.array_equal(measured[0], synthetic[0])
    assert gltf["accessors"][0]["min"] == position.min(axis=0).tolist()
    assert gltf["asset"]["extras"] == {
        "unit": "mm",
        "provenance": {"input": "UHU.pcd", "settings": {"cell_mm": 4.0}},
    }


def test_glb_normals_are_the_area_weighted_sum_over_the_faces(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    faces = rng.permuted(np.tile(np.arange(11), (7, 1)), axis=1)[:, :3]  # vertex 11 is unused
    mesh = Mesh(rng.normal(size=(12, 3)), faces, np.zeros(12))
    write_glb(tmp_path / "a.glb", mesh, name="soup", provenance={})
    _, (_, normals, _, _) = naive_glb((tmp_path / "a.glb").read_bytes())
    for vertex, normal in enumerate(normals):
        total = np.zeros(3)
        for a, b, c in mesh.faces:
            if vertex in (a, b, c):
                p, q, r = mesh.vertices_mm[[a, b, c]]
                total += np.cross(q - p, r - p) / 2
        length = np.linalg.norm(total)
        expected = total / length if length else (0.0, 0.0, 1.0)
        np.testing.assert_allclose(normal, expected, atol=1e-6)


def test_glb_refuses_a_mesh_without_faces(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="without faces"):
        write_glb(tmp_path / "a.glb", Mesh(np.eye(3), np.empty((0, 3)), np.zeros(3)),
                  name="a", provenance={})  # fmt: skip
    assert list(tmp_path.iterdir()) == []
