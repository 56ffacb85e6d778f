"""`loftscan reconstruct`, from the command line to every file of the result folder."""

from __future__ import annotations

import base64
import json
import math
import re
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import trimesh

from loftscan.result import Result
from reconstruction.exporting import (
    read_sections_json,
    read_step,
    read_surface_json,
    read_threedm,
)
from reconstruction.nurbs import Surface, evaluate_curve, evaluate_surface
from tests.conftest import Saved
from tests.system.command_cases import (
    RESULT_FILES,
    ROW_MM,
    FloatArray,
    contents,
    run,
    scanned_part,
    succeeded,
    volume_mm3,
    write_cloud,
)

CAD_MM = 1e-6
# What two runs, or a run and the verb, may differ in.
OF_THE_RUN = {"seconds", "seconds_by_stage", "peak_memory_mb", "peak_memory_children_mb"}

SCANS = {
    "UHU.pcd": ("y", "cm"),
    "cup.pcd": ("y", "cm"),
    "bigCub.pts": ("y", "cm"),
    "fabscanpi_duck.ply": ("y", "mm"),
}


def numbers(folder: Path) -> dict[str, object]:
    return json.loads((folder / "metrics.json").read_text())


def mesh_of(path: Path) -> trimesh.Trimesh:
    loaded = trimesh.load_mesh(path, process=False)
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    return loaded


# -- what a person sees --------------------------------------------------------------------------


def test_the_command_says_in_a_few_lines_what_came_out_and_where(saved: Saved) -> None:
    said = saved.stdout.splitlines()
    told = numbers(saved.folder)
    assert said[0].startswith(f"part: {told['points_in']} points, {told['sections']} of")
    assert f"{told['faces']} faces, watertight" in saved.stdout
    assert "tolerance: 100.00% within 1 mm" in said
    assert said[-1] == f"report: {saved.folder / 'report.html'}"
    assert (saved.folder / "report.html").is_file()
    *shadows, shoulder, ends = saved.stderr.splitlines()  # and no bar into a pipe
    assert [line.split(":")[1] for line in shadows] == [" slice 2", " slice 3", " slice 4"]
    assert shoulder.startswith("warning: contours step abruptly between slices 7 and 8: made level")
    assert ends.startswith("warning: ends of the part that no slice samples: 2 closed by a flat")


def test_by_the_paper_it_says_no_more_than_that(paper_saved: Saved) -> None:
    said = paper_saved.stdout.splitlines()
    told = numbers(paper_saved.folder)
    assert said[0].startswith(f"part: {told['points_in']} points, {told['sections']} of")
    assert f"{told['faces']} faces, watertight" in paper_saved.stdout
    assert "tolerance: 100.00% within 1 mm" in said
    assert said[-1] == f"report: {paper_saved.folder / 'report.html'}"
    assert paper_saved.stderr == ""  # no bar into a pipe


def test_json_lines_tell_progress_and_at_last_the_numbers(
    place: Path, saved: Saved, without_pictures: None
) -> None:
    ran = succeeded(run("reconstruct", saved.cloud, "--out", "o", "--json", "--formats", "ply"))
    *steps, done = [json.loads(line) for line in ran.stdout.splitlines()]
    assert {step["event"] for step in steps} == {"progress"}
    stages = list(dict.fromkeys(step["stage"] for step in steps))
    assert stages == ["slicing", "sections", "comparison", "saving"]
    sections = [step for step in steps if step["stage"] == "sections"]
    assert [step["done"] for step in sections] == list(range(1, 17))
    assert {step["total"] for step in sections} == {16}
    assert all(a["seconds"] <= b["seconds"] for a, b in pairwise(steps))
    assert done["event"] == "done"
    assert done["out"] == "o"
    assert numbers(place / "o").items() <= done.items()


# -- the result folder ---------------------------------------------------------------------------


