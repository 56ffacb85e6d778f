"""What the station knows of one axis on an AZ drive, checked before anything is sent.

How a table turns, and what its angle is called: the drive wraps at a turn, the axis does not::

    unwrapped        350 deg -> 0 deg turns back by 350
    wrap absolute    350 deg -> 0 deg turns back by 350, never over the border of the turn
    wrap proximity   350 deg -> 0 deg goes on by 10; the place is called 0 deg, as it was asked for
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

from drivers.axis import Kind
from drivers.errors import Refused
from drivers.long_words import words_of
from drivers.oriental.registers import Operation

_RATES: Final = range(1, 1_000_000_001)
_FASTEST_HZ: Final = 4_000_000


class Turning(Enum):
    """Which operation a move is."""

    UNWRAPPED = Operation.ABSOLUTE
    WRAP_ABSOLUTE = Operation.WRAP_ABSOLUTE
    WRAP_PROXIMITY = Operation.WRAP_PROXIMITY


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """One axis; positions in its own unit, rad or mm."""

    name: str  # for messages
    kind: Kind
    steps_per_unit: float  # of a degree or a mm
    steps_per_rev: int = 1000  # of the motor, as the drive's electronic gear must give
    lower: float
    upper: float
    speed: float  # a second
    acceleration: float  # a second squared, up and down
    tolerance: float  # of the position read back
    home_position: float = 0.0  # what the position is called at the drive's home
    turning: Turning = Turning.UNWRAPPED
    homing_s: float = 60.0
    settle_s: float = 0.1  # longer than the drive needs from the frame to "moving"
    slack_s: float = 2.0

    def __post_init__(self) -> None:
        for each in (
            "steps_per_unit", "steps_per_rev", "speed", "acceleration", "tolerance", "homing_s",
            "settle_s", "slack_s",
        ):  # fmt: skip
            if not 0 < getattr(self, each) < math.inf:
                raise ValueError(f"{self.name}: {each} must be above 0 and finite")
        if not (-math.inf < self.lower < self.upper < math.inf):
            raise ValueError(f"{self.name}: limits {self.lower} to {self.upper} hold nothing")
        for end in (self.lower, self.upper):
            words_of(self.steps(end))
        if self.kind is Kind.LINEAR and self.turning is not Turning.UNWRAPPED:
            raise ValueError(
                f"{self.name}: a linear stage does not wrap; turning must be unwrapped"
            )
        if not 1 <= self.speed_hz <= _FASTEST_HZ or self.rate not in _RATES:
            raise ValueError(
                f"{self.name}: {self.speed_hz} steps/s and {self.rate} steps/s2 are not what the"
                f" drive can do, 1 to {_FASTEST_HZ} and 1 to {_RATES[-1]}"
            )
        if self.to_wire(self.tolerance) < 0.5 / self.steps_per_unit:
            raise ValueError(f"{self.name}: the tolerance is finer than half a step; widen it")
        whole = self.to_wire(math.tau) * self.steps_per_unit
        if self.turning is not Turning.UNWRAPPED and abs(whole - round(whole)) > 1e-6:
            raise ValueError(f"{self.name}: a turn of {whole} steps; it wraps at whole steps only")

    def to_wire(self, value: float) -> float:
        """Degrees or mm."""
        return math.degrees(value) if self.kind is Kind.ROTARY else value

    @property
    def unit(self) -> str:
        """For messages."""
        return "deg" if self.kind is Kind.ROTARY else "mm"

    @property
    def turn_steps(self) -> int:
        """Steps of a turn of the table."""
        return round(360.0 * self.steps_per_unit)

    @property
    def speed_hz(self) -> int:
        """Speed on the wire."""
        return round(self.to_wire(self.speed) * self.steps_per_unit)

    @property
    def rate(self) -> int:
        """Acceleration on the wire."""
        return round(self.to_wire(self.acceleration) * self.steps_per_unit)

    def steps(self, position: float) -> int:
        """Position, counted from the drive's home."""
        return round(self.to_wire(position - self.home_position) * self.steps_per_unit)

    def position(self, steps: int) -> float:
        """Invert `steps`."""
        value = steps / self.steps_per_unit
        return self.home_position + (math.radians(value) if self.kind is Kind.ROTARY else value)

    def wrapped(self, steps: int) -> int:
        """The same place within the drive's turn, from minus a half of it on."""
        half = self.turn_steps // 2
        return (steps + half) % self.turn_steps - half

    def arrival(self, here: int, target: int) -> int:
        """Where the drive's own count will be after a move from `here` to a named `target`."""
        match self.turning:
            case Turning.UNWRAPPED:
                return target
            case Turning.WRAP_ABSOLUTE:
                return here - self.wrapped(here) + self.wrapped(target)
            case Turning.WRAP_PROXIMITY:
                return here + self.wrapped(target - here)

    def move_s(self, steps: int, speed_hz: int) -> float:
        """Time within which a move must be over: cruise, ramps, settling, slack."""
        return abs(steps) / speed_hz + speed_hz / self.rate + self.settle_s + self.slack_s

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
