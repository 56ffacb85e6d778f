"""What a simulated board is built of, and its EEPROM: the `$` settings and coordinate systems.

The numbers of the settings are the firmware's; "mm" stands for degrees of the table in all of them.
What the motor and its gear truly are stays in `GrblSettings`: a wrong ``$100`` turns the table
wrongly, as it would in the laboratory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim.grbl.numbers import printed, read_number, single
from sim.grbl.refusal import Error, Refusal

LETTERS = "XYZABC"  # the firmware counts in this order; stock boards have the first three
SYSTEMS = range(54, 60)

_STEP_PULSE, _SOFT_LIMITS, _HOMING, _HOMING_DIRECTION = 0, 20, 22, 23
_FLAGS = frozenset({4, 5, 6, 13, _SOFT_LIMITS, 21, _HOMING, 32})
_WHOLE = _FLAGS | {_STEP_PULSE, 1, 2, 3, 10, _HOMING_DIRECTION, 26}
_ROUNDED = _WHOLE | {30, 31}
_AXIS_SETTINGS = (100, 110, 120, 130)  # steps/mm, mm/min, mm/s2, mm; of X, and then of the others
_SHORTEST_PULSE_US = 3
_ABOVE_ZERO = (
    "steps_per_deg", "max_rate_deg_min", "acceleration_deg_s2", "travel_deg",
    "homing_seek_deg_min", "homing_feed_deg_min", "pull_off_deg", "cam_deg",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSettings:
    """One table on one axis of a board; angles are the motor's, in degrees of the table."""

    letter: str = "X"
    steps_per_deg: float = 80.0
    max_rate_deg_min: float = 7200.0
    acceleration_deg_s2: float = 360.0
    travel_deg: float = 3600.0
    homing: bool = True
    homing_seek_deg_min: float = 3600.0
    homing_feed_deg_min: float = 120.0
    pull_off_deg: float = 2.0
    switch_deg: float = 30.0  # where the cam meets the home switch when the table turns upward
    cam_deg: float = 5.0  # how long it presses it, once a turn
    hal: bool = False  # speaks grblHAL's dialect
    late_cancel_s: float = 2e-5  # after the end of a jog: 0x85 then suspends an idle board

    def __post_init__(self) -> None:
        if self.letter not in LETTERS or len(self.letter) != 1:
            raise ValueError(f"grbl: an axis {self.letter!r}; it must be one of {LETTERS}")
        for name in _ABOVE_ZERO:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"grbl: {name} = {value}; it must be finite and above 0")
        if not (math.isfinite(self.switch_deg) and self.late_cancel_s >= 0.0):
            raise ValueError("grbl: switch_deg must be finite, late_cancel_s not below 0")

    @property
    def index(self) -> int:
        """Which axis of the board turns the table, from 0 on."""
        return LETTERS.index(self.letter)

    @property
    def axes(self) -> str:
        """The letters of all axes the board has."""
        return LETTERS[: max(3, self.index + 1)]


class Eeprom:
    """What survives a loss of power."""

    def __init__(self, settings: GrblSettings) -> None:
        self._values = _as_delivered(settings)
        self._index = settings.index
        self._hal = settings.hal
        self._divisors = [first + settings.index for first in _AXIS_SETTINGS[:3]]
        self.offsets_deg = dict.fromkeys(SYSTEMS, 0.0)

    def __getitem__(self, number: int) -> float:
        return self._values[number]

    @property
    def steps_per_deg(self) -> float:
        """What the firmware believes of the gear."""
        return self._values[100 + self._index]

    @property
    def max_rate_deg_min(self) -> float:
        """The speed of G0."""
        return self._values[110 + self._index]

    @property
    def acceleration_deg_s2(self) -> float:
        """Of every move."""
        return self._values[120 + self._index]

    @property
    def travel_deg(self) -> float:
        """From 0 down to minus this the soft limits let it go."""
        return self._values[130 + self._index]

    @property
    def homes_downward(self) -> bool:
        """Whether the home switch lies at the low end."""
        return bool(int(self._values[_HOMING_DIRECTION]) >> self._index & 1)

    def within_travel(self, target_deg: float) -> bool:
        """Whether soft limits, when they are on, allow a target in machine coordinates."""
        return not self._values[_SOFT_LIMITS] or -self.travel_deg <= target_deg <= 0.0

    def listing(self) -> list[str]:
        """The lines of `$$`."""
        return [
            f"${number}={printed(value, self._decimals(number))}"
            for number, value in sorted(self._values.items())
        ]

    def _decimals(self, number: int) -> int:
        if number in _ROUNDED:
            return 0
        return 5 if self._hal and number in range(100, 106) else 3

    def store(self, assignment: str) -> None:
        """Do `n=value`.

        Raises
        ------
        Refusal
            Malformed, unknown or not allowed; nothing was changed.
        """
        number, at = read_number(assignment, 0)
        if assignment[at : at + 1] != "=":
            raise Refusal(Error.INVALID_STATEMENT)
        value, end = read_number(assignment, at + 1)
        if end != len(assignment) or number > 255:
            raise Refusal(Error.INVALID_STATEMENT)
        self._store(int(number), value)

    def _store(self, number: int, value: float) -> None:
        if value < 0.0:
            raise Refusal(Error.NEGATIVE_VALUE)
        if number not in self._values:
            raise Refusal(Error.INVALID_STATEMENT)
        if number == _STEP_PULSE and value < _SHORTEST_PULSE_US:
            raise Refusal(Error.STEP_PULSE_TOO_SHORT)
        if value == 0.0 and number in self._divisors:  # the firmware takes it, and is lost
            raise Refusal(Error.INVALID_STATEMENT)
        if number in _FLAGS and not (self._hal and number == _HOMING):  # there it is a mask
            value = float(int(value) != 0)
        if number == _SOFT_LIMITS and value and not self._values[_HOMING]:
            raise Refusal(Error.SOFT_LIMITS_NEED_HOMING)
        if number == _HOMING and not value:
            self._values[_SOFT_LIMITS] = 0.0
        self._values[number] = float(int(value)) if number in _WHOLE else value


def _as_delivered(settings: GrblSettings) -> dict[int, float]:
    """Stock values where the table asks for no other."""
    values: dict[int, float] = {0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.01}
    values |= {12: 0.002, 13: 0, _SOFT_LIMITS: 0, 21: 0, _HOMING: float(settings.homing)}
    values |= {_HOMING_DIRECTION: 0, 24: settings.homing_feed_deg_min}
    values |= {25: settings.homing_seek_deg_min, 26: 25, 27: settings.pull_off_deg}
    values |= {30: 1000, 31: 0, 32: 0}
    for first, stock in zip(_AXIS_SETTINGS, (250.0, 500.0, 10.0, 200.0), strict=True):
        values |= {first + index: stock for index in range(len(settings.axes))}
    table = (
        settings.steps_per_deg,
        settings.max_rate_deg_min,
        settings.acceleration_deg_s2,
        settings.travel_deg,
    )
    values |= {
        first + settings.index: own for first, own in zip(_AXIS_SETTINGS, table, strict=True)
    }
    return {number: single(value) for number, value in values.items()}
