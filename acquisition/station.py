"""The station as station.toml describes it: which devices, at which addresses, standing how.

The dataclasses below are the file's tables: their fields are its keys. `read_station` refuses what
it does not know; `write_station` writes the commented file that `loftscan init` leaves behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated, ClassVar

from acquisition.frames import Kinematics
from acquisition.motion_settings import AzStage, AzTable, ZaberStage, ZaberTable
from acquisition.profiler_settings import (
    BannerEzArray,
    Hokuyo,
    RegisterProfiler,
    Riftek,
    SickProfiler2,
)
from acquisition.settings import Key, commented_toml, parse_settings, read_settings
from drivers.addresses import parse_address

_SERIAL_OR_TCP = ("serial://", "tcp://")
_HEAD = """\
A scanning station, read by loftscan. Lengths are mm, angles degrees, times s: every key says so.
Addresses: serial:///dev/ttyUSB0?baud=115200  tcp://host:port  udp://:port
A key that is not known here is an error, so that a slip of the pen is never silently ignored."""


def _reached(meaning: str, starts: tuple[str, ...]) -> Key:
    return Key(meaning, starts=starts, parse=parse_address)


def _chain(what: str) -> Key:
    meaning = f"the block's input that {what} closes while all is well; absent: not wired"
    return Key(meaning, at_least=0, at_most=15)


_WARNING = Key(
    "told before the laser may be lit; 0 where nobody stands", at_least=0.0, at_most=60.0
)


class GrblLetter(Enum):
    """Which of Grbl's axes turns the table."""

    X = "X"
    Y = "Y"
    Z = "Z"
    A = "A"
    B = "B"
    C = "C"


class TableZero(Enum):
    """Where the table's zero comes from."""

    SWITCH = "switch"
    SOFTWARE_ZERO = "software zero"  # where it stands when it is homed


class LeadshineModel(Enum):
    """Which table of alarm codes holds."""

    EM2RS = "em2rs"
    CS2RS = "cs2rs"


class HomeMark(Enum):
    """What the stage looks for when it homes."""

    LIMIT_SWITCH = "limit switch"
    HOME_SWITCH = "home switch"
    INDEX_PULSE = "index pulse"
    TORQUE = "torque"
    HERE = "here"  # nothing: where it stands when it is homed


class HomeWay(Enum):
    """Which way the stage looks first."""

    DOWN = "negative"
    UP = "positive"


class OutputBy(Enum):
    """How the relay's output is addressed."""

    COIL = "coil"
    REGISTER_BIT = "register bit"


