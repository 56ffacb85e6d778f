"""The axes of a simulated station by family: devices, the serial lines they hang on, their tables.

Whoever speaks the same language shares a line, as in a laboratory with one adapter::

    grbl | leadshine                two lines
    oriental + leadshine            one RS-485 line, ids 3 and 1
    oriental + oriental             one RS-485 line, ids 3 and 4
    zaber + zaber                   one chain, numbers 2 and 1

The texts are written here, word by word, and not by the program that reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sim.device import Device, ModbusUnit
from sim.grbl import GrblBoard, GrblSettings
from sim.leadshine import Family, LeadshineDrive, LeadshineSettings
from sim.modbus import RtuServer
from sim.oriental import AzDrive, AzSettings
from sim.world import World
from sim.zaber import ZaberChain, ZaberDevice, ZaberSettings

if TYPE_CHECKING:
    from sim.stations import Layout

_STEPS_PER_DEG = 80.0
_SEEK_DEG_S, _FIND_DEG_S, _PULL_OFF_DEG = 90.0, 10.0, 2.0
_PULSES_PER_TURN, _SCREW_LEAD_MM = 10_000, 5.0
_CLEAR_OF_SWITCH_MM = 2.0
_AZ_STEPS_PER_DEG, _AZ_STEPS_PER_MM, _AZ_TURNS = 100.0, 200.0, 36.0
_ZABER_PER_DEG, _ZABER_PER_MM = 800.0, 2000.0
_LEADSHINE_ID, _AZ_TABLE_ID, _AZ_STAGE_ID = 1, 3, 4
_ZABER_STAGE, _ZABER_TABLE = 1, 2


class TableFamily(Enum):
    """What turns the part."""

    GRBL = "grbl"
    GRBLHAL = "grblhal"
    ZABER = "zaber"
    ORIENTAL = "oriental"


class StageFamily(Enum):
    """What lifts the laser plane."""

    LEADSHINE = "leadshine"
    ZABER = "zaber"
    ORIENTAL = "oriental"


Table = GrblBoard | ZaberDevice | AzDrive
Stage = LeadshineDrive | ZaberDevice | AzDrive


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """The serial lines of both axes; one object where they share it."""

    table: Device
    stage: Device
    baud: int


def build_table(layout: Layout, world: World) -> Table:
    """The device that turns the part."""
    if layout.table_family is TableFamily.ZABER:
        return ZaberDevice(world.table, _zaber_table(layout))
    if layout.table_family is TableFamily.ORIENTAL:
        return AzDrive(world.table, _az_table(layout))
    return GrblBoard(world.table, _grbl(layout))


def build_stage(layout: Layout, world: World) -> Stage:
    """The device that lifts the laser plane."""
    if layout.stage_family is StageFamily.ZABER:
        return ZaberDevice(world.stage, _zaber_stage(layout))
    if layout.stage_family is StageFamily.ORIENTAL:
        return AzDrive(world.stage, _az_stage(layout))
    return LeadshineDrive(world.stage, _leadshine(layout))


def lines_of(table: Table, stage: Stage, baud: int) -> Lines:
    """Put both on lines, on one where they speak the same language."""
    if isinstance(table, ZaberDevice) and isinstance(stage, ZaberDevice):
        chain = ZaberChain({_ZABER_TABLE: table, _ZABER_STAGE: stage})
        return Lines(chain, chain, baud)
    if isinstance(table, AzDrive) and not isinstance(stage, ZaberDevice):
        bus = RtuServer({_AZ_TABLE_ID: table, _stage_id(stage): stage})
        return Lines(bus, bus, baud)
    return Lines(_table_alone(table), _stage_alone(stage), baud)


def _table_alone(table: Table) -> Device:
    if isinstance(table, ZaberDevice):
        return ZaberChain({_ZABER_TABLE: table})
    return RtuServer({_AZ_TABLE_ID: table}) if isinstance(table, AzDrive) else table


def _stage_alone(stage: Stage) -> Device:
    if isinstance(stage, ZaberDevice):
        return ZaberChain({_ZABER_STAGE: stage})
    unit: ModbusUnit = stage
    return RtuServer({_stage_id(stage): unit})


def _stage_id(stage: LeadshineDrive | AzDrive) -> int:
    return _AZ_STAGE_ID if isinstance(stage, AzDrive) else _LEADSHINE_ID


# ---- what they are made of


def _grbl(layout: Layout) -> GrblSettings:
    hal = layout.table_family is TableFamily.GRBLHAL
    return GrblSettings(
        letter="A" if hal else "X",
        hal=hal,
        steps_per_deg=_STEPS_PER_DEG,
        max_rate_deg_min=60.0 * math.degrees(layout.table_limits.speed),
        acceleration_deg_s2=math.degrees(layout.table_limits.acceleration),
        homing_seek_deg_min=60.0 * _SEEK_DEG_S,
        homing_feed_deg_min=60.0 * _FIND_DEG_S,
        pull_off_deg=_PULL_OFF_DEG,
        switch_deg=layout.table_switch_deg,
    )


def _leadshine(layout: Layout) -> LeadshineSettings:
    return LeadshineSettings(
        family=Family.CS2RS,  # the one that notices when its motor is held
        pulses_per_turn=_PULSES_PER_TURN,
        screw_lead_mm=_SCREW_LEAD_MM,
        travel_mm=layout.stage_travel_mm,
    )


def _zaber_table(layout: Layout) -> ZaberSettings:
    per_rad = math.degrees(_ZABER_PER_DEG)
    return ZaberSettings(
        microsteps_per_unit=per_rad,
        home_at=math.radians(layout.table_switch_deg),
        travel=(-10.0 * math.tau, 20.0 * math.tau),
        serial=33002,
        encoder=True,
        accel=_zaber_accel(layout.table_limits.acceleration, per_rad),
    )


def _zaber_stage(layout: Layout) -> ZaberSettings:
    low_mm, high_mm = layout.stage_travel_mm
    return ZaberSettings(
        microsteps_per_unit=_ZABER_PER_MM,
        home_at=low_mm,
        travel=(0.0, high_mm - low_mm),
        encoder=True,
        accel=_zaber_accel(layout.stage_limits.acceleration, _ZABER_PER_MM),
    )


def _zaber_accel(acceleration: float, per_unit: float) -> int:
    return round(acceleration * per_unit * 1.6384 / 10_000.0)


def _az_table(layout: Layout) -> AzSettings:
    return AzSettings(
        steps_per_unit=math.degrees(_AZ_STEPS_PER_DEG),
        home_at=math.radians(layout.table_switch_deg),
        stored={0x390: round(10.0 * _AZ_TURNS)},
    )


def _az_stage(layout: Layout) -> AzSettings:
    return AzSettings(steps_per_unit=_AZ_STEPS_PER_MM, home_at=layout.stage_travel_mm[0])


# ---- what station.toml says of them


def table_toml(layout: Layout, address: str) -> str:
    """Write [table]."""
    facts = {
        "address": address,
        "speed": round(math.degrees(layout.table_limits.speed), 9),
        "acceleration": round(math.degrees(layout.table_limits.acceleration), 9),
        "backlash_deg": round(math.degrees(layout.table_play_rad), 9),
        "home_deg": layout.table_switch_deg,
        "rests_deg": layout.table_switch_deg - _PULL_OFF_DEG,
        "letter": "A" if layout.table_family is TableFamily.GRBLHAL else "X",
        "setting": 103 if layout.table_family is TableFamily.GRBLHAL else 100,
    }
    return _TABLES[layout.table_family].format(**facts)


def stage_toml(layout: Layout, address: str) -> str:
    """Write [stage]."""
    ramp_s = _SCREW_LEAD_MM * 1000.0 / 60.0 / layout.stage_limits.acceleration  # to 1000 rpm
    low_mm, high_mm = layout.stage_travel_mm
    facts = {
        "address": address,
        "speed": layout.stage_limits.speed,
        "acceleration": layout.stage_limits.acceleration,
        "home_mm": low_mm,
        "home_fast_mm_s": layout.stage_limits.speed / 2.0,
        "home_slow_mm_s": layout.stage_limits.speed / 10.0,
        "ramp_ms": math.floor(1000.0 * ramp_s),
        "lowest_mm": low_mm + _CLEAR_OF_SWITCH_MM,
        "highest_mm": high_mm - _CLEAR_OF_SWITCH_MM,
    }
    return _STAGES[layout.stage_family].format(**facts)


_GRBL_TABLE = f"""\
# what turns the part: a Grbl board, whose "mm" are degrees
[table]
family = "grbl"
address = "{{address}}"
letter = "{{letter}}"
steps_per_deg = {_STEPS_PER_DEG}  # the board's ${{setting}}
speed_deg_s = {{speed}}
tolerance_deg = 0.05
backlash_deg = {{backlash_deg}}
zero = "switch"  # found again after a power cycle, so that a scan can be resumed
zero_deg = {{rests_deg}}  # where it rests after homing: a pull-off before the switch
"""
_ZABER_TABLE_TEXT = f"""\
# what turns the part: a Zaber device, read back by its encoder
[table]
family = "zaber"
address = "{{address}}"
device = {_ZABER_TABLE}
serial = "33002"
microsteps_per_deg = {_ZABER_PER_DEG}
read_back = "encoder"
speed_deg_s = {{speed}}
tolerance_deg = 0.02
zero_deg = {{home_deg}}  # where its home sensor is
"""
_AZ_TABLE_TEXT = f"""\
# what turns the part: an AZ drive on Modbus RTU, the shorter way round
[table]
family = "oriental"
address = "{{address}}"
device_id = {_AZ_TABLE_ID}
steps_per_deg = {_AZ_STEPS_PER_DEG}
turning = "wrap proximity"
speed_deg_s = {{speed}}
acceleration_deg_s2 = {{acceleration}}
tolerance_deg = 0.02
zero_deg = {{home_deg}}  # where its home is
"""
_TURNS = """\
lowest_deg = -360.0
highest_deg = 3600.0  # ten turns
"""
_TABLES = {
    TableFamily.GRBL: _GRBL_TABLE + _TURNS,
    TableFamily.GRBLHAL: _GRBL_TABLE + _TURNS,
    TableFamily.ZABER: _ZABER_TABLE_TEXT + _TURNS,
    TableFamily.ORIENTAL: _AZ_TABLE_TEXT + _TURNS,
}
_ENDS = """\
tolerance_mm = 0.02
lowest_mm = {lowest_mm}
highest_mm = {highest_mm}
"""
_STAGES = {
    StageFamily.LEADSHINE: f"""\
