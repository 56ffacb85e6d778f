"""One .scan folder that is stopped and resumed, again and again, and what must hold each time.

::

    scan --struck--> folder --resume, struck--> folder ... --resume--> whole
               '-- judged         '-- judged                   '-- judged as a whole

The witness log judges the station, the bytes on the disk judge the folder: no slice is lost that
was acknowledged, none is taken twice, and each shows what truly was there.
"""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.plan import Plan, write_plan
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from loftscan.simulation import Simulated
from tests.campaigns.deaths import WATCHDOG_S
from tests.campaigns.kinds import Kind, Struck
from tests.campaigns.testimony import (
    Event,
    Witnessed,
    begun_by_nobody,
    cut_from_the_laser,
    lasted_at,
    lit,
    lit_in_motion,
    moving,
    over_after_s,
    read_all,
)
from tests.campaigns.victims import Instant, Victim, command, script, started

HEARD_S = 0.05  # a word that was on the wire when its sender died is heard within this
_REST_S = 0.4  # nothing happens for so long: it is over
_AT_MOST_S = 20.0  # for a device to come to rest by itself
_RESUME_S = 120.0
_FAR_RAD, _FAR_MM = 0.002, 0.05  # a pose from the truth: tolerance, backlash
_READS_PER_STOP = 3  # of the profiles' link: one finds it empty, and then come datagrams


@dataclass(frozen=True, slots=True)
class Outcome:
    """One struck scan, judged."""

    kind: Kind
    instant: Instant
    code: int
    laser_s: float  # from the stop until it was off for good
    axes_s: float
    was_lit: bool
    was_moving: bool
    lost: tuple[int, ...]  # slices that were acknowledged, and are not there as they were
    twice: tuple[int, ...]  # slices that were kept, and taken again
    broken: tuple[str, ...]

    def complaints(self) -> list[str]:
        """Everything that was not as promised, with the instant that broke it."""
        at = self.instant
        where = f"{self.kind.name}, {at.phase.name.lower()} {at.which:.3f} {at.share:.3f}"
        lost = (f"slice {index} was lost" for index in self.lost)
        twice = (f"slice {index} was taken twice" for index in self.twice)
        return [f"{where}: {what}" for what in (*self.broken, *lost, *twice)]


