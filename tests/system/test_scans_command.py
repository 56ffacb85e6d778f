"""``loftscan scans``: list, verify, repair, export, as a person runs them."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from tests.loftscan.made_scans import damage, sweeps, write_scan
from tests.system.command_cases import complaint, contents, run, succeeded


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("kept")
    write_scan(place / "whole.scan")
    write_scan(place / "deeper/paused.scan", sweeps()[:4], State.ABORTED)
    return place


@pytest.fixture
def place(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def events(*arguments: object) -> list[dict[str, object]]:
    return [json.loads(line) for line in run("scans", *arguments, "--json").stdout.splitlines()]


def test_a_list_says_how_each_scan_stands(place: Path) -> None:
    ScanFolder(place / "deeper/paused.scan").file(2).rename(
        place / "deeper/paused.scan/slices/000002.npz.damaged"
    )
    (place / "broken.scan").mkdir()
    writer = ScanFolder.open(place / "whole.scan").resume()
    found = {Path(str(each["path"])).name: each for each in events("list")}
    writer.close()
    assert {name: each["standing"] for name, each in found.items()} == {
        "whole.scan": "being written", "paused.scan": "damaged", "broken.scan": "damaged",
    }  # fmt: skip
    whole = next(each for each in events("list", ".") if each["path"] == "whole.scan")
    assert (whole["standing"], whole["slices"], whole["expected"]) == ("whole", 10, 10)
    assert whole["created"] == "2026-01-02T03:04:05+00:00"
    assert "10 rings from 6 mm by 4 mm, 60 stops" in str(whole["plan"])
    lines = succeeded(run("scans", "list")).stdout.splitlines()
    assert len(lines) == 3
    assert any("10 of 10" in line and "kB  whole" in line for line in lines)


def test_a_list_of_nothing_and_of_nowhere(place: Path) -> None:
    (place / "empty").mkdir()
    assert "no .scan folder" in succeeded(run("scans", "list", "empty")).stdout
    assert "no such folder" in complaint(run("scans", "list", "nowhere"), 2)


def test_verify_writes_nothing_and_names_the_damaged(place: Path) -> None:
    before = contents(place)
    assert "10 slices are sound" in succeeded(run("scans", "verify", "whole.scan")).stdout
    assert contents(place) == before
    damage(place / "whole.scan", 3)
    ran = run("scans", "verify", "whole.scan")
    assert ran.exit_code == 1
    assert "slices/000003.npz: damaged: damaged archive" in ran.stdout
    assert "1 of 10 slices are damaged; mend" in ran.stderr
    (told,) = events("verify", "whole.scan")
    assert (told["sound"], told["missing"]) == (9, [3])


def test_an_older_scan_is_readable_and_has_no_checksum(place: Path) -> None:
    for file in place.glob("whole.scan/slices/*.npz"):
        with zipfile.ZipFile(file, "a") as archive:
            archive.comment = b""
    ran = succeeded(run("scans", "verify", "whole.scan"))
    assert "10 of them have no checksum" in ran.stdout
    assert events("verify", "whole.scan")[0]["no_checksum"] == list(range(10))


def test_repair_says_what_it_did_and_what_is_left(place: Path) -> None:
    damage(place / "whole.scan", 3)
    file = ScanFolder(place / "whole.scan").file(5)
    file.write_bytes(file.read_bytes()[:-40])
    lines = succeeded(run("scans", "repair", "whole.scan")).stdout.splitlines()
    assert lines == [
        "slices/000003.npz.damaged: set aside: " + lines[0].partition("aside: ")[2],
        "slices/000005.npz.damaged: set aside: " + lines[1].partition("aside: ")[2],
        "slices/000005.npz: rebuilt: every column has its checksum",
        "scan.json: state: complete is now aborted",
        "whole.scan: 9 slices are sound, 1 of the plan are missing",
    ]
    assert "nothing to repair" in run("scans", "repair", "whole.scan").stdout
    assert "is it a .scan folder" in complaint(run("scans", "repair", "deeper"), 2)


def test_an_export_is_told_and_refused_in_one_line(place: Path) -> None:
    ran = succeeded(run("scans", "export", "whole.scan", "vase.ply"))
    assert ran.stdout == "vase.ply: 48380 points of 10 slices, in mm\n"
    assert "is there already" in complaint(run("scans", "export", "whole.scan", "vase.ply"), 2)
    damage(place / "whole.scan", 3)
    ran = succeeded(run("scans", "export", "whole.scan", "vase.xyz", "--json"))
    assert "warning: slice 3 left out" in ran.stderr
    assert json.loads(ran.stdout)["slices"] == 9
    assert "ends in none of" in complaint(run("scans", "export", "whole.scan", "vase.stl"), 2)
    missing = run("scans", "export", "whole.scan", "nowhere/vase.ply")
    assert missing.exit_code == 1
