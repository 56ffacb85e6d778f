"""The judges of the surface benchmark, against formulas and against other libraries."""

from __future__ import annotations

import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.surface.cases import GAP_RAD, HEIGHT_MM, Gap, draw_gaps, in_gaps, make_case
from benchmarks.surface.child import ended, read_made, run_apart, write_made
from benchmarks.surface.contours import draw, outlines
from benchmarks.surface.measures import (
    distances,
    errors_of,
    folded_share,
    mesh_of,
    shape_of,
    side_errors_of,
)
from benchmarks.surface.methods import Made, Task, reduced, signed_like
from benchmarks.surface.shapes import closed, vase
from reconstruction.nurbs import Surface, loft_sections, periodic_uniform

SAMPLES = 20_000


def ball(radius_mm: float, subdivisions: int = 5) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm)


def tube(radius_mm: float, columns: int = 3600, rows: int = 201) -> trimesh.Trimesh:
    turn = np.arange(columns) / columns * math.tau
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(columns)], axis=1) * radius_mm
    levels = np.linspace(0.0, HEIGHT_MM, rows)[:, None, None] * [0.0, 0.0, 1.0]
    vertices, faces = closed(ring + levels, bottom=np.zeros(3), top=np.array([0, 0, HEIGHT_MM]))
    return trimesh.Trimesh(vertices, faces, process=False)


# --- distances ------------------------------------------------------------------------------------


def test_distances_agree_with_trimesh() -> None:
    rng = np.random.default_rng(0)
    mesh = trimesh.creation.torus(30.0, 8.0)
    points = rng.uniform(-45.0, 45.0, (400, 3))
    ours, _ = distances(points, mesh)
    theirs = trimesh.proximity.closest_point_naive(mesh, points)[1]
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_distances_agree_with_open3d() -> None:
    why = "open3d-cpu is in the group bench"
    open3d = pytest.importorskip("open3d", reason=why, exc_type=ImportError)
    rng = np.random.default_rng(1)
    mesh = trimesh.creation.torus(30.0, 8.0)
    points = rng.uniform(-45.0, 45.0, (20_000, 3))
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    theirs = scene.compute_distance(points.astype(np.float32)).numpy()
    # Single precision at 45 mm.
    np.testing.assert_allclose(distances(points, mesh)[0], theirs, atol=2e-5)


def test_two_balls_about_one_centre_are_as_far_apart_as_their_radii() -> None:
    truth = ball(50.0)
    errors = errors_of(ball(50.5), truth, seed=0, samples=SAMPLES)
    share = 100.0 / np.linalg.norm(truth.extents)
    # Two equal polyhedra: the faces are parallel and 0.5 times the inradius' share of 1 apart.
    for value in (errors.chamfer, errors.h95, errors.h100):
        assert value == pytest.approx(0.5 * share, rel=2e-3)
    assert errors.normals_deg < 0.1
    assert errors.volume == pytest.approx(100 * ((50.5 / 50.0) ** 3 - 1), rel=1e-6)
    assert math.isnan(errors.apex)


def test_a_missing_half_is_seen_from_the_truth_only() -> None:
    truth = ball(50.0)
    upper = trimesh.Trimesh(
        truth.vertices, truth.faces[truth.triangles_center[:, 2] > 0], process=False
    )
    errors = errors_of(upper, truth, seed=0, samples=SAMPLES)
    share = 100.0 / np.linalg.norm(truth.extents)
    assert errors.h100 == pytest.approx(50.0 * math.sqrt(2) * share, rel=0.02)  # pole to rim
    # A place of the missing half, so far below the equator, sees the rim over a chord.
    below = np.linspace(0.0, math.pi / 2, 10_001)
    mean = np.trapezoid(2 * 50.0 * np.sin(below / 2) * np.cos(below), below)
    # Half of the places, and one of the two ways; 20 000 of them know it to half a per cent.
    assert errors.chamfer == pytest.approx(mean / 4 * share, rel=0.02)
    assert math.isnan(errors.volume)
    assert not shape_of(upper).watertight


def test_a_result_turned_inside_out_has_no_volume_error_of_zero() -> None:
    truth = ball(50.0, 3)
    inverted = trimesh.Trimesh(truth.vertices, truth.faces[:, ::-1], process=False)
    assert errors_of(inverted, truth, seed=0, samples=1000).volume == pytest.approx(200.0)


def test_vertices_that_were_written_twice_do_not_open_a_mesh() -> None:
    solid = ball(10.0, 2)
    split = mesh_of(solid.triangles.reshape(-1, 3), np.arange(len(solid.faces) * 3).reshape(-1, 3))
    assert shape_of(split).watertight
    assert shape_of(split).euler == 2


# --- the cylinder ---------------------------------------------------------------------------------


def test_gaps_are_a_fifth_of_the_side_and_never_meet() -> None:
    for seed in range(20):
        gaps = draw_gaps(np.random.default_rng(seed))
        area = sum(GAP_RAD * (gap.high_mm - gap.low_mm) for gap in gaps)
        assert area / (math.tau * HEIGHT_MM) == pytest.approx(0.2)
        turn, level = np.meshgrid(np.linspace(0, math.tau, 721), np.linspace(0.05, 99.95, 400))
        hits = sum(gap.holds(turn.ravel(), level.ravel()).astype(int) for gap in gaps)
        assert hits.max() == 1


