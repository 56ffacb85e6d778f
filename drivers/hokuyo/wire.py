r"""The lines of SCIP 2.0, both directions, and whose reply a reply is; no clock.

After Hokuyo's communication protocol specification C-42-03320B (pages 6 to 23)::

    host   -> GD0044072501;a07\n          command, parameters, `;` and a string of our choice
    sensor -> GD0044072501;a07\n          the same line: it alone carries no check
              00P\n                       status, check
              0C]9X\n                     time stamp of four characters, check
              ....(64)..?\n ...           data, 64 characters a line, check of each line
              \n                          an empty line ends the reply

The check is the low six bits of the sum of a line's bytes, plus 0x30; VV, PP and II write a `;`
before it that is not summed. A number is written six bits a character, plus 0x30, high bits first.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from drivers.arrays import IntArray, frozen
from drivers.errors import FrameError

STAMP_BITS: Final = 24  # of the time stamp, in ms: it wraps after 4.66 hours
LINE_CHARACTERS: Final = 64  # of data, without the check
TAGS: Final = 1000
_MOST_LINE: Final = 256
_MOST_LINES: Final = 256
_SHOWN: Final = 60
_COMMAND: Final = re.compile(
    rb"(?:VV|PP|II|BM|QT|RS|TM[0-2]|G[DS]\d{10}|M[DS]\d{13})(?:;[A-Za-z0-9 ._+@]{1,16})?"
)
_ECHO: Final = re.compile(_COMMAND.pattern + rb"\Z")  # noise may stand before it
_STATUS: Final = re.compile(rb"\d[0-9A-I]")


@dataclass(frozen=True, slots=True)
class Reply:
    """One whole reply of which every check is right; lines are without their checks."""

    echo: str
    status: str
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Damaged:
    """Lines up to an empty one that are no reply, or whose checks are wrong."""

    text: str


Message = Reply | Damaged


@dataclass(frozen=True, slots=True)
class Window:
    """Which steps a scan is asked for; `cluster` neighbours become one, the nearest of them."""

    first: int
    last: int
    cluster: int = 1

    def __post_init__(self) -> None:
        if not (0 <= self.first <= self.last <= 9999 and 1 <= self.cluster <= 99):
            raise ValueError(
                f"hokuyo: steps {self.first} to {self.last} by {self.cluster}; give"
                " 0 <= first <= last <= 9999 and a cluster of 1 to 99"
            )

    @property
    def points(self) -> int:
        """How many ranges the reply has."""
        return (self.last - self.first) // self.cluster + 1

    @property
    def reply_bytes(self) -> int:
        """How long the reply to GD is, of a command with a tag."""
        data = 3 * self.points
        return 18 + 4 + 6 + data + 2 * -(-data // LINE_CHARACTERS) + 1


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """The ranges of a reply, as the sensor wrote them; below its least range they are codes."""

    stamp_ms: int  # modulo 2**24
    ranges: IntArray  # (n,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ranges", frozen(self.ranges, np.int64))


def check_of(line: bytes) -> int:
    """The check of a line: one character, 0x30 to 0x6F."""
    return (sum(line) & 0x3F) + 0x30


def number_of(text: str) -> int:
    """Read a number of any length, six bits a character.

    Raises
    ------
    FrameError
        A character outside 0x30 to 0x6F.
    """
    value = 0
    for letter in text:
        digit = ord(letter) - 0x30
        if not 0 <= digit < 64:
            raise FrameError(f"hokuyo: {text[:_SHOWN]!r} holds what no number has")
        value = value << 6 | digit
    return value


def command_bytes(command: str, tag: str = "") -> bytes:
    r"""Write one command, with a string of our choice that its reply gives back.

    Raises
    ------
    ValueError
        A command or a string that SCIP 2.0 does not have, or that we never send.
    """
    line = f"{command};{tag}" if tag else command
    if not (line.isascii() and _COMMAND.fullmatch(line.encode())):
        raise ValueError(f"hokuyo: {line!r} is no command")
    return line.encode() + b"\n"


def scan_command(window: Window) -> str:
    """Ask for the newest scan; refused by the sensor while its laser is off."""
    return f"GD{window.first:04d}{window.last:04d}{window.cluster:02d}"


def scan_of(reply: Reply, window: Window) -> Scan:
    """Read the ranges of a reply to `scan_command` or to MD.

    Raises
    ------
    FrameError
        It has not as many as `window`, or lines of another length than the sensor writes.
    """
    stamp, *data = reply.lines or ("",)
    whole = "".join(data)
    full = all(len(line) == LINE_CHARACTERS for line in data[:-1])
    if len(stamp) != 4 or len(whole) != 3 * window.points or not full:
        raise FrameError(
            f"hokuyo: {len(whole)} characters of data in {len(data)} lines; {window.points} ranges"
            " of 3 were asked for"
        )
    number_of(whole)  # refuses what no number has
    digits = np.frombuffer(whole.encode(), dtype=np.uint8).astype(np.int64) - 0x30
    return Scan(number_of(stamp), digits.reshape(-1, 3) @ np.array([4096, 64, 1]))


def fields_of(reply: Reply, needed: Sequence[str]) -> dict[str, str]:
    """Read the lines ``NAME:value`` of a reply to VV, PP or II.

    Raises
    ------
    FrameError
        One of `needed` is missing.
    """
    found = {name: value.strip() for name, _, value in (s.partition(":") for s in reply.lines)}
    if missing := [name for name in needed if name not in found]:
        raise FrameError(f"hokuyo: the reply to {reply.echo} has no {', '.join(missing)}")
    return found


class Decoder:
    """Replies out of bytes in any chunking; a damaged one costs itself and nothing more.

    Only an empty line ends a reply, so that garbage before, between and behind replies becomes
    part of the next one's lines, where the last line that can be an echo is looked for.
    """

    def __init__(self) -> None:
        self._line = bytearray()
        self._lines: list[bytes] = []

    def feed(self, data: bytes) -> Iterator[Message]:
        """Yield the messages that `data` completes; empty lines between them are none."""
        for byte in data:
            if byte != 0x0A:
                if len(self._line) <= _MOST_LINE:
                    self._line.append(byte)
            elif self._line:
                # The oldest go first: what a flood of noise leaves is the newest.
                self._lines = [*self._lines[-_MOST_LINES:], bytes(self._line)]
                self._line.clear()
            elif self._lines:
                lines, self._lines = self._lines, []
                yield _found(lines)


def _found(lines: Sequence[bytes]) -> Message:
    """Find the reply that ends a run of lines; noise, or one that broke off, may stand before it.

    The last full line of a scan can look like an echo with a tag, and a rest of two characters
    like its status, by a chance below 1e-5; then that scan is a stray and is asked for again. So
    the last one with a tag is the echo, and without any tag the first.
    """
    sound = [reply for at in range(len(lines) - 1) if (reply := _reply(lines[at:]))]
    tagged = [reply for reply in sound if ";" in reply.echo]
    if sound:
        return tagged[-1] if tagged else sound[0]
    return Damaged(b"\n".join(lines)[:_SHOWN].decode("latin-1"))


def _reply(lines: Sequence[bytes]) -> Reply | None:
    echo = _ECHO.search(lines[0])
    if echo is None or len(lines[1]) != 3 or not _STATUS.fullmatch(lines[1][:2]):
        return None
    named = echo[0][:2] in (b"VV", b"PP", b"II")
    texts = [_checked(lines[1], named=False)]
    texts += [_checked(line, named=named) for line in lines[2:]]
    whole = [text for text in texts if text is not None]
    if len(whole) != len(texts):
        return None
    return Reply(echo[0].decode(), whole[0], tuple(whole[1:]))


def _checked(line: bytes, *, named: bool) -> str | None:
    """Take the check off a line; None where it is wrong, or a byte is none of the protocol's."""
    text, check = line[:-1], line[-1]
    if named:
        if not text.endswith(b";"):
            return None
        text = text[:-1]
    if not text or check_of(text) != check or not all(0x20 <= byte < 0x7F for byte in text):
        return None
    return text.decode()


