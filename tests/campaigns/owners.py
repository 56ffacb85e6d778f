"""Programs that own a station and come to their end, one after the other, forked from a warm one.

    python -m tests.campaigns.owners

A line on stdin is an owner: ``{"station": FILE, "phase": NAME, "own": NAME, "after_s": S}``. It
opens the station, comes into its phase and stays there; ``own`` is what it does to itself so long
after, or "" where somebody else ends it. What it does it tells in lines of JSON on stdout; the last
is of its parent, and has its exit code. Forking spares the second that imports take.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from acquisition.errors import Stopped
from loftscan import Station

_STAYS_S = 20.0
GIL_HELD_S = 1


class OwnError(Exception):
    """What a script of an operator may raise."""


def tell(event: str, **words: object) -> None:
    line = json.dumps({"event": event, "pid": os.getpid(), "time_s": time.monotonic(), **words})
    os.write(1, line.encode() + b"\n")


class Fate:
    """What an owner does to itself, at its instant, wherever it is just then."""

    def __init__(self, own: str) -> None:
        self._own = own
        self.raises = False

    def come(self, _number: int, _frame: FrameType | None) -> None:
        tell("struck")
        if self._own == "os._exit":
            os._exit(7)
        elif self._own == "GIL held":
            ctypes.PyDLL(None).sleep(GIL_HELD_S)  # a PyDLL does not let go of the interpreter
        elif self._own == "SIGSEGV":
            ctypes.string_at(0)
        else:
            self.raises = True  # where the script itself is at work: amid a driver nobody raises

    def look(self) -> None:
        if self.raises:
            raise OwnError


def idle(at: Station, fate: Fate, until_s: float) -> None:
    at.stand()
    tell("phase")
    while time.monotonic() < until_s:
        time.sleep(0.002)
        fate.look()


def moving(at: Station, fate: Fate, until_s: float) -> None:
    at.home()
    tell("phase")
    ends = 0.0
    while time.monotonic() < until_s:
        ends = 120.0 - ends
        at.jog(table_deg=ends)
        at.jog(stage_mm=2.0 + ends / 30.0)
        fate.look()


def exposing(at: Station, fate: Fate, until_s: float) -> None:
    with at.lit() as look:
        look()
        tell("phase")
        while time.monotonic() < until_s:
            look()
            fate.look()


PHASES: dict[str, Callable[[Station, Fate, float], None]] = {
    "idle": idle,
    "moving": moving,
    "exposing": exposing,
}


def live(station: str, phase: str, own: str, after_s: float) -> None:
    fate = Fate(own)
    signal.signal(signal.SIGALRM, fate.come)
    until_s = time.monotonic() + _STAYS_S

    def tell_and_wind(event: str, **words: object) -> None:
        _tell(event, **words)
        if event == "phase" and own:
            signal.setitimer(signal.ITIMER_REAL, after_s)

    _tell, globals()["tell"] = tell, tell_and_wind
    with Station.open(station) as at:
        at.devices.guard.report_to(Path(os.environ["GUARD_REPORT"]))
        laser_s = [s for name, s in at.devices.guarded.items() if name.startswith("laser")]
        tell("open", guarded_s=laser_s[0] if laser_s else None, guard=at.devices.guard.process_id)
        PHASES[phase](at, fate, until_s)


def child(words: dict[str, object]) -> int:
    try:
        live(**words)  # type: ignore[arg-type]
    except OwnError:
        return 1
    except (KeyboardInterrupt, Stopped):
        return 3
    return 0


def main() -> None:
    # Whoever starts the campaign in the background has these ignored, and children inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    for line in sys.stdin:
        if (owner := os.fork()) == 0:
            os._exit(_coded(json.loads(line)))
        _, status = os.waitpid(owner, 0)
        tell("ended", owner=owner, code=os.waitstatus_to_exitcode(status))


def _coded(words: dict[str, object]) -> int:
    try:
        return child(words)
    except SystemExit as asked:
        return int(asked.code or 0)
    except BaseException as error:  # noqa: BLE001 (a child of a fork must not go on as its parent)
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return 9


if __name__ == "__main__":
    main()
