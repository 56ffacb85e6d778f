"""What the station knows of a stage on a Leadshine drive, checked before anything is sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.leadshine.registers import (
    HomeSearch,
    HomingMethod,
    HomingSense,
    Model,
    Path,
    PathMode,
    homing_block,
    path_block,
)
from drivers.long_words import words_of


@dataclass(frozen=True, slots=True)
class Homing:
    """How the stage finds its reference."""

    method: HomingMethod
    sense: HomingSense
    fast_mm_s: float
    slow_mm_s: float
    reference_mm: float = 0.0  # what the position is called there
    torque_ms: int = 100  # against a stop: the current that ends the search, and for how long
    torque_percent: int = 50
    creep_mm: float = 10.0  # at most this far at the slow speed; the deadline needs it


@dataclass(frozen=True, slots=True)
class StageSettings:
    """What the drive cannot tell: the screw behind the motor and what is allowed on it."""

    model: Model
    pulses_per_rev: int  # must be what the drive's 0x0001 reads
    lead_mm: float  # travel of one revolution; the sense is the drive's own setting, 0x0007
    low_mm: float  # the soft limits
    high_mm: float
    speed_mm_s: float
    tolerance_mm: float  # between the position asked for and the one read back
    homing: Homing
    acceleration_ms: int = 200  # for 1000 rpm
    deceleration_ms: int = 200
    settle_s: float = 0.2  # longer than the drive needs from the frame to "running"
    slack_s: float = 2.0  # a move may take this much longer than computed

    def __post_init__(self) -> None:
        if not (0.0 < self.lead_mm < math.inf and 200 <= self.pulses_per_rev <= 51200):
            raise ValueError(
                f"lead {self.lead_mm} mm, {self.pulses_per_rev} pulses: lead_mm must be above 0, "
                "pulses_per_rev from 200 to 51200"
            )
        if not -math.inf < self.low_mm < self.high_mm < math.inf:
            raise ValueError(f"soft limits {self.low_mm} to {self.high_mm} mm are no range")
        for name in ("tolerance_mm", "settle_s", "slack_s"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}, must be above 0 and finite")
        for end_mm in (self.low_mm, self.high_mm):
            words_of(self.counts(end_mm))
        path_block(self.path_to(self.low_mm))
        homing_block(self.home_search())

    @property
    def steps_per_mm(self) -> float:
        """Counts of the drive for one millimetre."""
        return self.pulses_per_rev / self.lead_mm

    def counts(self, position_mm: float) -> int:
        """Position on the wire."""
        return round(position_mm * self.steps_per_mm)

    def rpm(self, speed_mm_s: float) -> int:
        """Speed on the wire, the nearest whole rpm; ValueError below half of one."""
        rpm = speed_mm_s * 60.0 / self.lead_mm
        if not 0.5 < rpm < math.inf:
            raise ValueError(f"{speed_mm_s} mm/s is {rpm:.2f} rpm on this screw, less than 1")
        return round(rpm)

    def path_to(self, position_mm: float, speed_mm_s: float | None = None) -> Path:
        """Return the move to an absolute position, at the speed of moves if none is given."""
        return Path(
            mode=PathMode.ABSOLUTE,
            position_counts=self.counts(position_mm),
            speed_rpm=self.rpm(speed_mm_s or self.speed_mm_s),
            acceleration_ms=self.acceleration_ms,
            deceleration_ms=self.deceleration_ms,
        )

    def home_search(self) -> HomeSearch:
        """Return the search for the reference."""
        return HomeSearch(
            method=self.homing.method,
            sense=self.homing.sense,
            reference_counts=self.counts(self.homing.reference_mm),
            fast_rpm=self.rpm(self.homing.fast_mm_s),
            slow_rpm=self.rpm(self.homing.slow_mm_s),
            acceleration_ms=self.acceleration_ms,
            deceleration_ms=self.deceleration_ms,
            torque_ms=self.homing.torque_ms,
            torque_percent=self.homing.torque_percent,
        )

    def move_s(self, distance_mm: float, speed_mm_s: float | None = None) -> float:
        """Return the time within which a move must be over: cruise, ramps, settling, slack."""
        rpm = self.rpm(speed_mm_s or self.speed_mm_s)
        cruise_s = abs(distance_mm) * 60.0 / (rpm * self.lead_mm)
        ramps_s = (self.acceleration_ms + self.deceleration_ms) / 1000.0 * rpm / 1000.0
        return cruise_s + ramps_s + self.settle_s + self.slack_s

    def braking_s(self) -> float:
        """Return the time that the drive takes to stand, from the fastest it is told to go."""
        fastest_mm_s = max(self.speed_mm_s, self.homing.fast_mm_s)
        return self.deceleration_ms / 1000.0 * self.rpm(fastest_mm_s) / 1000.0

    def homing_s(self) -> float:
        """Return the time within which the reference must be found: there, back, and creeping."""
        search = self.home_search()
        fast_mm_s = search.fast_rpm * self.lead_mm / 60.0
        slow_mm_s = search.slow_rpm * self.lead_mm / 60.0
        searching_s = 2.0 * (self.high_mm - self.low_mm) / fast_mm_s
        return searching_s + self.homing.creep_mm / slow_mm_s + self.settle_s + self.slack_s
