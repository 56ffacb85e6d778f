"""Who reads a scan's output leaves: an attended scan pauses after its slice, another goes on."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from acquisition.plan import Plan, Ring, StepAndShoot, write_plan
from acquisition.scanfile import ScanFolder
from loftscan import simulate

PLAN = Plan(
    ring=Ring(first_mm=4.0, last_mm=12.0, step_mm=2.0, profiles_per_turn=4),
    step_and_shoot=StepAndShoot(settle_s=0.05),
)
END_S = 60.0


@pytest.mark.parametrize("attended", [True, False])
def test_a_scan_whose_reader_left_ends_paused_or_whole(tmp_path: Path, *, attended: bool) -> None:
    plan, out = tmp_path / "plan.toml", tmp_path / "left.scan"
    plan.write_text(write_plan(PLAN))
    with simulate("cylinder", scale=20.0, seed=3) as station:
        words = ["-m", "loftscan.cli", "scan", str(station), str(plan), "--out", str(out), "--json"]
        process = subprocess.Popen(
            [sys.executable, *words, *(["--attended"] if attended else [])],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        with process:
            assert process.stdout is not None
            assert process.stderr is not None
            while '"slice"' not in process.stdout.readline():
                pass
            process.stdout.close()
            said = process.stderr.read()
            code = process.wait(END_S)
    missing = ScanFolder(out).missing()
    if attended:
        assert code == 3
        assert "paused: " in said
        assert "--resume" in said
        assert 0 < len(missing) < PLAN.ring.count - 1
    else:
        assert code == 0
        assert said == ""
        assert not missing
