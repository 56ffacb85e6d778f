r"""The lines of the Zaber ASCII protocol, both directions, and who answers whom; no clock.

After the ASCII protocol manual (firmware 6 and 7) and the bytes of the maker's own client::

    host   -> /1 1 01 move rel 1000:E2\n         device, axis, message id, command, check
    device -> @01 1 01 OK BUSY WR 0:..\r\n       reply: the same three, taken or not, flag, data
    device -> #01 1 01 ...\r\n                   info: lines that follow a reply
    device -> !01 1 IDLE --\r\n                  alert: unasked, answers nothing

The check makes the sum of all bytes after the first and before the colon zero modulo 256. A reply
is matched by its id, device and axis, so that a late one is never taken for another's.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

IDS: Final = 100
_MOST_BYTES: Final = 512  # of a message; what exceeds it is noise
_SHOWN: Final = 60
_COMMAND: Final = re.compile(r"[a-z0-9.\- ]*", re.ASCII)


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to one command."""

    device: int
    axis: int
    message_id: int | None
    accepted: bool
    busy: bool
    flag: str  # the highest one; ``--`` is none
    data: str  # a value, or the reason where it was rejected
    checked: bool  # it carried a check, and the check is right


@dataclass(frozen=True, slots=True)
class Info:
    """A line that belongs to a reply before it."""

    device: int
    axis: int
    message_id: int | None
    text: str


@dataclass(frozen=True, slots=True)
class Alert:
    """What a device says unasked, such as that a movement ended."""

    device: int
    axis: int
    busy: bool
    flag: str
    text: str


@dataclass(frozen=True, slots=True)
class Damaged:
    """A line that is none of these, or whose check is wrong."""

    text: str


Message = Reply | Info | Alert | Damaged


def check_of(body: bytes) -> int:
    """Two's complement of the sum of bytes: what makes the sum zero modulo 256."""
    return -sum(body) & 0xFF


def command_bytes(device: int, axis: int, message_id: int, command: str) -> bytes:
    r"""One command as sent, with id and check, as the maker's client writes it.

    Raises
    ------
    ValueError
        An address, id or command that the protocol does not have.
    """
    if not (0 <= device <= 99 and 0 <= axis <= 9 and 0 <= message_id < IDS):
        raise ValueError(f"zaber: no address: device {device}, axis {axis}, id {message_id}")
    if not _COMMAND.fullmatch(command):
        raise ValueError(f"zaber: {command!r} holds what no command has")
    body = f"{device} {axis} {message_id:02d}{' ' if command else ''}{command}".encode("ascii")
    return b"/%s:%02X\n" % (body, check_of(body))


_HEAD: Final = r"(?P<device>\d{2}) (?P<axis>\d)(?: (?P<id>\d{2}))?"
_STATE: Final = r"(?P<state>IDLE|BUSY) (?P<flag>--|[A-Z]{2})"
_REPLY: Final = re.compile(
    rf"@{_HEAD} (?P<taken>OK|RJ) {_STATE} (?P<data>[ -~]+)", re.ASCII
)  # fmt: skip
_INFO: Final = re.compile(rf"#{_HEAD}(?: (?P<text>[ -~]*))?", re.ASCII)
_ALERT: Final = re.compile(
    rf"!(?P<device>\d{{2}}) (?P<axis>\d) {_STATE}(?: (?P<text>[ -~]*))?", re.ASCII
)
_CHECK: Final = re.compile(r"(.)(.*):([0-9A-F]{2})", re.ASCII)


def parsed(line: str) -> Message:
    """One line without its terminator; what it cannot be is `Damaged`."""
    checked = _CHECK.fullmatch(line)
    if checked:
        if check_of(checked[2].encode("latin-1")) != int(checked[3], 16):
            return Damaged(line[:_SHOWN])
        line = checked[1] + checked[2]
    if found := _REPLY.fullmatch(line):
        return Reply(
            *_head(found), found["taken"] == "OK", found["state"] == "BUSY",
            found["flag"], found["data"], checked is not None,
        )  # fmt: skip
    if found := _INFO.fullmatch(line):
        return Info(*_head(found), found["text"] or "")
    if found := _ALERT.fullmatch(line):
        device, axis = int(found["device"]), int(found["axis"])
        return Alert(device, axis, found["state"] == "BUSY", found["flag"], found["text"] or "")
    return Damaged(line[:_SHOWN])


