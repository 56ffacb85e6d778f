"""From [table] and [stage] of station.toml to the axis that drives it, whatever its family.

`table_maker` and `stage_maker` check the settings at once and open nothing; what they give opens
the link, or takes its share of one that is open already.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from acquisition.motion_settings import AzStage, AzTable, ReadBack, ZaberStage, ZaberTable
from acquisition.station import (
    GrblTable,
    LeadshineModel,
    LeadshineStage,
    StageSettings,
    TableSettings,
    TableZero,
)
from drivers import grbl, leadshine, oriental, zaber
from drivers.axis import Axis, Kind
from drivers.bus import Bus
from drivers.links import ByteLink

# One degree written in two ways is two numbers: a stop at the very limit is inside it.
_ROUNDING_RAD = 1e-9
_MODELS = {
    LeadshineModel.EM2RS: leadshine.Model.EM,
    LeadshineModel.CS2RS: leadshine.Model.CS2RS,
}


class Wires(Protocol):
    """Open links by their address; axes at one address share what can be shared."""

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic seconds."""
        ...

    def link(self, address: str) -> ByteLink:
        """A link of the caller's own."""
        ...

    def bus(self, address: str) -> Bus:
        """A Modbus bus."""
        ...

    def chain(self, address: str) -> zaber.Chain:
        """A chain of Zaber devices."""
        ...


def table_maker(table: TableSettings) -> Callable[[Wires], Axis]:
    """What makes the table's axis; ValueError where the driver cannot do what the file says."""
    match table:
        case GrblTable():
            board = grbl_settings(table)
            return lambda at: grbl.GrblAxis(at.link(table.address), board, clock=at.clock)
        case ZaberTable():
            device = zaber_table_settings(table)
            return lambda at: zaber.ZaberAxis(at.chain(table.address), device)
        case AzTable():
            drive = az_table_settings(table)
            return lambda at: oriental.AzAxis(
                at.bus(table.address), table.device_id, drive, clock=at.clock
            )


def stage_maker(stage: StageSettings) -> Callable[[Wires], Axis]:
    """What makes the stage's axis; ValueError where the driver cannot do what the file says."""
    match stage:
        case LeadshineStage():
            drive = leadshine_settings(stage)
            return lambda at: leadshine.LeadshineStage(
                at.bus(stage.address), stage.device_id, drive, clock=at.clock
            )
        case ZaberStage():
            device = zaber_stage_settings(stage)
            return lambda at: zaber.ZaberAxis(at.chain(stage.address), device)
        case AzStage():
            az = az_stage_settings(stage)
            return lambda at: oriental.AzAxis(
                at.bus(stage.address), stage.device_id, az, clock=at.clock
            )


def grbl_settings(table: GrblTable) -> grbl.Settings:
    """Degrees of the file to radians of the driver."""
    switch = table.zero is TableZero.SWITCH
    return grbl.Settings(
        name="table",
        kind=Kind.ROTARY,
        letter=table.letter.value,
        steps_per_unit=table.steps_per_deg,
        lower=math.radians(table.lowest_deg) - _ROUNDING_RAD,
        upper=math.radians(table.highest_deg) + _ROUNDING_RAD,
        speed=math.radians(table.speed_deg_s),
        tolerance=math.radians(table.tolerance_deg),
        homing=grbl.Homing.SWITCH if switch else grbl.Homing.SOFTWARE_ZERO,
        home_position=math.radians(table.zero_deg),
        backlash=math.radians(table.backlash_deg),
    )


def leadshine_settings(stage: LeadshineStage) -> leadshine.StageSettings:
    """Names of the file to what the drive's registers mean by them."""
    return leadshine.StageSettings(
        model=_MODELS[stage.model],
        pulses_per_rev=stage.pulses_per_turn,
        lead_mm=stage.screw_lead_mm,
        low_mm=stage.lowest_mm,
        high_mm=stage.highest_mm,
        speed_mm_s=stage.speed_mm_s,
        tolerance_mm=stage.tolerance_mm,
        homing=leadshine.Homing(
            method=leadshine.HomingMethod[stage.home_mark.name],
            sense=leadshine.HomingSense[stage.home_way.value.upper()],
            fast_mm_s=stage.home_fast_mm_s,
            slow_mm_s=stage.home_slow_mm_s,
            reference_mm=stage.home_position_mm,
        ),
        acceleration_ms=stage.ramp_ms_per_1000_rpm,
        deceleration_ms=stage.ramp_ms_per_1000_rpm,
    )


def zaber_table_settings(table: ZaberTable) -> zaber.Settings:
    """Degrees of the file to radians of the driver."""
    return zaber.Settings(
        name="table",
        kind=Kind.ROTARY,
        device=table.device,
        axis=table.axis,
        microsteps_per_unit=table.microsteps_per_deg,
        resolution=table.resolution,
        lower=math.radians(table.lowest_deg) - _ROUNDING_RAD,
        upper=math.radians(table.highest_deg) + _ROUNDING_RAD,
        speed=math.radians(table.speed_deg_s),
        tolerance=math.radians(table.tolerance_deg),
        home_position=math.radians(table.zero_deg),
        encoder=table.read_back is ReadBack.ENCODER,
        serial=table.serial,
    )


def zaber_stage_settings(stage: ZaberStage) -> zaber.Settings:
    """The file's stage as the driver's."""
    return zaber.Settings(
        name="stage",
        kind=Kind.LINEAR,
        device=stage.device,
        axis=stage.axis,
        microsteps_per_unit=stage.microsteps_per_mm,
        resolution=stage.resolution,
        lower=stage.lowest_mm,
        upper=stage.highest_mm,
        speed=stage.speed_mm_s,
        tolerance=stage.tolerance_mm,
        home_position=stage.home_position_mm,
        encoder=stage.read_back is ReadBack.ENCODER,
        serial=stage.serial,
    )


def az_table_settings(table: AzTable) -> oriental.Settings:
    """Degrees of the file to radians of the driver."""
    return oriental.Settings(
        name="table",
        kind=Kind.ROTARY,
        steps_per_unit=table.steps_per_deg,
        steps_per_rev=table.steps_per_turn,
        lower=math.radians(table.lowest_deg) - _ROUNDING_RAD,
        upper=math.radians(table.highest_deg) + _ROUNDING_RAD,
        speed=math.radians(table.speed_deg_s),
        acceleration=math.radians(table.acceleration_deg_s2),
        tolerance=math.radians(table.tolerance_deg),
        home_position=math.radians(table.zero_deg),
        turning=oriental.Turning[table.turning.name],
    )


def az_stage_settings(stage: AzStage) -> oriental.Settings:
    """The file's stage as the driver's."""
    return oriental.Settings(
        name="stage",
        kind=Kind.LINEAR,
        steps_per_unit=stage.steps_per_mm,
        steps_per_rev=stage.steps_per_turn,
        lower=stage.lowest_mm,
        upper=stage.highest_mm,
        speed=stage.speed_mm_s,
        acceleration=stage.acceleration_mm_s2,
        tolerance=stage.tolerance_mm,
        home_position=stage.home_position_mm,
    )
