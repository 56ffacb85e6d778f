"""The station.toml and the plan.toml that `loftscan init` leaves behind.

What nobody said stands there as a placeholder, marked as one: the file is whole and can be read,
and a search for PLACEHOLDER finds what is still to be measured.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from acquisition.plan import Plan, check_plan, ring, write_plan
from acquisition.settings import read_table
from acquisition.station import HokuyoLaser, Station, write_station
from drivers.addresses import parse_address

NO_SWITCH = "none"
_OWN_SWITCH = "hokuyo"  # a profiler that switches its laser itself
MARK = "PLACEHOLDER, to be set: "
_PLAN_STEP_MM = 1.0
_PLAN_STOPS = 360
_PLAN_HEIGHT_MM = 50.0


@dataclass(frozen=True, slots=True)
class Question:
    """One value of station.toml that differs from station to station."""

    key: str  # table.key of the file
    words: str
    placeholder: str | float | int

    def read(self, text: str) -> str | float | int:
        """Read what a person typed.

        Raises
        ------
        ValueError
            Not what is asked for; says what is.
        """
        if self.key.endswith((".address", ".profiles")):
            if not (self.key == "laser.address" and text == NO_SWITCH):
                parse_address(text)
            return text
        if isinstance(self.placeholder, str):
            return text
        try:
            return type(self.placeholder)(text)
        except ValueError as wrong:
            kind = "whole number" if isinstance(self.placeholder, int) else "number"
            raise ValueError(f"{text!r} is no {kind}, such as {self.placeholder}") from wrong


_TURNS = (
    Question("table.speed_deg_s", "speed of the table, degrees a second", 90.0),
    Question("table.lowest_deg", "lowest angle of the table, degrees", -10.0),
    Question("table.highest_deg", "highest angle of the table, degrees", 370.0),
)
_TABLES: Mapping[str, tuple[Question, ...]] = {
    "grbl": (
        Question("table.address", "port of the table's board", "serial:///dev/ttyUSB0?baud=115200"),
        Question("table.steps_per_deg", "steps a degree of the table ($100 of the board)", 100.0),
        *_TURNS,
    ),
    "zaber": (
        Question("table.address", "port of the chain", "serial:///dev/ttyUSB0?baud=115200"),
        Question("table.device", "number of the table's device in the chain", 1),
        Question("table.microsteps_per_deg", "microsteps a degree of the table", 711.111),
        *_TURNS,
    ),
    "oriental": (
        Question("table.address", "bus of the drive", "serial:///dev/ttyUSB0?baud=115200&parity=E"),
        Question("table.device_id", "Modbus id of the table's drive", 1),
        Question("table.steps_per_deg", "steps a degree of the table", 100.0),
        Question("table.acceleration_deg_s2", "acceleration, degrees a second squared", 360.0),
        *_TURNS,
    ),
}
_LIFTS = (
    Question("stage.speed_mm_s", "speed of the stage, mm a second", 10.0),
    Question("stage.lowest_mm", "lowest position of the stage, mm", 0.0),
    Question("stage.highest_mm", "highest position of the stage, mm", 100.0),
)
_STAGES: Mapping[str, tuple[Question, ...]] = {
    "leadshine": (
        Question("stage.address", "bus of the stage's drive", "serial:///dev/ttyUSB1?baud=115200"),
        Question("stage.pulses_per_turn", "pulses a turn, as set in the drive", 10_000),
        Question("stage.screw_lead_mm", "lead of the screw, mm a turn", 5.0),
        *_LIFTS,
    ),
    "zaber": (
        Question("stage.address", "port of the chain", "serial:///dev/ttyUSB1?baud=115200"),
        Question("stage.device", "number of the stage's device in the chain", 1),
        Question("stage.microsteps_per_mm", "microsteps a mm", 2000.0),
        *_LIFTS,
    ),
    "oriental": (
        Question("stage.address", "bus of the drive", "serial:///dev/ttyUSB1?baud=115200&parity=E"),
        Question("stage.device_id", "Modbus id of the stage's drive", 1),
        Question("stage.steps_per_mm", "steps a mm", 200.0),
        Question("stage.acceleration_mm_s2", "acceleration, mm a second squared", 100.0),
        *_LIFTS,
    ),
}
_MEASURES = (
    Question("profiler.rate_hz", "profiles a second", 100.0),
    Question("profiler.points_per_profile", "points of a profile, at most", 640),
)
_PROFILERS: Mapping[str, tuple[Question, ...]] = {
    "baumer_ox": (
        Question("profiler.address", "the profiler's Modbus", "tcp://192.168.0.250:502"),
        Question("profiler.profiles", "where its profiles arrive", "udp://:1234"),
        *_MEASURES,
        Question("profiler.x_mm_per_count", "mm a count of x", 0.01),
        Question("profiler.z_mm_per_count", "mm a count of z", 0.01),
    ),
    "riftek": (
        Question("profiler.address", "the profiler's HTTP port", "tcp://192.168.1.30:80"),
        Question("profiler.profiles", "where its profiles arrive", "udp://:50001"),
        *_MEASURES,
        Question("profiler.z_offset_mm", "where its range begins, mm", 0.0),
    ),
    "registers": (
        Question("profiler.address", "bus of the profiler", "tcp://192.168.0.250:502"),
        Question("profiler.first_register", "register of the first column, from 0", 0),
        *_MEASURES,
        Question("profiler.z_mm_per_count", "mm a count of z", 0.01),
        Question("profiler.column_pitch_mm", "mm from a column to the next", 0.1),
        Question("profiler.sequence_register", "register that counts profiles, from 0", 65535),
    ),
    "banner_ez_array": (
        Question("profiler.address", "bus of the screen", "serial:///dev/ttyUSB2?baud=19200"),
        Question("profiler.rate_hz", "scans a second", 10.0),
        Question("profiler.points_per_profile", "channels of the screen", 120),
        Question("profiler.channel_pitch_mm", "mm from a channel to the next", 5.0),
    ),
    _OWN_SWITCH: (
        Question("profiler.address", "port of the scanner", "serial:///dev/ttyACM0"),
        Question("profiler.port", "usb or rs-232", "usb"),
        Question("profiler.first_step", "first step of a profile", 304),
        Question("profiler.last_step", "last step of a profile", 464),
        Question("profiler.rate_hz", "turns a second", 10.0),
    ),
    "sick": (
        Question("profiler.address", "port of the sensor", "serial:///dev/ttyUSB2?baud=2000000"),
        Question("profiler.points", "points of a whole profile", 832),
        Question("profiler.x_mm_per_count", "mm a count of x", 0.0005),
        Question("profiler.z_mm_per_count", "mm a count of z", 0.0005),
    ),
}
_REST = (
    Question("laser.address", "the laser relay's Modbus, or none", "tcp://192.168.0.254:502"),
    Question("laser.watchdog_s", "seconds of silence after which the relay drops", 0.25),
    Question("kinematics.height_mm", "height of the laser plane over the plate, stage at 0", 0.0),
    Question("kinematics.standoff_mm", "from the sensor's z = 0 to the table's axis", 200.0),
)


@dataclass(frozen=True, slots=True)
class Families:
    """What turns the part, what lifts the laser plane, what measures."""

    table: str = "grbl"
    stage: str = "leadshine"
    profiler: str = "baumer_ox"

    def __post_init__(self) -> None:
        for role, name, known in (
            ("table", self.table, _TABLES),
            ("stage", self.stage, _STAGES),
            ("profiler", self.profiler, _PROFILERS),
        ):
            if name not in known:
                raise ValueError(
                    f"--{role}-family: {name!r} is not known; write {' or '.join(known)}"
                )

    @property
    def questions(self) -> tuple[Question, ...]:
        """Everything that differs from station to station, in the order of the file."""
        own = self.profiler == _OWN_SWITCH
        rest = (each for each in _REST if not (own and each.key.startswith("laser.")))
        return (
            *_TABLES[self.table],
            *_STAGES[self.stage],
            *_PROFILERS[self.profiler],
            *rest,
        )


_USUAL = Families()
_FIXED = {
    "laser": {"switch": "relay", "family": "turck"},
    "kinematics": {"kind": "nominal", "table_sense": "counter-clockwise", "stage_sense": "up"},
}
_ALWAYS_TO_CHECK = ("kinematics.table_sense", "kinematics.stage_sense")


def new_station(
    answers: Mapping[str, str | float | int], name: str, families: Families = _USUAL
) -> tuple[str, tuple[str, ...]]:
    """Write a station.toml of the answers by key, and name its placeholders.

    Raises
    ------
    ValueError
        An answer is out of bounds; names the key.
    """
    wanted = [each for each in families.questions if not _superfluous(each.key, answers)]
    given = {each.key: answers.get(each.key, each.placeholder) for each in wanted}
    # What was answered and is no key of these families is refused where the station is read.
    given |= {k: v for k, v in answers.items() if not _superfluous(k, answers)}
    unlit = answers.get("laser.address") == NO_SWITCH
    station = read_table(Station, _nested(given, families, unlit=unlit), name)
    open_keys = [each.key for each in wanted if each.key not in answers]
    if isinstance(station.laser, HokuyoLaser) and "profiler.address" in open_keys:
        open_keys.append("laser.address")  # the same
    to_set = (*open_keys, *_ALWAYS_TO_CHECK)
    return _marked(write_station(station), to_set), to_set


def new_plan(station: Station) -> str:
    """Write a plan.toml that stays within a station's limits, to be adapted to the part."""
    low_mm, high_mm = station.stage.lowest_mm, station.stage.highest_mm
    plan: Plan = ring(low_mm, min(high_mm, low_mm + _PLAN_HEIGHT_MM), _PLAN_STEP_MM, _PLAN_STOPS)
    check_plan(plan, station)
    return write_plan(plan)


