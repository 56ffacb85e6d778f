"""`loftscan demo`: what somebody types first; here with few rings and a station in a hurry."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.system.command_cases import RESULT_FILES, contents, run, succeeded

QUICK = ("--rings", "6", "--scale", "40")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """One demo for the tests that only look at it: its folder and what it said."""
    place = tmp_path_factory.mktemp("demo")
    ran = succeeded(
        run("demo", "--part", "cylinder", *QUICK, "--out", str(place / "out"), "--json")
    )
    return place, ran.stdout.splitlines()


def events(lines: list[str], kind: str) -> list[dict[str, float]]:
    told = [json.loads(line) for line in lines if line.startswith("{")]
    return [each for each in told if each["event"] == kind]


def test_the_demo_scans_over_wires_and_makes_a_whole_result(
    made: tuple[Path, list[str]],
) -> None:
    place, _ = made
    assert set(contents(place / "out")) == RESULT_FILES
    told = json.loads((place / "out/metrics.json").read_text())
    assert told["watertight"] is True
    assert told["slices"] == told["sections"] == 6


def test_the_scan_is_kept_beside_the_result_and_is_complete(
    made: tuple[Path, list[str]],
) -> None:
    place, _ = made
    folder = ScanFolder.open(place / "out.scan")
    assert folder.record().state is State.COMPLETE
    assert folder.verify().missing == ()


def test_sections_are_fitted_while_the_scan_goes_on(made: tuple[Path, list[str]]) -> None:
    _, said = made
    sections = events(said, "section")
    assert [each["index"] for each in sections] == list(range(6))
    (lag,) = events(said, "lag")
    assert lag["median_s"] is not None
    # Half the slices or more were waited for, else nothing was live.
    assert sum(each["lag_s"] is not None for each in sections) >= 3


def test_the_simulator_says_how_far_the_walls_are_from_the_true_part(
    made: tuple[Path, list[str]],
) -> None:
    _, said = made
    (truth,) = events(said, "truth")
    # A cylinder of 40 mm under a cloud of 0.1 mm (4 sigma): far within the cloud.
    assert truth["rms_mm"] < 0.05
    assert abs(truth["mean_mm"]) < 0.02
    assert truth["points"] >= 1000


def test_a_second_demo_is_refused_unless_it_may_overwrite(made: tuple[Path, list[str]]) -> None:
    place, _ = made
    ran = run("demo", "--part", "cylinder", *QUICK, "--out", str(place / "out"))
    assert ran.exit_code == 2
    assert "--overwrite" in ran.stderr


def test_the_demo_refuses_to_replace_what_it_did_not_make(place: Path) -> None:
    (place / "demo-out").mkdir()
    (place / "demo-out/thesis.txt").write_text("years of work")
    for options in ([], ["--overwrite"]):
        assert run("demo", *options).exit_code == 2
    assert (place / "demo-out/thesis.txt").read_text() == "years of work"


def test_the_demo_refuses_to_replace_a_folder_that_is_no_scan(place: Path) -> None:
    (place / "demo-out.scan").mkdir()
    (place / "demo-out.scan/thesis.txt").write_text("years of work")
    for options in ([], ["--overwrite"]):
        ran = run("demo", *options)
        assert ran.exit_code == 2
        assert "demo-out.scan" in ran.stderr
    assert (place / "demo-out.scan/thesis.txt").read_text() == "years of work"


def test_a_part_that_nobody_knows_is_one_line_that_names_those_that_are_known(
    place: Path,
) -> None:
    ran = run("demo", "--part", "teapot")
    assert ran.exit_code == 2
    assert "built-in parts are" in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
    assert not (place / "demo-out").exists()
