"""The conversation with a Grbl controller: what is asked, and what its reports mean.

Every wait is bounded by the clock that was handed in. The functions at the end each read one
thing out of what the controller said, and ask nothing.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import Enum
from typing import Final

from drivers.axis import Identity, Motion, Pause
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
from drivers.grbl.settings import LETTERS
from drivers.grbl.wire import Dialogue
from drivers.links import ByteLink

ANSWER_S: Final = 1.0  # Grbl reports within 5 to 20 ms; a line waits for room in the planner
REPORT_S: Final = 0.5
BANNER_S: Final = 2.5  # an Arduino's boot loader takes 2 s after the port opens
QUIET_S: Final = 0.1
_STARTING_TRIES: Final = 3  # reports of half a second, twice each
_STEP_S: Final = 0.005  # between looks at the link while an answer is due
_DRAIN_READS: Final = 64
_HANDSHAKES: Final = 3
_OLDEST: Final = 1.1  # of the firmware
_SINGLE_AXIS: Final = 1 << 1  # of grblHAL's $22


class Lines(Enum):
    """Whether a line that was sent may still start something."""

    ANSWERED = "answered"
    OPEN = "open"


class Conversation:
    """The dialogue over a link: send-response, reports, resets; every wait bounded.

    Without a `pause` it waits in the link, with one it waits in the caller's hands.
    """

    def __init__(self, link: ByteLink, name: str, clock: Callable[[], float]) -> None:
        self.name = name  # for messages
        self.clock = clock
        self.dialogue = Dialogue()
        self.asked_s = clock()  # of the last question for a report
        self._asked = self._timeouts = 0
        self._link = link
        self._heard_bytes = 0

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        return {
            "asked": self._asked,
            "timeouts": self._timeouts,
            "damaged": self.dialogue.unknown_lines,
            "late": self.dialogue.stray_answers,
        }

    def introduced(self) -> Identity:
        """Who it is, and its settings, by questions alone; a board that still starts is waited for.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            It moves, and answers no such question then.
        """
        self.drain()
        for tries_left in reversed(range(_STARTING_TRIES)):
            try:
                self.status(None)
                break
            except NoReply:
                if not tries_left:
                    raise
        for line in ("$I", "$$"):
            self.exchange(line, None)
        return identity_of(self)

    def exchange(self, line: str, pause: Pause | None, *, within_s: float = ANSWER_S) -> None:
        """Send one line and see it answered ok; never sends it twice."""
        dialogue = self.dialogue
        alarm, upsets = dialogue.alarm, dialogue.upsets
        self._asked += 1
        self.write(dialogue.send(line))
        self.until(lambda: not dialogue.outstanding or dialogue.alarm is not alarm, within_s, pause)
        if isinstance(dialogue.answer, Error):
            code = dialogue.answer.number
            raise Refused(
                f"{self.name}: {line} refused, {error_name(code)}; {error_remedy(code)}", code=code
            )
        if dialogue.answer is not None:
            return
        if dialogue.outstanding:
            self._timeouts += 1
            dialogue.give_up()
        if dialogue.upsets != upsets:
            raise self.upset(line)
        raise NoReply(f"{self.name}: {line} was not answered in {within_s:.1f} s; check the cable")

    def insist(self, handshake: Callable[[], Identity]) -> Identity:
        """Ask who it is and how it is set; anew where an answer was lost or damaged, twice at most.

        Nothing asked for changes anything, and a handshake begins with a reset: that ends what a
        bent question may have begun. `$I` with one bit wrong is `$H`, which homes.
        """
        for tries_left in reversed(range(_HANDSHAKES)):
            heard_before = self._heard_bytes
            try:
                return handshake()
            except (NoReply, FrameError):
                if not tries_left or self._heard_bytes == heard_before:  # nobody is there
                    raise
            except Refused:
                misheard = isinstance(self.dialogue.answer, Error)
                if not (tries_left and misheard):
                    raise
        raise AssertionError  # the last handshake returned or raised

    def status(self, pause: Pause | None) -> Status:
        """One report, asked for at most twice."""
        damaged = self.dialogue.unknown_lines
        for _ in range(2):
            status = self.report(pause, within_s=REPORT_S)
            if status is not None:
                return status
            if self.dialogue.locked:
                raise self.upset("a report")
            self.until(lambda: False, QUIET_S, pause)
        damaged = self.dialogue.unknown_lines - damaged
        if damaged:
            raise FrameError(
                f"{self.name}: {damaged} unreadable lines and no report; check baud rate and cable"
            )
        raise NoReply(
            f"{self.name}: no report in {2 * REPORT_S} s at {self._link.address}; is the"
            " controller on, its baud rate that of the address, and is this its port?"
        )

    def report(self, pause: Pause | None, *, within_s: float) -> Status | None:
        """One report, asked for once; None where it did not come."""
        dialogue = self.dialogue
        self.asked_s = self.clock()
        self.write(dialogue.ask())
        self._asked += 1
        self.until(lambda: dialogue.status is not None or dialogue.locked, within_s, pause)
        self._timeouts += dialogue.status is None
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
                f"{self.name}: the controller restarted during {during}; check its supply, home"
            )
        code = None if alarm is None else alarm.number
        remedy = "home it" if code is None else alarm_remedy(code)
        return Refused(f"{self.name}: {self.alarm_text()} during {during}; {remedy}", code=code)

    def alarm_text(self) -> str:
        """Number and name of the alarm that stands, or what silences the controller."""
        alarm, status = self.dialogue.alarm, self.dialogue.status
        if alarm is not None:
            return alarm_name(alarm.number)
        if status is None or status.state is not State.ALARM:
            return "asleep"
        return alarm_name(status.substate) if status.substate else "locked since it started"

    def setting(self, code: int) -> float:
        """One of the numbers that `$$` printed."""
        text = self.dialogue.settings.get(code, "none")
        try:
            return float(text)
        except ValueError as wrong:
            raise FrameError(
                f"{self.name}: ${code} is {text!r}, a number was due; is this a Grbl 1.1?"
            ) from wrong

    def rate(self, code: int) -> float:
        """A setting that divides."""
        value = self.setting(code)
        if not value > 0:
            raise Refused(f"{self.name}: ${code} is {value:g}; set it above zero", code=code)
        return value

    @property
    def lines(self) -> Lines:
        """Whether anything sent so far may still start a motion."""
        open_ = self.dialogue.outstanding or not self.dialogue.fenced
        return Lines.OPEN if open_ else Lines.ANSWERED

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
        self._heard_bytes += len(data)
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
        """Send at once, behind no line; a lost link is an upset."""
        try:
            self._link.write(data)
        except LinkLost:
            self.dialogue.upsets += 1
            raise


# --- what the controller said --------------------------------------------------------------------


def identity_of(talk: Conversation) -> Identity:
    """Out of the banner and the answer to `$I`."""
    banner, feedback = talk.dialogue.banner, talk.dialogue.feedback
    version, _, label = feedback.get("VER", "").partition(":")
    if not version:
        raise FrameError(f"{talk.name}: $I was answered without a version; is this a Grbl?")
    number = re.match(r"\d+\.\d+", version)
    if number is None or float(number[0]) < _OLDEST:
        raise Refused(
            f"{talk.name}: firmware {version}; jogs and reports came with Grbl {_OLDEST}: update it"
        )
    model = banner.firmware if banner else feedback.get("FIRMWARE", "Grbl")
    return Identity(family="grbl", model=model, firmware=version, serial=label)


def homing_line(talk: Conversation, letter: str) -> str:
    """The axis alone where grblHAL allows it: nobody else's axis is moved by our homing."""
    hal = talk.dialogue.feedback.get("FIRMWARE") == "grblHAL"
    return f"$H{letter}" if hal and int(talk.setting(22)) & _SINGLE_AXIS else "$H"


