"""From registers to ways along the axis: paths, homing, jog. Pure, in the world's millimetres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from sim.leadshine import registers as reg
from sim.leadshine.registers import RegisterBank
from sim.leadshine.settings import LeadshineSettings

_BACKED_OFF_TURNS = 0.2
_POSITION, _VELOCITY = 1, 2  # bits 0 to 3 of a path's mode
_TYPE, _RELATIVE = 0x0F, 0x40
_LIMITED = 0x02  # of `reg.PATH_GLOBAL`
_FORWARD, _GO_TO_STOP_POSITION = 0x01, 0x02  # of the homing mode


class Kind(Enum):
    """What a task is."""

    PATH = "a path to a position"
    ENDLESS = "a path of velocity, to be stopped"
    JOG = "a jog, to be renewed"
    HOMING = "homing"
    STOPPING = "stopping"


@dataclass(frozen=True, slots=True)
class Leg:
    """One way of the shaft."""

    target_mm: float
    speed_mm_s: float
    acceleration_mm_s2: float | None
    finds_home: bool = False
    held_is_there: bool = False  # it is to run against something


@dataclass(frozen=True, slots=True)
class Task:
    """What the shaft is about; its first leg is under way."""

    kind: Kind
    legs: tuple[Leg, ...] = ()
    completes: bool = True  # False: a limit is in the way
    dwell_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Screw:
    """Pulses of the shaft, and where they are on the axis."""

    zero_mm: float  # where the count is 0
    mm_per_pulse: float  # negative: the direction is reversed
    lead_mm: float

    @classmethod
    def of(cls, bank: RegisterBank, settings: LeadshineSettings, zero_mm: float) -> Screw:
        """The screw as the registers have it turn."""
        sign = -1.0 if bank.word(reg.DIRECTION) else 1.0
        pulses = bank.word(reg.PULSES_PER_TURN)
        return cls(zero_mm, sign * settings.screw_lead_mm / pulses, settings.screw_lead_mm)

    def mm(self, pulses: int) -> float:
        """Where a count is."""
        return self.zero_mm + pulses * self.mm_per_pulse

    def pulses(self, place_mm: float) -> int:
        """What is counted at a place."""
        return round((place_mm - self.zero_mm) / self.mm_per_pulse)

    def leg(self, target_mm: float, rpm: int, ramp_ms: int) -> Leg:
        """A way at a speed in r/min, with ramps in ms per 1000 r/min."""
        acceleration = 1000.0 / 60.0 * self.lead_mm / (ramp_ms / 1000.0) if ramp_ms else None
        return Leg(target_mm, abs(rpm) / 60.0 * self.lead_mm, acceleration)

    @property
    def forward(self) -> int:
        """The sign that counting up has on the axis."""
        return 1 if self.mm_per_pulse > 0.0 else -1


@dataclass(frozen=True, slots=True)
class Planner:
    """Everything a way depends on."""

    bank: RegisterBank
    settings: LeadshineSettings
    screw: Screw

    def path(self, number: int, here_mm: float) -> Task | None:
        """Path `number`; None if its mode means no motion that is simulated."""
        first = reg.PATHS + reg.WORDS_A_PATH * number
        mode, high, low, rpm, up_ms, down_ms, dwell_ms = (
            self.bank.word(first + k) for k in range(7)
        )
        # The world's ramps are alike; the gentler one is kept.
        speed, ramp_ms = reg.signed16(rpm), max(up_ms, down_ms)
        if mode & _TYPE == _VELOCITY:
            return self.endless(Kind.ENDLESS, speed, ramp_ms)
        if mode & _TYPE != _POSITION:
            return None
        asked = reg.joined(high, low)
        asked_mm = self.screw.mm(asked)
        if mode & _RELATIVE:
            asked_mm += here_mm - self.screw.zero_mm
        target_mm = self.within(asked_mm)
        leg = self.screw.leg(target_mm, speed, ramp_ms)
        return Task(Kind.PATH, (leg,), target_mm == asked_mm, dwell_ms / 1000.0)

    def endless(self, kind: Kind, rpm: int, ramp_ms: int) -> Task:
        """On and on, to the end of the way."""
        low_mm, high_mm = self.settings.travel_mm
        end_mm = high_mm if rpm * self.screw.forward > 0 else low_mm
        return Task(kind, (self.screw.leg(self.within(end_mm), rpm, ramp_ms),), completes=False)

    def homing(self, here_mm: float) -> Task | None:
        """To the place that the mode names; with a switch fast, back off it, and slowly again."""
        mode, ramp_ms = self._word(reg.HOMING_MODE), self._word(reg.HOMING_MS_PER_1000_RPM)
        fast, slow = self._word(reg.HOMING_FAST_RPM), self._word(reg.HOMING_SLOW_RPM)
        way = self.screw.forward if mode & _FORWARD else -self.screw.forward
        if (method := _METHODS.get(mode >> 2 & 0x3F)) is None:
            return None
        place_mm = self._home_mm(method, here_mm, way)
        to_it = self.screw.leg(place_mm, fast, ramp_ms)
        if method in (_Method.STOP, _Method.HERE):
            found = replace(to_it, finds_home=True, held_is_there=method is _Method.STOP)
            return Task(Kind.HOMING, (found,))
        back_mm = place_mm - way * _BACKED_OFF_TURNS * self.screw.lead_mm
        again = replace(self.screw.leg(place_mm, slow, ramp_ms), finds_home=True)
        return Task(Kind.HOMING, (to_it, self.screw.leg(back_mm, slow, ramp_ms), again))

    def after_home(self) -> tuple[Leg, ...]:
        """Where it goes once home is found, if anywhere."""
        if not self._word(reg.HOMING_MODE) & _GO_TO_STOP_POSITION:
            return ()
        stop_mm = self.within(self.screw.mm(self._position(reg.HOME_STOP_POSITION)))
        ramp_ms = self._word(reg.HOMING_MS_PER_1000_RPM)
        return (self.screw.leg(stop_mm, self._word(reg.HOMING_FAST_RPM), ramp_ms),)

    def zero_at_home_mm(self, here_mm: float) -> float:
        """Where the count's zero is, if home is here."""
        return here_mm - self._position(reg.HOME_POSITION) * self.screw.mm_per_pulse

    def within(self, target_mm: float) -> float:
        """As far as limit switches and, once switched on, the soft limits let it go."""
        low_mm, high_mm = self.settings.travel_mm
        if self._word(reg.PATH_GLOBAL) & _LIMITED:
            soft = sorted(self.screw.mm(self._position(a)) for a in _SOFT_LIMITS)
            low_mm, high_mm = max(low_mm, soft[0]), min(high_mm, soft[1])
        return min(max(target_mm, low_mm), high_mm)

    def _home_mm(self, method: _Method, here_mm: float, way: int) -> float:
        if method is _Method.HERE:
            return here_mm
        if method is _Method.SWITCH:
            return self.settings.home_switch_mm
        return self.settings.travel_mm[1 if way > 0 else 0]

    def _word(self, address: int) -> int:
        return self.bank.word(address)

    def _position(self, address: int) -> int:
        return reg.joined(self.bank.word(address), self.bank.word(address + 1))


class _Method(Enum):
    """What homing looks for."""

    LIMIT = "a limit switch"
    SWITCH = "the home switch"
    STOP = "a stop, by torque"
    HERE = "nothing: home is here"


# Bits 2 to 7 of the homing mode. That they are one number is inferred: limit 0, switch bit 2, index
# bit 3 (found where the switch is), torque both of them (0x0C, 0x0D), here bit 5.
_METHODS = {
    0: _Method.LIMIT,
    1: _Method.SWITCH,
    2: _Method.SWITCH,
    3: _Method.STOP,
    8: _Method.HERE,
}
_SOFT_LIMITS = (reg.UPPER_LIMIT, reg.LOWER_LIMIT)
