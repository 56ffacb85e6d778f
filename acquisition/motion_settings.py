"""Tables of station.toml for axes of other families than the first two: [table] and [stage].

A table's home is found by its own sensor, and nothing takes up backlash: both ends of a move are
read back by an encoder or counted by a drive that closes its loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, ClassVar

from acquisition.settings import Key
from drivers.addresses import parse_address

_ZABER_PORT = Key(
    "the port of the chain; axes with one address share it",
    starts=("serial://", "tcp://"),
    parse=parse_address,
)
_MODBUS = Key(
    "the bus the drive is on; drives with one address share it",
    starts=("serial://", "tcp://"),
    parse=parse_address,
)


class ReadBack(Enum):
    """What the position read back is."""

    COUNTED = "counted"  # microsteps sent: lost ones do not show
    ENCODER = "encoder"


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberTable:
    """A rotary stage on a Zaber device in ASCII."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "zaber"
    backlash_deg: ClassVar = 0.0
    address: Annotated[str, _ZABER_PORT]
    device: Annotated[int, Key("its number in the chain", at_least=1, at_most=99)] = 1
    axis: Annotated[int, Key("which of its axes", at_least=1, at_most=9)] = 1
    serial: Annotated[str, Key("its serial number, so that no other is taken; empty: any")] = ""
    microsteps_per_deg: Annotated[float, Key("of the table", above=0.0)]
    resolution: Annotated[int, Key("microsteps a step; the device must say so", at_least=1)] = 64
    read_back: Annotated[ReadBack, Key("counted, or encoder where it has one")] = ReadBack.COUNTED
    speed_deg_s: Annotated[float, Key("of moves", above=0.0)]
    tolerance_deg: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.02
    zero_deg: Annotated[float, Key("what the position is called where homing ends")] = 0.0
    lowest_deg: Annotated[float, Key("soft limit: no move goes below")]
    highest_deg: Annotated[float, Key("soft limit: no move goes above; ten turns are 3600")]

    def __post_init__(self) -> None:
        in_order("deg", self.lowest_deg, self.highest_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class ZaberStage:
    """A linear stage on a Zaber device in ASCII."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "zaber"
    address: Annotated[str, _ZABER_PORT]
    device: Annotated[int, Key("its number in the chain", at_least=1, at_most=99)] = 1
    axis: Annotated[int, Key("which of its axes", at_least=1, at_most=9)] = 1
    serial: Annotated[str, Key("its serial number, so that no other is taken; empty: any")] = ""
    microsteps_per_mm: Annotated[float, Key("of travel", above=0.0)]
    resolution: Annotated[int, Key("microsteps a step; the device must say so", at_least=1)] = 64
    read_back: Annotated[ReadBack, Key("counted, or encoder where it has one")] = ReadBack.COUNTED
    speed_mm_s: Annotated[float, Key("of moves", above=0.0)]
    tolerance_mm: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.02
    home_position_mm: Annotated[float, Key("what the position is called where homing ends")] = 0.0
    lowest_mm: Annotated[float, Key("soft limit: no move goes below")]
    highest_mm: Annotated[float, Key("soft limit: no move goes above")]

    def __post_init__(self) -> None:
        in_order("mm", self.lowest_mm, self.highest_mm)


class TableTurning(Enum):
    """How an AZ drive takes a table to an angle."""

    UNWRAPPED = "unwrapped"  # back the way it came
    WRAP_ABSOLUTE = "wrap absolute"  # never over the border of the drive's turn
    WRAP_PROXIMITY = "wrap proximity"  # the shorter way round


@dataclass(frozen=True, slots=True, kw_only=True)
class AzTable:
    """A turntable on an AZ drive of Oriental Motor over Modbus RTU."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "oriental"
    backlash_deg: ClassVar = 0.0
    address: Annotated[str, _MODBUS]
    device_id: Annotated[int, Key("the drive's Modbus id", at_least=1, at_most=31)] = 1
    steps_per_deg: Annotated[float, Key("of the table", above=0.0)]
    steps_per_turn: Annotated[
        int, Key("of the motor: 1000 x gear B / gear A, as set in the drive", at_least=1)
    ] = 1000
    turning: Annotated[TableTurning, Key("unwrapped, wrap absolute or wrap proximity")] = (
        TableTurning.UNWRAPPED
    )
    speed_deg_s: Annotated[float, Key("of moves", above=0.0)]
    acceleration_deg_s2: Annotated[float, Key("of moves, up and down", above=0.0)]
    tolerance_deg: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.02
    zero_deg: Annotated[float, Key("what the position is called at the drive's home")] = 0.0
    lowest_deg: Annotated[float, Key("soft limit: no move goes below")]
    highest_deg: Annotated[float, Key("soft limit: no move goes above; ten turns are 3600")]

    def __post_init__(self) -> None:
        in_order("deg", self.lowest_deg, self.highest_deg)


@dataclass(frozen=True, slots=True, kw_only=True)
class AzStage:
    """A linear stage on an AZ drive of Oriental Motor over Modbus RTU."""

    SELECTOR: ClassVar = "family"
    family: ClassVar = "oriental"
    address: Annotated[str, _MODBUS]
    device_id: Annotated[int, Key("the drive's Modbus id", at_least=1, at_most=31)] = 1
    steps_per_mm: Annotated[float, Key("of travel", above=0.0)]
    steps_per_turn: Annotated[
        int, Key("of the motor: 1000 x gear B / gear A, as set in the drive", at_least=1)
    ] = 1000
    speed_mm_s: Annotated[float, Key("of moves", above=0.0)]
    acceleration_mm_s2: Annotated[float, Key("of moves, up and down", above=0.0)]
    tolerance_mm: Annotated[float, Key("largest error of a position read back", above=0.0)] = 0.02
    home_position_mm: Annotated[float, Key("what the position is called at the drive's home")] = 0.0
    lowest_mm: Annotated[float, Key("soft limit: no move goes below")]
    highest_mm: Annotated[float, Key("soft limit: no move goes above")]

    def __post_init__(self) -> None:
        in_order("mm", self.lowest_mm, self.highest_mm)


def in_order(unit: str, lowest: float, highest: float) -> None:
    """Refuse soft limits that hold nothing."""
    if lowest >= highest:
        raise ValueError(
            f"lowest_{unit}: {lowest} is not below highest_{unit} {highest}; swap them"
        )
