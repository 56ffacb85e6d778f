r"""The lines of Grbl 1.1, both directions, and the discipline between them; no reading, no clock.

After doc/markdown/interface.md, commands.md and jogging.md of gnea/grbl (commit bfb67f0)::

    host  -> "G53G1X10F600\n"     lines, each answered by exactly one ok or error:N
    host  -> ? ! ~ 0x18 0x85       realtime bytes, taken out of the stream wherever they stand
    board -> "ok\r\n"             one line a message; pushes come at any time and answer nothing

There is no checksum: a damaged line is `Unknown` at best and a wrong number at worst, which is why
the axis reads every position back.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from drivers.grbl.messages import (
    Alarm,
    Banner,
    Error,
    Feedback,
    Message,
    Ok,
    Setting,
    StartupLine,
    State,
    Status,
    Unknown,
    Vector,
    parsed,
)

LINE_LIMIT: Final = 80  # LINE_BUFFER_SIZE of protocol.h, its terminating zero included
_MESSAGE_LIMIT: Final = 512  # longer than any report; what exceeds it is noise
_SHOWN: Final = 60  # characters of an overlong line that are kept
_DIGITS: Final = 8  # MAX_INT_DIGITS of nuts_bolts.c: Grbl drops the rest


class Realtime(IntEnum):
    """Bytes that never enter the line buffer and get no answer."""

    STATUS = 0x3F
    HOLD = 0x21
    RESUME = 0x7E
    RESET = 0x18
    DOOR = 0x84
    JOG_CANCEL = 0x85
    FEED_100 = 0x90

    @property
    def wire(self) -> bytes:
        """The byte."""
        return bytes([self])


# --- host to board ---------------------------------------------------------------------------


def number(value: float, decimals: int = 4) -> str:
    """Shortest decimal of `value` to `decimals` places, within the eight digits Grbl reads.

    Raises
    ------
    ValueError
        NaN, infinite, or more than eight digits before the point.
    """
    whole = len(str(math.trunc(abs(value)))) if math.isfinite(value) else _DIGITS + 1
    if whole > _DIGITS:
        raise ValueError(f"grbl: {value} is no number of at most {_DIGITS} digits")
    text = f"{value:.{min(decimals, _DIGITS - whole)}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text == "-0" else text


def feed_move(letter: str, position: float, feed_per_min: float) -> str:
    """Straight move in machine coordinates; modal states of startup lines cannot reach it."""
    return f"G21G94G53G1{letter}{number(position)}F{_feed(feed_per_min)}"


def jog(letter: str, position: float, feed_per_min: float) -> str:
    """Jog in machine coordinates: cancelled by one byte, the position kept."""
    return f"$J=G21G53{letter}{number(position)}F{_feed(feed_per_min)}"


def _feed(feed_per_min: float) -> str:
    text = number(feed_per_min, decimals=3)
    if text.startswith("-") or text == "0":
        raise ValueError(f"grbl: a move needs a feed above zero, not {feed_per_min} a minute")
    return text


def line_bytes(line: str) -> bytes:
    r"""One line as sent: ``\n`` only, because Grbl counts ``\r\n`` as two lines.

    Raises
    ------
    ValueError
        When the line is too long or contains a terminator, a realtime byte, or no ASCII.
    """
    data = line.encode("ascii")
    if len(data) > LINE_LIMIT - 1:
        raise ValueError(f"grbl: a line of {len(data)} bytes, at most {LINE_LIMIT - 1} fit")
    if any(
        byte < 0x20 or byte in (Realtime.STATUS, Realtime.HOLD, Realtime.RESUME) for byte in data
    ):
        raise ValueError(f"grbl: {line!r} contains a byte that is no part of a line")
    return data + b"\n"


@dataclass(frozen=True, slots=True)
class Line:
    """One line from the host; `overflow` where Grbl would answer error:11."""

    text: str
    overflow: bool = False


class CommandDecoder:
    """The board's ear: lines and realtime bytes out of what the host sent.

    A realtime byte is yielded where it stands, before the line that it interrupts. Bytes from 0x80
    that are no known command are dropped, as the firmware does.
    """

    def __init__(self) -> None:
        self._line = bytearray()

    def feed(self, data: bytes) -> Iterator[Line | Realtime]:
        """Yield what `data` completes."""
        for byte in data:
            if byte in _REALTIME:
                if byte == Realtime.RESET:
                    self._line.clear()
                yield Realtime(byte)
            elif byte in b"\r\n":
                line = self._line[: LINE_LIMIT - 1].decode("ascii")
                yield Line(line, len(self._line) > LINE_LIMIT - 1)
                self._line.clear()
            elif byte < 0x80 and len(self._line) < LINE_LIMIT:
                self._line.append(byte)


_REALTIME: Final = frozenset(Realtime)

# --- board to host ---------------------------------------------------------------------------


class LineDecoder:
    """Messages out of bytes in any chunking; a damaged line costs itself and nothing more."""

    def __init__(self) -> None:
        self._line = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Yield the messages that `data` completes; empty lines are none."""
        for byte in data:
            if byte not in b"\r\n":
                if len(self._line) <= _MESSAGE_LIMIT:  # bounded; the rest of the line is dropped
                    self._line.append(byte)
            elif self._line:
                text = self._line.decode("latin-1")
                self._line.clear()
                yield parsed(text) if len(text) <= _MESSAGE_LIMIT else Unknown(text[:_SHOWN])


