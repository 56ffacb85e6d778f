"""What a scan is to do: rings, meridians or stripes; checked before anything moves.

Rings; the others are in `acquisition.patterns`::

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

from acquisition.adaptive_plan import Adaptive
from acquisition.continuous import (
    Continuous,
    check_continuous,
    turning_seconds,
    turns_measured,
)
from acquisition.patterns import (
    MOST_SLICES,
    Meridian,
    Reach,
    SliceKind,
    Stripe,
    must_climb,
    steps_in,
)
from acquisition.settings import (
    Key,
    commented_toml,
    parse_settings,
    read_settings,
    read_table,
)
from acquisition.station import Station

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
        must_climb(self.first_mm, self.last_mm, self.step_mm, MOST_SLICES)

    @property
    def count(self) -> int:
        """How many rings."""
        return steps_in(self.first_mm, self.last_mm, self.step_mm)

    @property
    def stops(self) -> int:
        """Of the table, in each ring."""
        return self.profiles_per_turn

    @property
    def reach(self) -> Reach:
        """The table turns there and back in every ring; the stage goes up once."""
        top_mm = self.first_mm + (self.count - 1) * self.step_mm
        last_deg = 360.0 * (self.profiles_per_turn - 1) / self.profiles_per_turn
        turned_deg = 2.0 * self.count * last_deg
        return Reach(self.first_mm, top_mm, 0.0, last_deg, turned_deg, top_mm - self.first_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepAndShoot:
    """The table stands while it is measured."""

    settle_s: Annotated[float, Key("wait after each stop, before the profile", at_least=0)] = 0.05
    profiles_per_stop: Annotated[int, Key("taken at each stop", at_least=1)] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Everything plan.toml says."""

    ring: Annotated[Ring | None, Key("where: rings; or one of the next two")] = None
    meridian: Annotated[Meridian | None, Key("where: an upright sheet, and the table turns")] = None
    stripe: Annotated[Stripe | None, Key("where: the stage moves along, the table stands")] = None
    step_and_shoot: Annotated[StepAndShoot | None, Key("how: stop, settle, measure")] = None
    continuous: Annotated[Continuous | None, Key("how: measure rings while the table turns")] = None
    adaptive: Annotated[
        Adaptive | None, Key("which rings: chosen on the way; ring.step_mm is the least way")
    ] = None

    def __post_init__(self) -> None:
        given = [kind.value for kind in SliceKind if getattr(self, kind.value) is not None]
        if not given:
            raise ValueError("ring is missing; add a [ring] table, or [meridian], or [stripe]")
        if len(given) > 1:
            raise ValueError(f"{given[1]}: stands beside [{given[0]}]; a plan has one of them")
        self._check_how(given[0])
        if self.adaptive is not None:
            if self.ring is None:
                raise ValueError(f"adaptive: chooses among rings; replace [{given[0]}] by [ring]")
            try:
                self.adaptive.coarse(self.ring.count, self.ring.step_mm)
            except ValueError as bad:
                raise ValueError(f"adaptive.{bad}") from bad

    def _check_how(self, where: str) -> None:
        if self.step_and_shoot is None and self.continuous is None:
            raise ValueError(
                "step_and_shoot is missing; add a [step_and_shoot] table, or a [continuous] one"
            )
        if self.step_and_shoot is not None and self.continuous is not None:
            raise ValueError("continuous: there is [step_and_shoot], too; remove one of them")
        if self.continuous is not None and self.ring is None:
            raise ValueError(
                f"continuous: turns for [ring] only, not for [{where}]; use [step_and_shoot]"
            )

    @property
    def kind(self) -> SliceKind:
        """What its slices are."""
        return next(kind for kind in SliceKind if getattr(self, kind.value) is not None)

    @property
    def pattern(self) -> Ring | Meridian | Stripe:
        """Where its slices lie."""
        pattern: Ring | Meridian | Stripe = getattr(self, self.kind.value)
        return pattern

    @property
    def count(self) -> int:
        """How many slices; of an adaptive plan: places for them."""
        return self.pattern.count

    @property
    def most(self) -> int:
        """How many slices there will be at most."""
        return self.count if self.adaptive is None else min(self.adaptive.most_slices, self.count)

    @property
    def first_indices(self) -> tuple[int, ...] | range:
        """The slices that are certain before anything is known: all, or the coarse ones."""
        if self.adaptive is None or self.ring is None:
            return range(self.count)
        return self.adaptive.coarse(self.ring.count, self.ring.step_mm)


