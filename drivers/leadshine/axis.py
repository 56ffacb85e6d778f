r"""A linear stage on a Leadshine PR drive.

A move is one frame. That it is over is read from "path complete", which still says yes to the
previous move until the drive has begun this one::

    running        ______________/~~~~~~~~~~~~~~~~\____________
    path complete  ~~~~~~~~~~~~~~\________________/~~~~~~~~~~~~
                   frame  stale  ^ seen to drop     ^ done: then the position is read and compared

A move so short that no poll sees the drop counts as over when the drive has stood for `settle_s`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.bus import Bus
from drivers.endings import insist, stop_or_refuse, unless_done
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.leadshine.registers import (
    DAMAGED_REQUEST,
    LIMITED,
    RESET_ALARM,
    LoopMode,
    Path,
    Register,
    Status,
    Trigger,
    Watch,
    alarm_name,
    alarm_remedy,
    homing_block,
    path_block,
)
from drivers.leadshine.settings import StageSettings
from drivers.long_words import value_of, words_of
from drivers.modbus_recipes import without_bits, write_register
from drivers.recipes import Order, Recipe

_POLL_S = 0.02
_UNHOMED_JOG_MM = 1.0
_FAMILY = "leadshine"
_NOT_THERE = (2, 3)  # Modbus exceptions: illegal address, illegal value


class LeadshineStage:
    """A linear `Axis` on a bus that it may share.

    "Homed" is this object's own knowledge: it starts without, and forgets it on an alarm, on a lost
    link, and when the drive says that it is not homed or not enabled.
    """

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        settings: StageSettings,
        *,
        name: str = "stage",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = bus
        self._device_id = device_id
        self._settings = settings
        self._name = name
        self._clock = clock
        self._homed_at: int | None = None  # the bus's count of losses then
        self._homing = False

    @property
    def kind(self) -> Kind:
        """Linear."""
        return Kind.LINEAR

    def identify(self) -> Identity:
        """Model from the settings, the rest from the drive; version registers it may lack."""
        mode = self._read_if_there(Register.LOOP_MODE)
        loops = {
            None: "loop not told",
            int(LoopMode.OPEN): "open loop",
            int(LoopMode.CLOSED): "closed loop",
        }
        loop = loops.get(mode, f"loop mode {mode}")
        pulses = self._read(Register.PULSES_PER_REV)
        way = ", reversed" if self._read_if_there(Register.DIRECTION) == 1 else ""
        versions = (
            f"{register.name.lower()} 0x{value:04X}"
            for register in (Register.VERSION, Register.FIRMWARE)
            if (value := self._read_if_there(register)) is not None
        )
        model = f"{self._settings.model.value}, {loop}, {pulses} pulses/rev{way}"
        return Identity(_FAMILY, model, " ".join(versions))

    def state(self) -> AxisState:
        """Status, position and, where there is one, the alarm; see `Axis.state`."""
        return self._state_of(self._status())

    def home(self, pause: Pause) -> AxisState:
        """Let the drive look for its reference; see `Axis.home`."""
        before = self._must_be_ready()
        self._must_have_the_scale()
        self._homed_at = None
        timeout_s = self._settings.homing_s()
        with unless_done(self._give_up):
            self._lift_limits()
            self._keep(Register.HOMING, homing_block(self._settings.home_search()))
            self._homing = True
            # Never re-sent either: a lost answer shows in the status, as a lost request does.
            with suppress(NoReply, FrameError):
                self._write_one(Register.TRIGGER, Trigger.HOME)
            watch = self._watch(Status.HOMED)
            # A bit that was there before may be of the previous homing: without a start it
            # proves nothing. One that was not is new, however late the first look is.
            watch.started = Status.HOMED not in before
            status = self._wait(watch, "homing", timeout_s, pause)
            if not (watch.started and Status.HOMED in status):
                raise Refused(
                    f"{self._name}: homing found no reference, the drive stands"
                    f"{self._inputs_closed()}; check the switch, its input and the direction of"
                    " the search"
                )
            self._homing = False
            self._set_limits()
            self._homed_at = self._bus.losses
            return self._state_of(status)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move in one frame, wait, read the position back and compare; see `Axis.move_to`."""
        self._must_be_inside(position)
        self._must_be_homed()
        self._must_be_ready()
        self._must_be_homed()  # the drive may have said otherwise
        return self._travel(position, self._settings.speed_mm_s, pause)

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move slowly; unhomed by a millimetre at most, in the drive's own count."""
        self._must_be_inside(position)
        self._must_be_ready()
        self._must_have_the_scale()
        if not self._homed and abs(position - self._position_mm()) > _UNHOMED_JOG_MM:
            raise Refused(f"{self._name}: not homed; it jogs at most {_UNHOMED_JOG_MM:g} mm")
        speed_mm_s = min(self._settings.homing.slow_mm_s, self._settings.speed_mm_s)
        return self._travel(position, speed_mm_s, pause)

    def _travel(self, position: float, speed_mm_s: float, pause: Pause) -> AxisState:
        timeout_s = self._settings.move_s(position - self._position_mm(), speed_mm_s)
        with unless_done(self._give_up):
            lost = self._start(self._settings.path_to(position, speed_mm_s))
            watch = self._watch(Status.PATH_COMPLETE)
            status = self._wait(watch, f"the move to {position:.3f} mm", timeout_s, pause)
            state = self._state_of(status)
            self._must_have_arrived(position, state, status, lost)
            return state

    def stop(self) -> None:
        """Stop; the drive's acknowledgement is asked for up to three times.

        Raises
        ------
        NoReply, FrameError
            It was never acknowledged: press the emergency stop.
        """
        insist(lambda: self._write_one(Register.TRIGGER, Trigger.STOP), self._name)

    def recipes(self) -> tuple[Recipe, ...]:
        """Stop, and read the status until it no longer runs; see `drivers.recipes`."""
        bus, device_id = self._bus, self._device_id
        stop = write_register(bus, device_id, Register.TRIGGER, Trigger.STOP)
        stands = without_bits(bus, device_id, 3, Register.STATUS, Status.RUNNING)
        wire_s, rest_s = bus.wire_s(len(stop.send)), self._settings.braking_s() + 0.5
        return (Recipe(self._name, Order.AXIS, (stop,), (stands,), bus.quiet_s, wire_s, rest_s),)

    def clear_alarm(self) -> None:
        """Reset the drive's alarm, once, because a person asked; forgets "homed"."""
        self._homed_at = None
        self._write_one(Register.CONTROL_WORD, RESET_ALARM)

    def _start(self, path: Path) -> DriverError | None:
        """Send the move once. A lost answer is returned: the position will tell what it did."""
        try:
            self._write(Register.PATH_0, path_block(path))
        except (NoReply, FrameError) as lost:
            return lost
        return None

    def _watch(self, done: Status) -> Watch:
        return Watch(done, self._settings.settle_s, self._clock())

    def _wait(self, watch: Watch, aim: str, timeout_s: float, pause: Pause) -> Status:
        """Poll until it is over; the last status. Refused on an alarm or past the deadline."""
        deadline_s = self._clock() + timeout_s
        while True:
            status = self._status()
            self._must_be_sound(status)
            now_s = self._clock()
            if watch.over(status, now_s):
                return status
            if now_s >= deadline_s:
                raise Refused(
                    f"{self._name}: {aim} was not over after {timeout_s:.1f} s, at "
                    f"{self._position_mm():.3f} mm; told to stop; is it blocked?"
                )
            pause(_POLL_S)

    def _give_up(self) -> None:
        self._homing = False
        stop_or_refuse(self.stop, self._name)

    def _lift_limits(self) -> None:
        """The drive's own limits are in a count that homing is about to change."""
        flags = self._read_if_there(Register.PATHS)
        if flags is not None and flags & LIMITED:
            self._keep(Register.PATHS, [flags & ~LIMITED])

    def _set_limits(self) -> None:
        """Have the drive mind the soft limits, too; nothing is saved in it."""
        flags = self._read_if_there(Register.PATHS)
        if flags is not None:
            ends = (self._settings.high_mm, self._settings.low_mm)
            words = [word for end in ends for word in words_of(self._settings.counts(end))]
            self._keep(Register.SOFT_LIMITS, words)
            self._keep(Register.PATHS, [flags | LIMITED])

    def _keep(self, first: Register, words: Sequence[int]) -> None:
        """Write parameters once; where the answer was lost they are read back and compared."""
        try:
            if len(words) == 1:
                self._write_one(first, words[0])
            else:
                self._write(first, words)
        except (NoReply, FrameError):
            with self._on_the_bus():
                found = self._bus.read_holding(self._device_id, first, len(words))
            if found != tuple(words):
                raise

    def _must_be_inside(self, position_mm: float) -> None:
        low_mm, high_mm = self._settings.low_mm, self._settings.high_mm
        if not math.isfinite(position_mm):
            raise ValueError(f"{self._name}: {position_mm} mm is no position")
        if not low_mm <= position_mm <= high_mm:
            raise Refused(
                f"{self._name}: {position_mm:.3f} mm is outside its soft limits "
                f"{low_mm:.3f} to {high_mm:.3f} mm; change the target or the limits"
            )

    @property
    def _homed(self) -> bool:
        return self._homed_at == self._bus.losses

    def _must_be_homed(self) -> None:
        if not self._homed:
            raise Refused(f"{self._name}: not homed, its position means nothing; home it first")

    def _must_be_ready(self) -> Status:
        status = self._status()
        self._must_be_sound(status)
        if Status.RUNNING in status:
            raise Refused(f"{self._name}: is still moving; stop it first")
        return status

    def _must_be_sound(self, status: Status) -> None:
        if Status.FAULT in status:
            code = self._read(Register.ALARM)
            raise Refused(
                f"{self._name}: alarm {alarm_name(self._settings.model, code)}; "
                f"{alarm_remedy(self._settings.model, code)}, clear the alarm, home again",
                code=code,
            )
        if Status.ENABLED not in status:
            raise Refused(f"{self._name}: the drive is not enabled; check its enable input (SI1)")

    def _must_have_the_scale(self) -> None:
        pulses = self._read(Register.PULSES_PER_REV)
        if pulses != self._settings.pulses_per_rev:
            raise Refused(
                f"{self._name}: the drive has {pulses} pulses per revolution, the station says "
                f"{self._settings.pulses_per_rev}; every millimetre would be wrong: correct one"
            )

    def _must_have_arrived(
        self, position_mm: float, state: AxisState, status: Status, lost: DriverError | None
    ) -> None:
        off_mm = abs(state.position - position_mm)
        if off_mm <= self._settings.tolerance_mm and Status.PATH_COMPLETE in status:
            return
        remedy = "is something in its way, or was it stopped?"
        if lost is not None:
            remedy = "the answer to the move was lost; it was not sent again"
        raise Refused(
            f"{self._name}: asked for {position_mm:.3f} mm, stands at {state.position:.3f} mm, "
            f"tolerance {self._settings.tolerance_mm} mm, path "
            f"{'complete' if Status.PATH_COMPLETE in status else 'not complete'}; {remedy}"
        ) from lost

    def _state_of(self, status: Status) -> AxisState:
        alarm = ""
        motion = Motion.STANDING
        if Status.FAULT in status:
            motion = Motion.ALARM
            alarm = alarm_name(self._settings.model, self._read(Register.ALARM))
        elif Status.RUNNING in status:
            motion = Motion.HOMING if self._homing else Motion.MOVING
        return AxisState(motion, self._position_mm(), self._homed, alarm)

    def _status(self) -> Status:
        status = Status(self._read(Register.STATUS))
        if Status.FAULT in status or Status.ENABLED not in status or Status.HOMED not in status:
            self._homed_at = None
        return status

    def _position_mm(self) -> float:
        with self._on_the_bus():
            high, low = self._bus.read_holding(self._device_id, Register.MOTOR_POSITION, 2)
        return value_of(high, low) / self._settings.steps_per_mm

    def _read(self, register: Register) -> int:
        with self._on_the_bus():
            (value,) = self._bus.read_holding(self._device_id, register, 1)
        return value

    def _read_if_there(self, register: Register) -> int | None:
        try:
            return self._read(register)
        except Refused as refused:
            if refused.code not in _NOT_THERE:
                raise
            return None

    def _inputs_closed(self) -> str:
        """Which inputs are closed, for a message; empty where the drive does not tell."""
        word = self._read_if_there(Register.INPUTS)
        if word is None:
            return ""
        closed = [f"SI{k + 1}" for k in range(7) if word >> k & 1]
        return f", inputs closed: {', '.join(closed) or 'none'}"

    def _write_one(self, register: Register, value: int) -> None:
        with self._on_the_bus():
            self._bus.write_register(self._device_id, register, value)

    def _write(self, first: Register, values: Sequence[int]) -> None:
        with self._on_the_bus():
            self._bus.write_registers(self._device_id, first, values)

    @contextmanager
    def _on_the_bus(self) -> Iterator[None]:
        try:
            yield
        except LinkLost:
            self._homed_at = None
            raise
        except Refused as refused:
            if refused.code != DAMAGED_REQUEST:
                raise
            raise FrameError(f"{self._name}: the drive got a damaged request") from refused
