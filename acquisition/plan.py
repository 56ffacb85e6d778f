"""What a scan is to do: rings at stage heights; checked before anything moves.

::

    stage_mm   first_mm -> last_mm in steps of step_mm, always upward: the screw's backlash is
       |       taken up by the way it comes
       |   o o o o   each ring: profiles_per_turn stops from 0 on, the same angles in every ring
       |   o o o o
       +------------ table_rad   0, tau/n, 2 tau/n ... tau (n-1)/n; then back to 0

Each ring is taken step and shoot, or while the table turns: `acquisition.continuous`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from acquisition.continuous import (
    Continuous,
    check_continuous,
    turning_seconds,
    turns_measured,
)
from acquisition.settings import (
    Key,
    commented_toml,
    parse_settings,
    read_settings,
    read_table,
)
from acquisition.station import Station

_GRID_SLACK = 1e-6  # of a step: 0.1 + 0.1 + 0.1 still reaches 0.3
_MOST_RINGS = 1_000_000
_BYTES_A_POINT = 4 + 4 + 1 + 2  # x, z, reason, intensity at their widest
_BYTES_A_PROFILE = 96  # lengths, scale, offset, times, pose
_BYTES_A_SLICE = 4096  # the archive's directory and headers
_HEAD = """\
A scan plan, read by loftscan. Positions are the stage's own, in mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """Closed contours at equidistant stage positions."""

    first_mm: Annotated[float, Key("stage position of the first ring")]
    last_mm: Annotated[
        float, Key("no ring is above; the last one is there when the steps reach it")
    ]
    step_mm: Annotated[float, Key("from ring to ring", above=0.0)]
    profiles_per_turn: Annotated[
        int,
        Key(
            "stops of the table in each ring; turning, what sets its speed", at_least=3, at_most=1e6
        ),
    ]

    def __post_init__(self) -> None:
        if self.last_mm < self.first_mm:
            raise ValueError(
                f"last_mm: {self.last_mm} is below first_mm {self.first_mm}; swap them"
            )

        if not (self.last_mm - self.first_mm) / self.step_mm < _MOST_RINGS:
            raise ValueError(f"step_mm: {self.step_mm} makes over a million rings; widen it")

    @property
    def count(self) -> int:
        """How many rings."""
        return math.floor((self.last_mm - self.first_mm) / self.step_mm + _GRID_SLACK) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class StepAndShoot:
    """The table stands while it is measured."""

    settle_s: Annotated[float, Key("wait after each stop, before the profile", at_least=0)] = 0.05
    profiles_per_stop: Annotated[int, Key("taken at each stop", at_least=1)] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Everything plan.toml says."""

    ring: Annotated[Ring, Key("where: rings")]
    step_and_shoot: Annotated[StepAndShoot | None, Key("how: stop, settle, measure")] = None
    continuous: Annotated[Continuous | None, Key("how: measure while the table turns")] = None

    def __post_init__(self) -> None:
        if self.step_and_shoot is None and self.continuous is None:
            raise ValueError(
                "step_and_shoot is missing; add a [step_and_shoot] table, or a [continuous] one"
            )
        if self.step_and_shoot is not None and self.continuous is not None:
            raise ValueError("continuous: there is [step_and_shoot], too; remove one of them")


@dataclass(frozen=True, slots=True)
class Target:
    """One slice to take: where the stage stands and where the table stops."""

    index: int
    stage_mm: float
    table_rad: tuple[float, ...]  # of a table that turns steadily: where its profiles are due


@dataclass(frozen=True, slots=True)
class Estimate:
    """What a plan costs."""

    slices: int
    profiles: int
    seconds_at_least: float  # constant speeds, no ramps, no waiting for answers
    bytes_at_most: int


def ring(first_mm: float, last_mm: float, step_mm: float, profiles_per_turn: int) -> Plan:
    """Plan rings with step and shoot and its defaults.

    Raises
    ------
    ValueError
        The same refusals as for a plan.toml.
    """
    table = {
        "first_mm": first_mm,
        "last_mm": last_mm,
        "step_mm": step_mm,
        "profiles_per_turn": profiles_per_turn,
    }
    return Plan(ring=read_table(Ring, table, "plan", "ring"), step_and_shoot=StepAndShoot())


def targets(plan: Plan) -> Iterator[Target]:
    """Give the slices of a plan in order, index from 0."""
    stops = plan.ring.profiles_per_turn
    table_rad = tuple(math.tau * stop / stops for stop in range(stops))
    for index in range(plan.ring.count):
        yield Target(index, plan.ring.first_mm + index * plan.ring.step_mm, table_rad)


def check_plan(plan: Plan, station: Station, name: str = "plan.toml") -> None:
    """Refuse a plan that leaves the station's soft limits, before anything moves.

    Raises
    ------
    ValueError
        One line: the plan's key, the position, the limit and the fix.
    """
    stage, table = station.stage, station.table
    top_mm = plan.ring.first_mm + (plan.ring.count - 1) * plan.ring.step_mm
    last_deg = 360.0 * (plan.ring.profiles_per_turn - 1) / plan.ring.profiles_per_turn
    if plan.ring.first_mm < stage.lowest_mm:
        raise ValueError(
            f"{name}: ring.first_mm: {plan.ring.first_mm} is below the stage's soft limit"
            f" lowest_mm {stage.lowest_mm}; raise it"
        )
    if top_mm > stage.highest_mm:
        raise ValueError(
            f"{name}: ring.last_mm: the last ring, at {top_mm:g}, is above the stage's soft limit"
            f" highest_mm {stage.highest_mm}; lower it"
        )
    if plan.continuous is not None:
        check_continuous(plan.continuous, plan.ring.profiles_per_turn, station, name)
        return
    if table.lowest_deg > 0.0 or table.highest_deg < last_deg:
        raise ValueError(
            f"{name}: ring: a turn from 0 to {last_deg:g} deg leaves the table's soft limits"
            f" {table.lowest_deg} to {table.highest_deg}; widen them in the station's [table]"
        )
    if table.lowest_deg > -table.backlash_deg:
        raise ValueError(
            f"{name}: ring: 0 deg is approached from backlash_deg {table.backlash_deg} below, past"
            f" the soft limit lowest_deg {table.lowest_deg}; lower it in the station's [table]"
        )


def estimate(plan: Plan, station: Station) -> Estimate:
    """Tell how long a plan takes at least and how many bytes it keeps at most."""
    rings, stops = plan.ring.count, plan.ring.profiles_per_turn
    lifting_s = (rings - 1) * plan.ring.step_mm / station.stage.speed_mm_s
    if plan.step_and_shoot is not None:
        profiles = rings * stops * plan.step_and_shoot.profiles_per_stop
        turning_s = rings * 2.0 * 360.0 * (stops - 1) / stops / station.table.speed_deg_s
        standing_s = rings * stops * plan.step_and_shoot.settle_s
        standing_s += profiles / station.profiler.rate_hz
    else:
        assert plan.continuous is not None  # a plan has one of them
        profiles = turns_measured(plan.continuous, rings) * stops
        turning_s = turning_seconds(plan.continuous, rings, stops, station)
        standing_s = 0.0
    points = profiles * station.profiler.points_per_profile
    kept = points * _BYTES_A_POINT + profiles * _BYTES_A_PROFILE + rings * _BYTES_A_SLICE
    return Estimate(rings, profiles, turning_s + lifting_s + standing_s, kept)


def parse_plan(text: str, name: str = "plan.toml") -> Plan:
    """Make a plan of the text of a plan.toml; see `parse_settings`."""
    return parse_settings(Plan, text, name)


def read_plan(path: Path) -> Plan:
    """Read and parse a plan.toml; see `read_settings`."""
    return read_settings(Plan, path)


def write_plan(plan: Plan) -> str:
    """Write a commented plan.toml that parses back to an equal plan."""
    return commented_toml(plan, _HEAD)