@dataclass(frozen=True, slots=True)
class Target:
    """One slice to take: where the stage stands and where the table stops."""

    index: int
    stage_mm: float
    table_rad: tuple[float, ...]  # of a table that turns steadily: where its profiles are due
    more_mm: tuple[float, ...] = ()  # further places of the stage, upward

    @property
    def stops(self) -> tuple[tuple[float, float], ...]:
        """Stage position in mm and table angle in rad of every profile, in order."""
        places_mm = (self.stage_mm, *self.more_mm)
        return tuple((at_mm, table_rad) for at_mm in places_mm for table_rad in self.table_rad)


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
    for index in range(plan.count):
        yield target(plan, index)


def target(plan: Plan, index: int) -> Target:
    """Give one slice of a plan."""
    match plan.pattern:
        case Ring() as rings:
            stops = rings.profiles_per_turn
            table_rad = tuple(math.tau * stop / stops for stop in range(stops))
            return Target(index, rings.first_mm + index * rings.step_mm, table_rad)
        case Meridian() as meridians:
            first_mm, *more_mm = meridians.positions_mm
            turned_rad = math.radians(meridians.angle_deg(index))
            return Target(index, first_mm, (turned_rad,), tuple(more_mm))
        case Stripe() as stripes:
            place_mm = stripes.first_mm + index * stripes.step_mm
            return Target(index, place_mm, (math.radians(stripes.table_deg),))


def check_plan(plan: Plan, station: Station, name: str = "plan.toml") -> None:
    """Refuse a plan that leaves the station's soft limits, before anything moves.

    Raises
    ------
    ValueError
        One line: the plan's key, the position, the limit and the fix.
    """
    stage, table = station.stage, station.table
    kind, reach = plan.kind.value, plan.pattern.reach
    if reach.lowest_mm < stage.lowest_mm:
        raise ValueError(
            f"{name}: {kind}.first_mm: {reach.lowest_mm} is below the stage's soft limit"
            f" lowest_mm {stage.lowest_mm}; raise it"
        )
    if reach.highest_mm > stage.highest_mm:
        raise ValueError(
            f"{name}: {kind}.last_mm: the last {kind}, at {reach.highest_mm:g}, is above the"
            f" stage's soft limit highest_mm {stage.highest_mm}; lower it"
        )
    if plan.continuous is not None:
        check_continuous(plan.continuous, plan.pattern.stops, station, name)
        return
    if table.lowest_deg > reach.lowest_deg or table.highest_deg < reach.highest_deg:
        raise ValueError(
            f"{name}: {kind}: a turn from {reach.lowest_deg:g} to {reach.highest_deg:g} deg leaves"
            f" the table's soft limits {table.lowest_deg} to {table.highest_deg}; widen them in the"
            " station's [table]"
        )
    if table.lowest_deg > reach.lowest_deg - table.backlash_deg:
        raise ValueError(
            f"{name}: {kind}: {reach.lowest_deg:g} deg is approached from backlash_deg"
            f" {table.backlash_deg} below, past the soft limit lowest_deg {table.lowest_deg}; lower"
            " it in the station's [table]"
        )


def estimate(plan: Plan, station: Station) -> Estimate:
    """Tell how long a plan takes at least and how many bytes it keeps at most."""
    profiles, turning_s, standing_s = (
        _stopping(plan, plan.step_and_shoot, station)
        if plan.step_and_shoot is not None
        else _turning(plan, plan.continuous or Continuous(), station)
    )
    lifting_s = plan.pattern.reach.lifted_mm / station.stage.speed_mm_s
    points = profiles * station.profiler.points_per_profile
    kept = points * _BYTES_A_POINT + profiles * _BYTES_A_PROFILE + plan.most * _BYTES_A_SLICE
    return Estimate(plan.most, profiles, turning_s + lifting_s + standing_s, kept)


def _stopping(plan: Plan, how: StepAndShoot, station: Station) -> tuple[int, float, float]:
    """Profiles, and seconds in turning and in standing."""
    stops = plan.most * plan.pattern.stops
    profiles = stops * how.profiles_per_stop
    turned_deg = plan.pattern.reach.turned_deg * plan.most / plan.count
    standing_s = stops * how.settle_s + profiles / station.profiler.rate_hz
    return profiles, turned_deg / station.table.speed_deg_s, standing_s


def _turning(plan: Plan, how: Continuous, station: Station) -> tuple[int, float, float]:
    """The same of a table that is never awaited."""
    stops = plan.pattern.stops
    profiles = turns_measured(how, plan.most) * stops
    return profiles, turning_seconds(how, plan.most, stops, station), 0.0


def parse_plan(text: str, name: str = "plan.toml") -> Plan:
    """Make a plan of the text of a plan.toml; see `parse_settings`."""
    return parse_settings(Plan, text, name)


def read_plan(path: Path) -> Plan:
    """Read and parse a plan.toml; see `read_settings`."""
    return read_settings(Plan, path)


def write_plan(plan: Plan) -> str:
    """Write a commented plan.toml that parses back to an equal plan."""
    return commented_toml(plan, _HEAD)
