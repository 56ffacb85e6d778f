"""The scanner between its port and the World: a `sim.device.Device`.

After C-42-03320B. It turns all the time and measures while its laser is on. GD gives the newest
scan, which right after BM is one of before QT, and is refused in the dark; MD lights the laser
itself and streams until QT or until it is done. QT and RS are done as they are read, whatever is
still to be said.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from sim.hokuyo.lines import characters, named, plain, scan
from sim.sensor import Reason, SimProfile
from sim.world import World

_STRING = re.compile(r"[A-Za-z0-9 ._+@]*")
_MOST_STRING = 16
_MOST_LINE = 80
_CODES = {  # table 3 of the specification, for what the optics know of a beam
    Reason.NO_HIT: 1,
    Reason.GRAZING: 2,
    Reason.DARK: 1,
    Reason.OCCLUDED: 7,
    Reason.OUT_OF_RANGE: 0,
}
_NOT_SEEN = 19


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerSettings:
    """A URG-04LX, unless told otherwise."""

    model: str = "URG-04LX(Hokuyo Automatic Co.,Ltd.)"
    vendor: str = "Hokuyo Automatic Co.,Ltd."
    firmware: str = "3.3.00(16/Apr./2008)"
    protocol: str = "SCIP 2.0"
    serial: str = "H0000001"
    least_mm: int = 20
    most_mm: int = 5600
    steps_a_turn: int = 1024
    first_step: int = 44
    last_step: int = 725
    front_step: int = 384
    rpm: int = 600
    begins_in_scip_1: bool = False
    clock_ms: int = 0  # of its timer when the station's time is 0
    laser_works: bool = True


class HokuyoScanner:
    """One scanner and its port."""

    def __init__(self, world: World, settings: ScannerSettings | None = None) -> None:
        self._world = world
        self._told = settings or ScannerSettings()
        self._line = b""
        self._scip_1 = self._told.begins_in_scip_1
        self._stream: _Stream | None = None
        self._lit_turn = -1
        self._held: tuple[int, SimProfile] | None = None  # turn and scan of before it was dark

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take characters off the wire; answer each line."""
        said = self.tick(now_s)
        for byte in data:
            if byte not in b"\r\n":
                self._line += bytes([byte])
            elif self._line:
                line, self._line = self._line.decode("latin-1"), b""
                said += self._heard(line, now_s)
        return said

    def tick(self, now_s: float) -> bytes:
        """Say the scans of a stream that are due."""
        stream, turn = self._stream, self._turn(now_s)
        if stream is None or turn < stream.next_turn:
            return b""
        stream.next_turn = turn + stream.every
        if stream.left is not None:
            stream.left -= 1
        echo = f"{stream.head}{stream.left or 0:02d}{stream.string}"
        said = self._scan(echo, "99", stream.steps, 3, now_s)
        if stream.left == 0:
            self._stream = None
            self._switch(now_s, on=False, why="MD is done")
        return said

    def _heard(self, line: str, now_s: float) -> bytes:
        if self._scip_1:
            self._scip_1 = line != "SCIP2.0"
            return f"{line}\n{'E' if self._scip_1 else '0'}\n\n".encode("latin-1")
        command, semicolon, string = line.partition(";")
        if len(string) > _MOST_STRING or len(line) > _MOST_LINE:
            return plain(line[:_MOST_LINE], "0G")
        if not _STRING.fullmatch(string):
            return plain(line, "0H")
        match command[:2]:
            case "VV" | "PP" | "II" if len(command) == 2:
                return self._told_of_itself(command, line, now_s)
            case "BM" if command == "BM":
                return plain(line, self._lit(now_s))
            case "QT" | "RS" if len(command) == 2:
                self._stream = None
                self._switch(now_s, on=False, why=command)
                return plain(line, "00")
            case "GD" | "GS":
                return self._newest(command, line, now_s)
            case "MD":
                return self._streaming(command, semicolon + string, line, now_s)
        return plain(line, "0E")

    def _told_of_itself(self, command: str, line: str, now_s: float) -> bytes:
        told = self._told
        if command == "VV":
            return named(line, [
                ("VEND", told.vendor), ("PROD", f"SOKUIKI Sensor {told.model.split('(')[0]}"),
                ("FIRM", told.firmware), ("PROT", told.protocol), ("SERI", told.serial),
            ])  # fmt: skip
        if command == "PP":
            return named(line, [
                ("MODL", told.model), ("DMIN", told.least_mm), ("DMAX", told.most_mm),
                ("ARES", told.steps_a_turn), ("AMIN", told.first_step), ("AMAX", told.last_step),
                ("AFRT", told.front_step), ("SCAN", told.rpm),
            ])  # fmt: skip
        on, measuring = self._world.laser_on, self._stream is not None
        return named(line, [
            ("MODL", told.model), ("LASR", "ON" if on else "OFF"), ("SCSP", "Initial(600[rpm])"),
            ("MESM", "Measuring by Sensitive Mode" if measuring else "IDLE"),
            ("SBPS", "USB only"), ("TIME", characters(self._clock_ms(now_s), 4)),
            ("STAT", "Sensor works well."),
        ])  # fmt: skip

    def _lit(self, now_s: float) -> str:
        if not self._told.laser_works:
            return "01"
        if self._world.laser_on:
            return "02"
        self._switch(now_s, on=True, why="BM")
        return "00"

    def _newest(self, command: str, line: str, now_s: float) -> bytes:
        steps = _steps(command[2:], self._told)
        if isinstance(steps, str):
            return plain(line, steps)
        if not self._world.laser_on:
            return plain(line, "10")
        return self._scan(line, "00", steps, 3 if command[1] == "D" else 2, now_s)

    def _streaming(self, command: str, string: str, line: str, now_s: float) -> bytes:
        steps, rest = _steps(command[2:12], self._told), command[12:]
        if isinstance(steps, str) or not (len(rest) == 3 and rest.isdecimal()):
            return plain(line, steps if isinstance(steps, str) else "06")
        self._switch(now_s, on=True, why="MD")
        every, count = int(rest[0]) + 1, int(rest[1:])
        self._stream = _Stream(
            command[:-2], string, steps, every, count or None, self._turn(now_s) + 1
        )
        return plain(line, "00")

    def _scan(self, echo: str, status: str, steps: _Steps, width: int, now_s: float) -> bytes:
        measured = self._measured(now_s)
        if measured is None:
            return plain(echo, "10")
        turn, profile = measured
        ranges = self._ranges(profile, steps)
        turn_ms = round(turn * 60_000 / self._told.rpm)
        self._world.witness.note(
            now_s, "profile", frame=turn, seen=int(np.count_nonzero(profile.seen)),
            table_rad=self._world.table.load(now_s), stage_mm=self._world.stage.load(now_s),
        )  # fmt: skip
        return scan(echo, status, self._told.clock_ms + turn_ms, ranges, width)

    def _measured(self, now_s: float) -> tuple[int, SimProfile] | None:
        """The newest scan and its turn: in the turn in which it was lit, one of before."""
        turn, profile = self._turn(now_s), self._world.look(now_s)
        if profile is None:
            return None
        return self._held if self._held and turn <= self._lit_turn else (turn, profile)

    def _ranges(self, profile: SimProfile, steps: _Steps) -> list[int]:
        """The nearest of each cluster's steps; a code where none of them has a range."""
        single = self._single_ranges(profile, steps)
        least = self._told.least_mm
        found = []
        for start in range(0, len(single), steps.cluster):
            cluster = single[start : start + steps.cluster]
            found.append(min((r for r in cluster if r >= least), default=min(cluster)))
        return found

    def _single_ranges(self, profile: SimProfile, steps: _Steps) -> list[int]:
        sensor, told = self._world.bench.settings.sensor, self._told
        x = profile.counts[:, 0] * sensor.x_mm_per_count + sensor.x_offset_mm
        z = profile.counts[:, 1] * sensor.z_mm_per_count + sensor.z_offset_mm
        half = math.atan(sensor.steepest)
        beams = np.arctan(np.linspace(-sensor.steepest, sensor.steepest, len(x)))
        ranges = []
        for step in range(steps.first, steps.last + 1):
            # The optics' beams run to the right, the scanner's steps to the left.
            angle = -(step - told.front_step) * math.tau / told.steps_a_turn
            beam = int(np.argmin(np.abs(beams - angle)))
            code = _CODES.get(Reason(int(profile.reasons[beam])))
            if abs(angle) > half:
                ranges.append(_NOT_SEEN)
            else:
                ranges.append(round(math.hypot(x[beam], z[beam])) if code is None else code)
        return ranges

    def _switch(self, now_s: float, *, on: bool, why: str) -> None:
        turn, seen = self._turn(now_s), self._world.look(now_s)
        if on and seen is None:
            self._lit_turn = turn
        elif not on and seen is not None:
            self._held = turn, seen
        self._world.switch_laser(now_s, on=on, why=why)

    def _turn(self, now_s: float) -> int:
        return math.floor(self._world.pace.station_s(now_s) * self._told.rpm / 60.0)

    def _clock_ms(self, now_s: float) -> int:
        return (self._told.clock_ms + round(self._world.pace.station_s(now_s) * 1e3)) % 2**24


@dataclass(frozen=True, slots=True)
class _Steps:
    first: int
    last: int
    cluster: int


@dataclass(slots=True)
class _Stream:
    head: str  # of the echo, without the number of scans
    string: str
    steps: _Steps
    every: int
    left: int | None  # None: until QT
    next_turn: int


def _steps(digits: str, told: ScannerSettings) -> _Steps | str:
    """Read start, end and cluster; a status where they are wrong."""
    parts = digits[:4], digits[4:8], digits[8:10]
    if len(digits) != 10:
        return "0C"
    for status, part in zip(("01", "02", "03"), parts, strict=True):
        if not part.isdecimal():
            return status
    first, last, cluster = map(int, parts)
    if last > told.last_step:
        return "04"
    if last < first:
        return "05"
    return _Steps(first, last, max(cluster, 1))
