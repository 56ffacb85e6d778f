"""The drive itself: what it takes, what its shaft does in time, and the words that tell of it.

The sensor is absolute: the count outlives the power. A shaft that is held short of its target is
alarm 0x10, unless its detection is planted away; then the drive stands there without IN-POS.

::

    trigger   delay        shaft stands
    ---|--------|---------------|------>
       | READY  | MOVE          | READY, IN-POS
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from sim.device import ModbusRefusal
from sim.oriental import registers as reg
from sim.world import WorldAxis

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3
_ALL = 1
_ABSOLUTE, _BY_COMMAND, _BY_FEEDBACK, _WRAP_ABSOLUTE, _NEAREST, _FORWARD, _REVERSE = (
    1, 2, 3, 8, 9, 10, 11,
)  # fmt: skip
_HOME_SPEED, _HOME_RATE = 20_000, 100_000


@dataclass(frozen=True, slots=True, kw_only=True)
class AzSettings:
    """The drive and what hangs on it; the world's unit is rad or mm."""

    steps_per_unit: float = 1000.0  # of a radian or mm: gearing and electronic gear together
    home_at: float = 0.0
    home_set: bool = True  # whether the sensor knows its home
    start_delay_s: float = 0.004  # of the firmware, so of wall time
    tells_deviation: bool = True
    tells_parameters: bool = True  # whether 0x0380 and beyond are there
    stored: Mapping[int, int] = field(default_factory=dict)  # parameters, as once saved