def test_a_result_folder_holds_every_file_and_nothing_else(saved: Saved) -> None:
    assert set(contents(saved.folder)) == RESULT_FILES
    assert all(contents(saved.folder).values())
    assert set(contents(saved.folder.parent)) == {
        "part.xyz", "result", *(f"result/{name}" for name in RESULT_FILES)
    }  # fmt: skip


def test_the_numbers_agree_with_the_part_that_was_scanned(
    saved: Saved, paper_saved: Saved, part_points: FloatArray
) -> None:
    beyond = ROW_MM / 2 * math.pi * (20.0**2 + 2.0**2 / 2.0 + 13.0**2)  # the first and last row
    for each, more_mm3 in ((saved, beyond), (paper_saved, 0.0)):
        told = numbers(each.folder)
        assert told["points_in"] == len(part_points)
        assert told["points_set_aside"] == 6
        assert (told["slices"], told["sections"], told["patches"]) == (16, 16, 2)
        assert told["spacing_mm"] == pytest.approx(2.0)
        assert told["watertight"] is True
        # 4 sigma of the noise that was put in.
        assert told["thickness_mm"] == pytest.approx(0.2, rel=0.1)
        assert told["residual_rms_mm"] <= 0.05
        assert told["volume_mm3"] == pytest.approx(volume_mm3() + more_mm3, rel=0.005)


@pytest.mark.parametrize("kind", ["surface", "sections"])
def test_the_json_documents_obey_their_schemas(saved: Saved, kind: str) -> None:
    schema = files("reconstruction.exporting").joinpath(f"{kind}.schema.json").read_text("utf-8")
    document = json.loads((saved.folder / f"{kind}.json").read_text())
    jsonschema.validate(document, json.loads(schema))
    assert document["unit"] == "mm"
    assert document["name"] == "part"


def test_the_patches_contain_the_section_curves(paper_saved: Saved) -> None:
    lower, upper = read_surface_json(paper_saved.folder / "surface.json")
    sections = read_sections_json(paper_saved.folder / "sections.json")
    runs = [section for section in sections if section.height_mm < 15.0], sections[8:]
    for patch, run_of_sections in zip((lower, upper), runs, strict=True):
        assert len(run_of_sections) == 8
        for section in run_of_sections:
            u = np.linspace(*section.curve.domain, 50)
            on_patch = evaluate_surface(patch, u, np.array([section.height_mm]))[:, 0]
            on_curve = evaluate_curve(section.curve, u)
            np.testing.assert_allclose(on_patch, on_curve, rtol=0, atol=1e-9)


def cloud_on(surface: Surface) -> FloatArray:
    u = np.linspace(*(surface.knots_u[k] for k in (surface.degree_u, -surface.degree_u - 1)), 400)
    v = np.linspace(*(surface.knots_v[k] for k in (surface.degree_v, -surface.degree_v - 1)), 30)
    return evaluate_surface(surface, u, v)


@pytest.mark.parametrize("form", ["step", "3dm"])
def test_cad_files_read_back_as_the_same_patches(paper_saved: Saved, form: str) -> None:
    saved = paper_saved
    told = read_surface_json(saved.folder / "surface.json")
    path = saved.folder / f"surface.{form}"
    back = read_step(path) if form == "step" else read_threedm(path)[0]
    assert len(back) == len(told) == 2
    for ours, theirs in zip(told, back, strict=True):
        # Read back, the parameters are the same: u runs over the same knots.
        np.testing.assert_allclose(cloud_on(theirs), cloud_on(ours), rtol=0, atol=CAD_MM)


@pytest.mark.parametrize("form", ["step", "3dm"])
def test_cad_files_of_a_fit_read_back_as_the_same_wall(saved: Saved, form: str) -> None:
    foot, neck = read_surface_json(saved.folder / "surface.json")
    assert np.ptp(foot.weights) == 0.0
    assert np.ptp(neck.weights) > 0.0  # an exact cylinder
    path = saved.folder / f"surface.{form}"
    back = read_step(path) if form == "step" else read_threedm(path)[0]
    # Its flat caps are surfaces of their own; a cylinder may be cut at another seam.
    lattices = [cloud_on(each) for each in back]
    wall = cloud_on(foot)
    off = [np.abs(each - wall).max() for each in lattices if each.shape == wall.shape]
    assert min(off) <= CAD_MM


