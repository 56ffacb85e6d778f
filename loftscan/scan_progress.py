"""A scan, told while it runs: a line that is rewritten on a terminal, a line a slice elsewhere.

With ``--json`` one object a line: ``estimate``, ``laser``, ``slice`` for every slice that is safe
on the disk, and at last ``done`` or ``paused``.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TextIO

import numpy as np

from acquisition.frames import Kinematics
from acquisition.loop_closure import Closure, in_words
from acquisition.patterns import SliceKind
from acquisition.poses import Sweep, Timing
from acquisition.safety.promises import promise_of_guard
from acquisition.scan import Progress, StopRequest, Wish
from acquisition.timing import in_words as in_words_timing
from drivers.laser import Guarantee
from drivers.profiler import Reason, Tally
from loftscan.coverage import sweep_coverage
from loftscan.scan_folders import Prospect, in_bytes

_WIDTH = 78


class Manner(Enum):
    """How it is told."""

    JSON = "one object a line"
    LINES = "a line a slice"
    LIVE = "one line, rewritten"


@dataclass(frozen=True, slots=True)
class Pace:
    """How far a run is, and what that says of its end."""

    seconds: float
    slices_done: float  # of this run, the one under way as a fraction
    slices: int

    @property
    def slices_per_min(self) -> float:
        """Mean rate; 0 before anything is done."""
        return 60.0 * self.slices_done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def left_s(self) -> float | None:
        """Time left at that rate; None before there is one."""
        rate = self.slices_per_min / 60.0
        return (self.slices - self.slices_done) / rate if rate > 0.0 else None


class ScanTeller:
    """Tells of one run."""

    def __init__(
        self,
        stream: TextIO,
        manner: Manner,
        kinematics: Kinematics,
        stop: StopRequest,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream
        self._manner = manner
        self._kinematics = kinematics
        self._stop = stop
        self._clock = clock
        self._begun_s = clock()
        self._coverage: float | None = None
        self._kind = SliceKind.RING
        self._last: Progress | None = None
        self._torn_profiles = 0  # kept, with points that were lost on the wire
        self._lost_points = 0
        self._line = ""
        self._turned = False  # the table turns while it is measured

    def estimate(self, here: Prospect) -> None:
        """Say what the run will cost, before anything is opened."""
        cost = here.cost
        self._kind = here.plan.kind
        self._turned = here.plan.continuous is not None
        if self._manner is Manner.JSON:
            self._say(
                event="estimate", slices=cost.slices, kept=len(here.kept), profiles=cost.profiles,
                seconds_at_least=round(cost.seconds_at_least, 1), bytes_at_most=cost.bytes_at_most,
                free_bytes=here.free_bytes,
            )  # fmt: skip
            return
        if here.whole:
            self._print(f"{here.out}: all {len(here.kept)} slices are kept already")
            return
        kept = f", {len(here.kept)} are kept already" if here.resumed else ""
        adaptive = here.plan.adaptive is not None
        self._print(
            f"{here.out}: {'at most ' if adaptive else ''}{cost.slices} slices{kept},"
            f" {cost.profiles} profiles, {'' if adaptive else 'at least '}"
            f"{in_time(cost.seconds_at_least)}, at most {in_bytes(cost.bytes_at_most)}"
            f" ({in_bytes(here.free_bytes)} free)"
        )

    def laser(self, guarantee: Guarantee, guarded_s: Mapping[str, float]) -> None:
        """Say who turns the laser off when this program is dead or hangs, and after how long."""
        guard = promise_of_guard(guarded_s)
        if self._manner is Manner.JSON:
            self._say(
                event="laser", watchdog_s=guarantee.watchdog_s, guarantee=guarantee.sentence,
                guard=guard, guard_s=dict(guarded_s),
            )  # fmt: skip
        else:
            self._print(guarantee.sentence)
            self._print(guard)

    def stopped_at(self, progress: Progress) -> None:
        """Take note of a stop of the table."""
        self._last = progress
        if self._manner is Manner.LIVE:
            done = progress.slices_done + progress.stops_done / progress.stops
            what = "profile" if self._turned else "stop"
            self._rewrite(
                f"slice {progress.slices_done + 1} of {progress.slices},"
                f" {what} {progress.stops_done} of {progress.stops}"
                + self._how(Pace(self._clock() - self._begun_s, done, progress.slices))
            )

    def compared(self, closure: Closure) -> None:
        """Tell how a kept slice that was taken again lies to it."""
        if self._manner is Manner.JSON:
            turned = closure.turned_rad
            self._say(
                event="closure", index=closure.index, agrees=closure.agrees,
                difference_mm=None if math.isnan(closure.difference_mm) else closure.difference_mm,
                noise_mm=closure.noise_mm, limit_mm=closure.limit_mm, overlap=closure.overlap,
                turned_deg=None if turned is None else math.degrees(turned),
            )  # fmt: skip
        else:
            self._print(in_words(closure))

    def kept(self, sweep: Sweep) -> None:
        """Tell that a slice is safe on the disk."""
        self._coverage = sweep_coverage(sweep, self._kinematics, self._kind)
        self._count_lost(sweep)
        last = self._last
        if last is None:
            return
        done = last.slices_done + 1
        pace = Pace(self._clock() - self._begun_s, done, last.slices)
        if self._manner is Manner.JSON:
            self._say(
                event="slice", index=sweep.index, slices_done=done, slices=last.slices,
                profiles=len(sweep.profiles), lost_profiles=last.lost_profiles,
                coverage=round(self._coverage, 4), seconds=round(pace.seconds, 3),
                slices_per_min=round(pace.slices_per_min, 2), left_s=round(pace.left_s or 0.0, 1),
                **({} if sweep.timing is None else {"timing": _timing(sweep.timing)}),
            )  # fmt: skip
            return
        if self._manner is Manner.LINES:
            self._print(f"slice {done} of {last.slices}{self._how(pace)}")
        if sweep.timing is not None:
            self._print(f"slice {sweep.index}: {in_words_timing(sweep.timing)}")

    def done(self, here: Prospect, slices: int) -> None:
        """Tell that the scan is complete."""
        seconds = self._clock() - self._begun_s
        if self._manner is Manner.JSON:
            out = str(here.out)
            self._say(
                event="done", out=out, slices=slices, seconds=round(seconds, 3),
                torn_profiles=self._torn_profiles, lost_points=self._lost_points,
                lost_profiles=self._last.lost_profiles if self._last else 0, **self._frames(),
            )  # fmt: skip
        else:
            self._print(f"{here.out}: complete, {slices} slices; {in_time(seconds)}")
        self._tell_of_frames()
        self._warn_of_lost()

    def paused(self, here: Prospect, kept: int) -> None:
        """Tell that the run ended at a slice's border."""
        if self._manner is Manner.JSON:
            self._say(
                event="paused", out=str(here.out), kept=kept, slices=here.plan.most,
                **self._frames(),
            )  # fmt: skip
        self.end_line()
        self._tell_of_frames()
        self._warn_of_lost()

    def note(self, text: str) -> None:
        """Say something beside the progress."""
        if self._manner is Manner.JSON:
            self._say(event="note", text=text)
        else:
            self._print(text)

    def end_line(self) -> None:
        """Leave a rewritten line, so that what follows begins a line of its own."""
        if self._line:
            self._write("\n")
            self._line = ""

    def _count_lost(self, sweep: Sweep) -> None:
        lost = [int(np.count_nonzero(each.reasons == Reason.LOST)) for each in sweep.profiles]
        self._torn_profiles += sum(count > 0 for count in lost)
        self._lost_points += sum(lost)

    def _frames(self) -> dict[str, int]:
        """What the profiler's stream went through, beside what is kept of it."""
        tally = self._last.tally if self._last else Tally()
        return {
            "dropped_frames": tally.lost_profiles,
            "torn_frames": tally.torn_profiles,
            "bad_frames": tally.bad_frames,
        }

    def _tell_of_frames(self) -> None:
        """Say what was dropped, where anything was: exposures were repeated for it."""
        frames = self._frames()
        if self._manner is not Manner.JSON and any(frames.values()):
            dropped, torn, bad = frames.values()
            then = (
                "those of a slice have their places in it, marked as lost"
                if self._turned
                else "exposures were repeated for those that were wanted"
            )
            self._print(
                f"profiler: {dropped} frames dropped, {torn} torn, {bad} damaged on their way;"
                f" {then}"
            )

    def _warn_of_lost(self) -> None:
        if self._torn_profiles and self._manner is not Manner.JSON:
            self._print(
                f"warning: {self._torn_profiles} profiles are kept with {self._lost_points} points"
                " lost between sensor and program, marked as lost; look at the network, or scan"
                " more slowly"
            )

    def _how(self, pace: Pace) -> str:
        parts = [f"{pace.slices_per_min:.1f} slices/min"]
        if self._coverage is not None:
            parts.append(f"coverage {self._coverage:.0%}")
        if self._last is not None and self._last.lost_profiles:
            parts.append(f"{self._last.lost_profiles} profiles lost")
        if pace.left_s is not None:
            parts.append(f"{in_time(pace.left_s)} left")
        if self._stop.wish is Wish.PAUSE:
            parts = ["pausing after this slice; Ctrl-C again stops now"]
        return "".join(f", {part}" for part in parts)

    def _rewrite(self, text: str) -> None:
        padded = text[:_WIDTH].ljust(len(self._line))
        self._write(f"\r{padded}")
        self._line = text[:_WIDTH]

    def _print(self, text: str) -> None:
        self.end_line()
        self._write(f"{text}\n")

    def _say(self, **fields: object) -> None:
        self._write(json.dumps(fields) + "\n")

    def _write(self, text: str) -> None:
        """Nobody who reads is no error: the scan pauses at the border, or goes on unattended."""
        try:
            self._stream.write(text)
            self._stream.flush()
        except BrokenPipeError:
            self._stop.leave()
            with Path(os.devnull).open("wb") as nowhere:  # what is still buffered goes there
                os.dup2(nowhere.fileno(), self._stream.fileno())


def _timing(timing: Timing) -> dict[str, object]:
    """What a turning table's poses can be off, as JSON knows numbers."""
    told = {
        "speed_deg_s": math.degrees(timing.speed_rad_s),
        "latency_ms": 1e3 * timing.latency_s,
        "latency_sd_ms": 1e3 * timing.latency_sd_s,
        "drift_ppm": timing.drift_ppm,
        "clock_late_ms": 1e3 * timing.clock_late_s,
        "table_rms_deg": math.degrees(timing.table_rms_rad),
        "apart_mm": timing.apart_mm,
        "noise_mm": timing.noise_mm,
    }
    finite: dict[str, object] = {
        name: value if math.isfinite(value) else None for name, value in told.items()
    }
    return {**finite, "lost_profiles": timing.lost}


def in_time(seconds: float) -> str:
    """Write a duration for a person."""
    whole = round(seconds)
    if whole < 90:
        return f"{seconds:.1f} s" if seconds < 10.0 else f"{whole} s"
    if whole < 90 * 60:
        return f"{whole / 60:.0f} min"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
