"""`loftscan reconstruct --follow`: another process writes the scan, this one makes the surface."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.loftscan.made_scans import SLICES, damage, sweeps, write_scan
from tests.loftscan.test_following import ENDS, LAGS, OF_THE_RUN
from tests.system.command_cases import complaint, contents, run, start, succeeded

WRITER = Path(__file__).with_name("slow_writer.py")
REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 120.0


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("source") / "vase.scan")


@contextmanager
def writing(source: Path, target: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """A process that writes a copy of a scan, slice by slice."""
    words = [sys.executable, WRITER, source, target, *options]
    with subprocess.Popen(
        [str(word) for word in words], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY
    ) as child:
        try:
            yield child
        finally:
            child.kill()


@contextmanager
def following(place: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    words = ("reconstruct", "live.scan", "--follow", "--out", "o", "--formats", "ply", *options)
    with start(*words, cwd=place) as child:
        try:
            yield child
        finally:
            child.kill()


def first_line(child: subprocess.Popen[str]) -> dict:
    assert child.stdout is not None
    return json.loads(child.stdout.readline())


def test_a_follower_makes_sections_while_the_scan_is_written(place: Path, source: Path) -> None:
    with following(place, "--json") as follower, writing(source, place / "live.scan", 0.05):
        stdout, stderr = follower.communicate(timeout=DEADLINE_S)
    assert follower.returncode == 0, stderr
    *events, done = [json.loads(line) for line in stdout.splitlines()]
    sections = [event for event in events if event["event"] == "section"]
    assert [event["index"] for event in sections] == list(range(SLICES))
    for number, event in enumerate(sections, start=1):
        assert (event["done"], event["total"]) == (number, SLICES)
        assert event["points"] > 3000
        assert 0.0 < event["residual_rms_mm"] < 0.05
        assert event["coverage"] == 1.0
        assert event["lag_s"] is None or 0.0 <= event["lag_s"] < DEADLINE_S
    stages = [event["stage"] for event in events if event["event"] == "progress"]
    assert list(dict.fromkeys(stages)) == ["comparison", "saving"]
    assert done["warnings"] == [ENDS]
    # The writer could begin before the follower had come so far as to look.
    assert (set(done) >= LAGS) == any(event["lag_s"] is not None for event in sections)
    assert (place / "o/report.html").is_file()


def test_a_follower_and_a_replay_agree(place: Path, source: Path, without_pictures: None) -> None:
    (place / "live").mkdir()
    with writing(source, place / "live/vase.scan", 0.0) as writer:
        ran = run(
            "reconstruct", "live/vase.scan", "--follow", "--out", "a", "--formats", "stl", "--json"
        )
        succeeded(ran)
        assert writer.wait(DEADLINE_S) == 0
    succeeded(run("reconstruct", source, "--out", "b", "--formats", "stl"))
    one, other = contents(place / "a"), contents(place / "b")
    assert one["mesh.stl"] == other["mesh.stl"]
    numbers = [json.loads(each["metrics.json"]) for each in (one, other)]
    differing = {k for k in numbers[0] | numbers[1] if numbers[0].get(k) != numbers[1].get(k)}
    assert differing <= OF_THE_RUN | LAGS
    origins = [json.loads(each["provenance.json"])["input"] for each in (one, other)]
    assert origins[0] == origins[1]


def test_a_scanner_that_is_killed_leaves_a_result_of_what_it_kept(
    place: Path, source: Path
) -> None:
    with (
        writing(source, place / "live.scan", 0.0, 4) as writer,
        following(place, "--json") as follower,
    ):
        assert [first_line(follower)["index"] for _ in range(4)] == [0, 1, 2, 3]
        assert follower.poll() is None  # its writer lives: it waits
        writer.kill()
        stdout, stderr = follower.communicate(timeout=DEADLINE_S)
    assert follower.returncode == 0, stderr
    done = json.loads(stdout.splitlines()[-1])
    assert (done["sections"], done["slices_missing"]) == (4, SLICES - 4)
    died, missing, ends = done["warnings"]
    assert died.startswith("live.scan: the program that scanned died before the end")
    assert "`loftscan scan STATION.toml PLAN.toml --out live.scan --resume`" in died
    assert missing.startswith(f"slices 4-{SLICES - 1} of the plan: not there")
    assert ends == ENDS


def test_ctrl_c_ends_a_follower_with_exit_code_3_and_leaves_nothing(
    place: Path, source: Path
) -> None:
    with writing(source, place / "live.scan", 0.0, 2), following(place, "--json") as follower:
        assert first_line(follower)["event"] == "section"
        follower.send_signal(signal.SIGINT)
        _, stderr = follower.communicate(timeout=DEADLINE_S)
    assert follower.returncode == 3
    assert stderr == "loftscan: stopped by the operator; nothing was written\n"
    assert {path.name for path in place.iterdir()} == {"live.scan", "temporary"}


def test_a_scan_that_does_not_begin_is_waited_for_and_named(place: Path) -> None:
    ran = run("reconstruct", "no.scan", "--follow", "--patience-s", 0, "--out", "o")
    assert ran.exit_code == 2
    waiting, error = ran.stderr.splitlines()
    assert waiting == "waiting for no.scan to begin, at most 0 s"
    assert error == (
        "loftscan: no.scan: no scan began there within 0 s; start `loftscan scan ... --out"
        " no.scan`, or wait longer with --patience-s"
    )
    assert not (place / "o").exists()


def test_a_damaged_slice_is_a_warning_with_the_remedy_not_an_error(
    place: Path, source: Path, without_pictures: None
) -> None:
    write_scan(place / "vase.scan")
    damage(place / "vase.scan", 6)
    ran = succeeded(run("reconstruct", "vase.scan", "--out", "o", "--formats", "stl"))
    warning, ends = ran.stderr.splitlines()
    assert ends == f"warning: {ENDS}"
    assert warning.startswith("warning: slice 6 damaged, so left out")
    assert "--resume` takes what is damaged again" in warning
    assert "9 of 9 slices became sections" in ran.stdout


def test_a_scan_with_nothing_but_damage_is_a_damaged_file(place: Path) -> None:
    write_scan(place / "vase.scan", sweeps()[:1], State.ABORTED)
    damage(place / "vase.scan", 0)
    line = complaint(run("reconstruct", "vase.scan", "--out", "o"), 2)
    assert line.startswith("vase.scan: no slice that can be read (slice 0: ")
    assert line.endswith("resume the scan to take them again")


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("vase.scan", ("--axis", "x"), "--axis x: the slices of a scan say their axis"),
        ("vase.scan", ("--spacing-mm", 1), "--spacing-mm: the slices of a scan say"),
        ("vase.scan", ("--unit", "cm", "--follow"), "--unit cm: the slices of a scan say"),
        ("empty.scan", (), "empty.scan: no scan.json there; is it a .scan folder?"),
        ("none.scan", (), "none.scan: no scan.json there; is it a .scan folder?"),
    ],
)
def test_what_a_scan_does_not_take_is_refused_before_the_work(
    place: Path, source: Path, name: str, options: tuple, said: str
) -> None:
    (place / "vase.scan").symlink_to(source)
    (place / "empty.scan").mkdir()
    assert complaint(run("reconstruct", name, "--out", "o", *options), 2).startswith(said)


def test_a_folder_without_the_ending_is_a_scan_by_what_is_in_it(
    place: Path, source: Path, without_pictures: None
) -> None:
    (place / "monday").symlink_to(source)
    succeeded(run("reconstruct", "monday", "--out", "o", "--formats", "stl"))
    assert ScanFolder.open(source).missing() == ()
    assert json.loads((place / "o/provenance.json").read_text())["input"]["format"] == "scan"
