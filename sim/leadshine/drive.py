"""The drive itself: what it takes, what it does in time, and the words that tell of it.

What the bits of 0x1003 do in a move; bits 2 and 4 speak of the command, which the shaft lags, bit 5
of the path, which ends with the shaft at rest and the dwell over::

    trigger   delay                command ends   shaft rests, dwell over
    ---|--------|------------------------|--------------|------->
       | as before | 2 running           | 4 complete   | 4, 5 complete

So whoever looks too early sees the last move's bits, and whoever looks at bit 4 alone sees a shaft
that still moves, or one that was stopped half way. Bit 6 stays until the next homing, whatever
happens. Homing is no path: after it bits 4 and 6 stand, and bit 5 does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import IntFlag

from sim.device import ModbusRefusal
from sim.leadshine import registers as reg
from sim.leadshine.planning import Kind, Leg, Planner, Screw, Task
from sim.leadshine.registers import Alarm, Family, RegisterBank
from sim.leadshine.settings import LeadshineSettings
from sim.world import WorldAxis

_MOST_BYTES = 200  # of a message, either way
_MOST_WORDS_READ, _MOST_WORDS_WRITTEN = (_MOST_BYTES - 5) // 2, (_MOST_BYTES - 9) // 2
_HOME, _ZERO, _STOP = 0x20, 0x21, 0x40
_RESET_ALARM, _SAVE, _FACTORY = 0x1111, 0x2211, (0x2222, 0x2233)
_JOG_SIGNS = {0x4001: 1, 0x4002: -1}
_NOT_SAVED, _SAVED = 0x1111, 0x5555
_JOG_RENEWAL_S = 0.05


class _Status(IntFlag):
    FAULT = 1 << 0
    ENABLED = 1 << 1
    RUNNING = 1 << 2
    COMMAND_COMPLETE = 1 << 4
    PATH_COMPLETE = 1 << 5
    HOMED = 1 << 6


class LeadshineDrive:
    """One drive on the line; a `sim.device.ModbusUnit`."""

    crc_refusal = reg.BAD_CRC  # the standard wants silence

    def __init__(self, axis: WorldAxis, settings: LeadshineSettings | None = None) -> None:
        self.saves = 0  # each one wears the EEPROM
        self._axis = axis
        self._settings = settings or LeadshineSettings()
        self._saved = {
            reg.PULSES_PER_TURN: self._settings.pulses_per_turn, **self._settings.stored
        }  # fmt: skip
        self._start_afresh(axis.motor(0.0))

    def power_up(self, now_s: float) -> None:
        """Off and on again: unhomed, counting from 0, with what was saved."""
        self._start_afresh(self._axis.motor(now_s))
        if not self._axis.stands(now_s):
            self._brake(now_s)

    def _start_afresh(self, here_mm: float) -> None:
        self._bank = RegisterBank(self._settings.family, self._saved)
        self._screw = Screw.of(self._bank, self._settings, here_mm)
        self._flags = _Status(0)  # of the last thing done
        self._alarm: Alarm | None = None
        self._task: Task | None = None
        self._due: tuple[float, int] | None = None  # a command taken, not yet begun
        self._jogged_s = 0.0
        self._last_path = 0
        self._save_status = _NOT_SAVED

    def fail(self, alarm: Alarm, now_s: float) -> None:
        """Raise an alarm: the shaft brakes, and nothing moves until it is reset."""
        if alarm not in reg.ALARM_CODES[self._settings.family]:
            raise ValueError(f"leadshine: {self._settings.family.value} has no alarm {alarm.value}")
        self._alarm = alarm
        self._flags &= _Status.HOMED
        self._brake(now_s)

    def heard(self, now_s: float) -> None:
        """Nothing hangs on a frame as such: the drive has no communication watchdog."""

    def tick(self, now_s: float) -> None:
        """Begin what is due, go on with what is under way."""
        if self._due is not None and now_s >= self._due[0]:
            (_, command), self._due = self._due, None
            self._begin(command, now_s)
        if self._task is not None:
            self._go_on(self._task, now_s)

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """Refused: the drive knows functions 3, 6 and 16."""
        raise ModbusRefusal(reg.ILLEGAL_FUNCTION)

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """Refused likewise."""
        raise ModbusRefusal(reg.ILLEGAL_FUNCTION)

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Refused likewise."""
        raise ModbusRefusal(reg.ILLEGAL_FUNCTION)

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """Refused likewise."""
        raise ModbusRefusal(reg.ILLEGAL_FUNCTION)

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Some registers, as they stand now."""
        if count > _MOST_WORDS_READ:
            raise ModbusRefusal(reg.ILLEGAL_VALUE)
        self.tick(now_s)
        words = self._bank.words(first, count, self._live(now_s))
        if reg.SAVE_STATUS in range(first, first + count):
            self._save_status = _NOT_SAVED  # it is told once
        return words

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Store all words; then do what those of them that are commands say."""
        if len(words) > _MOST_WORDS_WRITTEN:
            raise ModbusRefusal(reg.ILLEGAL_VALUE)
        self.tick(now_s)
        self._bank.store(first, words)
        self._rescale(now_s)
        written = dict(enumerate(words, first))
        for address in (reg.PATH_CONTROL, reg.PATH_0_TRIGGER):
            if address in written:
                self._command(written[address], now_s)
        if reg.CONTROL_WORD in written:
            self._control(written[reg.CONTROL_WORD], now_s)
        if self._task is not None and not self._enabled():
            self._brake(now_s)

    # ---- what the registers tell

    def _live(self, now_s: float) -> dict[int, int]:
        position = reg.split(self._screw.pulses(self._axis.motor(now_s)))
        rpm = reg.split(self._rpm())
        live = {
            reg.MOTION_STATUS: int(self._status(now_s)),
            reg.SAVE_STATUS: self._save_status,
            reg.PATH_CONTROL: self._path_state(),
            reg.PATH_0_TRIGGER: self._path_state(),
        }
        if self._alarm is not None:
            live[reg.CURRENT_ALARM] = reg.ALARM_CODES[self._settings.family][self._alarm]
        for high in (reg.FEEDBACK_POSITION, reg.COMMAND_POSITION, reg.MOTOR_POSITION):
            live[high], live[high + 1] = position
        for high in (reg.PROFILE_RPM, reg.FEEDBACK_RPM):
            live[high], live[high + 1] = rpm
        return live

    def _status(self, now_s: float) -> _Status:
        word = self._flags
        if self._alarm is not None:
            word |= _Status.FAULT
        elif self._enabled():
            word |= _Status.ENABLED
        if self._task is not None:
            runs = self._command_runs(self._task, now_s)
            word |= _Status.RUNNING if runs else _Status.COMMAND_COMPLETE
        return word

    def _command_runs(self, task: Task, now_s: float) -> bool:
        """Whether the command, which the shaft lags, is still under way."""
        if task.kind is not Kind.PATH:
            return True
        stands_still = task.legs[0].speed_mm_s == 0.0  # at 0 r/min, for ever
        return stands_still or now_s < self._axis.ends_s() - self._settings.lag_s

    def _path_state(self) -> int:
        """What 0x6002 reads: the command until it is begun, 0x10P while path P runs, then 0x00P."""
        if self._due is not None:
            return self._due[1]
        runs = self._task is not None and self._task.kind is not Kind.STOPPING
        return (0x100 if runs else 0) | self._last_path

    def _rpm(self) -> int:
        """The speed commanded now; ramps are not told."""
        if self._task is None or not self._task.legs:
            return 0
        leg = self._task.legs[0]
        return round(leg.speed_mm_s / self._screw.lead_mm * 60.0)

    def _enabled(self) -> bool:
        """By register, or by an input to which nothing is wired and that enables when open."""
        inputs = (self._bank.word(address) for address in reg.INPUT_FUNCTIONS)
        return self._bank.word(reg.FORCED_ENABLE) == 1 or reg.ENABLE_IF_OPEN in inputs

    # ---- what it is told

    def _rescale(self, now_s: float) -> None:
        """Keep the count where pulses per turn or direction were changed."""
        here_mm = self._axis.motor(now_s)
        count = self._screw.pulses(here_mm)
        after = Screw.of(self._bank, self._settings, self._screw.zero_mm)
        if after != self._screw:
            self._screw = replace(after, zero_mm=here_mm - count * after.mm_per_pulse)

    def _command(self, word: int, now_s: float) -> None:
        if word == _STOP:
            self._stop(now_s)
        elif word == _ZERO and self._task is None:
            self._screw = replace(self._screw, zero_mm=self._axis.motor(now_s))
        elif word in (0, _ZERO) or not self._can_begin():
            return
        else:
            self._due = (now_s + self._settings.trigger_delay_s, word)

    def _stop(self, now_s: float) -> None:
        if self._task is None and self._due is None:
            self._axis.brake(now_s)  # it stands, and the last path stays complete
            return
        self._flags &= ~_Status.PATH_COMPLETE
        self._brake(now_s)

    def _control(self, word: int, now_s: float) -> None:
        if word == _RESET_ALARM:
            self._alarm = None
        elif word == _SAVE:
            self._saved, self._save_status = self._bank.copy(), _SAVED
            self.saves += 1
        elif word in _FACTORY:
            self._bank = RegisterBank(self._settings.family, {})
            self._rescale(now_s)
        elif (sign := _JOG_SIGNS.get(word)) is not None:
            self._jog(sign, now_s)

    def _jog(self, sign: int, now_s: float) -> None:
        self._jogged_s = now_s
        if self._can_begin():
            self._flags &= _Status.HOMED
            rpm, ramp_ms = (
                self._bank.word(address) for address in (reg.JOG_RPM, reg.JOG_MS_PER_1000_RPM)
            )
            self._start(self._planner().endless(Kind.JOG, sign * rpm, ramp_ms), now_s)

    def _can_begin(self) -> bool:
        """A path under way is not interrupted: the mode's bit for that is not simulated."""
        return self._task is None and self._alarm is None and self._enabled()

    # ---- what it does in time

    def _begin(self, command: int, now_s: float) -> None:
        if not self._can_begin():
            return
        if command == _HOME:
            task = self._planner().homing(self._axis.motor(now_s))
            self._flags = _Status(0)
        else:
            self._last_path = command & 0x0F
            task = self._planner().path(self._last_path, self._axis.motor(now_s))
            self._flags &= _Status.HOMED
        if task is not None:
            self._start(task, now_s)

    def _planner(self) -> Planner:
        return Planner(self._bank, self._settings, self._screw)

    def _start(self, task: Task, now_s: float) -> None:
        self._task = task
        leg = task.legs[0]
        if leg.speed_mm_s > 0.0:
            self._axis.go(
                leg.target_mm, now_s, speed=leg.speed_mm_s, acceleration=leg.acceleration_mm_s2
            )

    def _brake(self, now_s: float) -> None:
        self._due = None
        self._axis.brake(now_s)
        self._task = Task(Kind.STOPPING)

    def _go_on(self, task: Task, now_s: float) -> None:
        if task.kind is Kind.JOG and now_s - self._jogged_s > _JOG_RENEWAL_S:
            self._brake(now_s)
        elif not self._axis.stands(now_s):
            return
        elif task.kind is Kind.STOPPING:
            self._finish(_Status.COMMAND_COMPLETE)
        elif self._axis.blocked(now_s) and not task.legs[0].held_is_there:
            self._held(task.legs[0], now_s)
        elif task.legs[0].speed_mm_s > 0.0 and now_s >= self._axis.ends_s() + task.dwell_s:
            self._arrived(task, now_s)

    def _held(self, leg: Leg, now_s: float) -> None:
        """Something is in the way: told where there is an encoder, else counted as if gone."""
        if self._settings.family is Family.CS2RS:
            self.fail(Alarm.FOLLOWING_ERROR, now_s)
            return
        lost_mm = leg.target_mm - self._axis.motor(now_s)
        self._screw = replace(self._screw, zero_mm=self._screw.zero_mm - lost_mm)
        self._axis.brake(now_s)  # it no longer wants to go on

    def _arrived(self, task: Task, now_s: float) -> None:
        legs = task.legs[1:]
        if task.legs[0].finds_home:
            here_mm = self._axis.motor(now_s)
            zero_mm = self._planner().zero_at_home_mm(here_mm)
            self._screw = replace(self._screw, zero_mm=zero_mm)
            legs = self._planner().after_home()
        if legs:
            self._start(replace(task, legs=legs), now_s)
        elif task.kind is Kind.HOMING:
            self._finish(_Status.COMMAND_COMPLETE | _Status.HOMED)
        elif task.completes:
            self._finish(_Status.COMMAND_COMPLETE | _Status.PATH_COMPLETE)
        else:
            self._finish(_Status.COMMAND_COMPLETE)

    def _finish(self, flags: _Status) -> None:
        self._task = None
        if self._alarm is None:
            self._flags |= flags