# what lifts the laser plane: a Leadshine drive on Modbus RTU
[stage]
family = "leadshine"
address = "{{address}}"
device_id = {_LEADSHINE_ID}
model = "cs2rs"
pulses_per_turn = {_PULSES_PER_TURN}
screw_lead_mm = {_SCREW_LEAD_MM}
speed_mm_s = {{speed}}
home_mark = "limit switch"
home_way = "negative"
home_fast_mm_s = {{home_fast_mm_s}}
home_slow_mm_s = {{home_slow_mm_s}}
home_position_mm = {{home_mm}}  # where the limit switch is
ramp_ms_per_1000_rpm = {{ramp_ms}}
"""
    + _ENDS,
    StageFamily.ZABER: f"""\
# what lifts the laser plane: a Zaber device, read back by its encoder
[stage]
family = "zaber"
address = "{{address}}"
device = {_ZABER_STAGE}
serial = "33001"
microsteps_per_mm = {_ZABER_PER_MM}
read_back = "encoder"
speed_mm_s = {{speed}}
home_position_mm = {{home_mm}}  # where its home sensor is
"""
    + _ENDS,
    StageFamily.ORIENTAL: f"""\
# what lifts the laser plane: an AZ drive on Modbus RTU
[stage]
family = "oriental"
address = "{{address}}"
device_id = {_AZ_STAGE_ID}
steps_per_mm = {_AZ_STEPS_PER_MM}
speed_mm_s = {{speed}}
acceleration_mm_s2 = {{acceleration}}
home_position_mm = {{home_mm}}  # where its home is
"""
    + _ENDS,
}
