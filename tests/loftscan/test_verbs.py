"""The verbs for scripts and notebooks: what `import loftscan` offers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import loftscan
from loftscan import compare, reconstruct
from loftscan.result import Result
from reconstruction.errors import NotLoftable, TooFewPoints, UnreadableCloud
from tests.system.command_cases import FloatArray, write_cloud


def told(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_the_package_and_the_help_load_no_numerics() -> None:
    heavy = "{'numpy', 'scipy', 'numba', 'trimesh', 'matplotlib', 'pymeshlab', 'OCP'}"
    assert told(f"import sys, loftscan; print({heavy} & set(sys.modules))") == "set()"
    code = f"""
import sys
from loftscan.cli import app
for each in ([], ["reconstruct"], ["compare"], ["demo"]):
    try:
        app([*each, "--help"])
    except SystemExit as end:
        assert not end.code
print({heavy} & set(sys.modules))
"""
    assert told(code).splitlines()[-1] == "set()"


def test_the_verbs_are_listed_and_a_misspelt_one_is_an_attribute_error() -> None:
    assert set(loftscan.__all__) <= set(dir(loftscan))
    assert all(hasattr(loftscan, name) for name in loftscan.__all__)
    with pytest.raises(AttributeError, match="'loftscan' has no attribute 'reconstrukt'"):
        _ = loftscan.reconstrukt  # type: ignore[attr-defined]


def test_a_file_a_path_an_array_and_a_list_give_the_same_mesh(
    place: Path, part_points: FloatArray, part_result: Result
) -> None:
    wanted = part_result.mesh
    path = write_cloud(place / "part.npy", part_points)
    for source in (path, str(path), part_points, part_points.tolist(), part_points.copy("F")):
        mesh = reconstruct(source).mesh
        assert mesh.vertices_mm.tobytes() == wanted.vertices_mm.tobytes()
        assert mesh.faces.tobytes() == wanted.faces.tobytes()


def test_what_is_given_is_not_changed(part_points: FloatArray) -> None:
    before = part_points.copy()
    reconstruct(part_points, unit="cm", crop_mm=((-1e3, -1e3, 0.0), (1e3, 1e3, 120.0)))
    assert part_points.tobytes() == before.tobytes()
    assert part_points.flags.writeable


def test_what_comes_out_cannot_be_changed_by_mistake(part_result: Result) -> None:
    with pytest.raises(ValueError, match="read-only"):
        part_result.mesh.vertices_mm[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        part_result.surface[0].control_points_mm[0] = 0.0
    with pytest.raises(AttributeError):
        part_result.name = "another"  # type: ignore[misc]


def test_progress_is_told_stage_by_stage(part_points: FloatArray) -> None:
    steps: list[tuple[str, int, int]] = []
    reconstruct(part_points, progress=lambda *step: steps.append(step))
    assert list(dict.fromkeys(stage for stage, _, _ in steps)) == [
        "slicing", "sections", "comparison"
    ]  # fmt: skip
    assert [step for step in steps if step[0] == "sections"] == [
        ("sections", k, 16) for k in range(1, 17)
    ]
    assert steps[-1] == ("comparison", 1, 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"axis": "w"}, "'w' is not a valid Axis"),
        ({"unit": "km"}, "'km' is not a valid Unit"),
        ({"method": "spline"}, "'spline' is not a valid Method"),
        ({"spacing_mm": 0.0}, "spacing-mm 0: a length above 0 mm"),
        ({"remesh_edge_mm": -1.0}, "remesh_edge_mm must be above 0"),
        ({"intermediate": -1}, "intermediate"),
    ],
)
def test_an_argument_that_cannot_be_meant_is_a_value_error(
    part_points: FloatArray, options: dict, said: str
) -> None:
    with pytest.raises(ValueError, match=said):
        reconstruct(part_points, **options)


def test_input_that_is_no_surface_has_errors_of_its_own(
    place: Path, part_points: FloatArray
) -> None:
    with pytest.raises(UnreadableCloud, match=r"missing.ply: there is no such file"):
        reconstruct(place / "missing.ply")
    with pytest.raises(TooFewPoints, match=r"^array: 3 points"):
        reconstruct(part_points[:3])
    with pytest.raises(NotLoftable, match="choose a smaller --spacing-mm"):
        reconstruct(part_points, spacing_mm=400.0)


def test_a_crop_box_is_two_corners(part_points: FloatArray) -> None:
    done = reconstruct(part_points, crop_mm=((-50, -50, 17), (50, 50, 29)))
    assert done.metrics["sections"] == 6
    assert done.provenance["settings"]["crop_mm"] is not None


# -- compare -------------------------------------------------------------------------------------


def test_points_compared_with_a_mesh_have_signed_distances(place: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    ball.export(place / "ball.ply")
    off = np.where(np.arange(len(ball.faces)) % 2, 0.1, -0.2)
    points = ball.triangles_center + off[:, None] * ball.face_normals
    found = compare(points, place / "ball.ply", tolerance_mm=0.15)
    np.testing.assert_allclose(found.deviation.distances_mm, off, rtol=0, atol=1e-5)
    assert found.metrics["verdict"]["within"] is False
    assert found.metrics["verdict"]["share_within"] == 0.5
    np.testing.assert_array_equal(found.points_mm, points)


def test_a_saved_result_compared_with_itself_is_zero(
    place: Path, part_result: Result, without_pictures: None
) -> None:
    part_result.save("o", formats=["ply"])
    found = compare("o", "o", tolerance_mm=1e-9)
    assert found.metrics["verdict"]["within"] is True
    assert found.metrics["points"] == part_result.metrics["vertices"]


def test_a_folder_without_a_mesh_names_what_is_missing(place: Path) -> None:
    (place / "o").mkdir()
    with pytest.raises(UnreadableCloud, match=r"no mesh.ply in it; is it a result folder"):
        compare("o", np.eye(3))


def test_a_cloud_at_one_height_asks_for_another_axis() -> None:
    flat = np.random.default_rng(0).uniform(0.0, 50.0, (2000, 3)) * [1.0, 1.0, 0.0]
    with pytest.raises(TooFewPoints, match="one height along --axis z: try another --axis"):
        reconstruct(flat)


def interrupted_tube() -> FloatArray:
    """A tube whose rows 20 to 59 mm are missing, (n, 3)."""
    rng = np.random.default_rng(0)
    heights = np.concatenate([np.arange(20.0), np.arange(60.0, 80.0)]).repeat(400)
    angle = np.tile(np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False), 40)
    radius = 20.0 + rng.normal(0.0, 0.05, len(heights))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), heights])


def test_slices_that_are_missing_between_two_sections_are_marked_synthetic() -> None:
    result = reconstruct(interrupted_tube(), spacing_mm=1.0, method="paper")
    between = np.abs(result.mesh.vertices_mm[:, 2] - 39.5) < 20.25
    assert between.sum() > 30 * 30
    assert result.mesh.synthetic[between].all()
    assert not result.mesh.synthetic[~between].any()
    assert result.metrics["watertight"]


def test_a_fit_bridges_no_forty_slices_and_says_that_the_part_is_cut_off_there() -> None:
    result = reconstruct(interrupted_tube(), spacing_mm=1.0)
    assert (np.abs(result.mesh.vertices_mm[:, 2] - 39.5) > 19.9).all()
    assert (result.metrics["components"], result.metrics["watertight"]) == (2, True)
    assert any(said.startswith("slices 20-59: no section, so") for said in result.warnings)
    assert any("4 closed by a flat cap" in said for said in result.warnings)


def test_a_cone_without_two_equal_sections_is_saved_without_step(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rings = []
    for height, size in ((0.0, 60.0), (10.0, 30.0), (20.0, 14.0), (30.0, 6.0)):
        angle = rng.uniform(0.0, 2.0 * np.pi, 3000)
        radius = size + rng.normal(0.0, 0.05, 3000)
        ring = [radius * np.cos(angle), radius * np.sin(angle), np.full(3000, height)]
        rings.append(np.column_stack(ring))
    result = reconstruct(np.concatenate(rings), spacing_mm=10.0, method="paper")
    assert result.surface == ()
    assert any("no NURBS patch" in warning for warning in result.warnings)
    result.save(tmp_path / "out", formats=["step", "3dm", "stl"])
    assert (tmp_path / "out" / "surface.3dm").exists()
    assert not (tmp_path / "out" / "surface.step").exists()
