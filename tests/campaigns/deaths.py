"""Every way in which a program that owns a station comes to its end, judged by the witness log.

Half of the owners are struck while the laser is on, the others at rest or in motion. What is
promised::

    ended by itself or by a signal that it hears   laser off and axes standing within 250 ms
    killed, crashed                                within what the guard told, less the lease
    stopped, hung                                  within what the guard told; then it is dead
    cable pulled, or the guard killed as well      the switch's own watchdog and 50 ms
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquisition.lease import TTL_S
from loftscan.simulation import Simulated
from tests.campaigns.kinds import WATCHDOG_S
from tests.campaigns.testimony import Event, Witnessed, lasted_at, lit, moving, over_after_s
from tests.campaigns.victims import REPOSITORY

OWN_WAY_S = 0.25
HELD_S = 0.6
_PATIENCE_S = 30.0
_REST_S = 0.08
_QUIET_S = 5.0

Reach = Literal["way out", "guard", "lease", "watchdog"]


@dataclass(frozen=True, slots=True)
class Death:
    """One way."""

    name: str
    reach: Reach  # who turns the laser off
    number: signal.Signals | None = None  # sent from outside
    own: str = ""  # done by the owner itself
    codes: tuple[int, ...] = ()
    lit_only: bool = False  # where nothing is lit, nothing happens

    def bound_s(self, guarded_s: float) -> float:
        """Until the laser is off, of a device of which the guard told so much."""
        match self.reach:
            case "way out":
                return OWN_WAY_S
            case "guard":
                return guarded_s - TTL_S
            case "lease":
                return guarded_s
            case "watchdog":
                return WATCHDOG_S


DEATHS = (
    Death("exception", "way out", own="exception", codes=(1,)),
    Death("SIGTERM", "way out", signal.SIGTERM, codes=(128 + signal.SIGTERM,)),
    Death("SIGINT", "way out", signal.SIGINT, codes=(3,)),
    Death("SIGHUP", "way out", signal.SIGHUP, codes=(128 + signal.SIGHUP,)),
    Death("SIGKILL", "guard", signal.SIGKILL, codes=(-signal.SIGKILL,)),
    Death("SIGSEGV", "guard", own="SIGSEGV", codes=(-signal.SIGSEGV,)),
    Death("os._exit", "guard", own="os._exit", codes=(7, -signal.SIGKILL)),
    Death("SIGSTOP", "lease", signal.SIGSTOP, codes=(-signal.SIGKILL,), lit_only=True),
    Death("GIL held", "lease", own="GIL held", codes=(-signal.SIGKILL,), lit_only=True),
)
OF_THE_HARDWARE = (
    Death("guard killed too", "watchdog", signal.SIGKILL, codes=(-signal.SIGKILL,)),
    Death("cable pulled", "watchdog", codes=(3, 9, -signal.SIGKILL)),
)


@dataclass(frozen=True, slots=True)
class End:
    """One owner's end, judged."""

    death: Death
    phase: str
    laser_s: float
    axes_s: float
    was_lit: bool
    bound_s: float
    broken: tuple[str, ...]
    stalled: bool = False  # ended by the guard before its own way out was gone to its end

    def complaints(self) -> list[str]:
        """What was not as promised."""
        return [f"{self.death.name}, {self.phase}: {what}" for what in self.broken]


@dataclass
class Owners:
    """A process that forks owners, and what they tell."""

    process: subprocess.Popen[bytes]
    report: Path
    _rest: bytes = b""
    _told: list[dict[str, Any]] = field(default_factory=list)

    def last_words(self) -> str:
        """The last line of all stderr."""
        said = (self.report.parent / "complained.txt").read_text(errors="replace")
        return (said.strip().splitlines() or [""])[-1]

    def begin(self, **words: object) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(words).encode() + b"\n")
        self.process.stdin.flush()

    def until(self, *events: str) -> dict[str, Any]:
        """The next line of one of these kinds."""
        assert self.process.stdout is not None
        deadline_s = time.monotonic() + _PATIENCE_S
        while True:
            while self._told:
                told = self._told.pop(0)
                if told["event"] in events:
                    return told
            left_s = deadline_s - time.monotonic()
            if left_s < 0.0 or not select.select([self.process.stdout], [], [], left_s)[0]:
                raise TimeoutError(f"no {' or '.join(events)} in {_PATIENCE_S} s")
            data = os.read(self.process.stdout.fileno(), 65536)
            if not data:
                raise TimeoutError("the owners' parent ended")
            *lines, self._rest = (self._rest + data).split(b"\n")
            self._told += map(json.loads, lines)


