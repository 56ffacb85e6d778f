"""`loftscan compare`: deviations that are known from how the points were made."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.conftest import Saved
from tests.system.command_cases import FloatArray, complaint, contents, run, succeeded

FILES = {"comparison.json", "deviation.ply", "report.html"}
OFF_MM = 0.1
FLOAT32_MM = 1e-5  # of coordinates up to 40 mm, as .stl has them


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=20.0)


def block() -> trimesh.Trimesh:
    """Three different sides: a shape that holds all six freedoms."""
    return trimesh.creation.box(extents=(40.0, 24.0, 10.0)).subdivide().subdivide()


def above(mesh: trimesh.Trimesh, distance_mm: FloatArray | float) -> FloatArray:
    """A point over the middle of every face, so far along its normal: the distance is exact."""
    return mesh.triangles_center + np.reshape(distance_mm, (-1, 1)) * mesh.face_normals


def compared(folder: Path) -> dict:
    return json.loads((folder / "comparison.json").read_text())


def deviations(folder: Path) -> tuple[FloatArray, FloatArray]:
    head, _, body = (folder / "deviation.ply").read_bytes().partition(b"end_header\n")
    assert b"unit: mm" in head
    rows = np.frombuffer(body, dtype=[("p", "<f8", 3), ("d", "<f4")])
    assert f"element vertex {len(rows)}\n".encode() in head
    return rows["p"], rows["d"]


@pytest.fixture
def sphere(place: Path) -> trimesh.Trimesh:
    mesh = ball()
    mesh.export(place / "ball.stl")
    return mesh


@pytest.mark.parametrize(("sign", "said"), [(1.0, "+0.1 mm"), (-1.0, "-0.1 mm")])
def test_points_outside_a_sphere_are_positive_and_inside_negative(
    place: Path, sphere: trimesh.Trimesh, sign: float, said: str
) -> None:
    np.save("points.npy", above(sphere, sign * OFF_MM))
    ran = succeeded(run("compare", "points.npy", "ball.stl", "--out", "c"))
    told = compared(place / "c")
    assert set(contents(place / "c")) == FILES
    assert f"mean {said}" in ran.stdout
    assert told["points"] == len(sphere.faces)
    assert told["mean_mm"] == pytest.approx(sign * OFF_MM, abs=FLOAT32_MM)
    assert told["rms_mm"] == pytest.approx(OFF_MM, abs=FLOAT32_MM)
    assert told["std_mm"] == pytest.approx(0.0, abs=FLOAT32_MM)
    assert told["alignment"] is None
    assert told["verdict"] is None
    where, off = deviations(place / "c")
    np.testing.assert_array_equal(where, above(sphere, sign * OFF_MM))
    np.testing.assert_allclose(off, sign * OFF_MM, rtol=0, atol=FLOAT32_MM)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".off"])
def test_every_mesh_format_gives_the_same_signed_distances(
    place: Path, without_pictures: None, suffix: str
) -> None:
    mesh = ball()
    mesh.export(place / f"ball{suffix}")
    wanted = np.where(np.arange(len(mesh.faces)) % 4 == 0, -OFF_MM, OFF_MM)
    np.save("points.npy", above(mesh, wanted))
    succeeded(run("compare", "points.npy", f"ball{suffix}", "--out", "c"))
    np.testing.assert_allclose(deviations(place / "c")[1], wanted, rtol=0, atol=FLOAT32_MM)
    assert compared(place / "c")["mean_mm"] == pytest.approx(OFF_MM / 2, abs=FLOAT32_MM)


def test_a_mesh_against_a_cloud_is_measured_from_the_cloud(
    place: Path, sphere: trimesh.Trimesh, without_pictures: None
) -> None:
    np.save("points.npy", above(sphere, OFF_MM))
    succeeded(run("compare", "ball.stl", "points.npy", "--out", "c"))
    told = compared(place / "c")
    assert told["measured"] == {"name": "points.npy", "kind": "cloud"}
    assert told["reference"] == {"name": "ball.stl", "kind": "mesh"}
    assert told["mean_mm"] == pytest.approx(OFF_MM, abs=FLOAT32_MM)


def test_two_clouds_have_distances_without_a_sign(place: Path, without_pictures: None) -> None:
    grid = np.stack(np.meshgrid(*[np.arange(6) * 10.0] * 3), axis=-1).reshape(-1, 3)
    np.save("grid.npy", grid)
    np.save("shifted.npy", grid - [0.0, 0.25, 0.0])
    succeeded(run("compare", "shifted.npy", "grid.npy", "--out", "c"))
    told = compared(place / "c")
    assert (told["min_mm"], told["max_mm"]) == (0.25, 0.25)
    assert "unsigned" in told["method"]
    succeeded(run("compare", "shifted.npy", "grid.npy", "--out", "d", "--unit", "cm"))
    assert compared(place / "d")["max_mm"] == pytest.approx(2.5)


# -- alignment -----------------------------------------------------------------------------------


def motion(angle_rad: float, shift_mm: FloatArray) -> FloatArray:
    turn = trimesh.transformations.rotation_matrix(angle_rad, [1.0, 2.0, 2.0])
    turn[:3, 3] = shift_mm
    return turn


def test_a_best_fit_finds_and_reports_the_motion_that_was_put_in(
    place: Path, without_pictures: None
) -> None:
    mesh, moved = block(), motion(0.05, np.array([0.8, -0.5, 0.3]))
    mesh.export(place / "block.ply")
    np.save("points.npy", trimesh.transform_points(above(mesh, 0.0), moved))
    succeeded(run("compare", "points.npy", "block.ply", "--out", "none"))
    assert compared(place / "none")["rms_mm"] > 0.3
    ran = succeeded(
        run("compare", "points.npy", "block.ply", "--out", "fit", "--align", "best-fit")
    )
    told = compared(place / "fit")
    assert told["rms_mm"] < 1e-6
    assert told["alignment"]["converged"] is True
    assert told["alignment"]["held_freedoms"] == 6
    assert told["alignment"]["rotation_rad"] == pytest.approx(0.05, abs=1e-7)
    np.testing.assert_allclose(
        told["alignment"]["transform"], np.linalg.inv(moved), rtol=0, atol=1e-6
    )
    # deviation.ply has the points where they were compared.
    np.testing.assert_allclose(deviations(place / "fit")[0], above(mesh, 0.0), rtol=0, atol=1e-5)
    assert "aligned by best fit: turned by 2.865°, moved by 0.9" in ran.stdout


def test_two_clouds_cannot_be_fitted_and_the_line_says_why(place: Path) -> None:
    np.save("a.npy", np.random.default_rng(1).normal(size=(50, 3)))
    line = complaint(run("compare", "a.npy", "a.npy", "--out", "c", "--align", "best-fit"), 2)
    assert line == "--align best-fit: two clouds have no surface to fit to; use a mesh for B"
    line = complaint(run("compare", "a.npy", "a.npy", "--out", "c", "--align", "datum"), 2)
    assert line == "--align 'datum': one of none, best-fit expected"


# -- verdict -------------------------------------------------------------------------------------


def test_the_verdict_is_the_exit_code_and_the_result_is_there_either_way(
    place: Path, sphere: trimesh.Trimesh
) -> None:
    off = np.where(np.arange(len(sphere.faces)) % 20 == 0, -0.3, OFF_MM)
    np.save("points.npy", above(sphere, off))
    ran = run("compare", "points.npy", "ball.stl", "--out", "out", "--tolerance-mm", "0.2")
    assert ran.exit_code == 1
    assert ran.stderr == "loftscan: out of tolerance: 95.00% within 0.2 mm\n"
    told = compared(place / "out")
    assert told["verdict"]["within"] is False
    assert told["verdict"]["share_within"] == pytest.approx(0.95)
    assert "Out of tolerance: 95.00%" in (place / "out/report.html").read_text()
    succeeded(run("compare", "points.npy", "ball.stl", "--out", "in", "--tolerance-mm", "0.31"))
    assert compared(place / "in")["verdict"]["within"] is True
    page = (place / "in/report.html").read_text()
    assert "In tolerance: 100.00%" in page
    assert page.count("data:image/png;base64,") == 2
    assert not any(word in page for word in ("http:", "https:", "<script"))


def test_json_is_one_object_with_the_numbers(
    place: Path, sphere: trimesh.Trimesh, without_pictures: None
) -> None:
    np.save("points.npy", above(sphere, OFF_MM))
    ran = succeeded(run("compare", "points.npy", "ball.stl", "--out", "c", "--json"))
    told = json.loads(ran.stdout)
    assert told["event"] == "done"
    assert compared(place / "c").items() <= told.items()


# -- result folders ------------------------------------------------------------------------------


def test_a_result_folder_stands_for_its_mesh_in_millimetres(
    place: Path, saved: Saved, without_pictures: None
) -> None:
    # --unit is of plain files; a result folder says itself that it is in mm.
    for unit, size in (("mm", 1.0), ("cm", 10.0)):
        mesh = trimesh.load_mesh(saved.folder / "mesh.ply", process=False)
        mesh.apply_scale(1.0 / size)
        mesh.export(place / "other.ply")
        arguments = ("other.ply", saved.folder, "--out", unit, "--unit", unit)
        succeeded(run("compare", *arguments))
        assert compared(place / unit)["rms_mm"] < FLOAT32_MM
    assert compared(place / "mm")["reference"] == {"name": "result", "kind": "mesh"}


def test_the_cloud_of_a_result_lies_as_far_from_it_as_its_numbers_say(
    place: Path, saved: Saved, without_pictures: None
) -> None:
    succeeded(run("compare", saved.cloud, saved.folder, "--out", "c"))
    numbers = json.loads((saved.folder / "metrics.json").read_text())
    off = np.abs(deviations(place / "c")[1])
    used = off[off < 5.0]  # the strays lie 40 mm away
    assert len(used) == numbers["surface_deviation_points"]
    rms = math.sqrt(float((used.astype(float) ** 2).mean()))
    assert rms == pytest.approx(numbers["surface_deviation_rms_mm"], rel=1e-5)


# -- what is no mesh -----------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".off"])
@pytest.mark.parametrize("seed", [1, 2])
def test_rubbish_with_the_name_of_a_mesh_is_refused(place: Path, suffix: str, seed: int) -> None:
    np.save("a.npy", np.eye(3))
    rubbish = place / f"rubbish{suffix}"
    rubbish.write_bytes(np.random.default_rng(seed).bytes(4000))
    before = contents(place)
    line = complaint(run("compare", "a.npy", rubbish.name, "--out", "c"), 2)
    assert line.startswith(f"{rubbish.name}: ")
    assert line.isprintable()
    assert contents(place) == before


@pytest.mark.parametrize("keep", [0, 3, 100, 5000])
def test_a_truncated_mesh_is_refused(place: Path, sphere: trimesh.Trimesh, keep: int) -> None:
    np.save("a.npy", np.eye(3))
    data = (place / "ball.stl").read_bytes()
    (place / "ball.stl").write_bytes(data[:keep])
    line = complaint(run("compare", "a.npy", "ball.stl", "--out", "c"), 2)
    assert line.startswith("ball.stl: ")


def test_a_negative_tolerance_is_bad_usage(place: Path) -> None:
    line = complaint(run("compare", "a", "b", "--out", "c", "--tolerance-mm", "-1"), 2)
    assert line == "--tolerance-mm -1: a length above 0 mm is expected"


def test_an_older_comparison_is_replaced_only_when_asked(
    place: Path, sphere: trimesh.Trimesh, without_pictures: None
) -> None:
    np.save("a.npy", above(sphere, OFF_MM))
    np.save("b.npy", above(sphere, 2 * OFF_MM))
    succeeded(run("compare", "a.npy", "ball.stl", "--out", "c"))
    assert "is there already" in complaint(run("compare", "b.npy", "ball.stl", "--out", "c"), 2)
    assert compared(place / "c")["measured"]["name"] == "a.npy"
    succeeded(run("compare", "b.npy", "ball.stl", "--out", "c", "--overwrite"))
    assert compared(place / "c")["mean_mm"] == pytest.approx(2 * OFF_MM, abs=FLOAT32_MM)
