"""Continuous motion: what plan.toml says of it, and which stations can do it.

The table turns steadily while the profiler measures by itself, `ring.profiles_per_turn` times a
turn: the table's speed follows from that and from the sensor's rate::

    table_deg    -run_in          0 =================================== 360      360 + run_in
                  | speeds up     | lit, measured at a steady speed      | slows down |
    way back      |<------------- dark and fast, or measured, too -------------------|

Why it is done so: docs/continuous.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

from acquisition.motion_settings import AzTable, TableTurning
from acquisition.profiler_settings import Riftek, RiftekTrigger
from acquisition.settings import Key
from acquisition.station import BaumerOx, GrblTable, Station

TURN_DEG = 360.0
MOST_TRIED = 3  # slices turned both ways until the latency is known; then the part does not tell it
_ROUNDING = 1e-9


class WayBack(Enum):
    """What the table's way back to where it began is good for."""

    EMPTY = "empty"  # dark, as fast as the table moves
    MEASURED = "measured"  # the slice a second time, the other way round


@dataclass(frozen=True, slots=True, kw_only=True)
class Continuous:
    """The table turns while it is measured."""

    run_in_deg: Annotated[
        float,
        Key(
            "turned before 0 and beyond 360 to speed up and slow down; longer for a slow ramp",
            at_least=1.0,
            at_most=180.0,
        ),
    ] = 15.0
    way_back: Annotated[
        WayBack, Key("empty: fast and dark; measured: each slice is seen both ways round")
    ] = WayBack.EMPTY


def speed_deg_s(profiles_per_turn: int, rate_hz: float) -> float:
    """How fast the table turns."""
    return TURN_DEG * rate_hz / profiles_per_turn


def turns_measured(continuous: Continuous, slices: int) -> int:
    """How many turns of so many slices are measured at most."""
    if continuous.way_back is WayBack.MEASURED:
        return 2 * slices
    return slices + min(slices, MOST_TRIED)


def turning_seconds(
    continuous: Continuous, slices: int, profiles_per_turn: int, station: Station
) -> float:
    """How long the table turns at least: measured ways as planned, empty ones as fast as it can."""
    both = turns_measured(continuous, slices) - slices
    way_deg = TURN_DEG + 2.0 * continuous.run_in_deg
    measured_s = way_deg / speed_deg_s(profiles_per_turn, station.profiler.rate_hz)
    return (slices + both) * measured_s + (slices - both) * way_deg / station.table.speed_deg_s


def check_continuous(
    continuous: Continuous, profiles_per_turn: int, station: Station, name: str
) -> None:
    """Refuse what this station cannot do, before anything moves.

    Raises
    ------
    ValueError
        One line: who cannot, or which limit is left, and the fix.
    """
    where = f"{name}: continuous"
    _must_stream(station, where)
    _must_sweep(station, where)
    table, rate_hz = station.table, station.profiler.rate_hz
    speed = speed_deg_s(profiles_per_turn, rate_hz)
    if speed > table.speed_deg_s * (1.0 + _ROUNDING):
        least = math.ceil(TURN_DEG * rate_hz / table.speed_deg_s)
        raise ValueError(
            f"{where}: {profiles_per_turn} profiles a turn at {rate_hz:g} Hz turn the table by"
            f" {speed:g} deg/s, and its speed_deg_s is {table.speed_deg_s:g}; write"
            f" ring.profiles_per_turn = {least} or more"
        )
    if continuous.run_in_deg < (least_deg := 1.0 + 2.0 * table.backlash_deg):
        raise ValueError(
            f"{where}.run_in_deg: {continuous.run_in_deg:g} does not take up the table's"
            f" backlash_deg {table.backlash_deg:g}; write {least_deg:g} or more"
        )
    lowest = -continuous.run_in_deg - table.backlash_deg
    highest = TURN_DEG + continuous.run_in_deg
    if table.lowest_deg > lowest or table.highest_deg < highest:
        raise ValueError(
            f"{where}: a turn with its run-in goes from {lowest:g} to {highest:g} deg, past the"
            f" table's soft limits {table.lowest_deg:g} to {table.highest_deg:g}; widen them in the"
            " station's [table], shorten run_in_deg, or plan [step_and_shoot]"
        )


def _must_stream(station: Station, where: str) -> None:
    match station.profiler:
        case BaumerOx() | Riftek(trigger=RiftekTrigger.SENSOR):
            return
        case Riftek():
            raise ValueError(
                f"{where}: a riftek profiler that software triggers does not measure by itself;"
                ' write profiler.trigger = "sensor", or plan [step_and_shoot]'
            )
        case other:
            raise ValueError(
                f"{where}: a {other.family} profiler does not stream profiles with time stamps"
                " (baumer_ox and riftek do); plan [step_and_shoot]"
            )


def _must_sweep(station: Station, where: str) -> None:
    match station.table:
        case GrblTable() | AzTable(turning=TableTurning.UNWRAPPED):
            return
        case AzTable():
            raise ValueError(
                f"{where}: an oriental table that wraps takes the shorter way, and no whole turn;"
                ' write table.turning = "unwrapped", or plan [step_and_shoot]'
            )
        case other:
            raise ValueError(
                f"{where}: a {other.family} table is not told a speed of its own for a move (grbl"
                " and oriental are); plan [step_and_shoot]"
            )