class StruckScan:
    """A scan of a plan at a simulated station, in a folder of its own.

    Parameters
    ----------
    heard_s
        How late a word of a dead program may be heard; a busy machine needs more.
    """

    def __init__(
        self, station: Simulated, plan: Plan, folder: Path, *, heard_s: float = HEARD_S
    ) -> None:
        self._station = station
        self._plan = plan
        self._folder = folder
        self._out = folder / "struck.scan"
        self._heard_s = heard_s
        self._kept: dict[int, bytes] = {}
        self._failed: list[str] = []
        folder.mkdir(parents=True)
        (folder / "plan.toml").write_text(write_plan(plan))

    @property
    def missing(self) -> set[int]:
        """Slices that are not on the disk."""
        return set(range(self._plan.ring.count)) - set(self._contents())

    @property
    def failed(self) -> bool:
        """Whether it ended badly though nobody had struck: it will not come any further."""
        return bool(self._failed)

    def strike(self, kind: Kind, instant: Instant) -> Outcome | None:
        """Scan or resume, struck at an instant; None when it was over before that came."""
        victim = self._start(kind, instant)
        reached = kind.raises or victim.await_instant(instant)
        struck = kind.strike(victim, instant) if reached else None
        ended_s = victim.await_end()
        if kind.raises:
            struck = _raised(victim)
        events = _until_rest(victim.witnessed)
        if struck is None:
            code = victim.process.returncode
            self._failed += (
                [f"unstruck, it ended with {code}: {victim.last_words()}"] if code else []
            )
            self._kept = self._contents()
            return None
        return self._judged(kind, instant, victim, struck, ended_s, events)

    def finish(self) -> list[str]:
        """Resume undisturbed, and judge the whole; empty if every slice is there once and true."""
        return self._failed + self._finished()

    def _finished(self) -> list[str]:
        kept = set(self._kept)
        witnessed = Witnessed(self._station.witness)
        words = command(self._station.station, self._folder / "plan.toml", self._out)
        ran = subprocess.run(words, capture_output=True, text=True, timeout=_RESUME_S, check=False)
        if ran.returncode != 0:
            return [f"the resume ended with {ran.returncode}: {ran.stderr.strip()}"]
        taken = self._looked_at(_until_rest(witnessed))
        folder = ScanFolder(self._out)
        if folder.record().state is not State.COMPLETE or folder.missing():
            return ["the resume left slices out"]
        if folder.verify().damaged:
            return ["the resume left a damaged slice"]
        # One that was kept is taken again, to be compared.
        missing = set(range(self._plan.ring.count)) - kept
        if not missing <= taken or len(taken & kept) > 1:
            return [f"the resume took {sorted(taken)}, and {sorted(kept)} were kept"]
        return list(untrue(folder, self._plan, read_all(self._station.witness)))

    def _start(self, kind: Kind, instant: Instant) -> Victim:
        plan, missing = self._folder / "plan.toml", self.missing
        stops = len(missing) * self._plan.ring.profiles_per_turn
        reads = 1 + int(instant.which * _READS_PER_STOP * stops) if kind.raises else 0
        address = self._station.station
        words = (
            script(address, plan, self._out, reads)
            if kind.by_script
            else command(address, plan, self._out)
        )
        said, complained = self._folder / "said.jsonl", self._folder / "complained.txt"
        witnessed = Witnessed(self._station.witness)
        with said.open("wb") as file:
            process = started(words, subprocess.PIPE if kind.piped else file, complained)
        kept = frozenset(self._kept)
        return Victim(
            process, self._out, said, complained, kept, stops, len(missing), witnessed,
            self._station.pid, self._station.unplug,
        )  # fmt: skip

    def _judged(
        self,
        kind: Kind,
        instant: Instant,
        victim: Victim,
        struck: Struck,
        ended_s: float,
        events: list[Event],
    ) -> Outcome:
        acted = [event for event in events if event["time_s"] < struck.until_s]
        lights, motions = lit(acted), moving(acted, "table", "stage")
        since_s = ended_s if kind.counts_from_end else struck.time_s
        laser_s, axes_s = over_after_s(lights, since_s), over_after_s(motions, since_s)
        broken = [
            *kind.too_late(laser_s, axes_s),
            *self._unsafe(kind, events, acted, struck),
            *self._untold(kind, victim, ended_s, events),
        ]
        lost, twice = self._slices(victim, events)
        return Outcome(
            kind, instant, victim.process.returncode, laser_s, axes_s,
            lasted_at(lights, struck.time_s), lasted_at(motions, struck.time_s),
            lost, twice, tuple(broken),
        )  # fmt: skip

    def _unsafe(
        self, kind: Kind, events: list[Event], acted: list[Event], struck: Struck
    ) -> Iterator[str]:
        """What must hold of the station whatever was struck."""
        if any(math.isinf(span.ended_s) for span in lit(events)):
            yield "the laser stayed on"
        if lit_in_motion(events):
            yield "an axis moved under the laser"
        for pulled_s in cut_from_the_laser(acted):
            if (on_s := over_after_s(lit(acted), pulled_s)) > WATCHDOG_S:
                yield f"laser on {1000.0 * on_s:.0f} ms after its cable was pulled"
        if kind.dies and begun_by_nobody(acted, struck.time_s, heard_s=self._heard_s):
            yield "an axis began to move after its program was stopped"

    def _untold(
        self, kind: Kind, victim: Victim, ended_s: float, events: list[Event]
    ) -> Iterator[str]:
        """Exit code and words; at the border, that the slice under way was finished."""
        if math.isinf(ended_s):
            yield "it did not end"
        if begun_by_nobody(events, ended_s, heard_s=self._heard_s):
            yield "an axis began to move after the program's end"
        code, missing = victim.process.returncode, self.missing
        last = victim.last_words()
        if code not in (kind.codes if missing else (*kind.codes, 0)):
            yield f"exit {code} with {len(missing)} slices missing: {last}"
        if "Traceback" in victim.complained.read_text() and not kind.by_script:
            yield f"a traceback: {last}"
        if kind.at_border and self._looked_at(events) != set(self._contents()) - set(self._kept):
            yield "a slice was begun and not kept"

    def _slices(
        self, victim: Victim, events: list[Event]
    ) -> tuple[tuple[int, ...], tuple[int, ...]]:
        now = self._contents()
        acknowledged = {int(str(each["index"])) for each in victim.told() if "index" in each}
        sound = set(ScanFolder(self._out).verify().sound) if now else set()
        changed = {index for index, data in self._kept.items() if now.get(index) != data}
        lost = changed | (acknowledged - sound) | (set(now) - sound)
        twice = self._looked_at(events) & set(self._kept)
        self._kept = now
        return tuple(sorted(lost)), tuple(sorted(twice))

    def _contents(self) -> dict[int, bytes]:
        """The slices' bytes by index."""
        folder = ScanFolder(self._out)
        return {index: folder.file(index).read_bytes() for index in folder.indices()}

    def _looked_at(self, events: Sequence[Event]) -> set[int]:
        """Slices at whose height the sensor saw something."""
        seen = [event["stage_mm"] for event in events if event["what"] == "profile"]
        return {_index(self._plan, stage_mm) for stage_mm in seen}


def untrue(folder: ScanFolder, plan: Plan, events: Sequence[Event]) -> Iterator[str]:
    """Profiles that are there twice, or whose pose is not where the axes truly were."""
    truth = {event["frame"]: event for event in events if event["what"] == "profile"}
    for index in folder.indices():
        sweep = folder.read(index)
        for profile, pose in zip(sweep.profiles, sweep.poses, strict=True):
            there = truth.pop(profile.frame, None)
            if there is None:
                yield f"slice {index}: frame {profile.frame} was never sent, or is there twice"
                continue
            # The switch comes once a turn: the world may count turns that nobody else does.
            off_rad = math.remainder(there["table_rad"] - pose.table_rad, math.tau)
            off_mm = there["stage_mm"] - pose.stage_mm
            elsewhere = _index(plan, there["stage_mm"]) != index
            if abs(off_rad) > _FAR_RAD or abs(off_mm) > _FAR_MM or elsewhere:
                yield f"slice {index}: frame {profile.frame} was taken elsewhere"


def _index(plan: Plan, stage_mm: float) -> int:
    return round((stage_mm - plan.ring.first_mm) / plan.ring.step_mm)


def _raised(victim: Victim) -> Struck | None:
    times = [float(str(told["time_s"])) for told in victim.told() if told["event"] == "raised"]
    return Struck(times[0]) if times else None


def _until_rest(witnessed: Witnessed) -> list[Event]:
    """The events up to a time when nothing moves, nothing is lit, and nothing comes any more."""
    begun_s = quiet_s = time.monotonic()
    count = -1
    while (now_s := time.monotonic()) < min(quiet_s + _REST_S, begun_s + _AT_MOST_S):
        events = witnessed.listen()
        busy = lasted_at([*lit(events), *moving(events, "table", "stage")], now_s)
        if busy or len(events) != count:
            quiet_s, count = now_s, len(events)
        time.sleep(0.01)
    return witnessed.events
