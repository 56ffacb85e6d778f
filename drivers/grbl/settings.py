"""What the station knows of one Grbl axis, checked before anything is sent.

Positions are in the axis's own unit, rad or mm; `to_wire` and `from_wire` are the only conversions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

from drivers.axis import Kind
from drivers.errors import Refused

LETTERS: Final = "XYZABC"  # in the order of a report


class Homing(Enum):
    """Where the axis's zero comes from."""

    SWITCH = "switch"  # $H finds it
    SOFTWARE_ZERO = "software zero"  # where the axis stands when `home` is called


@dataclass(frozen=True, slots=True)
class Settings:
    """What the station knows of one axis; positions in its own unit, rad or mm."""

    name: str  # for messages
    kind: Kind
    letter: str
    steps_per_unit: float  # a degree or a mm, as $100 to $105 of the controller must say
    lower: float
    upper: float
    speed: float  # a second
    tolerance: float  # of the position read back
    homing: Homing = Homing.SWITCH
    home_position: float = 0.0  # what the position is called where homing ends
    backlash: float = 0.0  # taken up from below before every stop; 0 approaches directly
    poll_s: float = 0.05

    def __post_init__(self) -> None:
        if self.letter not in LETTERS or len(self.letter) != 1:
            raise ValueError(f"{self.name}: an axis letter of {LETTERS}, not {self.letter!r}")
        positive = (self.steps_per_unit, self.speed, self.tolerance)
        if not all(0 < value < math.inf for value in positive):
            raise ValueError(f"{self.name}: steps, speed and tolerance must be above zero")
        if not self.lower < self.upper:
            raise ValueError(f"{self.name}: limits {self.lower:g} to {self.upper:g} hold nothing")
        if not (0 <= self.backlash < math.inf and math.isfinite(self.home_position)):
            raise ValueError(f"{self.name}: backlash and home position must be finite numbers")
        if not 0.05 <= self.poll_s <= 0.2:  # report.c: 5 to 20 Hz
            raise ValueError(f"{self.name}: Grbl is polled every 0.05 to 0.2 s, not {self.poll_s}")

    def to_wire(self, position: float) -> float:
        """Degrees or mm."""
        return math.degrees(position) if self.kind is Kind.ROTARY else position

    def from_wire(self, value: float) -> float:
        """Radians or mm."""
        return math.radians(value) if self.kind is Kind.ROTARY else value

    @property
    def unit(self) -> str:
        """The wire's unit, for messages."""
        return "deg" if self.kind is Kind.ROTARY else "mm"

    def check_limits(self, position: float) -> None:
        """Refuse a position outside the limits, before a byte is sent."""
        if not math.isfinite(position):
            raise ValueError(f"{self.name}: {position} is no position")
        if not self.lower <= position <= self.upper:
            lower, upper, wanted = map(self.to_wire, (self.lower, self.upper, position))
            raise Refused(
                f"{self.name}: {wanted:.3f} {self.unit} is outside its limits"
                f" {lower:.3f} to {upper:.3f}; change the target or the limits"
            )

    def check_turns(self, turns: int) -> None:
        """Refuse whole turns of an axis that does not turn, and a reference without a switch."""
        if turns and self.kind is not Kind.ROTARY:
            raise ValueError(f"{self.name}: a linear axis has no turns")
        if self.homing is not Homing.SWITCH:
            raise Refused(f"{self.name}: has no switch to compare with; its zero is where it stood")

    def check_steps(self, steps: float, *, code: int) -> None:
        """Refuse a controller whose steps a unit (its setting `code`) do not fit the station."""
        if abs(steps - self.steps_per_unit) > 0.00051:  # $$ prints three decimals
            raise Refused(
                f"{self.name}: ${code} is {steps:g} steps a {self.unit}, {self.steps_per_unit:g}"
                f" expected; set ${code}={self.steps_per_unit:g} or correct the station",
                code=code,
            )
        tolerance = self.to_wire(self.tolerance)
        if tolerance < 0.5 / steps + 0.0005:
            raise Refused(
                f"{self.name}: a tolerance of {tolerance:.6f} {self.unit} is"
                f" finer than half a step of {1 / steps:.6f} and the report's 0.001; widen it"
            )