def test_every_mesh_file_is_the_same_closed_mesh_in_millimetres(saved: Saved) -> None:
    told = numbers(saved.folder)
    # .stl and .glb hold 32-bit floats, and glTF is in metres by its standard.
    for name, to_mm in (("mesh.stl", 1.0), ("mesh.ply", 1.0), ("mesh.glb", 1000.0)):
        mesh = mesh_of(saved.folder / name)
        assert mesh.is_watertight, name
        assert len(mesh.faces) == told["faces"], name
        assert len(mesh.vertices) == told["vertices"], name
        assert mesh.volume * to_mm**3 == pytest.approx(told["volume_mm3"], rel=1e-5), name
        assert mesh.area * to_mm**2 == pytest.approx(told["area_mm2"], rel=1e-5), name


def test_every_file_says_its_unit(saved: Saved) -> None:
    assert b"unit: mm" in (saved.folder / "mesh.stl").read_bytes()[:80]
    assert "millimetres" in (saved.folder / "mesh.stl.unit.txt").read_text()
    assert b"comment unit: mm" in (saved.folder / "mesh.ply").read_bytes()[:400]
    step = (saved.folder / "surface.step").read_text()
    assert re.search(r"SI_UNIT\(\s*\.MILLI\.\s*,\s*\.METRE\.\s*\)", step)
    assert json.loads((saved.folder / "provenance.json").read_text())["unit"] == "mm"
    assert "all lengths in mm" in (saved.folder / "report.html").read_text()


def test_provenance_has_hash_settings_and_versions_but_no_path(saved: Saved) -> None:
    import hashlib
    import platform
    from importlib.metadata import version

    told = json.loads((saved.folder / "provenance.json").read_text())
    data = saved.cloud.read_bytes()
    assert told["input"] == {
        "name": "part.xyz", "format": "xyz", "unit": "mm", "bytes": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
    }  # fmt: skip
    assert told["settings"]["method"] == "fit"
    assert told["settings"]["axis"] == "z"
    assert told["settings"]["tolerance_mm"] == 1.0
    assert told["python"] == platform.python_version()
    assert told["libraries"]["numpy"] == version("numpy")
    folders = [str(saved.cloud.parent).encode(), str(Path.home()).encode() + b"/"]
    for name, data in contents(saved.folder).items():
        assert data is not None
        assert not any(folder in data for folder in folders), name


def test_the_report_is_one_file_with_pictures_that_asks_nothing_of_a_network(saved: Saved) -> None:
    page = (saved.folder / "report.html").read_text()
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) >= 8
    assert all(base64.b64decode(each).startswith(b"\x89PNG\r\n\x1a\n") for each in pictures)
    words = re.sub(r"base64,[^\"]+", "", page)
    assert not re.search(r"https?:|src=\"(?!data:)|url\(|@import|<script|<link", words)
    assert "Deviation of the points from the mesh" in words
    assert "of the points lie within 1 mm" in words


# -- the same, whoever asks ----------------------------------------------------------------------


def test_the_verb_and_the_command_give_the_same(saved: Saved, part_result: Result) -> None:
    told, ours = numbers(saved.folder), json.loads(json.dumps(part_result.metrics))
    differing = {key for key in told | ours if told.get(key) != ours.get(key)}
    assert differing <= OF_THE_RUN
    for patch, same in zip(
        read_surface_json(saved.folder / "surface.json"), part_result.surface, strict=True
    ):
        assert patch.control_points_mm.tobytes() == same.control_points_mm.tobytes()
        assert patch.knots_v.tobytes() == same.knots_v.tobytes()