def _superfluous(key: str, answers: Mapping[str, object]) -> bool:
    return key.startswith("laser.") and answers.get("laser.address") == NO_SWITCH


def _nested(
    values: Mapping[str, object], families: Families, *, unlit: bool
) -> dict[str, dict[str, Any]]:
    nested: dict[str, dict[str, Any]] = {name: dict(table) for name, table in _FIXED.items()}
    for role in ("table", "stage", "profiler"):
        nested[role] = {"family": getattr(families, role)}
    for path, value in values.items():
        table, _, key = path.partition(".")
        nested[table][key] = value
    if not any(path.startswith("laser.") for path in values):
        nested["laser"] = {"switch": NO_SWITCH}
        if families.profiler == _OWN_SWITCH and not unlit:
            nested["laser"] = {"switch": _OWN_SWITCH, "address": nested["profiler"]["address"]}
    return nested


def _marked(text: str, keys: Collection[str]) -> str:
    """Put the mark before the remark of each of these keys."""
    table, lines = "", []
    for line in text.splitlines():
        if line.startswith("["):
            table = line.strip("[]")
        key, _, rest = line.partition(" = ")
        if f"{table}.{key}" in keys and not line.startswith("#"):
            value, _, remark = rest.rpartition("  # ")
            line = f"{key} = {value}  # {MARK}{remark}"
        lines.append(line)
    return "\n".join(lines) + "\n"
