"""``loftscan scan`` of a simulated station, killed and starved at every write into its folder.

After each the witness of the station says whether the laser is off; then the scan is resumed.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.scanfile import ScanFolder
from loftscan import simulate
from loftscan.simulation import Simulated
from tests.campaigns.killed_writes import Tally, options_at

STOPS, FIRST_MM, STEP_MM, SCALE = 3, 6.0, 2.0, 20.0
_PATIENCE_S = 300.0
_DARK_S = 2.0  # for the guard and the relay's own watchdog
DEEDS = ("signal=KILL", "error=ENOSPC", "error=EIO")


def killed_scans(place: Path, slices: int, tally: Tally) -> None:
    """Every write of every deed; each scan is resumed to its end."""
    plan = place / "plan.toml"
    rings = ring(FIRST_MM, FIRST_MM + STEP_MM * (slices - 1), STEP_MM, STOPS).ring
    plan.write_text(write_plan(Plan(ring=rings, step_and_shoot=StepAndShoot(settle_s=0.0))))
    with simulate(seed=1, scale=SCALE) as station:
        for deed in DEEDS:
            for number in range(1, 2 * slices + 40):
                out = place / f"{deed[-4:]}-{number}.scan"
                if _struck(station, plan, out, slices, (deed, number), tally):
                    break
            else:
                tally.wrong.append(f"{deed}: no scan came through")


def _struck(
    station: Simulated, plan: Path, out: Path, slices: int, at: tuple[str, int], tally: Tally
) -> bool:
    """Strike one scan; whether it came through unscathed."""
    deed, number = at
    tally.cases[deed] += 1
    code, told, line = _scan(station, plan, out, options_at(out, slices, "write", deed, number))
    if code == 0:
        return True
    case = f"{deed} at write {number}"
    if not _dark(station):
        tally.wrong.append(f"{case}: the laser is on")
    if deed.startswith("error") and (code != 1 or str(out) not in line or "\n" in line.strip()):
        tally.wrong.append(f"{case}: exit code {code}, said {line[-300:]!r}")
    before = {
        i: ScanFolder(out).file(i).read_bytes() for i in told if ScanFolder(out).file(i).exists()
    }
    begun = (out / "scan.json").exists()
    again, more, line = _scan(station, plan, out, [], *(["--resume"] if begun else []))
    kept = {index: ScanFolder(out).file(index).read_bytes() for index in before}
    tally.lost += len(set(told) - set(before)) + sum(kept[i] != before[i] for i in before)
    tally.twice += len(set(told) & set(more))
    if again != 0 or ScanFolder.open(out).verify().sound != tuple(range(slices)):
        tally.wrong.append(f"{case}: not resumed to its end, code {again}: {line[-300:]}")
    return False


def _scan(
    station: Simulated, plan: Path, out: Path, strace: list[str], *options: str
) -> tuple[int, list[int], str]:
    tracer = ["strace", "-f", "-qq", "-o", "/dev/null", *strace] if strace else []
    words = ["-m", "loftscan.cli", "scan", str(station.station), str(plan), "--out", str(out)]
    ran = subprocess.run(
        [*tracer, sys.executable, *words, "--json", *options],
        capture_output=True, text=True, timeout=_PATIENCE_S, check=False,
    )  # fmt: skip
    events = [json.loads(line) for line in ran.stdout.splitlines() if line.endswith("}")]
    told = [event["index"] for event in events if event["event"] == "slice"]
    return ran.returncode, told, ran.stderr


def _dark(station: Simulated) -> bool:
    """Whether the last thing that the laser did, by the station's own witness, was to go off."""
    import time

    deadline_s = time.monotonic() + _DARK_S
    while True:
        events = map(json.loads, station.witness.read_text().splitlines())
        lit = [event["on"] for event in events if event["what"] == "laser"]
        if not lit or not lit[-1] or time.monotonic() > deadline_s:
            return not lit or not lit[-1]
        time.sleep(0.05)