@pytest.mark.parametrize("suffix", [".npy", ".pts", ".csv"])
def test_two_runs_and_every_file_format_give_the_same_mesh_bytes(
    place: Path, saved: Saved, part_points: FloatArray, without_pictures: None, suffix: str
) -> None:
    if suffix == ".csv":
        np.savetxt("part.csv", part_points, "%.17g", ",", header="x,y,z", comments="")
    else:
        write_cloud(place / f"part{suffix}", part_points)
    succeeded(run("reconstruct", f"part{suffix}", "--out", "o", "--formats", "stl"))
    assert (place / "o/mesh.stl").read_bytes() == (saved.folder / "mesh.stl").read_bytes()


@pytest.mark.parametrize(("unit", "size"), [("cm", 10.0), ("m", 1000.0), ("um", 0.001)])
def test_a_cloud_in_another_unit_gives_the_same_surface(
    place: Path, saved: Saved, part_points: FloatArray, without_pictures: None, unit, size
) -> None:
    write_cloud(place / "part.npy", part_points / size)
    succeeded(run("reconstruct", "part.npy", "--out", "o", "--formats", "ply", "--unit", unit))
    told, same = numbers(place / "o"), numbers(saved.folder)
    assert (told["sections"], told["patches"]) == (same["sections"], same["patches"])
    # A last bit in the input may move a point to another cell, not the body.
    assert told["volume_mm3"] == pytest.approx(same["volume_mm3"], rel=1e-3)
    assert told["residual_rms_mm"] == pytest.approx(same["residual_rms_mm"], rel=0.05)


def test_the_stacking_axis_is_the_one_that_was_named(
    place: Path, saved: Saved, part_points: FloatArray, without_pictures: None
) -> None:
    # x, y, z become y, z, x: what was stacked along z is stacked along y.
    write_cloud(place / "part.npy", part_points[:, [1, 2, 0]])
    succeeded(run("reconstruct", "part.npy", "--out", "o", "--formats", "ply", "--axis", "y"))
    # 30 mm from row to row, and half a row beyond the first and the last.
    assert mesh_of(place / "o/mesh.ply").extents[1] == pytest.approx(32.0, abs=1e-9)
    told, same = numbers(place / "o"), numbers(saved.folder)
    assert told["sections"] == 16
    assert told["volume_mm3"] == pytest.approx(same["volume_mm3"], rel=1e-3)


# -- options -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wanted", "files_there"),
    [
        ("stl", {"mesh.stl", "mesh.stl.unit.txt"}),
        (" GLB, ply ", {"mesh.glb", "mesh.ply"}),
        ("3dm", {"surface.3dm"}),
    ],
)
def test_only_the_formats_asked_for_are_written(
    place: Path, saved: Saved, without_pictures: None, wanted: str, files_there: set[str]
) -> None:
    succeeded(run("reconstruct", saved.cloud, "--out", "o", "--formats", wanted))
    always = {"surface.json", "sections.json", "metrics.json", "provenance.json", "report.html"}
    assert set(contents(place / "o")) == always | files_there


def test_a_crop_uses_only_its_box_and_counts_the_rest(
    place: Path, part_points: FloatArray, saved: Saved, without_pictures: None
) -> None:
    succeeded(
        run("reconstruct", saved.cloud, "--out", "o", "--formats", "ply", "--crop", ",,,,17,29")
    )
    told = numbers(place / "o")
    heights = part_points[:, 2]
    outside = int(((heights < 17.0) | (heights > 29.0)).sum())
    assert told["points_set_aside_by_reason"]["cropped"] == outside
    assert told["sections"] == 6


def cropped(place: Path, saved: Saved, method: str) -> tuple[float, FloatArray]:
    """Volume and lowest and highest point of six rows of the neck."""
    options = ("--formats", "ply", "--crop", ",,,,17,29", "--method", method)
    succeeded(run("reconstruct", saved.cloud, "--out", "o", *options))
    return numbers(place / "o")["volume_mm3"], mesh_of(place / "o/mesh.ply").bounds[:, 2]


