"""A rotary table or a linear axis on Grbl 1.1 or grblHAL.

Stock Grbl knows no rotary axis: a table is wired to X, Y or Z with its steps per "mm" set to steps
per degree. Grbl's mm are then degrees, its mm a minute degrees a minute, and nothing wraps: the
unwrapped angle of `drivers.axis` is simply what the controller counts. Degrees stand here only
where a line is made or a report is read::

    position (rad or mm)  --to_wire-->  + zero  -->  machine coordinates (G53), never work ones

Grbl has no checksum and is open loop, so no motion is believed: it is over when two reports agree
that the controller is idle (or one does, at the target), and the position read back is compared.
One report is not enough by itself, since `ok` comes before the planner has started to move.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from typing import Final

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.grbl.messages import (
    Error,
    State,
    Status,
    Vector,
    alarm_name,
    alarm_remedy,
    error_name,
    error_remedy,
)
from drivers.grbl.wire import FENCE, Dialogue, Realtime, feed_move, jog
from drivers.links import ByteLink

_LETTERS: Final = "XYZABC"  # in the order of a report
_STEP_S: Final = 0.005  # between looks at the link while an answer is due
_ANSWER_S: Final = 1.0  # Grbl reports within 5 to 20 ms; a line waits for room in the planner
_REPORT_S: Final = 0.5
_BANNER_S: Final = 2.5  # an Arduino's boot loader takes 2 s after the port opens
_QUIET_S: Final = 0.1
_STOP_POLL_S: Final = 0.05
_DRAIN_READS: Final = 64
_UNHOMED_JOG: Final = 1.0  # degree or mm, from where the axis stands


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
    poll_s: float = 0.1

    def __post_init__(self) -> None:
        if self.letter not in _LETTERS or len(self.letter) != 1:
            raise ValueError(f"{self.name}: an axis letter of {_LETTERS}, not {self.letter!r}")
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


class _Doing(Enum):
    """What was last asked of the controller."""

    NOTHING = "nothing"
    JOG = "jog"
    FEED = "feed"
    HOMING = "homing"


class _Lines(Enum):
    """Whether a line that was sent may still start something."""

    ANSWERED = "answered"
    OPEN = "open"


_ENDING: Final = {
    _Doing.NOTHING: Realtime.JOG_CANCEL,  # harmless when nothing moves, and never elided
    _Doing.JOG: Realtime.JOG_CANCEL,
    _Doing.FEED: Realtime.HOLD,
    _Doing.HOMING: Realtime.RESET,  # the homing loop hears nothing else
}


class _Conversation:
    """The dialogue over a link: send-response, reports, resets; every wait bounded.

    Without a `pause` it waits in the link, with one it waits in the caller's hands.
    """

    def __init__(self, link: ByteLink, name: str, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.dialogue = Dialogue()
        self._link = link
        self._name = name

    def exchange(self, line: str, pause: Pause | None, *, within_s: float = _ANSWER_S) -> None:
        """Send one line and see it answered ok; never sends it twice."""
        dialogue = self.dialogue
        alarm, upsets = dialogue.alarm, dialogue.upsets
        self.write(dialogue.send(line))
        self.until(lambda: not dialogue.outstanding or dialogue.alarm is not alarm, within_s, pause)
        if isinstance(dialogue.answer, Error):
            code = dialogue.answer.number
            raise Refused(
                f"{self._name}: {line} refused, {error_name(code)}; {error_remedy(code)}", code=code
            )
        if dialogue.answer is not None:
            return
        if dialogue.outstanding:
            dialogue.give_up()
        if dialogue.upsets != upsets:
            raise self.upset(line)
        raise NoReply(f"{self._name}: {line} was not answered in {within_s:.1f} s; check the cable")

    def status(self, pause: Pause | None) -> Status:
        """One report, asked for at most twice."""
        damaged = self.dialogue.unknown_lines
        for _ in range(2):
            status = self.report(pause, within_s=_REPORT_S)
            if status is not None:
                return status
            if self.dialogue.locked:
                raise self.upset("a report")
            self.until(lambda: False, _QUIET_S, pause)
        damaged = self.dialogue.unknown_lines - damaged
        if damaged:
            raise FrameError(
                f"{self._name}: {damaged} unreadable lines and no report; check baud rate and cable"
            )
        raise NoReply(
            f"{self._name}: no report in {2 * _REPORT_S} s at {self._link.address}; is the"
            " controller on, and is this its port?"
        )

    def report(self, pause: Pause | None, *, within_s: float) -> Status | None:
        dialogue = self.dialogue
        self.write(dialogue.ask())
        self.until(lambda: dialogue.status is not None or dialogue.locked, within_s, pause)
        return dialogue.status

    def reset(self, pause: Pause | None, *, within_s: float) -> bool:
        """Whether the banner came."""
        self.write(self.dialogue.reset())
        return self.until(lambda: self.dialogue.banner is not None, within_s, pause)

    def upset(self, during: str) -> Refused:
        """Why the position is no longer believed."""
        alarm, status = self.dialogue.alarm, self.dialogue.status
        if alarm is None and (status is None or status.state not in (State.ALARM, State.SLEEP)):
            return Refused(
                f"{self._name}: the controller restarted during {during}; check its supply, home"
            )
        code = None if alarm is None else alarm.number
        remedy = "home it" if code is None else alarm_remedy(code)
        return Refused(f"{self._name}: {self.alarm_text()} during {during}; {remedy}", code=code)

    def alarm_text(self) -> str:
        alarm, status = self.dialogue.alarm, self.dialogue.status
        if alarm is not None:
            return alarm_name(alarm.number)
        if status is None or status.state is not State.ALARM:
            return "asleep"
        return alarm_name(status.substate) if status.substate else "locked since it started"

    def setting(self, code: int) -> float:
        text = self.dialogue.settings.get(code, "none")
        try:
            return float(text)
        except ValueError as wrong:
            raise FrameError(
                f"{self._name}: ${code} is {text!r}, a number was due; is this a Grbl 1.1?"
            ) from wrong

    def rate(self, code: int) -> float:
        """A setting that divides."""
        value = self.setting(code)
        if not value > 0:
            raise Refused(f"{self._name}: ${code} is {value:g}; set it above zero", code=code)
        return value

    def until(self, done: Callable[[], bool], within_s: float, pause: Pause | None) -> bool:
        """Listen until `done` or the time is over; the caller is heard every 5 ms."""
        deadline_s = self.clock() + within_s
        while not done():
            left_s = deadline_s - self.clock()
            if left_s <= 0:
                return False
            self._listen(min(left_s, _STEP_S), pause)
        return True

    def _listen(self, seconds: float, pause: Pause | None) -> None:
        """Take what came; wait for more in the caller's hands where there is a caller."""
        try:
            data = self._link.read(seconds if pause is None else 0.0)
        except LinkLost:
            self.dialogue.upsets += 1
            raise
        self.dialogue.feed(data)
        if pause is not None:
            pause(0.0 if data else seconds)

    def drain(self) -> None:
        """Take what lay in the port: nothing of before the reset may answer for it."""
        for _ in range(_DRAIN_READS):
            data = self._link.read(0.0)
            if not data:
                return
            self.dialogue.feed(data)

    def write(self, data: bytes) -> None:
        try:
            self._link.write(data)
        except LinkLost:
            self.dialogue.upsets += 1
            raise