def test_the_cylinder_is_drawn_outside_its_gaps_with_its_noise() -> None:
    case = make_case("cylinder", seed=3)
    off = np.hypot(case.points_mm[:, 0], case.points_mm[:, 1]) - 50.0
    # Noise across the radius adds sigma^2 / 2r.
    assert off.mean() == pytest.approx(0.2**2 / 100.0, abs=4 * 0.2 / 1e3)
    assert off.std() == pytest.approx(0.2, rel=0.005)
    angle = np.arctan2(case.normals[:, 1], case.normals[:, 0])
    strip = case.gaps[0]
    assert not strip.holds(angle, np.full(len(angle), 50.0)).any()


def test_an_exact_side_has_no_error_and_covers_its_gaps() -> None:
    gaps = (Gap(0.5, 0.0, HEIGHT_MM),)
    seen = side_errors_of(tube(50.0), gaps, seed=0)
    assert seen.outside_rms_mm < 5e-5  # the sagitta of 3600 sides is 1.9e-5 mm
    assert seen.inside_rms_mm < 5e-5
    assert seen.covered == 1.0
    assert seen.stray == 0.0


def test_a_hole_in_the_gap_is_not_covered_and_a_wrong_radius_is_read_off() -> None:
    gaps = (Gap(0.5, 0.0, HEIGHT_MM),)
    whole = tube(50.25)
    middle = whole.triangles_center
    turn = np.mod(np.arctan2(middle[:, 1], middle[:, 0]) - 0.5, math.tau)
    half = (turn < GAP_RAD / 2) & (middle[:, 2] < 50.0)
    seen = side_errors_of(
        trimesh.Trimesh(whole.vertices, whole.faces[~half], process=False), gaps, seed=0
    )
    assert seen.outside_rms_mm == pytest.approx(0.25, abs=1e-4)
    assert seen.inside_rms_mm == pytest.approx(0.25, abs=1e-4)
    # A quarter of the gap, of which heights 3 to 50 of 3 to 97 are judged; cells of 0.5 mm.
    assert seen.covered == pytest.approx(0.75, abs=0.02)


# --- slices ---------------------------------------------------------------------------------------


def test_a_torus_is_cut_into_two_closed_outlines_on_its_surface() -> None:
    solid = trimesh.creation.torus(30.0, 8.0)
    inner, outer = sorted(outlines(solid, np.array([0.0, 0, 1]), 3.0), key=lambda o: o.marks_mm[-1])
    width = math.sqrt(8.0**2 - 3.0**2)
    # trimesh's torus has 32 x 32 sides: outlines are shorter than circles by 1 - (pi / 32)^2 / 6.
    assert inner.marks_mm[-1] == pytest.approx(math.tau * (30 - width), rel=0.02)
    assert outer.marks_mm[-1] == pytest.approx(math.tau * (30 + width), rel=0.02)
    places, faces = draw([inner, outer], 4000, np.random.default_rng(0))
    assert distances(places, solid)[0].max() < 1e-9
    plane = np.einsum("ij,ij->i", places - solid.triangles[faces, 0], solid.face_normals[faces])
    assert np.abs(plane).max() < 1e-9  # the face named is the face drawn on


def test_places_are_uniform_in_length_and_one_arc_of_each_outline_is_lost() -> None:
    solid = trimesh.creation.torus(30.0, 8.0)
    found = outlines(solid, np.array([0.0, 0, 1]), 0.1)
    places, _ = draw(found, 40_000, np.random.default_rng(2), lost_share=0.2)
    assert len(places) == pytest.approx(32_000, abs=400)  # 5 sigma of 0.2 * 40 000 drawn
    radii = np.hypot(places[:, 0], places[:, 1])
    for near in (radii < 30, radii > 30):
        turn = np.sort(np.arctan2(places[near, 1], places[near, 0]))
        steps = np.diff(np.append(turn, turn[0] + math.tau))
        assert steps.max() == pytest.approx(0.2 * math.tau, abs=0.02)
        assert np.sort(steps)[-2] < 0.02