@dataclass(frozen=True, slots=True)
class Asked:
    """A command that was sent: the line that its reply begins with."""

    line: str


@dataclass(slots=True)
class Dialogue:
    """Which commands are under way. Pure: `send` gives bytes, `feed` takes what was read.

    Several may be, because a QT waits for nobody; a tag is used again only after `TAGS` others.
    """

    decoder: Decoder = field(default_factory=Decoder)
    waiting: dict[str, Asked] = field(default_factory=dict)
    replies: dict[str, Reply] = field(default_factory=dict)
    damaged: int = 0
    strays: int = 0
    _next: int = 0

    def send(self, command: str) -> tuple[Asked, bytes]:
        """Choose a tag; the bytes to write."""
        data = command_bytes(command, f"a{self._next:03d}")
        self._next = (self._next + 1) % TAGS
        asked = Asked(data[:-1].decode())
        self.waiting[asked.line] = asked
        return asked, data

    def take(self, asked: Asked) -> Reply | None:
        """The reply to a command, once; None while it has not come."""
        reply = self.replies.pop(asked.line, None)
        if reply is not None:
            self.waiting.pop(asked.line, None)
        return reply

    def give_up(self, asked: Asked) -> None:
        """No longer wait: a reply that still comes is a stray."""
        self.waiting.pop(asked.line, None)
        self.replies.pop(asked.line, None)

    def feed(self, data: bytes) -> None:
        """Take what was read."""
        for message in self.decoder.feed(data):
            if isinstance(message, Damaged):
                self.damaged += 1
            elif message.echo not in self.waiting or message.echo in self.replies:
                self.strays += 1
            else:
                self.replies[message.echo] = message


@dataclass(slots=True)
class Stamps:
    """The sensor's clock without its wrap: of stamps less than 4.66 hours apart."""

    _last: int | None = None
    _time_ms: int = 0

    def seconds(self, stamp_ms: int) -> float:
        """Seconds on from the first stamp's own value."""
        step = stamp_ms if self._last is None else (stamp_ms - self._last) % (1 << STAMP_BITS)
        self._last = stamp_ms
        self._time_ms += step
        return self._time_ms / 1000.0
