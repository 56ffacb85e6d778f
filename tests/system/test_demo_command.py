"""`loftscan demo`: what somebody types first; here with few rings and a station in a hurry."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan.demo import ScanFailed, Scanning
from loftscan.warming import warm_up
from tests.system.command_cases import RESULT_FILES, contents, run, start, succeeded

QUICK = ("--rings", "6", "--scale", "40")
PATIENCE_S = 60.0  # for a machine that does a lot else
# Of a result, what is written of what was measured: the rest says how fast, or has pictures.
MEASURED = ("mesh.stl", "mesh.ply", "mesh.glb", "sections.json", "surface.json")
CREATED = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """One demo for the tests that only look at it: its folder and what it said."""
    place = tmp_path_factory.mktemp("demo")
    warm_up()  # compiles, once on a machine, which would be longer than these few rings take
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
    # Half the slices or more were waited for, else nothing was live.
    assert sum(each["lag_s"] is not None for each in sections) >= 3
    # Measured on two cores: 0.06 s of 0.8 s, and the less loaded of them is enough.
    assert 0.0 < lag["median_s"] <= lag["slice_period_s"]


def test_a_replay_of_the_demos_scan_gives_the_same_result(
    made: tuple[Path, list[str]], place: Path, without_pictures: None
) -> None:
    demo = made[0]
    succeeded(run("reconstruct", demo / "out.scan", "--out", "o", "--formats", "stl,ply,glb"))
    one, other = demo / "out", place / "o"
    for name in MEASURED:
        assert CREATED.sub(b"", (one / name).read_bytes()) == CREATED.sub(
            b"", (other / name).read_bytes()
        ), name
    numbers = [json.loads((each / "metrics.json").read_text()) for each in (one, other)]
    differing = {name for name in numbers[0] if numbers[0][name] != numbers[1].get(name)}
    assert all(name.startswith(("lag", "slice_period", "seconds", "peak")) for name in differing)


def test_the_simulator_says_how_far_the_walls_are_from_the_true_part(
    made: tuple[Path, list[str]],
) -> None:
    _, said = made
    (truth,) = events(said, "truth")
    # A cylinder of 40 mm under a cloud of 0.1 mm (4 sigma): far within the cloud.
    assert truth["rms_mm"] < 0.05
    assert abs(truth["mean_mm"]) < 0.02
    assert truth["points"] >= 1000


def first_slice(child: subprocess.Popen[str], folder: Path) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not list(folder.glob("slices/*.npz")):
        assert child.poll() is None, child.communicate()
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def children(parent: int) -> dict[str, int]:
    """The processes that a process has started, by the module they run."""
    told = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    words = {pid: Path(f"/proc/{pid}/cmdline").read_text().split("\0") for pid in told}
    return {argv[argv.index("-m") + 1]: int(pid) for pid, argv in words.items() if "-m" in argv}


def test_a_demo_whose_station_dies_says_what_happened_and_what_is_kept(place: Path) -> None:
    with start("demo", "--part", "cylinder", "--scale", "40", "--out", "out", cwd=place) as child:
        first_slice(child, place / "out.scan")
        os.kill(children(child.pid)["sim"], signal.SIGKILL)
        _, stderr = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 4
    (line,) = stderr.splitlines()
    assert "is gone" in line or "press the emergency stop" in line
    kept = len(ScanFolder.open(place / "out.scan").verify().sound)
    # A station that is gone cannot be gone on with.
    assert line.endswith(f"{kept} of 40 slices are kept in out.scan")
    assert not (place / "out").exists()


def test_a_demo_is_stopped_by_ctrl_c_and_leaves_its_slices(place: Path) -> None:
    with start("demo", "--part", "cylinder", "--scale", "40", "--out", "out", cwd=place) as child:
        first_slice(child, place / "out.scan")
        child.send_signal(signal.SIGINT)
        _, stderr = child.communicate(timeout=PATIENCE_S)
    assert (child.returncode, stderr) == (
        3, "loftscan: stopped by the operator; the slices so far are kept in out.scan\n"
    )  # fmt: skip
    assert ScanFolder.open(place / "out.scan").record().state is State.ABORTED
    assert not (place / "out").exists()


def test_a_scan_that_is_killed_is_no_result_and_no_riddle(tmp_path: Path) -> None:
    with subprocess.Popen(["sleep", "600"]) as child:
        scan = Scanning(child, tmp_path / "out.scan", tmp_path / "said.txt")
        scan.look()
        child.kill()
        with pytest.raises(ScanFailed, match=r"killed by signal 9; what it kept is in .*out\.scan"):
            scan.end()


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