def test_a_case_is_made_the_same_again_and_other_seeds_give_others() -> None:
    once, again, other = (make_case("cone+gaps", seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(once.points_mm, again.points_mm)
    assert len(once.points_mm) != len(other.points_mm) or (once.points_mm != other.points_mm).any()
    assert once.truth is not None
    assert once.truth.solid().is_watertight
    off = distances(once.points_mm, once.truth.solid())[0]
    assert off.max() < 6 * 0.3  # the noise; where the surface is steep it is seen whole


def test_normals_of_a_case_are_those_of_its_surface() -> None:
    case = make_case("cone", seed=0)
    outward = case.points_mm * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    slope = math.hypot(40.0, 100.0)
    expected = np.column_stack(
        [outward[:, :2] * 100.0 / slope, np.full(len(outward), 40.0 / slope)]
    )
    cosines = np.einsum("ij,ij->i", case.normals, expected)
    # The noise of 0.3 mm turns the direction of a place at the median radius by 0.02.
    assert np.median(cosines) > math.cos(0.03)


def test_the_vase_is_closed_and_twists() -> None:
    vertices, faces = vase()
    solid = trimesh.Trimesh(vertices, faces, process=False)
    assert solid.is_watertight
    assert solid.volume > 0
    radius = np.hypot(vertices[:, 0], vertices[:, 1])[:-2].reshape(-1, 1080)
    assert np.argmax(radius[0]) != np.argmax(radius[120]) != np.argmax(radius[-1])


# --- folds ----------------------------------------------------------------------------------------


def as_arrays(surface: Surface) -> dict[str, object]:
    names = ("degree_u", "degree_v", "knots_u", "knots_v", "control_points_mm", "weights",
             "periodic_u", "periodic_v")  # fmt: skip
    return {name: np.asarray(getattr(surface, name)) for name in names}


def lofted(heights: list[float]) -> Surface:
    turn = np.arange(12) / 12 * math.tau
    rings = [np.stack([9 * np.cos(turn), 9 * np.sin(turn), np.full(12, h)], 1) for h in heights]
    knots = periodic_uniform(rings[0]).knots
    return loft_sections(
        np.stack(rings), degree_u=3, knots_u=knots, periodic_u=True,
        parameters=np.arange(float(len(heights))), degree_v=3,
    )  # fmt: skip


def test_a_tube_has_no_fold_and_one_that_turns_back_has() -> None:
    assert folded_share(as_arrays(lofted([0, 1, 2, 3, 4])), grid=100) == 0.0
    assert folded_share(as_arrays(lofted([0, 3, 1, 4, 6])), grid=100) > 0.05


# --- methods and their processes ------------------------------------------------------------------


def test_a_reduced_cloud_has_the_mean_of_every_cell() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 10, (5000, 3))
    normals = np.tile([0.0, 0.6, 0.8], (5000, 1))
    few, directions = reduced(points, normals, 2.5)
    low = points.min(axis=0)
    keys = [tuple(key) for key in np.floor((points - low) / 2.5).astype(int)]
    naive = {key: points[[k == key for k in keys]].mean(axis=0) for key in set(keys)}
    np.testing.assert_allclose(few, [naive[key] for key in sorted(naive)], atol=1e-12)
    np.testing.assert_allclose(directions, normals[: len(few)], atol=1e-12)


def test_signs_are_taken_from_the_true_normals() -> None:
    found = signed_like(np.array([[0.0, 0, -1], [0, 1, 0]]), np.array([[0.1, 0, 1], [0, 1, 1]]))
    np.testing.assert_array_equal(found, [[0, 0, 1], [0, 1, 0]])


def test_a_child_that_crashes_fails_or_takes_too_long_is_reported_so(tmp_path: Path) -> None:
    task = Task(tmp_path / "points.npy", tmp_path / "normals.npy", "z", 1.0)
    died = subprocess.CompletedProcess([], -11, "", "")
    assert ended(died, tmp_path / "made.npz").failure == "crashed: SIGSEGV"
    assert "No such file" in run_apart("APSS", task, tmp_path, limit_s=60).failure
    assert run_apart("APSS", task, tmp_path, limit_s=0.01).failure == "timed out after 0.01 s"


def test_a_child_makes_a_mesh_and_tells_its_cost(tmp_path: Path) -> None:
    solid = ball(20.0)
    points, faces = trimesh.sample.sample_surface(solid, 20_000, seed=0)
    np.save(tmp_path / "points.npy", points)
    np.save(tmp_path / "normals.npy", solid.face_normals[faces])
    task = Task(tmp_path / "points.npy", tmp_path / "normals.npy", "z", 1.0)
    run = run_apart("APSS", task, tmp_path, limit_s=120)
    assert run.made is not None, run.failure
    assert run.cost is not None
    assert run.cost.cpu_s > 0.05
    assert run.cost.peak_mb > run.cost.above_imports_mb > 1
    radii = np.linalg.norm(run.made.vertices_mm, axis=1)
    assert np.abs(radii - 20.0).max() < 0.1


def test_a_mesh_and_its_patches_are_read_back(tmp_path: Path) -> None:
    solid, patch = ball(5.0, 1), lofted([0, 1, 2, 3])
    write_made(tmp_path / "made.npz", Made(solid.vertices, solid.faces, (patch, patch)))
    made = read_made(tmp_path / "made.npz")
    np.testing.assert_array_equal(made.faces, solid.faces)
    assert len(made.patches) == 2
    np.testing.assert_array_equal(made.patches[1]["control_points_mm"], patch.control_points_mm)
    assert folded_share(made.patches[0], grid=50) == 0.0


def test_places_of_a_gap_are_told_across_the_seam_of_the_angle() -> None:
    gap = Gap(math.tau - 0.1, 10.0, 30.0)
    inside = in_gaps((gap,), np.array([-0.05, 0.2, 0.6, 0.2]), np.array([20.0, 20, 20, 40]))
    np.testing.assert_array_equal(inside, [True, True, False, False])
