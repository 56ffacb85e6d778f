r"""A turntable or a linear stage on an AZ drive, by direct data operation.

A move is one frame of sixteen words. MOVE goes on some milliseconds after it and off when the shaft
stands; a move so short that no poll sees it counts as over when the drive has stood `settle_s`::

    MOVE     ______________/~~~~~~~~~~~~~~~~\____________
    IN-POS   ~~~~~~~~~~~~~~\________________/~~~~~~~~~~~~
             frame  stale  ^ seen           ^ done: then the position is read and compared

The position read back is of the drive's absolute sensor, so that lost steps do not exist and a held
shaft is an alarm (0x10) or a position that was not reached.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Final

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.bus import Bus
from drivers.endings import insist, stop_or_refuse, unless_done
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.long_words import value_of, words_of
from drivers.modbus_recipes import long_without_bits, write_registers
from drivers.oriental.registers import (
    STEPS_PER_GEAR,
    DirectData,
    Input,
    Operation,
    Output,
    Register,
    alarm_name,
    alarm_remedy,
    direct_block,
)
from drivers.oriental.settings import Settings, Turning
from drivers.recipes import Order, Recipe
from drivers.sweeping import Course

_POLL_S: Final = 0.02
_REST_S: Final = 1.0  # longer than a table brakes
_UNHOMED_JOG: Final = 1.0  # degree or mm
_JOG_PART: Final = 0.2  # of the speed of moves
_NOT_THERE: Final = (2, 3)  # Modbus exceptions: illegal address, illegal value


class AzAxis:
    """One axis on a bus that it may share; keeps `drivers.axis.Axis`.

    "Homed" is this object's own knowledge: it starts without, though the drive's sensor is
    absolute, and forgets it on an alarm, on a lost link, and when a position was not reached.
    """

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        settings: Settings,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = bus
        self._device_id = device_id
        self._settings = settings
        self._clock = clock
        self._identity: Identity | None = None
        self._homed_at: int | None = None  # the bus's count of losses then
        self._homing = False
        self._names = 0  # steps from the drive's count to what the place is called

    @property
    def kind(self) -> Kind:
        """Rotary or linear."""
        return self._settings.kind

    def identify(self) -> Identity:
        """Ask for gear and wrap range, and compare them; see `Axis.identify`.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            The electronic gear or the wrap range is not the station's.
        """
        if self._identity is None:
            self._homed_at = None
            told = [self._check_gear(), self._check_wrap()]
            model = ", ".join(["AZ", *filter(None, told)])
            self._identity = Identity("oriental", model, "not told")
        return self._identity

    def state(self) -> AxisState:
        """Outputs, position and, where there is one, the alarm; see `Axis.state`."""
        return self._state_of(self._output())

    def home(self, pause: Pause) -> AxisState:
        """Let the drive go to its home; see `Axis.home`."""
        self._ready()
        self._homed_at = None
        with unless_done(self._give_up):
            self._homing = True
            # Never re-sent: a lost answer shows in the outputs, as a lost request does.
            with suppress(NoReply, FrameError):
                self._tell(Input.HOME)
            output, begun = self._until_standing("homing", self._settings.homing_s, pause)
            at_home = abs(self._count()) <= self._tolerance_steps
            if Output.HOME_END not in output or not (begun or at_home):
                raise Refused(
                    f"{self._name}: homing did not end at home; check the home set in the drive,"
                    " and what is in the way"
                )
            self._homing = False
            self._homed_at, self._names = self._bus.losses, 0
            return self._state_of(output)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move in one frame, wait, read the position back and compare; see `Axis.move_to`."""
        self._settings.check_limits(position)
        self._must_be_homed()
        self._ready()
        self._must_be_homed()  # the drive may have said otherwise
        return self._travel(position, self._settings.speed_hz, pause)

    def sweep_to(self, position: float, course: Course, pause: Pause) -> AxisState:
        """Move in one frame at its own speed; see `drivers.sweeping`.

        Raises
        ------
        Refused
            Or the table wraps: the drive would take the shorter way.
        """
        settings = self._settings
        settings.check_limits(position)
        if settings.turning is not Turning.UNWRAPPED:
            raise Refused(f"{self._name}: it wraps, so no whole turn is one move; turn unwrapped")
        speed_hz = round(settings.to_wire(course.speed) * settings.steps_per_unit)
        if not 1 <= speed_hz <= settings.speed_hz:
            raise Refused(
                f"{self._name}: {settings.to_wire(course.speed):g} {settings.unit}/s is not between"
                " a step a second and the speed of its moves; turn at another speed"
            )
        self._must_be_homed()
        self._ready()
        self._must_be_homed()
        return self._travel(position, speed_hz, pause, course)

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move slowly, relative to where it stands; unhomed by a degree or millimetre at most."""
        self._settings.check_limits(position)
        self._ready()
        steps = self._settings.steps(position) - self._count() - self._names
        if not self._homed and abs(steps) > _UNHOMED_JOG * self._settings.steps_per_unit:
            raise Refused(
                f"{self._name}: not homed; it jogs at most {_UNHOMED_JOG:g} {self._settings.unit}"
            )
        slow_hz = max(round(self._settings.speed_hz * _JOG_PART), 1)
        return self._jog(steps, slow_hz, pause)

    def stop(self) -> None:
        """Stop; the drive's acknowledgement is asked for up to three times.

        Raises
        ------
        NoReply, FrameError
            It was never acknowledged: press the emergency stop.
        """
        insist(lambda: self._tell(Input.STOP), self._name)

    def recipes(self) -> tuple[Recipe, ...]:
        """Stop, and read the outputs until it no longer moves; see `drivers.recipes`."""
        bus, device_id = self._bus, self._device_id
        stop = write_registers(bus, device_id, Register.PULSED_INPUT, words_of(Input.STOP))
        stands = long_without_bits(bus, device_id, Register.OUTPUT, Output.MOVE)
        wire_s = bus.wire_s(len(stop.send))
        return (Recipe(self._name, Order.AXIS, (stop,), (stands,), bus.quiet_s, wire_s, _REST_S),)

    def clear_alarm(self) -> None:
        """Reset the drive's alarm, once, because a person asked; forgets "homed"."""
        self._homed_at = None
        self._write(Register.ALARM_RESET, words_of(1))

    # --- moving

    def _travel(
        self, position: float, speed_hz: int, pause: Pause, course: Course | None = None
    ) -> AxisState:
        settings, here = self._settings, self._count()
        named = settings.steps(position)
        arrival = settings.arrival(here, named)
        # A drive that does not wrap counts on; what the place is called is not its matter.
        wraps = settings.turning is not Turning.UNWRAPPED
        told = settings.wrapped(named) if wraps else named
        data = self._data(Operation(settings.turning.value), told, speed_hz)
        self._go(data, arrival, settings.move_s(arrival - here, speed_hz), pause, course)
        self._names = named - arrival
        return self._state_of(self._output())

    def _jog(self, steps: int, speed_hz: int, pause: Pause) -> AxisState:
        arrival = self._count() + steps
        data = self._data(Operation.RELATIVE, steps, speed_hz)
        self._go(data, arrival, self._settings.move_s(steps, speed_hz), pause)
        return self._state_of(self._output())

    def _data(self, operation: Operation, position: int, speed_hz: int) -> DirectData:
        rate = self._settings.rate
        return DirectData(operation, position, speed_hz, start_rate=rate, stop_rate=rate)

    def _go(
        self,
        data: DirectData,
        arrival: int,
        within_s: float,
        pause: Pause,
        course: Course | None = None,
    ) -> None:
        """Send one operation, once, and see it end where it should."""
        lost: DriverError | None = None
        before_stop = course.onlooker.failing if course else _nothing
        with unless_done(self._give_up), unless_done(before_stop):
            try:
                self._write(Register.DIRECT_DATA, direct_block(data))
            except (NoReply, FrameError) as unanswered:
                lost = unanswered  # it may have been heard: the position decides
            self._until_standing("the move", within_s, pause, course)
            self._must_have_arrived(arrival, lost)

    def _until_standing(
        self, aim: str, within_s: float, pause: Pause, course: Course | None = None
    ) -> tuple[Output, bool]:
        """Poll until it stands; the last outputs, and whether it was seen to move."""
        deadline_s = self._clock() + within_s
        stood_since_s, begun = self._clock(), False
        while True:
            output = self._output()
            self._must_be_sound(output, aim)
            now_s = self._clock()
            if Output.MOVE in output:
                stood_since_s, begun = now_s, True
            elif begun or now_s - stood_since_s >= self._settings.settle_s:
                return output, begun
            if now_s >= deadline_s:
                raise Refused(
                    f"{self._name}: {aim} was not over after {within_s:.1f} s; told to stop; is it"
                    " blocked?"
                )
            if course is not None:
                asked_s = self._clock()
                position = self._settings.position(self._count() + self._names)
                course.onlooker.seen(asked_s, position)
            pause(_POLL_S)

    def _must_have_arrived(self, arrival: int, lost: DriverError | None) -> None:
        count = self._count()
        if abs(count - arrival) <= self._tolerance_steps:
            return
        settings = self._settings
        said = (
            f"{self._name}: asked for {(arrival + self._names) / settings.steps_per_unit:.3f}"
            f" {settings.unit} from home, stands at"
            f" {(count + self._names) / settings.steps_per_unit:.3f}, tolerance"
            f" {settings.to_wire(settings.tolerance):.3f}"
        )
        if lost is not None:
            raise NoReply(
                f"{said}; the answer to the move was lost, it was not sent again"
            ) from lost
        self._homed_at = None
        raise Refused(f"{said}; is something in its way, or was it stopped? then home")

    def _give_up(self) -> None:
        self._homing = False
        stop_or_refuse(self.stop, self._name)

    # --- what it must be

    def _ready(self) -> None:
        self.identify()
        output = self._output()
        self._must_be_sound(output, "standing")
        if Output.MOVE in output:
            raise Refused(f"{self._name}: is still moving; stop it first")
        if Output.READY not in output:
            raise Refused(f"{self._name}: the drive is not ready; check its FREE and STOP inputs")

    @property
    def _homed(self) -> bool:
        return self._homed_at == self._bus.losses

    def _must_be_homed(self) -> None:
        if not self._homed:
            raise Refused(f"{self._name}: not homed, its position means nothing; home it first")

    def _must_be_sound(self, output: Output, during: str) -> None:
        if Output.ALARM in output:
            code = self._value(Register.ALARM)
            raise Refused(
                f"{self._name}: alarm {alarm_name(code)}, {during}; {alarm_remedy(code)}", code=code
            )

    def _check_gear(self) -> str:
        gear_a, gear_b = (self._if_there(each) for each in (Register.GEAR_A, Register.GEAR_B))
        if gear_a is None or gear_b is None:
            return "gear not told"
        found = STEPS_PER_GEAR * gear_b / gear_a if gear_a > 0 else 0.0
        if found != self._settings.steps_per_rev:
            raise Refused(
                f"{self._name}: the drive's gear {gear_b}/{gear_a} makes {found:g} steps a turn of"
                f" the motor, the station says {self._settings.steps_per_rev}; every position would"
                " be wrong: correct one"
            )
        return f"{found:g} steps/rev"

    def _check_wrap(self) -> str:
        if self._settings.turning is Turning.UNWRAPPED:
            return ""
        wraps, tenths = (self._if_there(each) for each in (Register.WRAP, Register.WRAP_RANGE))
        if wraps is None or tenths is None:
            return "wrap not told"
        found = tenths * self._settings.steps_per_rev / 10.0 if wraps else 0.0
        if found != self._settings.turn_steps:
            raise Refused(
                f"{self._name}: the drive wraps at {found:g} steps, a turn of the table has"
                f" {self._settings.turn_steps}; set its wrap range, or turn unwrapped"
            )
        return f"wraps at {found:g}"

    # --- asking

    @property
    def _name(self) -> str:
        return self._settings.name

    @property
    def _tolerance_steps(self) -> float:
        return self._settings.to_wire(self._settings.tolerance) * self._settings.steps_per_unit

    def _state_of(self, output: Output) -> AxisState:
        motion, alarm = Motion.STANDING, ""
        if Output.ALARM in output:
            motion, alarm = Motion.ALARM, alarm_name(self._value(Register.ALARM))
        elif Output.MOVE in output:
            motion = Motion.HOMING if self._homing else Motion.MOVING
        position = self._settings.position(self._count() + self._names)
        return AxisState(motion, position, self._homed, alarm)

    def _output(self) -> Output:
        output = Output(self._value(Register.OUTPUT) & 0xFFFF)
        if Output.ALARM in output:
            self._homed_at = None
        return output

    def _count(self) -> int:
        return self._value(Register.POSITION)

    def _value(self, register: Register) -> int:
        with self._on_the_bus():
            high, low = self._bus.read_holding(self._device_id, register, 2)
        return value_of(high, low)

    def _if_there(self, register: Register) -> int | None:
        try:
            return self._value(register)
        except Refused as refused:
            if refused.code not in _NOT_THERE:
                raise
            return None

    def _tell(self, bits: Input) -> None:
        self._write(Register.PULSED_INPUT, words_of(bits))

    def _write(self, first: Register, values: Sequence[int]) -> None:
        with self._on_the_bus():
            self._bus.write_registers(self._device_id, first, values)

    @contextmanager
    def _on_the_bus(self) -> Iterator[None]:
        try:
            yield
        except LinkLost:
            self._homed_at = None
            self._identity = None  # whoever answers next may be another
            raise


def _nothing() -> None:
    """Nobody looks on."""
