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
from dataclasses import dataclass

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.bus import Bus
from drivers.endings import unless_done
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.leadshine.registers import (
    DAMAGED_REQUEST,
    RESET_ALARM,
    HomeSearch,
    HomingMethod,
    HomingSense,
    LoopMode,
    Model,
    Path,
    PathMode,
    Register,
    Status,
    Trigger,
    Watch,
    alarm_name,
    homing_block,
    path_block,
    value_of,
    words_of,
)
from drivers.modbus_recipes import without_bits, write_register
from drivers.recipes import Order, Recipe

_POLL_S = 0.02
_STOP_TRIES = 3
_FAMILY = "leadshine"
_NOT_THERE = (2, 3)  # Modbus exceptions: illegal address, illegal value


@dataclass(frozen=True, slots=True)
class Homing:
    """How the stage finds its reference."""

    method: HomingMethod
    sense: HomingSense
    fast_mm_s: float
    slow_mm_s: float
    reference_mm: float = 0.0  # what the position is called there
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

    def path_to(self, position_mm: float) -> Path:
        """Return the move to an absolute position."""
        return Path(
            mode=PathMode.ABSOLUTE,
            position_counts=self.counts(position_mm),
            speed_rpm=self.rpm(self.speed_mm_s),
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
        )

    def move_s(self, distance_mm: float) -> float:
        """Return the time within which a move must be over: cruise, ramps, settling, slack."""
        rpm = self.rpm(self.speed_mm_s)
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
        self._homed = False
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
        versions = (
            f"{register.name.lower()} 0x{value:04X}"
            for register in (Register.VERSION, Register.FIRMWARE)
            if (value := self._read_if_there(register)) is not None
        )
        model = f"{self._settings.model.value}, {loop}, {pulses} pulses/rev"
        return Identity(_FAMILY, model, " ".join(versions))

    def state(self) -> AxisState:
        """Status, position and, where there is one, the alarm; see `Axis.state`."""
        return self._state_of(self._status())

    def home(self, pause: Pause) -> AxisState:
        """Let the drive look for its reference; see `Axis.home`."""
        self._must_be_ready()
        self._must_have_the_scale()
        self._homed = False
        timeout_s = self._settings.homing_s()
        with unless_done(self._give_up):
            self._write(Register.HOMING, homing_block(self._settings.home_search()))
            self._homing = True
            # Never re-sent either: a lost answer shows in the status, as a lost request does.
            with suppress(NoReply, FrameError):
                self._write_one(Register.TRIGGER, Trigger.HOME)
            watch = self._watch(Status.HOMED)
            status = self._wait(watch, "homing", timeout_s, pause)
            # The bit may be of the previous homing: without a start it proves nothing.
            if not (watch.started and Status.HOMED in status):
                raise Refused(
                    f"{self._name}: homing found no reference, the drive stands; "
                    "check the switch, its input and the direction of the search"
                )
            self._homing = False
            self._homed = True
            return self._state_of(status)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move in one frame, wait, read the position back and compare; see `Axis.move_to`."""
        self._must_be_inside(position)
        self._must_be_homed()
        self._must_be_ready()
        self._must_be_homed()  # the drive may have said otherwise
        timeout_s = self._settings.move_s(position - self._position_mm())
        with unless_done(self._give_up):
            lost = self._start(self._settings.path_to(position))
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
        for tries_left in reversed(range(_STOP_TRIES)):
            try:
                self._write_one(Register.TRIGGER, Trigger.STOP)
            except (NoReply, FrameError) as lost:
                if not tries_left:
                    lost.add_note(f"{self._name}: the stop was not acknowledged: emergency stop!")
                    raise
            else:
                return

    def recipes(self) -> tuple[Recipe, ...]:
        """Stop, and read the status until it no longer runs; see `drivers.recipes`."""
        bus, device_id = self._bus, self._device_id
        stop = write_register(bus, device_id, Register.TRIGGER, Trigger.STOP)
        stands = without_bits(bus, device_id, 3, Register.STATUS, Status.RUNNING)
        wire_s, rest_s = bus.wire_s(len(stop.send)), self._settings.braking_s() + 0.5
        return (Recipe(self._name, Order.AXIS, (stop,), (stands,), bus.quiet_s, wire_s, rest_s),)

    def clear_alarm(self) -> None:
        """Reset the drive's alarm, once, because a person asked; forgets "homed"."""
        self._homed = False
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
        try:
            self.stop()
        except DriverError as failed:
            raise Refused(f"{self._name}: the stop failed: {failed}") from failed

    def _must_be_inside(self, position_mm: float) -> None:
        low_mm, high_mm = self._settings.low_mm, self._settings.high_mm
        if not math.isfinite(position_mm):
            raise ValueError(f"{self._name}: {position_mm} mm is no position")
        if not low_mm <= position_mm <= high_mm:
            raise Refused(
                f"{self._name}: {position_mm:.3f} mm is outside its soft limits "
                f"{low_mm:.3f} to {high_mm:.3f} mm; change the target or the limits"
            )

    def _must_be_homed(self) -> None:
        if not self._homed:
            raise Refused(f"{self._name}: not homed, its position means nothing; home it first")

    def _must_be_ready(self) -> None:
        status = self._status()
        self._must_be_sound(status)
        if Status.RUNNING in status:
            raise Refused(f"{self._name}: is still moving; stop it first")

    def _must_be_sound(self, status: Status) -> None:
        if Status.FAULT in status:
            code = self._read(Register.ALARM)
            raise Refused(
                f"{self._name}: alarm {alarm_name(self._settings.model, code)}; "
                "remove the cause, clear the alarm, home again",
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
            self._homed = False
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
            self._homed = False
            raise
        except Refused as refused:
            if refused.code != DAMAGED_REQUEST:
                raise
            raise FrameError(f"{self._name}: the drive got a damaged request") from refused
