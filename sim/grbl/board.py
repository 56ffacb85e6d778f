"""A Grbl 1.1h board that turns one table.

After gnea/grbl, its documentation and the behaviour of its firmware. The main program is a
generator, which stands still wherever the firmware waits: for characters, for room in the planner,
for the motor, for a dwell. Realtime characters never enter its buffer; they act at once::

    bytes -+- ? ! ~ 0x18 0x85 0x90..97 --> at once
           '- the rest --> 128 bytes --> lines --> `$` or G-code --> planner --> motor

What traps hosts, and is so here too: `ok` means understood, not done; 0x85 does nothing once a jog
has ended (and in the very moment it suspends the idle board), whereas `!` then leaves a Hold; in
either no line is answered until `~`; while it homes, any number of `?` are answered once, at its
end; an alarm keeps it deaf for half a second, after alarms 1 and 2 to all but a reset; bytes beyond
the buffer are lost without a word.

Not here: the safety door, sleep, check mode and startup lines. An override holds from the next
block on. Delays of the firmware (dwell, debounce, alarm) pass in wall time, moves in station time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Generator

from sim.grbl import reports
from sim.grbl.cycle import BLOCKS, Cycle, State
from sim.grbl.gcode import LineBuffer
from sim.grbl.homing import Aim, Pass, origin_steps, passes, pressed, steps_to_switch
from sim.grbl.moves import Motion, Move
from sim.grbl.numbers import degrees_of, printed, steps_of
from sim.grbl.parser import Order, Parser
from sim.grbl.refusal import CRITICAL, Alarm, Alarmed, Error, Refusal
from sim.grbl.settings import Eeprom, GrblSettings
from sim.grbl.stepper import Stepper
from sim.world import WorldAxis

_RESET, _HOLD, _RESUME, _STATUS, _JOG_CANCEL = 0x18, 0x21, 0x7E, 0x3F, 0x85
_FIRST_EXTENDED = 0x80  # from here on no character enters the buffer
_REPORT_MASK, _INCHES, _HARD_LIMITS, _HOMING, _DEBOUNCE, _FASTEST_RPM = 10, 13, 21, 22, 26, 30
_DEAF_AFTER_ALARM_S = 0.5
_DWELL_TICKS_S = 20.0  # a dwell lasts whole ticks of 50 ms
_PAUSE = 0
_DRIVES_SPINDLE = {3: "S", 4: "C"}
_COOLING = {8: "F"}
_NOT_NUMBERS = "#HINSRC"  # what the firmware reads as other commands
_MOVING = (State.RUN, State.JOG, State.HOME)

_Program = Generator[Callable[[], bool], None, None]


class GrblBoard:
    """A Device; it is powered when it is first called.

    `spindle` is told, with the time, whether the spindle's output is on.
    """

    def __init__(
        self,
        axis: WorldAxis,
        settings: GrblSettings | None = None,
        spindle: Callable[[float, bool], None] | None = None,
    ) -> None:
        self._settings = settings or GrblSettings()
        self._eeprom = Eeprom(self._settings)
        self._stepper = Stepper(axis, self._settings.steps_per_deg)
        self._cycle = Cycle(self._stepper, self._eeprom, late_cancel_s=self._settings.late_cancel_s)
        self._spindle = spindle
        self._now_s = -math.inf
        self._wake_s = math.inf
        self._said = bytearray()
        self._limit_pressed = False
        self._reset_asked = False
        self._start_afresh(0.0)
        self._program = self._life()
        self._ready: Callable[[], bool] = _at_once

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take characters off the wire, in whatever pieces they come; return the answers."""
        self._advance(now_s)
        for byte in data:
            self._take(byte)
            self._run()
            self._advance(now_s)  # what takes no time is done before the next character
            self._drive_spindle()
        return self._spoken()

    def tick(self, now_s: float) -> bytes:
        """Do what time has brought, and return what is said unasked."""
        self._advance(now_s)
        return self._spoken()

    def power_cycle(self, now_s: float) -> None:
        """Lose power and get it back; only the EEPROM remembers."""
        self._advance(now_s)
        self._stepper.kill(now_s)
        self._power_up()

    def press_limit(self, now_s: float) -> None:
        """Press the limit switch, until it is released; any change of it is an alarm, if `$21`."""
        self._change_limit(now_s, pressed_now=True)

    def release_limit(self, now_s: float) -> None:
        """Let go of the limit switch."""
        self._change_limit(now_s, pressed_now=False)

    def _change_limit(self, now_s: float, *, pressed_now: bool) -> None:
        self._advance(now_s)
        self._limit_pressed = pressed_now
        blind = self._cycle.state in (State.ALARM, State.HOME)
        if self._eeprom[_HARD_LIMITS] and not blind:
            self._die(Alarm.HARD_LIMIT)

    # Time: everything happens when it is due, however late the board is asked.

    def _advance(self, now_s: float) -> None:
        if self._now_s == -math.inf:
            self._now_s = now_s
            self._power_up()
        while (due_s := self._due_s()) <= now_s:
            self._now_s = due_s
            self._wake_s = math.inf if self._wake_s <= due_s else self._wake_s
            if self._cycle.settle(due_s):
                self._parser.position_deg = self._position_deg()
            self._run()
        self._now_s = max(now_s, self._now_s)
        self._drive_spindle()

    def _due_s(self) -> float:
        ends_s = self._stepper.ends_s() if self._stepper.moving else math.inf
        return min(ends_s, self._wake_s)

    def _run(self) -> None:
        while not self._cycle.suspended and self._ready():
            try:
                self._ready = next(self._program)
            except Alarmed as alarmed:
                self._die(alarmed.alarm)

    def _wait(self, seconds: float) -> _Program:
        wake_s = self._wake_s = self._now_s + seconds
        yield lambda: self._now_s >= wake_s

    # Realtime characters.

    def _take(self, byte: int) -> None:
        if byte == _RESET:
            self._reset()
        elif byte == _STATUS:
            self._status_asked = True
            if not self._deaf:
                self._report_status()
        elif byte in (_HOLD, _RESUME) or byte >= _FIRST_EXTENDED:
            if not self._deaf:
                self._act(byte)
        elif len(self._rx) < reports.RX_BUFFER:
            self._rx.append(byte)

    def _act(self, byte: int) -> None:
        if byte == _HOLD:
            self._cycle.hold(self._now_s)
        elif byte == _RESUME:
            self._cycle.resume(self._now_s)
        elif byte == _JOG_CANCEL:
            self._cycle.cancel_jog(self._now_s)
        elif self._cycle.override(byte):
            self._status.overrides_changed()

    def _reset(self) -> None:
        self._reset_asked = True
        if self._dying:
            return
        if self._cycle.state is State.HOME:
            self._die(Alarm.HOMING_RESET)
        elif self._cycle.state in _MOVING or self._cycle.braking:
            self._die(Alarm.RESET_IN_MOTION)
        else:
            lasting = self._cycle.state is State.ALARM
            self._cycle.reset(State.ALARM if lasting else State.IDLE)
            self._restart(self._life())

    # What the main program does, from power-up or reset on.

    def _power_up(self) -> None:
        self._cycle.reset(State.ALARM if self._eeprom[_HOMING] else State.IDLE)
        self._restart(self._life(counted=0))

    def _restart(self, program: _Program) -> None:
        self._deaf, self._wake_s = True, math.inf
        self._program, self._ready = program, _at_once
        self._run()

    def _die(self, alarm: Alarm) -> None:
        self._stepper.kill(self._now_s)
        self._cycle.reset(State.ALARM)
        self._dying = True
        self._restart(self._death(alarm))

    def _death(self, alarm: Alarm) -> _Program:
        self._say(f"ALARM:{alarm.value}")
        yield from self._wait(_DEAF_AFTER_ALARM_S)
        if alarm in CRITICAL:
            self._say(reports.RESET_FIRST)
            self._reset_asked = False  # one sent in the meantime is lost
            yield lambda: self._reset_asked
        yield from self._life()

    def _life(self, counted: int | None = None) -> _Program:
        yield lambda: not self._stepper.moving  # a motor that was cut off coasts
        if counted is not None:
            self._stepper.redefine(counted, self._now_s)
        self._start_afresh(self._position_deg())
        self._say(reports.HAL_BANNER if self._settings.hal else reports.BANNER)
        if self._eeprom[_HARD_LIMITS] and self._limit_pin():
            self._cycle.state = State.ALARM
            self._say(reports.CHECK_LIMITS)
        if self._cycle.state is State.ALARM:
            self._say(reports.UNLOCK_FIRST)
        while True:
            yield lambda: bool(self._rx)
            yield from self._character(self._rx.popleft())

    def _start_afresh(self, position_deg: float) -> None:
        self._rx: deque[int] = deque()
        self._line = LineBuffer()
        self._status = reports.StatusReports()
        axes, letter = self._settings.axes, self._settings.letter
        self._parser = Parser(self._eeprom, axes, letter, position_deg)
        self._deaf = self._dying = self._status_asked = False

    def _character(self, byte: int) -> _Program:
        try:
            line = self._line.take(byte)
            if line is None:
                return
            yield from self._execute(line)
        except Refusal as refusal:
            self._say(str(refusal))
        else:
            self._say("ok")

    def _execute(self, line: str) -> _Program:
        if line.startswith("$"):
            yield from self._command(line[1:])
        elif line and self._cycle.state in (State.ALARM, State.JOG):
            raise Refusal(Error.LOCKED)
        elif line:
            yield from self._do(self._parser.order(line))

    def _command(self, command: str) -> _Program:
        state = self._cycle.state
        if command.startswith("J"):
            yield from self._jog(command)
        elif command[:1] in ("", "$", "G", "X"):
            self._ask(command)
        elif state not in (State.IDLE, State.ALARM):
            raise Refusal(Error.NOT_IDLE)
        elif command == "H" or self._homes_alone(command):
            yield from self._home()
        elif command in ("#", "I", "N"):
            self._tell(command)
        elif command[0] in _NOT_NUMBERS:
            raise Refusal(Error.INVALID_STATEMENT)
        else:
            self._eeprom.store(command)
            if command.startswith(f"{_INCHES}="):
                self._status.offset_changed()

    def _ask(self, command: str) -> None:
        """Answer what is answered in motion, too."""
        if len(command) > 1:
            raise Refusal(Error.INVALID_STATEMENT)
        if command == "":
            self._say(reports.HELP)
        elif command == "G":
            parser, form = self._parser, self._format()
            speed = printed(parser.speed_rpm, 0)
            self._say(parser.modes.report(parser.tool, form.rate(parser.feed_deg_min), speed))
        elif command == "X" and self._cycle.state is State.ALARM:
            self._say(reports.UNLOCKED)
            self._cycle.state = State.IDLE
        elif command == "$":
            if self._cycle.state is State.RUN:
                raise Refusal(Error.NOT_IDLE)
            self._say(*self._eeprom.listing())

    def _tell(self, command: str) -> None:
        if command == "#":
            parser, form = self._parser, self._format()
            self._say(*reports.parameters(self._eeprom.offsets_deg, parser.g92_deg, form))
        elif command == "I":
            self._say(*reports.build_info(self._settings.axes, BLOCKS, hal=self._settings.hal))
        else:
            self._say("$N0=", "$N1=")

    def _do(self, order: Order) -> _Program:
        if self._parser.must_wait(order):
            yield lambda: self._cycle.drained
        if order.dwell_s is not None:
            yield from self._wait(math.ceil(order.dwell_s * _DWELL_TICKS_S) / _DWELL_TICKS_S)
        if self._parser.accept(order):
            self._status.offset_changed()
        if order.motion is not None:
            yield from self._move(order.motion)
        if order.flow is not None:
            yield lambda: self._cycle.drained
            self._flow(order.flow)
            yield _at_once  # a pause stands still here

    def _flow(self, flow: int) -> None:
        if flow == _PAUSE:
            self._cycle.hold(self._now_s)
            return
        self._parser.modes = self._parser.modes.ended()
        self._cycle.restore_overrides()
        self._status.offset_changed()
        self._say(reports.PROGRAM_ENDED)

    def _move(self, motion: Motion) -> _Program:
        if not self._eeprom.within_travel(motion.target_deg):
            if self._cycle.state is State.RUN:
                self._cycle.going_idle = True
                self._cycle.hold(self._now_s)
            yield lambda: self._cycle.state is State.IDLE
            raise Alarmed(Alarm.SOFT_LIMIT)
        yield from self._plan(motion)

    def _jog(self, command: str) -> _Program:
        if self._cycle.state not in (State.IDLE, State.JOG):
            raise Refusal(Error.NOT_IDLE)
        if not command.startswith("J="):
            raise Refusal(Error.INVALID_STATEMENT)
        motion = self._parser.jog(command[2:])
        if not self._eeprom.within_travel(motion.target_deg):
            raise Refusal(Error.TRAVEL_EXCEEDED)
        yield from self._plan(motion)

    def _plan(self, motion: Motion) -> _Program:
        yield lambda: self._cycle.free > 0
        target = steps_of(motion.target_deg, self._eeprom.steps_per_deg)
        self._cycle.plan(Move(target, motion.feed_deg_min, motion.pace), self._now_s)
        self._parser.position_deg = motion.target_deg

    def _home(self) -> _Program:
        if not self._eeprom[_HOMING]:
            raise Refusal(Error.HOMING_DISABLED)
        self._cycle.state, self._deaf = State.HOME, True
        for each in passes(self._eeprom):
            yield from self._pass(each)
        self._stepper.redefine(origin_steps(self._eeprom), self._now_s)
        self._parser.position_deg = self._position_deg()
        if self._status_asked:
            self._report_status()
        self._cycle.state, self._deaf = State.IDLE, False

    def _homes_alone(self, command: str) -> bool:
        """Whether it is grblHAL's homing of the one axis that has a motor, and that is allowed."""
        alone = self._settings.hal and int(self._eeprom[_HOMING]) & 2
        return bool(alone) and command == f"H{self._settings.letter}"

    def _pass(self, each: Pass) -> _Program:
        way = steps_of(each.way_deg, self._eeprom.steps_per_deg)
        missed = False
        if each.aim is Aim.TO_SWITCH:
            motor_deg = self._stepper.motor_deg(self._now_s)
            left = steps_to_switch(motor_deg, each.way_deg, self._settings)
            missed = left > abs(way)
            way = way if missed else int(math.copysign(left, way))
        start = self._stepper.count(self._now_s)
        self._cycle.drive(start + way, each.rate_deg_min, self._now_s)
        yield lambda: not self._stepper.moving
        if missed:
            raise Alarmed(Alarm.SWITCH_NOT_FOUND)
        yield from self._wait(self._eeprom[_DEBOUNCE] / 1000.0)
        if each.aim is Aim.OFF_SWITCH and self._limit_pin():
            raise Alarmed(Alarm.PULL_OFF_FAILED)

    # What it says.

    def _report_status(self) -> None:
        cycle, parser = self._cycle, self._parser
        spindle_turns = parser.modes.spindle in _DRIVES_SPINDLE
        seen = reports.Seen(
            label=cycle.label,
            busy=cycle.busy,
            position_deg=self._position_deg(),
            offset_deg=parser.offset_deg,
            free_blocks=cycle.free,
            free_bytes=reports.RX_BUFFER - len(self._rx),
            rate_deg_min=cycle.rate_deg_min(self._now_s),
            speed_rpm=min(parser.speed_rpm, self._eeprom[_FASTEST_RPM]) if spindle_turns else 0.0,
            pin=self._settings.letter if self._limit_pin() else "",
            overrides=(cycle.feed_percent, cycle.rapid_percent, 100),
            accessories=_DRIVES_SPINDLE.get(parser.modes.spindle, "")
            + _COOLING.get(parser.modes.coolant, ""),
        )
        self._say(self._status.report(seen, int(self._eeprom[_REPORT_MASK]), self._format()))
        self._status_asked = False

    def _format(self) -> reports.Format:
        settings = self._settings
        return reports.Format(len(settings.axes), settings.index, bool(self._eeprom[_INCHES]))

    def _position_deg(self) -> float:
        return degrees_of(self._stepper.count(self._now_s), self._eeprom.steps_per_deg)

    def _drive_spindle(self) -> None:
        """Drive what hangs on the output; a reset or an alarm stops it before anything else."""
        if self._spindle is not None:
            turns = self._parser.modes.spindle in _DRIVES_SPINDLE and self._parser.speed_rpm > 0.0
            alive = not self._dying and self._cycle.state is not State.ALARM
            self._spindle(self._now_s, turns and alive)

    def _limit_pin(self) -> bool:
        return self._limit_pressed or pressed(self._stepper.motor_deg(self._now_s), self._settings)

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._said += line.encode("ascii") + b"\r\n"

    def _spoken(self) -> bytes:
        said = bytes(self._said)
        self._said.clear()
        return said


def _at_once() -> bool:
    return True
