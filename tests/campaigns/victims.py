"""A scan as a process of its own, and the instants at which it is struck.

An instant lies in a phase of the scan, which the witness log and the folder tell while it runs::

    estimate  first move           lifting, turning     lit
       |opening|~~~~homing~~~~|   ~~~~moving~~~~|settling|exposure|  ...  ~~back~~|  |appending|
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import cycle
from pathlib import Path
from typing import IO

import numpy as np

from tests.campaigns.testimony import Event, Witnessed

REPOSITORY = Path(__file__).resolve().parents[2]
_LOOK_S = 0.001
_END_S = 60.0  # of a program that was told to end; far above what any does


class Phase(Enum):
    """What a scan does, with the seconds of it in which it is struck."""

    OPENING = 0.4
    HOMING = 0.5
    MOVING = 1.0  # of the move itself, not seconds
    SETTLING = 0.12
    EXPOSURE = 0.008
    APPENDING = 0.012


@dataclass(frozen=True, slots=True)
class Instant:
    """When to strike: how far into which occurrence of a phase, both as shares in [0, 1)."""

    phase: Phase
    which: float
    share: float


def instants(seed: list[int]) -> Iterator[Instant]:
    """Draw without end: every phase in turn, after each the exposure, which is the shortest."""
    rng = np.random.default_rng(seed)
    others = [phase for phase in Phase if phase is not Phase.EXPOSURE]
    phases = [phase for other in others for phase in (other, Phase.EXPOSURE)]
    for phase in cycle(phases):
        which, share = rng.random(2)
        yield Instant(phase, float(which), float(share))


@dataclass(frozen=True, slots=True, eq=False)
class Victim:
    """A program that scans."""

    process: subprocess.Popen[bytes]
    out: Path
    said: Path  # its stdout, or what was taken out of it when it is a pipe
    complained: Path
    kept_before: frozenset[int]
    stops: int  # that it has still to make
    slices: int  # that it has still to take
    witnessed: Witnessed
    station_pid: int
    unplug: Callable[..., None]  # cables of the station, by name

    def await_instant(self, instant: Instant) -> bool:
        """Wait for it; whether the program was still alive then."""
        while self.process.poll() is None:
            due_s = self._due_s(instant, self.witnessed.listen())
            if due_s is not None:
                time.sleep(max(0.0, due_s - time.monotonic()))
                return self.process.poll() is None
            time.sleep(_LOOK_S)
        return False

    def await_end(self) -> float:
        """Wait until it has ended; the monotonic time, or inf for one that does not end."""
        ended = True
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            ended = False
            self.process.kill()
            self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        return time.monotonic() if ended else math.inf

    def told(self) -> list[dict[str, object]]:
        """Give what it printed, whole lines."""
        whole = self.said.read_bytes().rpartition(b"\n")[0]
        return [json.loads(line) for line in whole.splitlines()]

    def last_words(self) -> str:
        """The last line of its stderr."""
        return (self.complained.read_text().strip().splitlines() or [""])[-1]

    def stop_reading(self) -> None:
        """Close our end of its stdout, after a last look at what is in there."""
        pipe = self.process.stdout
        assert pipe is not None
        os.set_blocking(pipe.fileno(), False)
        self.said.write_bytes(pipe.read() or b"")
        pipe.close()

    def _due_s(self, instant: Instant, events: list[Event]) -> float | None:
        """Wall time of the instant once it can be known."""
        phase, share = instant.phase, instant.share
        delay_s = share * phase.value
        if phase is Phase.OPENING:
            return time.monotonic() + delay_s if self._began() else None
        if phase is Phase.APPENDING:
            return time.monotonic() + delay_s if self._appends(instant) else None
        moves = [event for event in events if event["what"] == "move"]
        if phase is Phase.HOMING:
            return float(moves[0]["time_s"]) + delay_s if moves else None
        number = int(instant.which * self.stops)
        lights_s = [float(e["time_s"]) for e in events if e["what"] == "laser" and e["on"]]
        if phase is Phase.EXPOSURE:
            return lights_s[number] + delay_s if len(lights_s) > number else None
        # The move to the first stop comes before the first light: those after it are counted.
        scanning = [event for event in moves if lights_s and event["time_s"] > lights_s[0]]
        if len(scanning) <= number:
            return None
        begun_s, ends_s = float(scanning[number]["time_s"]), float(scanning[number]["ends_s"])
        return begun_s + share * (ends_s - begun_s) if phase is Phase.MOVING else ends_s + delay_s

    def _began(self) -> bool:
        """Whether it is past its imports: it says the estimate before it opens anything."""
        return self.process.stdout is not None or b"\n" in self.said.read_bytes()

    def _appends(self, instant: Instant) -> bool:
        number = len(self.kept_before) + int(instant.which * self.slices)
        with contextlib.suppress(FileNotFoundError):
            names = [each.name for each in (self.out / "slices").iterdir()]
            kept = sum(name.endswith(".npz") for name in names)
            return kept > number or (kept == number and any(n.endswith(".part") for n in names))
        return False


def command(station: Path, plan: Path, out: Path) -> list[str]:
    """Give `loftscan scan`, resuming what is there."""
    words = [sys.executable, "-m", "loftscan.cli", "scan", station, plan, "--out", out, "--json"]
    resumed = ["--resume"] if (out / "scan.json").exists() else []
    return [str(word) for word in words] + resumed


def script(station: Path, plan: Path, out: Path, reads: int) -> list[str]:
    """Give the script that uses the verbs."""
    words = ("-m", "tests.campaigns.verbs_script", station, plan, out, reads)
    return [sys.executable, *map(str, words)]


def started(words: list[str], stdout: int | IO[bytes], complained: Path) -> subprocess.Popen[bytes]:
    """Start it; not of the terminal's group, whose Ctrl-C is for the campaign."""
    with complained.open("wb") as stderr:
        return subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            cwd=REPOSITORY,
            start_new_session=True,
        )
