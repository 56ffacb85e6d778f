"""Scan one part again and again, with nobody there: a fixture that creeps, a part that dries.

    python scan_overnight.py STATION.toml PLAN.toml FOLDER [HOW_OFTEN] [EVERY_S]

Nobody is there, so the laser's switch needs a watchdog of its own; a station without one refuses
before anything is lit. A scan that a lost link cut short is gone on with, a few times. Afterwards
FOLDER holds a .scan each and night.jsonl, a line each. Exit code 1: something is missing.
"""

from __future__ import annotations

import json
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from acquisition.errors import AcquisitionError
from drivers.errors import DriverError
from loftscan import Station, scan

TRIES = 3
REST_S = 5.0  # before a station that was lost is opened again


def scan_overnight(
    station_file: str, plan_file: str, folder: Path, how_often: int, every_s: float
) -> bool:
    """Scan so often; tell whether every scan is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = True
    for number in range(how_often):
        begun_s = time.monotonic()
        out = folder / f"{number:04d}.scan"
        trouble = scan_in_tries(station_file, plan_file, out)
        note(folder, out, trouble)
        whole &= not trouble
        if number < how_often - 1:
            time.sleep(max(0.0, begun_s + every_s - time.monotonic()))
    return whole


def scan_in_tries(station_file: str, plan_file: str, out: Path) -> str:
    """Scan into one folder, and go on with it when a device was lost; say what went wrong."""
    trouble = ""
    for tries_left in reversed(range(TRIES)):
        try:
            with Station.open(station_file) as station:  # laser off, axes stopped on every way out
                for _ in scan(station, plan_file, out=out, resume=(out / "scan.json").exists()):
                    pass
        except (DriverError, AcquisitionError) as lost:
            trouble = str(lost)
            if tries_left:
                time.sleep(REST_S)
        else:
            return ""
    return trouble


def note(folder: Path, out: Path, trouble: str) -> None:
    """Append a line to night.jsonl, and print it."""
    line = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "scan": out.name}
    text = json.dumps({**line, "trouble": trouble})
    with (folder / "night.jsonl").open("a") as stream:
        stream.write(f"{text}\n")
    print(text, flush=True)


if __name__ == "__main__":
    how_often, every_s = (*sys.argv[4:6], *["8", "3600"][len(sys.argv[4:6]) :])
    done = scan_overnight(
        sys.argv[1], sys.argv[2], Path(sys.argv[3]), int(how_often), float(every_s)
    )
    sys.exit(0 if done else 1)
