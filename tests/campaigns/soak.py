"""A station worked for hours over bad wires: nothing grows, nothing hangs, nothing is lost.

    python -m tests.campaigns.soak [--hours 2] [--scale 20] [--seed 1] [--faults NAME=P,...]

The hours are the simulated station's; at 20 times real time two of them take six minutes. One
program moves, exposes and scans all that time (`tests.campaigns.soaked`), over wires on which each
message meets each kind of fault by its own chance. Judges are the kernel's counts of that program,
the witness log and the folders. It exits 1 when a bound is broken; docs/bad-wires.md says which.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan import simulate
from loftscan.simulation import Simulated
from tests.campaigns.kinds import WATCHDOG_S
from tests.campaigns.soaked import PLAN
from tests.campaigns.struck_scan import untrue
from tests.campaigns.testimony import Event, Witnessed, lit, lit_in_motion
from tests.campaigns.victims import REPOSITORY

# One in a hundred messages is struck, by each kind one in a thousand.
FAULTS = ",".join(
    f"{name}=0.001"
    for name in ("late", "drop", "flip", "cut", "twice", "swap", "split", "noise", "mute", "unplug")
) + ",away-ms=300"  # fmt: skip
HANG_S = 90.0  # nothing waits longer: a move's own deadline, three tries, and a reconnect
GROWN_BYTES = 8 << 20  # of resident memory, from after the warm-up to the end
WARM_SHARE = 0.25
_ASK_AGAIN_S = 10.0
_HEARD_S = 0.3  # a word of an order that was given up may come so late
_ASKED = {"home": True, "jog": True, "scan": True}  # work that moves axes
_EXPOSED = {"profile": True, "scan": True}


@dataclass
class Soak:
    """What the program told so far, and what of it was wrong."""

    began: list[dict[str, Any]] = field(default_factory=list)
    ended: list[dict[str, Any]] = field(default_factory=list)
    grown: list[dict[str, Any]] = field(default_factory=list)  # of the program that lives now
    lives: list[list[dict[str, Any]]] = field(default_factory=list)
    acknowledged: Counter[str] = field(default_factory=Counter)
    whole: int = 0
    given_up: int = 0
    broken: list[str] = field(default_factory=list)

    def take(self, told: dict[str, Any]) -> None:
        """One line."""
        match told["event"]:
            case "begun":
                self.began.append(told)
            case "ended":
                self.ended.append(told)
                if told["kind"] != "open" and told["time_s"] - told["begun_s"] > HANG_S:
                    self.broken.append(f"{told['kind']} took {told['time_s'] - told['begun_s']} s")
            case "grown":
                self.grown.append(told)
            case "slice":
                self.acknowledged[told["out"]] = max(
                    self.acknowledged[told["out"]], told["index"] + 1
                )
            case "given up":
                self.given_up += 1

    def judge_whole(self, out: Path, events: Sequence[Event]) -> None:
        """A scan that says it is complete: every slice sound, once, and true."""
        self.whole += 1
        folder = ScanFolder(out)
        if folder.record().state is not State.COMPLETE or folder.missing():
            self.broken.append(f"{out.name}: slices are missing")
        if folder.verify().damaged:
            self.broken.append(f"{out.name}: a damaged slice")
        self.broken += [f"{out.name}: {what}" for what in untrue(folder, PLAN, events)]

    def judge_kept(self, out: Path) -> None:
        """A scan that was given up: what was told as kept is there and sound."""
        kept = set(ScanFolder(out).verify().sound) if (out / "scan.json").exists() else set()
        if lost := set(range(self.acknowledged[str(out)])) - kept:
            self.broken.append(f"{out.name}: {sorted(lost)} were told as kept and are not")

    def next_life(self) -> None:
        """The program was ended, by its guard: what it grew to is compared with itself alone."""
        self.lives.append(self.grown)
        self.grown = []

    def spans(self, kinds: dict[str, bool]) -> list[tuple[float, float]]:
        """When work of these kinds was done; to no end where it was ended amid it."""
        ends = {told["begun_s"]: told["time_s"] for told in self.ended if told["kind"] in kinds}
        began = [told["time_s"] for told in self.began if told["kind"] in kinds]
        later = [told["time_s"] for told in self.began]
        return [
            (each, ends.get(each, min((s for s in later if s > each), default=math.inf)))
            for each in began
        ]


def witnessed_wrong(soak: Soak, events: Sequence[Event]) -> Iterator[str]:
    """What the simulator saw and nobody had asked for."""
    exposing, asked = soak.spans(_EXPOSED), soak.spans(_ASKED)
    for span in lit(events):
        if not any(a <= span.begun_s and span.ended_s <= b + WATCHDOG_S for a, b in exposing):
            yield f"lit at {span.begun_s:.3f} for {span.ended_s - span.begun_s:.3f} s, unasked"
    for span in lit_in_motion(events):
        yield f"an axis moved under the laser at {span.begun_s:.3f}"
    for event in events:
        if event["what"] == "move" and not any(
            a <= event["time_s"] <= b + _HEARD_S for a, b in asked
        ):
            yield f"{event['axis']} began to move at {event['time_s']:.3f}, unasked"


def growth(life: Sequence[dict[str, Any]], name: str) -> tuple[float, float]:
    """Medians of a count after the warm-up and at the end, of a tenth of the life each."""
    begun_s, ended_s = life[0]["time_s"], life[-1]["time_s"]

    def around(share: float) -> float:
        low = begun_s + (ended_s - begun_s) * share
        high = begun_s + (ended_s - begun_s) * (share + 0.1)
        nearest = min(life, key=lambda each: abs(each["time_s"] - (low + high) / 2.0))
        within = [each for each in life if low <= each["time_s"] <= high]
        return median(each[name] for each in within or [nearest])

    return around(WARM_SHARE), around(0.9)


def grown_wrong(life: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What grew."""
    bounds = {"rss": GROWN_BYTES, "threads": 0, "python_threads": 0, "descriptors": 0,
              "children": 0}  # fmt: skip
    for name, most in bounds.items():
        before, after = growth(life, name)
        if not after - before <= most:
            yield f"{name} grew from {before:.0f} to {after:.0f}; {most} more are allowed"