# --- the discipline --------------------------------------------------------------------------


@dataclass(slots=True)
class Dialogue:
    """Who owes whom an answer: send-response, one line at a time, pushes never counted.

    Pure: `send` and `reset` return the bytes to write, `feed` takes what was read. After an answer
    was given up as lost, the next line must be a fence: `$G` prints ``[GC:..]`` before its own ok,
    so that whatever comes before it is a late answer, and a torn line still lying in the board's
    buffer becomes an error instead of a motion. A fence given up in its turn could be taken for the
            A line is outstanding; it is mute; the last answer was given up and this is no fence.
    """

    decoder: LineDecoder = field(default_factory=LineDecoder)
    outstanding: str = ""  # the line that is owed an answer, empty when none is
    answer: Ok | Error | None = None
    status: Status | None = None  # of the last question
    work_offset: Vector | None = None  # cached, because it comes every 10 to 30 reports
    alarm: Alarm | None = None  # latched until `clear_alarm`
    locked: bool = False  # "Reset to continue": nothing but a reset is heard
    banner: Banner | None = None  # since the last reset
    reset_asked: bool = False  # a banner is due
    upsets: int = 0  # events after which a position is not to be trusted
    settings: dict[int, str] = field(default_factory=dict)
    feedback: dict[str, str] = field(default_factory=dict)
    stray_answers: int = 0
    unknown_lines: int = 0
    fenced: bool = True
    mute: bool = False  # a fence was given up: nothing but a reset

    def send(self, line: str) -> bytes:
        """Return one line's bytes; the line before must have been answered or given up.

        Raises
        ------
        ValueError
            A line is outstanding; the last answer was given up and this is no fence; it is mute.
        """
        if self.outstanding:
            raise ValueError(f"grbl: {self.outstanding!r} is still outstanding")
        if self.mute:
            raise ValueError(f"grbl: {line!r} before a reset after a lost fence")
        if not self.fenced and line != FENCE:
            raise ValueError(f"grbl: {line!r} before the fence after a lost answer")
        data = line_bytes(line)
        if self.sizes is not None and len(data) >= self.sizes[1]:
            raise ValueError(f"grbl: {len(data)} bytes do not fit a buffer of {self.sizes[1]}")
        self.outstanding, self.answer = line, None
        if line == FENCE:
            self.feedback.pop("GC", None)
        return data

    @property
    def sizes(self) -> tuple[int, int] | None:
        """Planner blocks and line buffer bytes of ``[OPT:V,15,128]``, once `$I` was answered."""
        numbers = self.feedback.get("OPT", "").split(",")[1:3]
        if len(numbers) < 2 or not all(text.isdecimal() for text in numbers):
            return None
        return int(numbers[0]), int(numbers[1])

    def give_up(self) -> None:
        """No longer wait for the outstanding answer; it may still come."""
        self.mute = self.mute or self.outstanding == FENCE
        self.outstanding = ""
        self.fenced = False

    def ask(self) -> bytes:
        """Return the status query; `status` is empty until the report comes."""
        self.status = None
        return Realtime.STATUS.wire

    def reset(self) -> bytes:
        """Return a soft reset: the board forgets every line, and so do we."""
        self.outstanding, self.answer, self.banner, self.fenced = "", None, None, True
        self.mute = False
        self.reset_asked = True
        return Realtime.RESET.wire

    def clear_alarm(self) -> None:
        """Forget the latched alarm, before it is resolved on the board."""
        self.alarm = None

    def feed(self, data: bytes) -> None:
        """Take what was read."""
        for message in self.decoder.feed(data):
            self._take(message)

    def _take(self, message: Message) -> None:
        match message:
            case Ok() | Error():
                self._take_answer(message)
            case Status():
                self._take_status(message)
            case Banner():
                self._take_banner(message)
            case Alarm():
                self.alarm = message
                self.upsets += 1
            case Feedback():
                self.feedback[message.tag] = message.text
                self.locked = self.locked or (message.tag, message.text) == _CRITICAL
            case Setting():
                self.settings[message.number] = message.value
            case Unknown():
                self.unknown_lines += 1
            case StartupLine():  # its ":ok" answers a line of the board's own
                pass

    def _take_answer(self, answer: Ok | Error) -> None:
        early = self.outstanding == FENCE and not self.fenced and "GC" not in self.feedback
        if not self.outstanding or early:
            self.stray_answers += 1
            return
        self.outstanding, self.answer, self.fenced = "", answer, True

    def _take_status(self, status: Status) -> None:
        self.status = status
        self.work_offset = status.work_offset or self.work_offset
        if status.state in (State.ALARM, State.SLEEP):
            self.upsets += 1
        else:
            self.alarm = None

    def _take_banner(self, banner: Banner) -> None:
        self.upsets += not self.reset_asked
        self.outstanding, self.answer, self.banner, self.fenced = "", None, banner, True
        self.mute = False
        self.reset_asked = self.locked = False


FENCE: Final = "$G"
_CRITICAL: Final = ("MSG", "Reset to continue")
