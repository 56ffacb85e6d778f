"""How long after its slice a section is there, while a simulated station scans: lag and period.

The first rows are `loftscan demo` at its own speed and at ten times that; what a stop of the table
costs in questions and answers does not shrink with time, so the second is not ten times as fast.
In the last row the slices of the first come at a tenth of its period, from a program that only
appends. Run: python benchmarks/following.py [rings]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan.warming import warm_up

DEMO_SCALE = 10.0  # the demo's own: times real time
TENTH = 0.1


@dataclass(frozen=True)
class Live:
    """What one followed scan says of itself."""

    slices: int
    period_s: float
    lag_s: float
    most_s: float

    def told(self, name: str) -> str:
        """One row."""
        verdict = "reached" if self.lag_s <= self.period_s else "MISSED"
        return (
            f"{name:34s} {self.slices:3d} slices  a slice every {self.period_s:5.3f} s"
            f"  lag: median {self.lag_s:5.3f} s, most {self.most_s:5.3f} s  {verdict}"
        )


def demo(scale: float, rings: int, out: Path) -> Live:
    """Run the demo."""
    options = ["--scale", scale, "--rings", rings, "--out", out, "--json"]
    return _live(["demo", *options])


def paced(source: Path, period_s: float, place: Path) -> Live:
    """Follow a scan whose slices come from another one, in the time that is left to each."""
    copy = place / "paced.scan"
    writer = get_context("spawn").Process(target=append_slowly, args=(source, copy, period_s))
    writer.start()
    try:
        words = ["reconstruct", copy, "--follow", "--method", "paper"]
        return _live([*words, "--out", place / "paced", "--json"])
    finally:
        writer.join()


def append_slowly(source: Path, target: Path, period_s: float) -> None:
    """Write the slices of one scan into another, one a period."""
    folder = ScanFolder.open(source)
    record = replace(folder.record(), state=State.SCANNING)
    with ScanFolder.create(target, record) as writer:
        time.sleep(5.0)  # the follower is warm by then
        due_s = time.monotonic()
        for sweep in map(folder.read, record.indices):
            due_s += period_s
            time.sleep(max(0.0, due_s - time.monotonic()))
            writer.append(sweep)
        writer.finish(State.COMPLETE)


def _live(words: list[object]) -> Live:
    command = [sys.executable, "-m", "loftscan.cli", *map(str, words)]
    ran = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    events = [json.loads(line) for line in ran.stdout.splitlines() if line.startswith("{")]
    (done,) = [event for event in events if event["event"] == "done"]
    lag = (done["slice_period_median_s"], done["lag_median_s"], done["lag_max_s"])
    return Live(done["lag_slices"], *lag)


def main() -> None:
    """Print the rows."""
    rings = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    warm_up()  # compiling happens once on a machine
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        normal = demo(DEMO_SCALE, rings, place / "normal")
        print(normal.told("demo"), flush=True)
        print(demo(10.0 * DEMO_SCALE, rings, place / "fast").told("demo, ten times its speed"))
        tenth = paced(place / "normal.scan", TENTH * normal.period_s, place)
        print(tenth.told("its slices, at a tenth of its period"))


if __name__ == "__main__":
    main()