class Program:
    """The program that works, and its lines as they come."""

    def __init__(self, station: Simulated, folder: Path, seed: int) -> None:
        words = ["-m", "tests.campaigns.soaked", str(station), str(folder), str(seed)]
        self._complained = (folder / "complained.txt").open("ab")
        self.process = subprocess.Popen(
            [sys.executable, *words],
            stdout=subprocess.PIPE,
            stderr=self._complained,
            stdin=subprocess.DEVNULL,
            cwd=REPOSITORY,
            start_new_session=True,
        )
        self._rest = b""

    def lines(self, until_s: float) -> Iterator[dict[str, Any]]:
        """What it tells until then; raises TimeoutError where it hangs, ends where it has ended."""
        pipe = self.process.stdout
        assert pipe is not None
        heard_s = time.monotonic()
        while (now_s := time.monotonic()) < until_s:
            if now_s - heard_s > HANG_S:
                raise TimeoutError
            if not select.select([pipe], [], [], 1.0)[0]:
                continue
            data, heard_s = os.read(pipe.fileno(), 65536), time.monotonic()
            if not data:
                return
            *lines, self._rest = (self._rest + data).split(b"\n")
            yield from map(json.loads, lines)

    def end(self) -> int:
        """End it; one signal may be but a note of an error that the program has caught."""
        until_s = time.monotonic() + HANG_S
        while self.process.poll() is None and time.monotonic() < until_s:
            self.process.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(_ASK_AGAIN_S)
        self.process.kill()
        code = self.process.wait()
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._complained.close()
        return code


def soaked(station: Simulated, folder: Path, *, seconds: float, seed: int) -> Soak:
    """Work the station for so many seconds of real time."""
    soak, until_s, life = Soak(), time.monotonic() + seconds, 0
    witnessed = Witnessed(station.witness)
    while time.monotonic() < until_s:
        program = Program(station, folder, seed + life)
        try:
            for told in program.lines(until_s):
                soak.take(told)
                _judge_folders(soak, told, witnessed)
        except TimeoutError:
            program.process.send_signal(signal.SIGUSR1)  # it writes where it hangs
            time.sleep(1.0)
            soak.broken.append(f"it hung: nothing in {HANG_S:g} s; see {folder}/complained.txt")
            program.process.kill()
        code = program.end()
        if time.monotonic() < until_s and code != -signal.SIGKILL:
            soak.broken.append(f"it ended with {code}: {_last_words(folder)}")
            time.sleep(1.0)
        soak.next_life()
        life += 1
    time.sleep(1.0)  # for the guard
    soak.broken += witnessed_wrong(soak, witnessed.listen())
    return soak