def _head(found: re.Match[str]) -> tuple[int, int, int | None]:
    message_id = found["id"]
    return int(found["device"]), int(found["axis"]), int(message_id) if message_id else None


class Decoder:
    """Messages out of bytes in any chunking; a damaged line costs itself and nothing more.

    What stands on a line before the last `@`, `#` or `!` that makes it a message is noise of the
    line's beginning, such as the rest of a line that broke off.
    """

    def __init__(self) -> None:
        self._line = bytearray()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Yield the messages that `data` completes; empty lines are none."""
        for byte in data:
            if byte not in b"\r\n":
                if len(self._line) <= _MOST_BYTES:
                    self._line.append(byte)
            elif self._line:
                text = self._line.decode("latin-1")
                self._line.clear()
                yield _found(text)


def _found(text: str) -> Message:
    whole = parsed(text) if len(text) <= _MOST_BYTES else Damaged(text[:_SHOWN])
    if not isinstance(whole, Damaged):
        return whole
    # Only with a check can the end of a torn line be told from a message.
    for at in (k for k, letter in enumerate(text[1:], 1) if letter in "@#!"):
        inner = parsed(text[at:])
        if not isinstance(inner, Damaged) and _CHECK.fullmatch(text[at:]):
            return inner
    return whole


@dataclass(frozen=True, slots=True)
class Asked:
    """A command that was sent: what its reply must name."""

    message_id: int
    device: int
    axis: int
    command: str


@dataclass(slots=True)
class Dialogue:
    """Who owes whom a reply. Pure: `send` gives bytes, `feed` takes what was read.

    Several commands may be under way: a stop waits for nobody. An id that was given up rests until
    its reply can no longer come.
    """

    decoder: Decoder = field(default_factory=Decoder)
    waiting: dict[int, Asked] = field(default_factory=dict)
    replies: dict[int, Reply] = field(default_factory=dict)
    infos: list[Info] = field(default_factory=list)
    alerts: list[Alert] = field(default_factory=list)
    damaged: int = 0
    strays: int = 0
    _resting: dict[int, float] = field(default_factory=dict)  # until when
    _next: int = 0

    def send(self, device: int, axis: int, command: str, now_s: float) -> tuple[Asked, bytes]:
        """Choose an id that nobody waits for; the bytes to write."""
        self._resting = {k: until for k, until in self._resting.items() if until > now_s}
        for _ in range(IDS):
            number, self._next = self._next, (self._next + 1) % IDS
            if number not in self.waiting and number not in self._resting:
                break
        else:
            raise ValueError("zaber: a hundred commands without a reply")
        asked = Asked(number, device, axis, command)
        data = command_bytes(device, axis, number, command)
        self.waiting[number] = asked
        return asked, data

    def take(self, asked: Asked) -> Reply | None:
        """The reply to a command, once; None while it has not come."""
        reply = self.replies.pop(asked.message_id, None)
        if reply is not None:
            del self.waiting[asked.message_id]
        return reply

    def give_up(self, asked: Asked, until_s: float) -> None:
        """No longer wait; the id rests."""
        self.waiting.pop(asked.message_id, None)
        self.replies.pop(asked.message_id, None)
        self._resting[asked.message_id] = until_s

    def feed(self, data: bytes) -> None:
        """Take what was read."""
        for message in self.decoder.feed(data):
            match message:
                case Reply():
                    self._take(message)
                case Info():
                    self.infos = [*self.infos[-31:], message]
                case Alert():
                    self.alerts = [*self.alerts[-31:], message]
                case Damaged():
                    self.damaged += 1

    def _take(self, reply: Reply) -> None:
        asked = None if reply.message_id is None else self.waiting.get(reply.message_id)
        if asked is None or (reply.device, reply.axis) != (asked.device, asked.axis):
            self.strays += 1
        elif asked.message_id in self.replies:
            self.strays += 1  # a second answer to one question: the first stands
        else:
            self.replies[asked.message_id] = reply
