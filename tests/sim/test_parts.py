from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from sim.parts import PARTS, badly_acquired, blade, cone, cylinder, find_part, vase
from sim.solids import Part, read_mesh


def as_trimesh(part: Part) -> trimesh.Trimesh:
    return trimesh.Trimesh(part.vertices_mm, part.faces, process=False)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_is_a_watertight_solid_that_stands_on_the_table(name):
    part = find_part(name)
    mesh = as_trimesh(part)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0.0
    assert part.vertices_mm[:, 2].min() == 0.0


@pytest.mark.parametrize("make", [cylinder, cone, vase, badly_acquired])
def test_the_vertices_obey_the_law_of_the_radius(make):
    part = make()
    x, y, z = part.vertices_mm.T
    radius_mm = np.hypot(x, y)
    skin = radius_mm > 0.0  # the middles of the fans are on the axis
    expected_mm = part.radius_mm(np.arctan2(y, x), z)
    assert skin.sum() >= len(z) - 2
    assert np.abs(radius_mm - expected_mm)[skin].max() < 1e-9


def test_volumes_are_the_textbooks():
    assert as_trimesh(cylinder(40.0, 80.0)).volume == pytest.approx(math.pi * 40**2 * 80, rel=1e-5)
    assert as_trimesh(cone(40.0, 80.0)).volume == pytest.approx(math.pi * 40**2 * 80 / 3, rel=1e-5)


def test_the_vase_has_the_faces_that_the_benchmark_promises_and_its_lobes_turn_with_height():
    part = vase(twist_rad=0.8)
    assert len(part.faces) >= 100_000
    angle_rad = np.linspace(0.0, math.tau / 5, 4001)
    low = part.radius_mm(angle_rad, np.zeros(4001))
    high = part.radius_mm(angle_rad, np.full(4001, 100.0))
    turned_rad = angle_rad[high.argmax()] - angle_rad[low.argmax()]
    assert abs((turned_rad - 0.8 + math.tau / 10) % (math.tau / 5) - math.tau / 10) < 2e-3


def test_the_badly_acquired_cylinder_is_black_in_many_places_and_the_same_every_time():
    part, again, other = badly_acquired(), badly_acquired(), badly_acquired(seed=8)
    black = part.reflectance == 0.0
    assert 0.2 < black.mean() < 0.6
    assert np.array_equal(part.reflectance, again.reflectance)
    assert not np.array_equal(part.reflectance, other.reflectance)


def test_the_blade_is_thinner_than_its_hub_and_twisted():
    part = blade()
    upper = part.vertices_mm[part.vertices_mm[:, 2] > 85.0]
    hub = part.vertices_mm[part.vertices_mm[:, 2] == 0.0]
    spread = np.linalg.svd(upper[:, :2] - upper[:, :2].mean(axis=0), compute_uv=False)
    assert spread[1] / spread[0] < 0.3
    assert np.hypot(*hub[:-1, :2].T).max() > np.hypot(*upper[:, :2].T).max()
    tip, root = (
        section[np.hypot(section[:, 0], section[:, 1]).argmax()]
        for section in (upper, part.vertices_mm[np.isclose(part.vertices_mm[:, 2], 20.0)][240:])
    )
    assert math.atan2(tip[1], tip[0]) - math.atan2(root[1], root[0]) == pytest.approx(0.7, abs=0.06)


@pytest.mark.parametrize("kind", ["stl", "ply", "obj"])
def test_a_mesh_file_is_merged_and_stood_on_the_table(tmp_path, kind):
    box = trimesh.creation.box((10.0, 20.0, 30.0))
    box.apply_translation((100.0, 50.0, 25.0))
    path = tmp_path / f"box.{kind}"
    box.export(path)
    part = find_part(str(path))
    assert part.name == "box"
    assert len(part.vertices_mm) == 8
    assert as_trimesh(part).is_watertight
    assert np.allclose(part.vertices_mm.min(axis=0), [-5.0, -10.0, 0.0], atol=1e-5)
    assert np.allclose(part.vertices_mm.max(axis=0), [5.0, 10.0, 30.0], atol=1e-5)


def test_a_mesh_in_metres_is_scaled(tmp_path):
    trimesh.creation.box((0.01, 0.02, 0.03)).export(tmp_path / "box.stl")
    part = read_mesh(tmp_path / "box.stl", mm_per_unit=1000.0)
    assert np.ptp(part.vertices_mm, axis=0) == pytest.approx([10.0, 20.0, 30.0], rel=1e-5)


@pytest.mark.parametrize("content", [b"", b"no mesh at all", b"solid a\nendsolid a\n"])
@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "txt"])
def test_a_file_without_triangles_is_refused_by_its_name(tmp_path, kind, content):
    path = tmp_path / f"bad.{kind}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"bad\."):
        read_mesh(path)


def test_an_unknown_part_is_refused_with_the_names_that_are_known():
    with pytest.raises(ValueError, match="no such file; built-in parts are cylinder, cone, vase"):
        find_part("teapot")


def test_a_part_is_read_only_and_checked():
    part = cylinder(levels=2, around=8)
    with pytest.raises(ValueError, match="read-only"):
        part.vertices_mm[0, 0] = 1.0
    with pytest.raises(ValueError, match="reflectances"):
        Part("odd", part.vertices_mm, part.faces, None, np.ones(3, np.float32))
    with pytest.raises(ValueError, match="finite"):
        Part("odd", part.vertices_mm * np.nan, part.faces)


def test_texture_seams_of_an_obj_file_do_not_open_the_surface(tmp_path):
    path = tmp_path / "seams.obj"
    corners = "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\n"
    texture = "".join(f"vt 0.{number:02d} 0.5\n" for number in range(12))
    faces = "f 1/1 3/2 2/3\nf 1/4 2/5 4/6\nf 1/7 4/8 3/9\nf 2/10 3/11 4/12\n"
    path.write_text(corners + texture + faces)
    part = read_mesh(path)
    assert len(part.vertices_mm) == 4
    assert as_trimesh(part).is_watertight
