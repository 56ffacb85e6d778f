"""`loftscan calibrate` on a crooked simulated station, over its wires, as a person runs it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from acquisition.calibration import read_calibration
from acquisition.plan import ring, write_plan
from acquisition.scanfile import ScanFolder
from loftscan import simulate
from tests.system.command_cases import run, start

WHY = "a first look, nothing is measured"


@dataclass(frozen=True)
class Ended:
    """How a command ended that lights the laser: in a process of its own, as its guard wants it."""

    exit_code: int
    stdout: str
    stderr: str


def scanning(*arguments: object) -> Ended:
    child = start(*arguments)
    stdout, stderr = child.communicate(timeout=400.0)
    return Ended(child.returncode, stdout, stderr)


@dataclass(frozen=True)
class Bench:
    """A crooked station with an artefact on it, and its calibration."""

    station: Path
    artefact: Path
    calibration: Path
    scan: Path
    said: str


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("crooked")
    with simulate("ball-plate", crooked=True, cloud_width_mm=0.04, scale=30.0, out=folder) as live:
        plan = folder / "artefact-plan.toml"
        plan.write_text(write_plan(ring(12.0, 74.0, 3.1, 18)), encoding="utf-8")
        artefact = folder / "artefact.toml"
        bare = scanning("scan", live.station, plan, "--out", folder / "early.scan")
        assert bare.exit_code == 2
        assert "there is no calibration of this station" in bare.stderr
        assert not (folder / "early.scan").exists()
        done = scanning("calibrate", live.station, artefact, "--plan", plan)
        assert done.exit_code == 0, done.stderr
        scan = next(folder.glob("calibration-*.scan"))
        yield Bench(live.station, artefact, folder / "calibration.toml", scan, done.stdout)


def test_it_finds_how_the_station_truly_stands(bench: Bench) -> None:
    found = read_calibration(bench.calibration)
    # The simulator's truth, by `sim.crooked`; seen from the axis in tests/campaigns/crooked_chain.
    from sim.crooked import Crookedness
    from tests.campaigns.crooked_chain import known

    truth = known(Crookedness())
    sd = dict(zip(found.names, found.covariance.diagonal() ** 0.5, strict=True))
    for name in found.names:
        off = getattr(found.kinematics, name) - getattr(truth, name)
        # Five: the noise of a speckle is not normal, and polyhedra and counts add a micrometre.
        assert abs(off) < 5.0 * sd[name], (name, off, sd[name])
    assert found.fit.rank == 11


def test_it_tells_the_numbers_and_draws_the_pictures(bench: Bench) -> None:
    assert "rank 11 of 11" in bench.said
    assert "held out: middle-high" in bench.said
    report = bench.calibration.with_name("calibration-report")
    assert {each.name for each in report.iterdir()} >= {
        "report.html", "residuals.png", "harmonics.png"
    }  # fmt: skip
    record = ScanFolder.open(bench.scan).record()
    assert record.override.startswith("scans an artefact")


def test_a_scan_then_uses_it_and_says_so(bench: Bench, place: Path) -> None:
    Path("few.toml").write_text(write_plan(ring(20.0, 22.0, 2.0, 3)), encoding="utf-8")
    done = scanning("scan", bench.station, "few.toml", "--out", "few.scan")
    assert done.exit_code == 0, done.stderr
    record = ScanFolder.open(Path("few.scan")).record()
    found = read_calibration(bench.calibration)
    assert record.calibration == found.kinematics
    assert record.calibration_file_sha256 == found.sha256
    assert record.override == ""


def test_another_calibration_does_not_resume_a_scan(bench: Bench, place: Path) -> None:
    Path("few.toml").write_text(write_plan(ring(20.0, 22.0, 2.0, 3)), encoding="utf-8")
    assert scanning("scan", bench.station, "few.toml", "--out", "few.scan").exit_code == 0
    text = bench.calibration.read_text(encoding="utf-8")
    pitch = read_calibration(bench.calibration).kinematics.pitch_deg
    try:
        bench.calibration.write_text(
            text.replace(f"pitch_deg = {pitch!r}", "pitch_deg = 0.125", 1), encoding="utf-8"
        )
        done = scanning("scan", bench.station, "few.toml", "--out", "few.scan", "--resume")
    finally:
        bench.calibration.write_text(text, encoding="utf-8")
    assert done.exit_code == 2
    assert "begun with another calibration: pitch_deg was" in done.stderr


def test_the_operators_words_go_into_the_record(bench: Bench, place: Path) -> None:
    Path("few.toml").write_text(write_plan(ring(20.0, 20.0, 2.0, 3)), encoding="utf-8")
    kept = bench.calibration.with_suffix(".away")
    shutil.move(bench.calibration, kept)
    try:
        done = scanning("scan", bench.station, "few.toml", "--out", "o.scan", "--override", WHY)
    finally:
        shutil.move(kept, bench.calibration)
    assert done.exit_code == 0, done.stderr
    assert WHY in json.loads(Path("o.scan/scan.json").read_text())["calibration"]["override"]


def test_a_check_finds_no_drift_and_remembers(bench: Bench) -> None:
    for checks in (1, 2):
        done = run(
            "calibrate", bench.station, bench.artefact, "--scan", bench.scan, "--check", "--json"
        )
        assert done.exit_code == 0, done.stderr
        assert json.loads(done.stdout)["checks"] == checks
    assert bench.calibration.with_name("calibration-report").joinpath("trend.png").is_file()


def test_a_check_finds_a_sensor_that_was_moved(bench: Bench) -> None:
    text = bench.calibration.read_text(encoding="utf-8")
    found = read_calibration(bench.calibration).kinematics
    try:
        # As if the sensor had been knocked by 0.2 mm since: the calibration no longer fits.
        bench.calibration.write_text(
            text.replace(f"side_mm = {found.side_mm!r}", f"side_mm = {found.side_mm + 0.2!r}", 1),
            encoding="utf-8",
        )
        done = run("calibrate", bench.station, bench.artefact, "--scan", bench.scan, "--check")
    finally:
        bench.calibration.write_text(text, encoding="utf-8")
    assert done.exit_code == 1
    assert "drifted" in done.stderr


def test_nothing_to_solve_from_is_bad_usage(bench: Bench) -> None:
    done = run("calibrate", bench.station, bench.artefact)
    assert done.exit_code == 2
    assert "give --plan, or --scan" in done.stderr


def test_a_calibration_that_is_refused_is_not_written(bench: Bench, place: Path) -> None:
    wrong = bench.artefact.read_text(encoding="utf-8").replace(
        "radius_mm = 10.0", "radius_mm = 9.9"
    )
    Path("wrong.toml").write_text(wrong, encoding="utf-8")
    done = run("calibrate", bench.station, "wrong.toml", "--scan", bench.scan, "--out", "no.toml")
    assert done.exit_code == 1
    assert not Path("no.toml").exists()
    assert len(done.stderr.strip().splitlines()) == 1
