"""One program that works a bad station for hours, and says what it does and what it has grown to.

    python -m tests.campaigns.soaked STATION.toml FOLDER SEED

Moves, exposures, scans that are resumed until they are whole; after each error what a person would
do: acknowledge, home, go on; where that does not help, the station is closed and opened again. Each
work is a line of JSON on stdout at its beginning and at its end, with the process's own counts.
"""

from __future__ import annotations

import faulthandler
import gc
import json
import os
import random
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from acquisition.errors import AcquisitionError
from acquisition.plan import Plan, Ring, StepAndShoot
from acquisition.safety.promises import Attendance
from drivers.errors import DriverError
from loftscan import Station, scan

PLAN = Plan(
    ring=Ring(first_mm=6.0, last_mm=8.0, step_mm=2.0, profiles_per_turn=4),
    step_and_shoot=StepAndShoot(settle_s=0.02),
)
_TRIES = 12  # of one scan, and of opening the station
_GIVES_UP = 4  # acknowledgements in a row that did not help
_WRONG = (DriverError, AcquisitionError)

T = TypeVar("T")


def tell(**words: object) -> None:
    os.write(1, json.dumps(words).encode() + b"\n")


def counts() -> dict[str, int]:
    """What the kernel says of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "rss": pages * os.sysconf("SC_PAGE_SIZE"),
        "threads": sum(1 for _ in Path("/proc/self/task").iterdir()),
        "python_threads": threading.active_count(),
        "descriptors": sum(1 for _ in Path("/proc/self/fd").iterdir()) - 1,
        "children": len(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()),
    }


class Work:
    """All that is done at one open station, one thing after the other."""

    def __init__(self, at: Station, folder: Path, dice: random.Random) -> None:
        self._at = at
        self._folder = folder
        self._dice = dice

    def one(self) -> None:
        """One work, drawn; raises what went wrong in it, once the station is at rest."""
        kind = self._dice.choice(["jog", "jog", "profile", "stop", "stand", "scan", "scan"])
        if kind == "scan":
            self._scan()
        elif kind in ("jog", "profile"):
            self._homed()
            done(kind, self._jog if kind == "jog" else lambda: self._at.profile())
        else:
            done(kind, lambda: self._at.stop() if kind == "stop" else self._at.stand())

    def acknowledge(self) -> None:
        """As a person would, after having looked."""
        done("acknowledge", lambda: self._at.acknowledge())

    def _homed(self) -> None:
        stand = done("stand", lambda: self._at.stand())
        if not (stand.table.homed and stand.stage.homed):
            done("home", lambda: self._at.home())

    def _jog(self) -> None:
        table_deg, stage_mm = self._dice.uniform(0.0, 350.0), self._dice.uniform(1.0, 20.0)
        self._at.jog(table_deg=table_deg, stage_mm=stage_mm)

    def _scan(self) -> None:
        """A scan of two slices, resumed after what goes wrong until it is whole."""
        out = self._folder / f"{time.monotonic_ns()}.scan"
        for attempt in range(_TRIES):
            with suppress(*_WRONG):
                done("scan", lambda: self._slices(out), out=str(out))
                tell(event="whole", out=str(out))
                return
            if attempt == _TRIES - 1:
                tell(event="given up", out=str(out))
            with suppress(*_WRONG):
                self.acknowledge()

    def _slices(self, out: Path) -> None:
        resume = (out / "scan.json").exists()
        # A watched relay may run alone; a plain one may not, and somebody is "here".
        taken = scan(self._at, PLAN, out=out, resume=resume, attendance=Attendance.PRESENT)
        for sweep in taken:
            tell(event="slice", index=sweep.index, out=str(out))


def done(kind: str, work: Callable[[], T], **words: object) -> T:
    """Do it, and tell when it began and ended and what came of it."""
    begun_s = time.monotonic()
    tell(event="begun", kind=kind, time_s=begun_s, **words)
    came = "done"
    try:
        return work()
    except BaseException as error:
        came = f"{type(error).__name__}: {error}"
        raise
    finally:
        tell(event="ended", kind=kind, begun_s=begun_s, time_s=time.monotonic(), came=came, **words)


def shift(station: str, folder: Path, dice: random.Random) -> None:
    """Open the station and work there until it does not help any more to acknowledge."""
    with Station.open(station) as at:
        work, in_vain = Work(at, folder, dice), 0
        while in_vain < _GIVES_UP:
            try:
                work.one()
                in_vain = 0
            except _WRONG:
                in_vain += 1
                with suppress(*_WRONG):
                    work.acknowledge()
                    in_vain = 0
            tell(event="grown", time_s=time.monotonic(), **counts())


def main(station: str, folder: str, seed: str) -> None:
    faulthandler.register(signal.SIGUSR1, all_threads=True)  # who hangs says where
    dice = random.Random(int(seed))
    while True:
        with suppress(*_WRONG):
            done("open", lambda: shift(station, Path(folder), dice))


if __name__ == "__main__":
    main(*sys.argv[1:])