def test_a_crop_is_the_body_inside_it(place: Path, saved: Saved, without_pictures: None) -> None:
    volume, bounds = cropped(place, saved, "paper")
    assert volume == pytest.approx(10.0 * math.pi * 13.0**2, rel=0.005)
    assert bounds == pytest.approx([18.0, 28.0])


def test_a_crop_is_the_body_inside_it_and_half_a_row_beyond(
    place: Path, saved: Saved, without_pictures: None
) -> None:
    volume, bounds = cropped(place, saved, "fit")
    assert volume == pytest.approx(12.0 * math.pi * 13.0**2, rel=0.005)
    assert bounds == pytest.approx([17.0, 29.0])


def test_intermediate_rows_refine_the_mesh_between_sections(
    place: Path, paper_saved: Saved, without_pictures: None
) -> None:
    succeeded(
        run("reconstruct", paper_saved.cloud, "--out", "o", "--formats", "ply",
            "--method", "paper", "--intermediate", 2)
    )  # fmt: skip
    fine, plain = numbers(place / "o"), numbers(paper_saved.folder)
    assert fine["watertight"] is True
    assert fine["control_points"] == plain["control_points"]
    assert fine["vertices"] > 2.8 * plain["vertices"]


def test_remeshing_and_decimation_keep_a_closed_mesh_of_the_same_volume(
    place: Path, saved: Saved, without_pictures: None
) -> None:
    plain = numbers(saved.folder)
    for folder, options in (("a", ("--remesh-mm", 1.5)), ("b", ("--decimate-faces", 1000))):
        ran = run("reconstruct", saved.cloud, "--out", folder, "--formats", "ply", *options)
        succeeded(ran)
        told = numbers(place / folder)
        assert told["watertight"] is True
        assert told["volume_mm3"] == pytest.approx(plain["volume_mm3"], rel=0.01)
    assert numbers(place / "b")["faces"] <= 1000
    edges = mesh_of(place / "a/mesh.ply").edges_unique_length
    assert np.median(edges) == pytest.approx(1.5, rel=0.25)


def test_points_on_the_border_of_two_slices_are_counted_and_sorted_alike() -> None:
    from loftscan import reconstruct

    # With many strays no rows are seen, and slices of 5/3 mm put whole rows on a border.
    rng = np.random.default_rng(3)
    strays = np.column_stack([rng.uniform(60.0, 65.0, (20, 2)), rng.uniform(0.0, 30.0, 20)])
    done = reconstruct(np.concatenate([scanned_part(), strays]))
    spacing = done.cutting.spacing.step_mm
    for piece in done.cutting.slices():
        away = piece.points_mm[:, 2] - piece.frame.origin_mm[2]
        assert (np.abs(away) <= spacing / 2 + 1e-9).all(), piece.index
        assert (np.hypot(*piece.points_mm[:, :2].T) > 12.0).all(), piece.index
    assert done.metrics["points_in"] == 3774 + 14


# -- real scans ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["fit", "paper"])
@pytest.mark.parametrize("name", SCANS)
def test_a_real_scan_gives_a_watertight_mesh(
    shared_data: Path, place: Path, name: str, method: str
) -> None:
    axis, unit = SCANS[name]
    succeeded(
        run("reconstruct", shared_data / "scans" / name, "--out", "o",
            "--axis", axis, "--unit", unit, "--method", method)
    )  # fmt: skip
    told = numbers(place / "o")
    assert set(contents(place / "o")) == RESULT_FILES
    mesh = mesh_of(place / "o/mesh.stl")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert told["watertight"] is True
    assert told["points_in"] == (
        told["points_set_aside"] + told["points_in_sections"] + told["points_in_skipped_slices"]
    )
    assert told["sections"] >= 0.9 * told["slices"]
    # A cell, or, where there are none, the cloud's own thickness.
    assert 0.0 < told["residual_rms_mm"] < told.get("cell_mm", told["thickness_mm"])