class AzDrive:
    """One drive on the line; a `sim.device.ModbusUnit`."""

    def __init__(self, axis: WorldAxis, settings: AzSettings | None = None) -> None:
        self.settings = settings or AzSettings()
        self._axis = axis
        self._items = dict(reg.STORED) | dict(self.settings.stored)
        if not self.settings.tells_parameters:
            self._items = {k: v for k, v in self._items.items() if k < reg.GEAR_A}
        self._power_up()

    def _power_up(self) -> None:
        self._alarm = 0
        self._history: list[int] = []
        self._due: tuple[float, float, float, float] | None = None  # when, target, speed, rate
        self._under_way = ""  # move, home or stop
        self._home_end = False
        self._arrived = True
        self._commanded = 0

    def power_cycle(self, now_s: float) -> None:
        """Lose power and get it back."""
        self._axis.brake(now_s)
        self._power_up()

    def fail(self, code: int, now_s: float) -> None:
        """Raise an alarm: the shaft brakes, and nothing moves until it is reset."""
        self._alarm = code
        self._history = [code, *self._history][:10]
        self._due, self._under_way, self._home_end = None, "stop", False
        self._axis.brake(now_s)

    def heard(self, now_s: float) -> None:
        """Its communication timeout is off, as delivered."""

    def tick(self, now_s: float) -> None:
        """Begin what is due, finish what is over."""
        if self._due is not None and now_s >= self._due[0]:
            (_, target, speed, rate), self._due = self._due, None
            self._axis.go(target, now_s, speed=speed, acceleration=rate)
        elif self._due is None and self._under_way and self._axis.stands(now_s):
            self._stand(now_s)

    def _stand(self, now_s: float) -> None:
        ended, self._under_way = self._under_way, ""
        held = self._axis.blocked(now_s)
        if held and self.settings.tells_deviation:
            self.fail(reg.DEVIATION if ended == "move" else reg.HOMING_FAILED, now_s)
            return
        self._arrived = not held and ended != "stop"
        if ended == "home" and not held:
            self._home_end = True
        if held:
            self._axis.brake(now_s)

    # ---- Modbus

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """Refused: functions 3, 6 and 16 are all there is."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """Refused likewise."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Refused likewise."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """Refused likewise."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Some words, as they stand now."""
        self.tick(now_s)
        told = self._items | self._live(now_s)
        words = []
        for address in range(first, first + count):
            if (item := address & ~1) not in told:
                raise ModbusRefusal(_ILLEGAL_ADDRESS)
            words.append(reg.halves(told[item])[address & 1])
        return words

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Store whole items; then do what those of them that are commands say."""
        self.tick(now_s)
        if first % 2 or len(words) % 2:
            raise ModbusRefusal(_ILLEGAL_ADDRESS)
        written = {first + k: reg.joined(words[k], words[k + 1]) for k in range(0, len(words), 2)}
        if any(item not in self._items or item in reg.TOLD for item in written):
            raise ModbusRefusal(_ILLEGAL_ADDRESS)
        if not 0 <= written.get(reg.DATA_NUMBER, 0) <= 255:
            raise ModbusRefusal(_ILLEGAL_VALUE)
        self._items |= written
        if written.get(reg.RESET_ALARM) == 1:
            self._alarm = 0
        if written.get(reg.CLEAR_HISTORY) == 1:
            self._history = []
        for item in (reg.INPUTS_PULSED, reg.INPUTS):
            if item in written:
                self._inputs(written[item], now_s)
        self._items[reg.INPUTS_PULSED] = 0
        if written.get(reg.DATA_TRIGGER) == _ALL:
            self._items[reg.DATA_TRIGGER] = 0
            self._direct(now_s)

    def _live(self, now_s: float) -> dict[int, int]:
        count = self._count(now_s)
        history = dict.fromkeys(reg.HISTORY, 0)
        history |= dict(zip(reg.HISTORY, self._history, strict=False))
        return {
            reg.OUTPUTS: self._outputs(),
            reg.PRESENT_ALARM: self._alarm,
            **history,
            reg.FEEDBACK: self._in_turn(count),
            reg.FEEDBACK_SPEED: 0,
            reg.DRIVER_TEMPERATURE: 312,
            reg.MOTOR_TEMPERATURE: 287,
            reg.FEEDBACK_COUNT: count,
            reg.COMMAND_COUNT: self._commanded if self._under_way else count,
        }

    def _outputs(self) -> int:
        moving = bool(self._under_way) and self._due is None
        word = reg.OUT_HOME_END if self._home_end else 0
        if self._alarm:
            return word | reg.OUT_ALARM
        if moving:
            return word | reg.OUT_MOVE
        free = self._items[reg.INPUTS] & (reg.BIT_FREE | reg.BIT_STOP)
        return word | (0 if free else reg.OUT_READY) | (reg.OUT_IN_POSITION if self._arrived else 0)

    # ---- what it is told

    def _inputs(self, bits: int, now_s: float) -> None:
        if bits & reg.BIT_RESET:
            self._alarm = 0
        if bits & (reg.BIT_STOP | reg.BIT_FREE):
            if self._under_way:
                self._due, self._under_way = None, "stop"
            self._axis.brake(now_s)
        elif bits & reg.BIT_HOME and self._may_start():
            if not self.settings.home_set:
                self.fail(reg.NOT_HOMED, now_s)
                return
            self._home_end = False
            self._start(0, _HOME_SPEED, _HOME_RATE, "home", now_s)

    def _direct(self, now_s: float) -> None:
        if not self._may_start():
            return
        here, target = self._count(now_s), self._items[reg.DATA_POSITION]
        speed, rate = self._items[reg.DATA_SPEED], self._items[reg.DATA_START_RATE]
        wraps = bool(self._items.get(reg.WRAP, 1))
        kind = self._items[reg.DATA_TYPE]
        half = self._turn() / 2
        wrong = kind in (_WRAP_ABSOLUTE, _NEAREST, _FORWARD, _REVERSE) and (
            not wraps or not -half <= target < half
        )
        if speed <= 0 or rate <= 0 or wrong:
            self.fail(reg.BAD_DATA, now_s)
        elif kind not in (_BY_COMMAND, _BY_FEEDBACK) and not self.settings.home_set:
            self.fail(reg.NOT_HOMED, now_s)
        elif (end := self._end(kind, here, target)) is None:
            self.fail(reg.BAD_DATA, now_s)
        else:
            self._start(end, speed, rate, "move", now_s)

    def _end(self, kind: int, here: int, target: int) -> int | None:
        """Where the count will be; None for operations that are not simulated."""
        turn = self._turn()
        on = (target - here) % turn
        match kind:
            case 1:
                return target
            case 2 | 3:
                return here + target
            case 8:
                return here + target - self._in_turn(here)
            case 9:
                return here + (on if 2 * on < turn else on - turn)
            case 10:
                return here + on
            case 11:
                return here + on - turn if on else here
        return None

    def _may_start(self) -> bool:
        held = self._items[reg.INPUTS] & (reg.BIT_FREE | reg.BIT_STOP)
        return not (self._alarm or self._under_way or held)

    def _start(self, count: int, speed: int, rate: int, what: str, now_s: float) -> None:
        per_unit = self.settings.steps_per_unit
        self._commanded = count
        target = self.settings.home_at + count / per_unit
        begin_s = now_s + self.settings.start_delay_s
        self._due, self._under_way = (begin_s, target, speed / per_unit, rate / per_unit), what

    # ---- where it is

    def _count(self, now_s: float) -> int:
        return round(
            (self._axis.motor(now_s) - self.settings.home_at) * self.settings.steps_per_unit
        )

    def _turn(self) -> int:
        """Steps at which it wraps."""
        per_rev = 1000 * self._items.get(reg.GEAR_B, 1) // self._items.get(reg.GEAR_A, 1)
        return max(per_rev * self._items.get(reg.WRAP_TENTHS, 10) // 10, 1)

    def _in_turn(self, count: int) -> int:
        """The count within the turn: as delivered from minus a half of it on."""
        turn = self._turn()
        inside = count % turn
        return inside if inside < turn - turn // 2 else inside - turn
