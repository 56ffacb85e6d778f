"""The simulator's judgement of a result, against formulas and a brute-force twin."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from sim.judging import Surface, judge, main
from sim.parts import cone, cylinder, vase


def surface_of(part):
    return Surface(part.vertices_mm, part.faces)


def mesh_of(part):
    return trimesh.Trimesh(part.vertices_mm, part.faces, process=False)


def brute_force_mm(corners_mm, points_mm):
    """Distance by trimesh's own nearest point of every triangle to every point."""
    least = np.full(len(points_mm), np.inf)
    for triangle in corners_mm:
        near = trimesh.triangles.closest_point(
            np.broadcast_to(triangle, (len(points_mm), 3, 3)), points_mm
        )
        least = np.minimum(least, np.linalg.norm(points_mm - near, axis=1))
    return least


def test_a_cylinder_that_is_too_wide_lies_outside_by_the_difference():
    truth = surface_of(cylinder(20.0, 30.0, around=256))
    found = judge(truth, mesh_of(cylinder(20.1, 30.0, around=256)), samples=2000)
    assert found.mean_mm == pytest.approx(0.1, abs=2e-3)
    assert found.rms_mm == pytest.approx(0.1, abs=2e-3)
    assert found.back_rms_mm == pytest.approx(0.1, abs=2e-3)


def test_a_cylinder_that_is_too_thin_lies_inside():
    truth = surface_of(cylinder(20.0, 30.0, around=256))
    found = judge(truth, mesh_of(cylinder(19.8, 30.0, around=256)), samples=2000)
    assert found.mean_mm == pytest.approx(-0.2, abs=2e-3)


def test_the_truth_lies_on_itself():
    part = cone(20.0, 30.0, around=128)
    found = judge(surface_of(part), mesh_of(part), samples=2000)
    assert found.max_mm < 1e-9
    assert found.back_max_mm < 1e-9


def test_faces_that_close_the_ends_are_left_out_and_counted():
    part = cylinder(10.0, 10.0, around=512)
    found = judge(surface_of(cylinder(10.0, 12.0, around=512)), mesh_of(part), samples=1000)
    # The lid at 10 mm is 2 mm under the true one; walls alone are judged.
    assert found.max_mm < 1e-9
    assert found.capped_area_share == pytest.approx(0.5, abs=1e-3)  # 2 pi r^2 of 2 pi r (r + h)


def test_distances_are_those_of_brute_force():
    part = vase(10.0, 20.0, around=40, levels=9)
    points_mm = np.random.default_rng(5).uniform([-14, -14, -3], [14, 14, 23], (300, 3))
    found = surface_of(part).signed_distances_mm(points_mm)
    np.testing.assert_allclose(
        np.abs(found), brute_force_mm(part.vertices_mm[part.faces], points_mm), atol=1e-9
    )


def test_points_within_the_part_are_negative():
    part = vase(10.0, 20.0, around=40, levels=9)
    points_mm = np.random.default_rng(6).uniform([-14, -14, -3], [14, 14, 23], (300, 3))
    inside = mesh_of(part).contains(points_mm)
    found = surface_of(part).signed_distances_mm(points_mm)
    np.testing.assert_array_equal(found < 0.0, inside)


def test_the_command_prints_one_json_object(tmp_path, capsys):
    file = tmp_path / "mesh.stl"
    mesh_of(cylinder(40.05, 80.0, around=512)).export(file)
    assert main([str(file), "--part", "cylinder", "--samples", "500"]) == 0
    assert json.loads(capsys.readouterr().out)["mean_mm"] == pytest.approx(0.05, abs=5e-3)


def test_a_mesh_that_is_not_there_is_one_line_and_bad_input(tmp_path, capsys):
    assert main([str(tmp_path / "absent.stl"), "--part", "cylinder"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