class RelayFamily(Enum):
    """What kind of Modbus relay switches the laser."""

    TURCK = "turck"  # an I/O block with a communication watchdog
    PLAIN = "plain"  # a relay without one
    TIMED = "timed"  # a relay that can be switched on for a time


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblTable:
    """A turntable on a Grbl 1.1 board, whose "mm" are degrees of the table."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "grbl"
    address: Annotated[str, _reached("the board's port", _SERIAL_OR_TCP)]
    letter: Annotated[GrblLetter, Key("Grbl's axis that turns the table")] = GrblLetter.X
    steps_per_deg: Annotated[
        float, Key("must equal the board's own $100 (or 101, 102, 103)", above=0.0)
    ]
    speed_deg_s: Annotated[float, Key("of moves", above=0.0)]
    tolerance_deg: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.05
    backlash_deg: Annotated[float, Key("taken up from below, 0 for none", at_least=0.0)] = 0.0
    zero: Annotated[TableZero, Key("switch, or software zero: where it stands when homed")] = (
        TableZero.SOFTWARE_ZERO
    )
    zero_deg: Annotated[float, Key("what the position is called there")] = 0.0
    lowest_deg: Annotated[float, Key("soft limit: no move goes below")]
    highest_deg: Annotated[float, Key("soft limit: no move goes above; ten turns are 3600")]

    def __post_init__(self) -> None:
        if self.lowest_deg >= self.highest_deg:
            raise ValueError(
                f"lowest_deg: {self.lowest_deg} is not below highest_deg {self.highest_deg};"
                " swap them"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LeadshineStage:
    """A linear stage on a Leadshine drive with PR motion over Modbus RTU."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "leadshine"
    address: Annotated[str, _reached("the bus the drive is on", _SERIAL_OR_TCP)]
    device_id: Annotated[int, Key("the drive's Modbus id", at_least=1, at_most=31)] = 1
    model: Annotated[LeadshineModel, Key("em2rs or cs2rs: whose alarm codes")] = (
        LeadshineModel.EM2RS
    )
    pulses_per_turn: Annotated[int, Key("as set in the drive", at_least=200, at_most=51200)]
    screw_lead_mm: Annotated[float, Key("travel of one turn of the motor", above=0.0)]
    speed_mm_s: Annotated[float, Key("of moves", above=0.0)]
    home_mark: Annotated[HomeMark, Key("limit switch, home switch, index pulse, torque, here")] = (
        HomeMark.LIMIT_SWITCH
    )
    home_way: Annotated[HomeWay, Key("negative or positive: where it looks first")] = HomeWay.DOWN
    home_fast_mm_s: Annotated[float, Key("of the search", above=0.0)] = 5.0
    home_slow_mm_s: Annotated[float, Key("of the last approach", above=0.0)] = 1.0
    home_position_mm: Annotated[float, Key("what the position is called there")] = 0.0
    ramp_ms_per_1000_rpm: Annotated[
        int,
        Key("acceleration and deceleration, as the drive counts them", at_least=1, at_most=65535),
    ] = 100
    tolerance_mm: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.02
    lowest_mm: Annotated[float, Key("soft limit: no move goes below")]
    highest_mm: Annotated[float, Key("soft limit: no move goes above")]

    def __post_init__(self) -> None:
        if self.lowest_mm >= self.highest_mm:
            raise ValueError(
                f"lowest_mm: {self.lowest_mm} is not below highest_mm {self.highest_mm}; swap them"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class BaumerOx:
    """A Baumer OX200 profiler: Modbus TCP for setup and state, profiles by UDP."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "baumer_ox"
    address: Annotated[str, _reached("the sensor's Modbus TCP", ("tcp://",))]
    device_id: Annotated[int, Key("the sensor's Modbus id", at_least=0, at_most=255)] = 1
    profiles: Annotated[str, _reached("where its profiles arrive here", ("udp://",))]
    setup: Annotated[int | None, Key("parameter setup to load; absent: as it is")] = None
    rate_hz: Annotated[float, Key("profiles a second", above=0.0)]
    points_per_profile: Annotated[int, Key("how many at most", at_least=1)]
    x_mm_per_count: Annotated[float, Key("scale of the sensor's x integers", above=0.0)]
    z_mm_per_count: Annotated[float, Key("scale of the sensor's z integers", above=0.0)]
    x_offset_mm: Annotated[float, Key("added to x after scaling")] = 0.0
    z_offset_mm: Annotated[float, Key("added to z after scaling")] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RelayLaser:
    """A relay in the sensor's interlock or supply line."""

    SELECTOR: ClassVar = "switch"
    switch: ClassVar = "relay"
    family: Annotated[
        RelayFamily,
        Key("turck (with a watchdog of its own), plain (without) or timed (on for 0.3 s)"),
    ]
    address: Annotated[str, _reached("the relay's Modbus", _SERIAL_OR_TCP)]
    device_id: Annotated[int, Key("the relay's Modbus id", at_least=0, at_most=247)] = 1
    output_by: Annotated[OutputBy, Key("coil or register bit: how outputs are addressed")] = (
        OutputBy.COIL
    )
    output: Annotated[int, Key("the coil or bit the laser hangs on, from 0", at_least=0)] = 0
    watchdog_s: Annotated[
        float | None,
        Key(
            "the outputs drop after this silence; absent for a plain relay",
            at_least=0.1,
            at_most=10.0,
        ),
    ] = None
    warning_s: Annotated[float, _WARNING] = 3.0
    estop_input: Annotated[int | None, _chain("the emergency stop")] = None
    interlock_input: Annotated[int | None, _chain("the interlock or door")] = None
    key_input: Annotated[int | None, _chain("the key switch")] = None

    def __post_init__(self) -> None:
        chain = {"estop_input": self.estop_input, "interlock_input": self.interlock_input,
                 "key_input": self.key_input}  # fmt: skip
        wired = [name for name, number in chain.items() if number is not None]
        if wired and self.family is not RelayFamily.TURCK:
            raise ValueError(f"{wired[0]}: a {self.family.value} relay has none; remove the key")
        if self.output_by is OutputBy.REGISTER_BIT and self.output > 15:
            raise ValueError(f"output: {self.output}: a register has the bits 0 to 15")
        if self.family is not RelayFamily.TURCK and self.watchdog_s is not None:
            raise ValueError(f"watchdog_s: a {self.family.value} relay has none; remove the key")
        if self.family is RelayFamily.TURCK and self.watchdog_s is None:
            raise ValueError("watchdog_s is missing; add watchdog_s = 0.25")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblLaser:
    """The spindle output of a Grbl board of its own in the sensor's interlock or supply line."""

    SELECTOR: ClassVar = "switch"
    switch: ClassVar = "grbl"
    address: Annotated[str, _reached("the board's port", _SERIAL_OR_TCP)]
    warning_s: Annotated[float, _WARNING] = 3.0
    safety_pins: Annotated[
        bool, Key("true: its reset pin is the emergency stop's, its door pin the interlock's")
    ] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HokuyoLaser:
    """The laser of the Hokuyo scanner that measures, which it switches itself."""

    SELECTOR: ClassVar = "switch"
    switch: ClassVar = "hokuyo"
    address: Annotated[str, _reached("the scanner's port, the profiler's own", _SERIAL_OR_TCP)]
    warning_s: Annotated[float, _WARNING] = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class NoLaserSwitch:
    """Nothing switches the laser: it is on while the sensor has power."""

    SELECTOR: ClassVar = "switch"
    switch: ClassVar = "none"


TableSettings = GrblTable | ZaberTable | AzTable
StageSettings = LeadshineStage | ZaberStage | AzStage
ProfilerSettings = BaumerOx | Riftek | RegisterProfiler | BannerEzArray | Hokuyo | SickProfiler2
LaserSettings = RelayLaser | GrblLaser | HokuyoLaser | NoLaserSwitch


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Which calibration a scan needs."""

    file: Annotated[str, Key("beside station.toml, or with a path")] = "calibration.toml"
    max_age_days: Annotated[float, Key("an older one is refused", above=0.0)] = 30.0
    scale_limit_percent: Annotated[
        float,
        Key("how far a solved scale may be from what is written here", above=0.0, at_most=50.0),
    ] = 5.0
    drift_limit_mm: Annotated[
        float, Key("how far `loftscan calibrate --check` may find an artefact off", above=0.0)
    ] = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOfView:
    """Where the sensor measures, as its data sheet draws it: a trapezium in the sheet of light."""

    near_mm: Annotated[float, Key("the sensor's z where it begins to measure", at_least=0.0)]
    far_mm: Annotated[float, Key("the sensor's z where it ends")]
    near_width_mm: Annotated[float, Key("width there, half of it on either side", above=0.0)]
    far_width_mm: Annotated[float, Key("width at its end", above=0.0)]

    def __post_init__(self) -> None:
        if self.near_mm >= self.far_mm:
            raise ValueError(
                f"near_mm: {self.near_mm} is not below far_mm {self.far_mm}; swap them"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Station:
    """Everything station.toml says."""

    name: Annotated[str, Key("for reports")] = "station"
    table: Annotated[TableSettings, Key("what turns the part")]
    stage: Annotated[StageSettings, Key("what lifts the laser plane or the part")]
    profiler: Annotated[ProfilerSettings, Key("what measures")]
    laser: Annotated[
        LaserSettings,
        Key('what switches the laser: "relay", "grbl", "hokuyo", or "none" (nobody can leave it)'),
    ]
    kinematics: Annotated[Kinematics, Key("how axes and sensor stand; see docs/frames.md")]
    calibration: Annotated[
        CalibrationSettings, Key("what a scan asks of it; see docs/calibration.md")
    ] = CalibrationSettings()
    field_of_view: Annotated[
        FieldOfView | None, Key("of the sensor, from its data sheet; `loftscan preview` needs it")
    ] = None

    def __post_init__(self) -> None:
        match self.laser, self.profiler:
            case HokuyoLaser(address=told), Hokuyo(address=own):
                if told != own:
                    raise ValueError(
                        f"laser.address: {told} is not the profiler's, and its scanner is what"
                        f" switches the laser; write {own}"
                    )
            case HokuyoLaser(), other:
                raise ValueError(
                    f"laser.switch: a {other.family} profiler has no switch of its own; write"
                    ' "relay", "grbl" or "none"'
                )


def parse_station(text: str, name: str = "station.toml") -> Station:
    """Make a station of the text of a station.toml; see `parse_settings`."""
    return parse_settings(Station, text, name)


def read_station(path: Path) -> Station:
    """Read and parse a station.toml; see `read_settings`."""
    return read_settings(Station, path)


def write_station(station: Station) -> str:
    """Write a commented station.toml that parses back to an equal station.

    Raises
    ------
    ValueError
        The station holds what its file may not, such as a negative speed.
    """
    text = commented_toml(station, _HEAD)
    parse_station(text)
    return text
