"""The operator scripts of examples/ run as they stand, against the simulator."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

from acquisition.plan import ring, write_plan
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
