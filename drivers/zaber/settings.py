"""What the station knows of one Zaber axis, checked before anything is sent.

Positions are in the axis's own unit, rad or mm; on the wire they are whole microsteps, speeds are
microsteps a second times 1.6384, accelerations microsteps a second squared times 1.6384 / 10000.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from drivers.axis import Kind
from drivers.errors import Refused

_SPEED: Final = 1.6384
_ACCELERATION: Final = _SPEED / 10_000.0
_LARGEST: Final = 10**9  # of a position, in microsteps


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """One axis; positions in its own unit, rad or mm."""

    name: str  # for messages
    kind: Kind
    device: int = 1
    axis: int = 1
    microsteps_per_unit: float  # of a degree or a mm
    resolution: int = 64  # microsteps a full step, which the device must say, too
    lower: float
    upper: float
    speed: float  # a second
    tolerance: float  # of the position read back
    home_position: float = 0.0  # what the position is called where homing ends
    encoder: bool = False  # read back what the encoder measures, not what was counted
    serial: str = ""  # the device must have it; empty: any
    homing_s: float = 60.0
    settle_s: float = 0.05
    slack_s: float = 2.0

    def __post_init__(self) -> None:
        if not (1 <= self.device <= 99 and 1 <= self.axis <= 9):
            raise ValueError(f"{self.name}: device {self.device}, axis {self.axis}: no address")
        for each in ("microsteps_per_unit", "resolution", "speed", "tolerance", "homing_s"):
            if not 0 < getattr(self, each) < math.inf:
                raise ValueError(f"{self.name}: {each} must be above 0 and finite")
        if not (self.lower < self.upper and math.isfinite(self.home_position)):
            raise ValueError(f"{self.name}: limits {self.lower:g} to {self.upper:g} hold nothing")
        ends = [abs(self.microsteps(each)) for each in (self.lower, self.upper)]
        if max(ends) > _LARGEST:
            raise ValueError(f"{self.name}: limits of {max(ends)} microsteps, at most {_LARGEST}")
        if self.to_wire(self.tolerance) < 0.5 / self.microsteps_per_unit:
            raise ValueError(f"{self.name}: the tolerance is finer than half a microstep; widen it")
        if self.speed_wire < 1:
            raise ValueError(f"{self.name}: a speed below what the device can say; raise it")

    def to_wire(self, value: float) -> float:
        """Degrees or mm."""
        return math.degrees(value) if self.kind is Kind.ROTARY else value

    @property
    def unit(self) -> str:
        """For messages."""
        return "deg" if self.kind is Kind.ROTARY else "mm"

    def microsteps(self, position: float) -> int:
        """Position, counted from where home is 0."""
        return round(self.to_wire(position - self.home_position) * self.microsteps_per_unit)

    def position(self, microsteps: float) -> float:
        """Invert `microsteps`."""
        value = microsteps / self.microsteps_per_unit
        return self.home_position + (math.radians(value) if self.kind is Kind.ROTARY else value)

    @property
    def speed_wire(self) -> int:
        """The `maxspeed` of the device."""
        return round(self.to_wire(self.speed) * self.microsteps_per_unit * _SPEED)

    def move_s(self, microsteps: int, acceleration_wire: int) -> float:
        """Time within which a move must be over; 0 on the wire is no ramp."""
        speed = self.speed_wire / _SPEED
        ramp_s = speed * _ACCELERATION / acceleration_wire if acceleration_wire > 0 else 0.0
        return abs(microsteps) / speed + ramp_s + self.settle_s + self.slack_s

    def check_limits(self, position: float) -> None:
        """Refuse a position outside the limits, before a byte is sent."""
        if not math.isfinite(position):
            raise ValueError(f"{self.name}: {position} is no position")
        if not self.lower <= position <= self.upper:
            low, high, wanted = map(self.to_wire, (self.lower, self.upper, position))
            raise Refused(
                f"{self.name}: {wanted:.3f} {self.unit} is outside its soft limits"
                f" {low:.3f} to {high:.3f}; change the target or the limits"
            )