def homing_s(talk: Conversation) -> float:
    """Seek 1.5 travels and locate at 6 pull-offs (interface.md, ALARM:9), axis by axis."""
    seek, locate = talk.rate(25), talk.rate(24)
    axes = [number for number in talk.dialogue.settings if number in range(130, 136)]
    seek_min = sum(1.5 * talk.setting(number) for number in axes) / seek
    return 60 * (seek_min + len(axes) * 12 * talk.setting(27) / locate) + 5.0


def axis_index(talk: Conversation, letter: str) -> int:
    """Place of a letter; grblHAL prints its letters as ``[AXS:4:XYZA]``."""
    letters = talk.dialogue.feedback.get("AXS", "").partition(":")[2] or LETTERS
    index = letters.find(letter)
    if index < 0:
        raise FrameError(f"{talk.name}: the controller has {letters}, no {letter}")
    return index


def machine_coordinate(talk: Conversation, status: Status, letter: str) -> float:
    """Where one axis is in machine coordinates, in the wire's unit."""
    offset = talk.dialogue.work_offset
    if status.machine is not None:
        vector = status.machine
    elif status.work is not None and offset is not None and len(offset) == len(status.work):
        vector = tuple(w + o for w, o in zip(status.work, offset, strict=True))
    else:
        raise FrameError(f"{talk.name}: reports work positions without offset; set $10=3")
    index = axis_index(talk, letter)
    if index >= len(vector):
        raise FrameError(f"{talk.name}: a report of {len(vector)} axes has no {letter}")
    return vector[index]


_STANDING_SUBSTATES: Final = {State.HOLD: (0,), State.DOOR: (0, 1)}


def motion_of(status: Status) -> Motion:
    """What the axis does while the controller is in this state."""
    match status.state:
        case State.ALARM | State.SLEEP:
            return Motion.ALARM
        case State.HOME:
            return Motion.HOMING
        case State.RUN | State.JOG:
            return Motion.MOVING
        case State.HOLD | State.DOOR if not is_held(status):
            return Motion.MOVING
        case _:
            return Motion.STANDING


def place_of(status: Status) -> Vector | None:
    """Where every axis is, in whatever coordinates the controller reports."""
    return status.machine or status.work


def rests(before: Status, now: Status) -> bool:
    """Two like reports of a standing axis."""
    like = (before.state, place_of(before)) == (now.state, place_of(now))
    return like and motion_of(now) is not Motion.MOVING


def is_held(status: Status) -> bool:
    """Standing in the middle of a motion: a reset keeps the position and drops the rest."""
    return status.substate in _STANDING_SUBSTATES.get(status.state, ())