@contextmanager
def owners(folder: Path) -> Iterator[Owners]:
    """Start the process that forks; its stderr, the guards' reports among it, goes to a file."""
    report = folder / "guard.jsonl"
    with (folder / "complained.txt").open("wb") as complained:
        process = subprocess.Popen(
            [sys.executable, "-m", "tests.campaigns.owners"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complained,
            cwd=REPOSITORY,
            env={**os.environ, "GUARD_REPORT": str(report)},
            start_new_session=True,
        )
    with process:
        yield Owners(process, report)
        assert process.stdin is not None
        process.stdin.close()


def strike(death: Death, phase: str, delay_s: float, station: Simulated, by: Owners) -> End:
    """Let one owner live, and end."""
    witnessed = Witnessed(station.witness)
    words = {"station": str(station), "phase": phase, "own": death.own, "after_s": delay_s}
    by.begin(**words)
    opened = by.until("open", "ended")
    if opened["event"] == "ended":
        what = f"did not open: {opened['code']}"
        return End(
            death, phase, laser_s=0.0, axes_s=0.0, was_lit=False, bound_s=0.0, broken=(what,)
        )
    ready = by.until("phase", "ended")
    struck_s = ready["time_s"]
    if ready["event"] == "phase":
        struck_s = _struck(death, delay_s, opened, station, by)
    events, code = _end(death, phase, opened["pid"], struck_s, witnessed, by, ready)
    if death.name == "cable pulled":
        station.plug_the_lasers_cable()
    end = _judged(death, phase, struck_s, events, code, opened["guarded_s"])
    return replace(end, broken=tuple(f"{what} ({by.last_words()})" for what in end.broken))


def _struck(
    death: Death, delay_s: float, opened: dict[str, Any], station: Simulated, by: Owners
) -> float:
    """Strike from outside, or wait until it has struck itself; when that was."""
    if death.own:
        return float(by.until("struck")["time_s"])
    time.sleep(delay_s)
    struck_s = time.monotonic()
    if death.name == "cable pulled":
        station.pull_the_lasers_cable()
        return struck_s
    if death.name == "guard killed too":
        os.kill(opened["guard"], signal.SIGKILL)
    with suppress(ProcessLookupError):
        os.kill(opened["pid"], death.number or signal.SIGKILL)
    return struck_s


def _end(
    death: Death,
    phase: str,
    pid: int,
    struck_s: float,
    witnessed: Witnessed,
    by: Owners,
    ready: dict[str, Any],
) -> tuple[list[Event], int]:
    """Wait until it is over and everything rests; one that only stood still is ended then."""
    survives = (death.lit_only or death.name == "cable pulled") and phase != "exposing"
    if survives and ready["event"] == "phase":
        time.sleep(max(0.0, struck_s + HELD_S - time.monotonic()))
        for number in (signal.SIGCONT, signal.SIGKILL):
            with suppress(ProcessLookupError):
                os.kill(pid, number)
    elif death.number is signal.SIGSTOP:
        time.sleep(max(0.0, struck_s + HELD_S - time.monotonic()))
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)  # too late for a program that the guard has killed
    ended = ready if ready["event"] == "ended" else by.until("ended")
    begun_s = quiet_s = time.monotonic()
    count = -1
    while (now_s := time.monotonic()) < min(quiet_s + _REST_S, begun_s + _QUIET_S):
        events = witnessed.listen()
        busy = lasted_at([*lit(events), *moving(events, "table", "stage")], now_s)
        if busy or len(events) != count:
            quiet_s, count = now_s, len(events)
        time.sleep(0.005)
    return witnessed.events, int(ended["code"])


def _judged(
    death: Death,
    phase: str,
    struck_s: float,
    events: Sequence[Event],
    code: int,
    guarded_s: float | None,
) -> End:
    lights = lit(events)
    bound_s = death.bound_s(guarded_s or 0.0)
    laser_s = over_after_s(lights, struck_s)
    axes_s = over_after_s(moving(events, "table", "stage"), struck_s)
    broken = []
    if laser_s > bound_s:
        broken.append(f"the laser was on for {1000.0 * laser_s:.0f} of {1000.0 * bound_s:.0f} ms")
    if [span for span in lights if span.begun_s > struck_s + OWN_WAY_S]:
        broken.append("the laser was lit again")
    if any(math.isinf(span.ended_s) for span in lights):
        broken.append("the laser stayed on")
    if death.reach in ("way out", "guard") and axes_s > OWN_WAY_S:
        broken.append(f"an axis moved for {1000.0 * axes_s:.0f} ms")
    # A machine that stalls for longer than a lease is a hang like any other: the guard ends it.
    stalled = death.reach == "way out" and code == -signal.SIGKILL
    if code not in death.codes and not stalled and not (death.lit_only and phase != "exposing"):
        broken.append(f"it ended with {code}")
    was_lit = lasted_at(lights, struck_s)
    return End(death, phase, laser_s, axes_s, was_lit, bound_s, tuple(broken), stalled)


def instants(seed: list[int]) -> Iterator[tuple[str, float]]:
    """Phases and delays without end: every second owner exposes."""
    rng = np.random.default_rng(seed)
    while True:
        for phase in ("exposing", "idle", "exposing", "moving"):
            yield phase, float(rng.uniform(0.0, 0.15))


def failure_bound(failures: int, count: int, confidence: float = 0.95) -> float:
    """The failure rate that so many of so many exclude, one-sided (Clopper and Pearson)."""
    from scipy.stats import beta

    return 1.0 if failures >= count else float(beta.ppf(confidence, failures + 1, count - failures))