class GrblAxis:
    """One axis of a Grbl controller; keeps `drivers.axis.Axis`.

    The first question opens the dialogue with a soft reset, which ends any motion; nothing moves
    by it. `jog_to` is for people at the bench: it works unhomed within one degree or millimetre.
    """

    def __init__(self, link: ByteLink, settings: Settings, *, clock: Callable[[], float]) -> None:
        self._settings = settings
        self._talk = _Conversation(link, settings.name, clock)
        self._identity: Identity | None = None
        self._doing = _Doing.NOTHING
        self._zero = 0.0  # machine coordinate of position 0, in the wire's unit
        self._homed_at: int | None = None  # the dialogue's count of upsets when homed
        self._taken_up = False  # the last motion went up by the backlash or more

    # --- what an axis does -------------------------------------------------------------------

    @property
    def kind(self) -> Kind:
        """Rotary or linear."""
        return self._settings.kind

    def identify(self) -> Identity:
        """Reset the controller, ask who it is and compare its settings.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            Its steps a unit are not the expected ones, or it reports inches; `code` is the setting.
        """
        return self._identity or self._open(None)

    def state(self) -> AxisState:
        """Ask for a report.

        The position is NaN after an alarm that silences the controller until it is reset.
        """
        if self._talk.dialogue.locked:
            return AxisState(Motion.ALARM, math.nan, homed=False, alarm=self._talk.alarm_text())
        return self._axis_state(self._talk.status(None))

    def home(self, pause: Pause) -> AxisState:
        """Find the switch, or name the place where the axis stands its zero."""
        self._taken_up = False
        self._homed_at = None
        self._ready(pause)
        self._unlock(pause)
        if self._settings.homing is Homing.SWITCH:
            self._find_switch(pause)
        status = self._idle(pause)
        self._zero = self._machine(status) - self._settings.to_wire(self._settings.home_position)
        self._homed_at = self._talk.dialogue.upsets
        return self._axis_state(status)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move in a straight feed (G1) in machine coordinates."""
        self._check_limits(position)
        if not self._homed:
            raise Refused(f"{self._name}: not homed; home it first")
        return self._travel(self._settings.to_wire(position), _Doing.FEED, pause)

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move by a jog: cancelled by one byte, refused beyond the controller's own travel."""
        self._check_limits(position)
        return self._travel(self._settings.to_wire(position), _Doing.JOG, pause)

    def stop(self) -> None:
        """Stop, gently if the controller can, else by a reset that loses the position.

        Waits behind nothing: the bytes go past any line, and a line that Grbl has not read yet
        is stopped when it starts.

        Raises
        ------
        NoReply
            The stop was not confirmed: press the emergency stop.
        LinkLost
        """
        doing, self._doing = self._doing, _Doing.NOTHING
        self._taken_up = False
        if doing is not _Doing.HOMING and self._comes_to_rest(_ENDING[doing]):
            if doing is _Doing.JOG:
                self._talk.dialogue.give_up()  # asks whether lines are heard before the next
            return
        self._homed_at = None
        if not self._talk.reset(None, within_s=_BANNER_S):
            raise NoReply(
                f"{self._name}: the stop was not confirmed in {_BANNER_S} s; press the"
                " emergency stop"
            )

    # --- moving ------------------------------------------------------------------------------

    def _travel(self, target: float, doing: _Doing, pause: Pause) -> AxisState:
        self._ready(pause)
        status = self._idle(pause)
        here = self._position(status)
        if not self._homed and abs(target - here) > _UNHOMED_JOG:
            raise Refused(
                f"{self._name}: not homed; it jogs at most {_UNHOMED_JOG:g} {self._settings.unit}"
            )
        for leg in self._legs(here, target):
            status = self._leg(here, leg, doing, pause)
            here = self._position(status)
        self._taken_up = self._settings.backlash > 0
        return self._axis_state(status)

    def _legs(self, here: float, target: float) -> list[float]:
        # From below: the play of the gear is always taken up in one direction.
        slack = self._settings.to_wire(self._settings.backlash)
        if slack == 0 or (self._taken_up and target >= here):
            return [target]
        before = target - slack
        if self._homed:
            self._check_limits(self._settings.from_wire(before))
        return [before, target]

    def _leg(self, here: float, target: float, doing: _Doing, pause: Pause) -> Status:
        """Send one move, once, and see it end where it should."""
        spell = jog if doing is _Doing.JOG else feed_move
        line = spell(self._settings.letter, target + self._zero, self._feed_per_min())
        lost: NoReply | None = None
        self._taken_up = False
        with self._stopped_unless_done(doing):
            try:
                self._talk.exchange(line, pause)
            except NoReply as unanswered:
                lost = unanswered  # it may have been heard: the position decides, not a second try
            status = self._until_standing(target, abs(target - here), pause)
            self._compare(target, self._position(status), lost)
        return status

    @contextmanager
    def _stopped_unless_done(self, doing: _Doing) -> Iterator[None]:
        """Stop on every way out but the good one, whatever is raised."""
        self._doing = doing
        try:
            yield
            self._doing = _Doing.NOTHING
        finally:
            executed = not isinstance(self._talk.dialogue.answer, Error)
            if self._doing is not _Doing.NOTHING and executed:
                self.stop()
            self._doing = _Doing.NOTHING

    def _until_standing(self, target: float, distance: float, pause: Pause) -> Status:
        within_s = 2 * self._duration_s(distance) + 2.0
        deadline_s = self._talk.clock() + within_s
        upsets = self._talk.dialogue.upsets
        far = distance > self._tolerance()
        before: float | None = None
        while self._talk.clock() < deadline_s:
            status = self._talk.status(pause)
            self._check_moving(status, upsets)
            here = self._position(status)
            if status.state is State.IDLE:
                if here == before or (far and abs(here - target) <= self._tolerance()):
                    return status
                before = here
            self._talk.until(
                lambda: self._talk.dialogue.upsets != upsets, self._settings.poll_s, pause
            )
        raise NoReply(f"{self._name}: still moving after {within_s:.1f} s; check feed and load")

    def _check_moving(self, status: Status, upsets: int) -> None:
        if self._talk.dialogue.upsets != upsets:
            raise self._talk.upset("the move")
        if status.state not in (State.IDLE, State.RUN, State.JOG):
            raise Refused(
                f"{self._name}: {status.state.value} during a move; check the hold and door inputs"
            )

    def _compare(self, target: float, here: float, lost: NoReply | None) -> None:
        if abs(here - target) <= self._tolerance():
            return
        unit = self._settings.unit
        if lost is not None:
            raise NoReply(
                f"{self._name}: a move was not answered and was not repeated; the axis stands at"
                f" {here:.3f} {unit}, not at {target:.3f}; check the cable"
            ) from lost
        self._homed_at = None
        raise Refused(
            f"{self._name}: stands at {here:.3f} {unit}, {abs(here - target):.3f} from"
            f" {target:.3f}, tolerated {self._tolerance():.3f}; check the line, then home"
        )

    # --- homing ------------------------------------------------------------------------------

    def _unlock(self, pause: Pause) -> None:
        """Clear an alarm; homing by a switch does that itself, unless only a reset is heard."""
        if self._talk.dialogue.locked and not self._talk.reset(pause, within_s=_BANNER_S):
            raise NoReply(f"{self._name}: no banner after a reset; switch its supply off and on")
        status = self._talk.status(pause)
        self._talk.dialogue.clear_alarm()
        if status.state is State.ALARM and self._settings.homing is Homing.SOFTWARE_ZERO:
            self._talk.exchange("$X", pause)

    def _find_switch(self, pause: Pause) -> None:
        if not int(self._talk.setting(22)) & 1:  # grblHAL: a mask, bit 0 enables
            raise Refused(f"{self._name}: {error_name(5)}; {error_remedy(5)}", code=5)
        with self._stopped_unless_done(_Doing.HOMING):
            self._talk.exchange("$H", pause, within_s=self._homing_s())

    def _homing_s(self) -> float:
        """Seek 1.5 travels and locate at 6 pull-offs (interface.md, ALARM:9), axis by axis."""
        seek, locate = self._talk.rate(25), self._talk.rate(24)
        axes = [number for number in self._talk.dialogue.settings if number in range(130, 136)]
        seek_min = sum(1.5 * self._talk.setting(number) for number in axes) / seek
        return 60 * (seek_min + len(axes) * 12 * self._talk.setting(27) / locate) + 5.0

    # --- stopping ----------------------------------------------------------------------------

    def _comes_to_rest(self, ending: Realtime) -> bool:
        """Say `ending`, watch until the controller stands with no line left.

        It is said again only for a line that had not been answered at the time: a jog cancel that
        arrives just after the jog's end leaves Grbl 1.1h suspended, idle and deaf to lines.
        """
        deadline_s = self._talk.clock() + 2 * self._braking_s() + 1.0
        said = self._say(ending)
        before: Status | None = None
        while self._talk.clock() < deadline_s and not self._talk.dialogue.locked:
            status = self._talk.report(None, within_s=2 * _STOP_POLL_S)
            if status is not None:
                if _is_held(status):
                    return self._reset_held(status)
                if status.state is State.HOME:
                    return False
                due = _ENDING_OF.get(status.state)
                if due is not None and said != (due, _Lines.ANSWERED):
                    said = self._say(due)
                elif before is not None and _rests(before, status):
                    # A line that was not answered could still start: a reset drops it.
                    return self._lines() is _Lines.ANSWERED or self._reset_held(status)
                before = status
            self._talk.until(lambda: False, _STOP_POLL_S, None)
        return self._talk.dialogue.locked

    def _say(self, ending: Realtime) -> tuple[Realtime, _Lines]:
        lines = self._lines()
        self._talk.write(ending.wire)
        return ending, lines

    def _lines(self) -> _Lines:
        dialogue = self._talk.dialogue
        open_ = dialogue.outstanding or not dialogue.fenced
        return _Lines.OPEN if open_ else _Lines.ANSWERED

    def _reset_held(self, held: Status) -> bool:
        """Reset where nothing moves: lines and queue are dropped, the position is kept."""
        if not self._talk.reset(None, within_s=_ANSWER_S):
            return False
        after = self._talk.report(None, within_s=_REPORT_S)
        if after is None or _place(after) != _place(held):
            self._homed_at = None
        return True

    # --- asking ------------------------------------------------------------------------------

    def _ready(self, pause: Pause) -> None:
        """Open the dialogue, or mend it after a lost answer."""
        if self._talk.dialogue.outstanding:  # the caller left an exchange by raising
            self._talk.dialogue.give_up()
        if self._identity is None:
            self._open(pause)
        if self._talk.dialogue.fenced:
            return
        try:
            self._talk.exchange(FENCE, pause)
        except NoReply:  # a torn line swallowed it, or the controller is suspended
            status = self._talk.status(pause)
            if _motion(status) is Motion.MOVING or not self._reset_held(status):
                raise

    def _open(self, pause: Pause | None) -> Identity:
        """Handshake that needs no banner: an open port may have swallowed it."""
        self._homed_at = None
        self._talk.drain()
        self._talk.reset(pause, within_s=_BANNER_S)
        self._talk.until(lambda: False, _QUIET_S, pause)  # startup lines, a second banner
        self._talk.dialogue.reset_asked = False
        self._talk.status(pause)
        self._talk.exchange("$I", pause)
        self._talk.exchange("$$", pause)
        self._check_settings()
        self._identity = self._identified()
        return self._identity

    def _identified(self) -> Identity:
        banner, feedback = self._talk.dialogue.banner, self._talk.dialogue.feedback
        version, _, label = feedback.get("VER", "").partition(":")
        if not version:
            raise FrameError(f"{self._name}: $I was answered without a version; is this a Grbl?")
        model = banner.firmware if banner else "Grbl"
        return Identity(family="grbl", model=model, firmware=version, serial=label)

    def _check_settings(self) -> None:
        if self._talk.setting(13):
            raise Refused(f"{self._name}: reports inches; set $13=0 on the controller", code=13)
        code, expected = 100 + self._index(), self._settings.steps_per_unit
        steps = self._talk.rate(code)
        if abs(steps - expected) > 0.00051:  # $$ prints three decimals
            raise Refused(
                f"{self._name}: ${code} is {steps:g} steps a {self._settings.unit}, {expected:g}"
                f" expected; set ${code}={expected:g} or correct the station",
                code=code,
            )
        if self._tolerance() < 0.5 / steps + 0.0005:
            raise Refused(
                f"{self._name}: a tolerance of {self._tolerance():.6f} {self._settings.unit} is"
                f" finer than half a step of {1 / steps:.6f} and the report's 0.001; widen it"
            )

    def _idle(self, pause: Pause) -> Status:
        status = self._talk.status(pause)
        if status.state in (State.ALARM, State.SLEEP):
            raise self._talk.upset("idle")
        if status.state is not State.IDLE:
            raise Refused(f"{self._name}: is in state {status.state.value}; stop it first")
        return status

    # --- what a report means -----------------------------------------------------------------

    def _axis_state(self, status: Status) -> AxisState:
        position = self._settings.from_wire(self._position(status))
        motion = _motion(status)
        alarm = self._talk.alarm_text() if motion is Motion.ALARM else ""
        return AxisState(motion, position, self._homed, alarm)

    def _position(self, status: Status) -> float:
        """From the zero, in the wire's unit."""
        return self._machine(status) - self._zero

    def _machine(self, status: Status) -> float:
        offset = self._talk.dialogue.work_offset
        if status.machine is not None:
            vector = status.machine
        elif status.work is not None and offset is not None and len(offset) == len(status.work):
            vector = tuple(w + o for w, o in zip(status.work, offset, strict=True))
        else:
            raise FrameError(f"{self._name}: reports work positions without offset; set $10=3")
        if self._index() >= len(vector):
            raise FrameError(
                f"{self._name}: a report of {len(vector)} axes has no {self._settings.letter}"
            )
        return vector[self._index()]

    def _index(self) -> int:
        """Place of our letter; grblHAL prints its letters as ``[AXS:4:XYZA]``."""
        letters = self._talk.dialogue.feedback.get("AXS", "").partition(":")[2] or _LETTERS
        index = letters.find(self._settings.letter)
        if index < 0:
            raise FrameError(
                f"{self._name}: the controller has {letters}, no {self._settings.letter}"
            )
        return index

    # --- quantities --------------------------------------------------------------------------

    @property
    def _name(self) -> str:
        return self._settings.name

    @property
    def _homed(self) -> bool:
        return self._homed_at == self._talk.dialogue.upsets

    def _tolerance(self) -> float:
        return self._settings.to_wire(self._settings.tolerance)

    def _check_limits(self, position: float) -> None:
        if not math.isfinite(position):
            raise ValueError(f"{self._name}: {position} is no position")
        if not self._settings.lower <= position <= self._settings.upper:
            lower, upper, wanted = map(
                self._settings.to_wire, (self._settings.lower, self._settings.upper, position)
            )
            raise Refused(
                f"{self._name}: {wanted:.3f} {self._settings.unit} is outside its limits"
                f" {lower:.3f} to {upper:.3f}; change the plan"
            )

    def _feed_per_min(self) -> float:
        return min(
            60 * self._settings.to_wire(self._settings.speed),
            self._talk.rate(110 + self._index()),
        )

    def _duration_s(self, distance: float) -> float:
        """A trapezoid's, or more than a triangle's."""
        return 60 * distance / self._feed_per_min() + self._braking_s()

    def _braking_s(self) -> float:
        if self._identity is None:
            return 1.0
        return self._feed_per_min() / 60 / self._talk.rate(120 + self._index())


_ENDING_OF: Final = {State.RUN: Realtime.HOLD, State.JOG: Realtime.JOG_CANCEL}
_STANDING_SUBSTATES: Final = {State.HOLD: (0,), State.DOOR: (0, 1)}


def _motion(status: Status) -> Motion:
    match status.state:
        case State.ALARM | State.SLEEP:
            return Motion.ALARM
        case State.HOME:
            return Motion.HOMING
        case State.RUN | State.JOG:
            return Motion.MOVING
        case State.HOLD | State.DOOR if not _is_held(status):
            return Motion.MOVING
        case _:
            return Motion.STANDING


def _place(status: Status) -> Vector | None:
    """Where every axis is, in whatever coordinates the controller reports."""
    return status.machine or status.work


def _rests(before: Status, now: Status) -> bool:
    """Two like reports of a standing axis."""
    like = (before.state, _place(before)) == (now.state, _place(now))
    return like and _motion(now) is not Motion.MOVING


def _is_held(status: Status) -> bool:
    """Standing in the middle of a motion: a reset keeps the position and drops the rest."""
    return status.substate in _STANDING_SUBSTATES.get(status.state, ())
