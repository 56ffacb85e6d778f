"""`loftscan section`: circles and corners whose sizes are known, in files and in a scan."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import loftscan
from reconstruction.errors import TooFewPoints
from reconstruction.exporting import read_sections_json
from tests.loftscan.made_scans import FIRST_MM, KINEMATICS, SLICES, STEP_MM, write_scan
from tests.system.command_cases import complaint, contents, run, succeeded

FloatArray = NDArray[np.float64]
PNG = b"\x89PNG\r\n\x1a\n"


def rings(*radii_mm: float, count: int = 1500) -> FloatArray:
    """Noisy circles around (3, -2), shuffled."""
    rng = np.random.default_rng(5)
    pieces = []
    for radius in radii_mm:
        angle = rng.uniform(0.0, math.tau, count)
        away = radius + rng.normal(0.0, 0.1, count)
        pieces.append(np.column_stack([3.0 + away * np.cos(angle), -2.0 + away * np.sin(angle)]))
    return rng.permutation(np.vstack(pieces))


def bow() -> FloatArray:
    """A third of a circle of 20 mm around the origin."""
    rng = np.random.default_rng(6)
    angle = rng.uniform(0.0, math.tau / 3, 800)
    away = 20.0 + rng.normal(0.0, 0.05, 800)
    return np.column_stack([away * np.cos(angle), away * np.sin(angle)])


@pytest.fixture
def ring(place: Path) -> Path:
    np.save(place / "ring.npy", rings(20.0))
    return Path("ring.npy")


def told(*arguments: object) -> list[dict]:
    return [json.loads(line) for line in succeeded(run(*arguments, "--json")).stdout.splitlines()]


def test_a_circle_is_told_in_one_line(place: Path, ring: Path) -> None:
    before = contents(place)
    head, line, last = succeeded(run("section", ring)).stdout.splitlines()
    assert head.startswith("ring.npy: 1500 points, cloud width 0.")
    found = re.match(
        r"0: circle, closed, radius ([\d.]+) mm, centre \(([\d.]+), (-[\d.]+)\) mm,"
        r" ([\d.]+) mm long, 8 control points, ",
        line,
    )
    assert found is not None, line
    np.testing.assert_allclose([float(n) for n in found.groups()], [20, 3, -2, 125.66], atol=0.05)
    assert "0 gaps" in line
    assert last == "picture: add --out FOLDER or FILE.png"
    assert contents(place) == before


def test_a_folder_gets_the_picture_and_the_curves(place: Path) -> None:
    np.save("rings.npy", rings(20.0, 12.0))
    succeeded(run("section", "rings.npy", "--out", "found"))
    assert set(contents(place / "found")) == {"section.png", "sections.json"}
    assert (place / "found/section.png").read_bytes().startswith(PNG)
    outer, hole = read_sections_json(place / "found/sections.json")
    wanted = loftscan.fit_section(rings(20.0, 12.0))
    u = np.linspace(0.0, 1.0, 40)
    for record, curve in zip((outer, hole), wanted, strict=True):
        np.testing.assert_array_equal(record.curve(u), curve(u))
        assert record.residual_rms_mm == curve.residual_rms_mm
        assert record.points == 1500
    said = json.loads((place / "found/sections.json").read_text())["provenance"]
    assert [curve["hole"] for curve in said["curves"]] == [False, True]
    assert (said["points_in"], said["strays"], said["exact"]) == (3000, 0, "auto")


def test_a_picture_alone_is_asked_for_by_its_name(place: Path, ring: Path) -> None:
    before = contents(place)
    succeeded(run("section", ring, "--out", "ring.png"))
    new = {name: data for name, data in contents(place).items() if name not in before}
    assert set(new) == {"ring.png"}
    assert (new["ring.png"] or b"").startswith(PNG)
    again = complaint(run("section", ring, "--out", "ring.png"), 2)
    assert again == "ring.png: is there already; name another --out, or add --overwrite"
    succeeded(run("section", ring, "--out", "ring.png", "--overwrite"))
    assert (place / "ring.png").read_bytes() == new["ring.png"]


def test_json_says_every_number(place: Path) -> None:
    points = np.vstack([rings(20.0), bow() + np.array([80.0, 0.0]), [[200.0, 200.0]]])
    np.save("points.npy", points)
    circle, arc, done = told("section", "points.npy")
    assert (circle["kind"], circle["closed"], circle["ambiguous"]) == ("circle", True, False)
    assert circle["radius_mm"] == pytest.approx(20.0, abs=0.02)
    assert circle["sigma_mm"] == pytest.approx(0.1, rel=0.1)
    assert circle["residual_rms_mm"] == pytest.approx(0.1, rel=0.1)
    assert 0.0 < circle["band_95_median_mm"] <= circle["band_95_max_mm"] < 0.05
    assert (arc["kind"], arc["closed"]) == ("arc", False)
    assert arc["radius_mm"] == pytest.approx(20.0, abs=0.05)
    np.testing.assert_allclose(arc["centre_mm"], [80.0, 0.0], atol=0.05)
    assert arc["length_mm"] == pytest.approx(20.0 * math.tau / 3, rel=0.01)
    assert (done["event"], done["curves"], done["points_in"]) == ("done", 2, len(points))
    assert (done["strays"], done["unordered"], done["lost"]) == (1, 0, 0)


def test_an_ellipse_says_its_half_axes(place: Path) -> None:
    np.save("oval.npy", rings(20.0) * [1.0, 0.5])
    oval, _ = told("section", "oval.npy")
    assert oval["kind"] == "ellipse"
    np.testing.assert_allclose(oval["half_axes_mm"], [20.0, 10.0], atol=0.05)
    np.testing.assert_allclose(oval["centre_mm"], [3.0, -1.0], atol=0.05)
    assert "ellipse, closed, half axes " in succeeded(run("section", "oval.npy")).stdout


def test_an_eight_is_two_loops_that_meet_as_no_outline_crosses_itself(place: Path) -> None:
    turn = np.random.default_rng(7).uniform(0.0, math.tau, 3000)
    eight = 30.0 * np.column_stack([np.sin(turn), np.sin(2.0 * turn)])
    np.save("eight.npy", eight + np.random.default_rng(8).normal(0.0, 0.1, eight.shape))
    *curves, _ = told("section", "eight.npy")
    assert [curve["closed"] for curve in curves] == [True, True]
    assert not any(curve["crosses_itself"] for curve in curves)


def test_never_exact_is_a_free_curve(place: Path, ring: Path) -> None:
    (free, _) = told("section", ring, "--exact", "never")
    assert free["kind"] == "free"
    assert "radius_mm" not in free
    assert loftscan.fit_section(rings(20.0), exact="never")[0].kind == "free"


def test_a_gap_is_marked(place: Path) -> None:
    points = rings(20.0)
    kept = np.abs(np.arctan2(points[:, 1] + 2.0, points[:, 0] - 3.0)) > math.radians(12)
    np.save("gap.npy", points[kept])
    succeeded(run("section", "gap.npy", "--out", "gap", "--exact", "never"))
    (record,) = read_sections_json(place / "gap/sections.json")
    ((start, end),) = record.gaps
    ends = record.curve(np.mod([start, end], 1.0)) - [3.0, -2.0]
    np.testing.assert_allclose(np.abs(ends[:, 1]), 20.0 * math.sin(math.radians(12)), atol=1.0)
    assert (ends[:, 0] > 0).all()
    assert "1 gap" in succeeded(run("section", "gap.npy", "--exact", "never")).stdout


# -- what is read --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text", "delimiter"),
    [
        ("a.txt", "", " "),
        ("a.xyz", "# two columns, in mm\n", "\t"),
        ("a.csv", "x;y\n", ";"),
        ("a.csv", "x, y\n\n", ", "),
        ("a.pts", "1500\n", " "),
    ],
)
def test_text_of_every_manner_is_read(
    place: Path, ring: Path, name: str, text: str, delimiter: str
) -> None:
    rows = "\n".join(f"{x:.17g}{delimiter}{y:.17g}" for x, y in rings(20.0))
    Path(name).write_text(text + rows + "\n", encoding="utf-8")
    assert told("section", name)[0] == told("section", ring)[0]


@pytest.mark.parametrize("column", [0, 1, 2])
def test_three_columns_at_one_height_are_laid_into_their_plane(place: Path, column: int) -> None:
    points = np.insert(rings(20.0), column, 7.5, axis=1)
    np.save("level.npy", points)
    succeeded(run("section", "level.npy", "--out", "found"))
    (record,) = read_sections_json(place / "found/sections.json")
    assert record.height_mm == 7.5
    there = record.frame.to_part(record.curve(np.linspace(0.0, 1.0, 50)))
    np.testing.assert_allclose(there[:, column], 7.5)
    flat = np.delete(there, column, axis=1) - [3.0, -2.0]
    np.testing.assert_allclose(np.linalg.norm(flat, axis=1), 20.0, atol=0.05)


def test_rows_without_numbers_are_set_aside_and_said(place: Path) -> None:
    points = rings(20.0)
    points[:3, 1] = math.nan
    np.save("holes.npy", points)
    ran = succeeded(run("section", "holes.npy"))
    assert ran.stderr == "warning: 3 rows without finite numbers were set aside\n"
    assert "of 1497 points" in ran.stdout


def test_a_slice_of_a_scan_is_fitted_at_its_height(place: Path) -> None:
    write_scan(place / "vase.scan")
    succeeded(run("section", "vase.scan", "--slice", "3", "--out", "found"))
    (record,) = read_sections_json(place / "found/sections.json")
    assert record.index == 3
    assert record.height_mm == pytest.approx(
        FIRST_MM + 3 * STEP_MM + KINEMATICS.height_mm, abs=1e-6
    )
    assert record.residual_rms_mm is not None
    assert record.residual_rms_mm < 0.06


# -- what is refused -----------------------------------------------------------------------------


def test_a_scan_needs_the_number_of_a_slice(place: Path) -> None:
    write_scan(place / "vase.scan")
    wanted = f"vase.scan: name a slice by --slice 0 to {SLICES - 1}"
    assert complaint(run("section", "vase.scan"), 2) == wanted
    assert complaint(run("section", "vase.scan", "--slice", "99"), 2) == wanted
    (place / "vase.scan/slices/000004.npz").unlink()
    line = complaint(run("section", "vase.scan", "--slice", "4"), 2)
    assert line == "vase.scan: slice 4: it is not there; resume the scan to take it"


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("none.npy", None, "none.npy: No such file or directory"),
        ("rubbish.npy", b"rubbish", "rubbish.npy: no .npy file of numbers"),
        ("empty.npy", b"", "empty.npy: "),
        ("a.ply", b"ply", "a.ply: unknown extension '.ply'; convert it to one of .npy"),
        ("words.txt", b"no numbers\n", "words.txt: it holds no row of two or three numbers"),
        ("a.csv", b"1,2\n3,x\n", "a.csv: could not convert"),
        ("nan.txt", b"nan nan\n" * 9, "nan.txt: it holds no point with finite numbers"),
        ("few.txt", b"1 2\n3 4\n", "2 points; a curve needs 4"),
        ("one.txt", b"1 2\n" * 9, "all 9 points lie in one place; a curve needs 4"),
    ],
)
def test_a_bad_file_is_told_in_a_line(
    place: Path, name: str, data: bytes | None, said: str
) -> None:
    if data is not None:
        Path(name).write_bytes(data)
    before = contents(place)
    assert complaint(run("section", name, "--out", "found"), 2).startswith(said)
    assert contents(place) == before


def test_a_whole_cloud_is_no_slice(place: Path) -> None:
    np.save("cloud.npy", np.random.default_rng(0).random((100, 3)))
    assert "no slice at one height" in complaint(run("section", "cloud.npy"), 2)
    np.save("wide.npy", np.zeros((100, 5)))
    assert "(n, 2) or (n, 3) expected" in complaint(run("section", "wide.npy"), 2)


def test_options_that_cannot_be_meant_are_refused(place: Path, ring: Path) -> None:
    line = complaint(run("section", ring, "--exact", "always"), 2)
    assert line == "--exact 'always': one of auto, never expected"
    assert "only a .scan folder has slices" in complaint(run("section", ring, "--slice", "1"), 2)
    line = complaint(run("section", ring, "--out", "no/where/a.png"), 2)
    assert line == "no/where/a.png: there is no folder no/where; make it first"
    assert complaint(run("section", ring, "--out", ring), 2).startswith("ring.npy: is a file")


def test_the_verb_names_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="exact 'always': 'auto' or 'never' expected"):
        loftscan.fit_section(rings(20.0), exact="always")  # type: ignore[arg-type] # on purpose
    with pytest.raises(TooFewPoints):
        loftscan.fit_section(np.eye(2))