def _judge_folders(soak: Soak, told: dict[str, Any], witnessed: Witnessed) -> None:
    if told["event"] not in ("whole", "given up"):
        return
    out = Path(told["out"])
    if told["event"] == "whole":
        soak.judge_whole(out, witnessed.listen())
    else:
        soak.judge_kept(out)
    shutil.rmtree(out, ignore_errors=True)
    out.with_suffix(".guard.jsonl").unlink(missing_ok=True)


def _last_words(folder: Path) -> str:
    said = (folder / "complained.txt").read_text(errors="replace").strip().splitlines()
    return (said or [""])[-1]


def report(soak: Soak, events: Sequence[Event]) -> list[str]:
    """The figures, a line each."""
    longest = max(soak.lives, key=len)
    durations: dict[str, list[float]] = {}
    for told in soak.ended:
        if told["kind"] != "open":
            durations.setdefault(told["kind"], []).append(told["time_s"] - told["begun_s"])
    came = Counter(told["came"].partition(":")[0] for told in soak.ended)
    struck = Counter(event["fault"] for event in events if event["what"] == "wire")
    lights, moves = lit(events), [event for event in events if event["what"] == "move"]
    lines = [
        "work: " + ", ".join(f"{len(each)} {kind}" for kind, each in sorted(durations.items())),
        "longest, s: " + ", ".join(f"{k} {max(each):.1f}" for k, each in sorted(durations.items())),
        "came: " + ", ".join(f"{n} {name}" for name, n in came.most_common()),
        "struck: " + ", ".join(f"{n} {name}" for name, n in struck.most_common()),
        f"scans whole: {soak.whole}, given up: {soak.given_up}; lit {len(lights)} times, longest"
        f" {max((span.ended_s - span.begun_s for span in lights), default=0.0):.3f} s;"
        f" {len(moves)} moves",
        f"lives of the program: {len(soak.lives)}, longest {len(longest)} works",
    ]
    if longest:
        for name in ("rss", "threads", "descriptors", "children"):
            before, after = growth(longest, name)
            unit = 1 << 20 if name == "rss" else 1
            lines.append(
                f"{name}: {before / unit:.1f} after the warm-up, {after / unit:.1f} at last"
            )
    return lines


def main(words: Sequence[str] | None = None) -> int:
    """Run it; 1 when a bound was broken."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=2.0, help="of the station's time")
    parser.add_argument("--scale", type=float, default=20.0, help="of the station's time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", default=FAULTS, help="as `python -m sim` has them")
    wanted = parser.parse_args(words)
    seconds = 3600.0 * wanted.hours / wanted.scale
    with (
        tempfile.TemporaryDirectory(prefix="loftscan-soak-") as folder,
        simulate("cylinder", scale=wanted.scale, seed=wanted.seed, faults=wanted.faults) as station,
    ):
        load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
        sys.stdout.write(f"{wanted.hours:g} h at {wanted.scale:g} times: {seconds:.0f} s, {load}\n")
        sys.stdout.flush()
        soak = soaked(station, Path(folder), seconds=seconds, seed=wanted.seed)
        events = Witnessed(station.witness, from_byte=0).listen()
        longest = max(soak.lives, key=len)
        soak.broken += grown_wrong(longest) if longest else ["it did nothing"]
        for line in report(soak, events):
            sys.stdout.write(f"{line}\n")
    sys.stdout.write("".join(f"broken: {each}\n" for each in soak.broken))
    sys.stdout.write(f"load {os.getloadavg()[0]:.1f}; {len(soak.broken)} bounds broken\n")
    return 1 if soak.broken else 0


if __name__ == "__main__":
    sys.exit(main())
