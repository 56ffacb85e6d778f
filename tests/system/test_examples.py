"""The operator scripts of examples/ run as they stand, against the simulator."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from acquisition.adaptive_plan import Adaptive
from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan import simulate
from loftscan.simulation import Simulated

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PATIENCE_S = 60.0


def started(script: str, *arguments: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-u", str(EXAMPLES / script), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def shell(script: str, *arguments: object) -> subprocess.Popen[str]:
    here = Path(sys.executable).parent  # where `loftscan` is
    return subprocess.Popen(
        ["sh", str(EXAMPLES / script), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PATH": f"{here}:{os.environ['PATH']}"},
    )  # fmt: skip


def laser_is_on(station: Simulated) -> bool:
    events = map(json.loads, station.witness.read_text().splitlines())
    return bool([event["on"] for event in events if event["what"] == "laser"][-1])


def test_scan_once_scans_and_ctrl_c_ends_it_as_python_users_expect(place: Path) -> None:
    Path("plan.toml").write_text(write_plan(ring(10.0, 14.0, 2.0, 3)))
    with simulate(scale=40.0) as station:
        child = started("scan_once.py", station, "plan.toml", "whole.scan")
        stdout, stderr = child.communicate(timeout=PATIENCE_S)
        assert (child.returncode, stderr) == (0, "")
        assert [line.partition(":")[0] for line in stdout.splitlines()] == [
            "slice 1 of 3", "slice 2 of 3", "slice 3 of 3"
        ]  # fmt: skip
        assert ScanFolder.open(Path("whole.scan")).record().state is State.COMPLETE

        child = started("scan_once.py", station, "plan.toml", "part.scan")
        assert child.stdout is not None
        assert child.stdout.readline().startswith("slice 1 of 3")
        child.send_signal(signal.SIGINT)
        _, stderr = child.communicate(timeout=PATIENCE_S)
        assert child.returncode == -signal.SIGINT
        assert stderr.rstrip().endswith("KeyboardInterrupt")
        assert not laser_is_on(station)
        folder = ScanFolder.open(Path("part.scan"))
        assert folder.record().state is State.ABORTED
        assert 0 in folder.indices()


def test_scan_overnight_keeps_every_scan_and_a_line_for_each(place: Path) -> None:
    Path("plan.toml").write_text(write_plan(ring(10.0, 12.0, 2.0, 3)))
    with simulate(scale=40.0) as station:
        child = started("scan_overnight.py", station, "plan.toml", "night", 2, 0)
        _, stderr = child.communicate(timeout=PATIENCE_S)
        assert (child.returncode, stderr) == (0, "")
        assert not laser_is_on(station)
    lines = [json.loads(line) for line in Path("night/night.jsonl").read_text().splitlines()]
    assert [(line["scan"], line["trouble"]) for line in lines] == [
        ("0000.scan", ""), ("0001.scan", "")
    ]  # fmt: skip
    assert all(ScanFolder(scan).is_whole() for scan in Path("night").glob("*.scan"))


def test_scan_overnight_refuses_a_laser_that_nothing_turns_off(place: Path) -> None:
    Path("plan.toml").write_text(write_plan(ring(10.0, 12.0, 2.0, 3)))
    with simulate(scale=40.0, laser="plain") as station:
        child = started("scan_overnight.py", station, "plan.toml", "night", 1, 0)
        child.communicate(timeout=PATIENCE_S)
        assert child.returncode == 1
        assert not any(
            json.loads(line).get("on") for line in station.witness.read_text().splitlines()
        )
    assert "--attended" in Path("night/night.jsonl").read_text()


def test_scan_until_tolerance_scans_and_reconstructs(place: Path) -> None:
    plan = Plan(
        ring=ring(4.0, 113.0, 0.5, 6).ring,
        step_and_shoot=StepAndShoot(settle_s=0.0),
        adaptive=Adaptive(
            tolerance_mm=3.0, coarse_step_mm=30.0, most_slices=20, answer_within_s=60.0
        ),
    )
    Path("plan.toml").write_text(write_plan(plan))
    with simulate(scale=40.0) as station:
        child = shell("scan_until_tolerance.sh", station, "plan.toml", "vase")
        stdout, stderr = child.communicate(timeout=3 * PATIENCE_S)
    assert child.returncode == 0, stderr
    assert "no more slices: 98 % of the surface" in stdout
    assert Path("vase/mesh.ply").exists()


def test_the_job_for_ci_holds_a_scan_against_its_truth(place: Path) -> None:
    child = started("ci_job.py", "vase", "out")
    stdout, stderr = child.communicate(timeout=3 * PATIENCE_S)
    assert child.returncode == 0, stderr
    assert "rms from the truth" in stdout
    assert Path("out/surface.step").exists()


def test_calibrate_every_morning_leaves_a_report_a_day(place: Path) -> None:
    with simulate(
        "ball-plate", crooked=True, cloud_width_mm=0.04, scale=30.0, out=Path("sim")
    ) as station:
        Path("plan.toml").write_text(write_plan(ring(12.0, 74.0, 3.1, 18)))
        artefact = Path("sim/artefact.toml")
        solve = ["-m", "loftscan.cli", "calibrate", station, artefact, "--plan", "plan.toml"]
        subprocess.run([sys.executable, *map(str, solve)], check=True, capture_output=True)
        Path("short.toml").write_text(write_plan(ring(12.0, 74.0, 6.2, 12)))
        child = shell("calibrate_every_morning.sh", station, artefact, "short.toml", "mornings")
        _, stderr = child.communicate(timeout=3 * PATIENCE_S)
        assert child.returncode == 0, stderr
    assert len(list(Path("mornings").glob("*/trend.png"))) == 1
