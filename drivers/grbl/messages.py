"""What a Grbl 1.1 controller says, as values and as lines, and its numbers by name.

The classes of interface.md of gnea/grbl (commit bfb67f0). Two of them answer a line, exactly one
for each line; everything else is a push and answers nothing::

    Ok, Error                                  the answer to one line
    Alarm, Status, Banner, Feedback,           pushes; may come between a line and its answer
    Setting, StartupLine, Unknown

The names are those of its doc/csv tables, and of errors.h and alarms.h of grblHAL/core for the
numbers that it adds. FluidNC has further ones: those keep their number and are called unknown.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final, TypeVar

from drivers.grbl.names import ALARM_REMEDIES, ALARMS, ERROR_REMEDIES, ERRORS

Vector = tuple[float, ...]
_T = TypeVar("_T")


class State(Enum):
    """The machine states of a status report; TOOL is grblHAL's."""

    IDLE = "Idle"
    RUN = "Run"
    HOLD = "Hold"
    JOG = "Jog"
    ALARM = "Alarm"
    DOOR = "Door"
    CHECK = "Check"
    HOME = "Home"
    SLEEP = "Sleep"
    TOOL = "Tool"


@dataclass(frozen=True, slots=True)
class Ok:
    """``ok``: the line was parsed and queued; says nothing about motion."""


@dataclass(frozen=True, slots=True)
class Error:
    """``error:9``: the line was not executed."""

    number: int


@dataclass(frozen=True, slots=True)
class Alarm:
    """``ALARM:3``: motion is locked."""

    number: int


@dataclass(frozen=True, slots=True)
class Banner:
    """``Grbl 1.1h ['$' for help]``: the controller has just restarted."""

    firmware: str
    version: str
    hint: str = "'$' for help"


@dataclass(frozen=True, slots=True)
class Feedback:
    """``[MSG:Reset to continue]``; the text may be empty."""

    tag: str
    text: str


@dataclass(frozen=True, slots=True)
class Setting:
    """``$100=250.000``; the value as it was printed."""

    number: int
    value: str


@dataclass(frozen=True, slots=True)
class StartupLine:
    """``>G54G20:ok``: a stored line ran by itself; `error` is None where it succeeded."""

    line: str
    error: int | None = None


@dataclass(frozen=True, slots=True)
class Unknown:
    """A line that is none of the others: noise, a torn line, or a dialect."""

    text: str


@dataclass(frozen=True, slots=True)
class Status:
    """``<Idle|MPos:0.000,0.000,0.000|FS:0,0>``: a report; only the first two fields are sure.

    Exactly one of `machine` and `work` stands: machine = work + offset. Numbers are the wire's own,
    millimetres (degrees where the steps are set so) and millimetres a minute.
    """

    state: State
    substate: int | None = None
    machine: Vector | None = None
    work: Vector | None = None
    buffer: tuple[int, int] | None = None  # free planner blocks, free bytes of the line buffer
    line: int | None = None
    feed: float | None = None
    spindle: float | None = None  # None in the ``F:`` form
    pins: str = ""  # triggered inputs, of PXYZDHRS
    work_offset: Vector | None = None  # every 10 to 30 reports
    overrides: tuple[int, int, int] | None = None
    accessories: str = ""
    others: tuple[str, ...] = ()  # fields of dialects, as they came


Message = (
    Ok | Error | Alarm | Status | Banner | Feedback | Setting | StartupLine | Unknown  # one line
)


def parsed(line: str) -> Message:
    """One line without its terminator; what it cannot be is `Unknown`."""
    for pattern, made in _GRAMMAR:
        if match := pattern.fullmatch(line):
            return made(match)
    if line.startswith("<") and line.endswith(">"):
        return _status(line)
    return Unknown(line)


def _startup(match: re.Match[str]) -> Message:
    error = match["error"]
    return StartupLine(match["line"], None if error is None else int(error))


_GRAMMAR: Final[tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], Message]], ...]] = (
    (re.compile(r"ok"), lambda _: Ok()),
    (re.compile(r"error:(\d{1,5})", re.ASCII), lambda found: Error(int(found[1]))),
    (re.compile(r"ALARM:(\d{1,5})", re.ASCII), lambda found: Alarm(int(found[1]))),
    (re.compile(r"\$(\d{1,5})=(.*)", re.ASCII), lambda found: Setting(int(found[1]), found[2])),
    (
        re.compile(r"\[([A-Za-z0-9][A-Za-z0-9 ]*):(.*)\]"),
        lambda found: Feedback(found[1], found[2]),
    ),
    (re.compile(r">(?P<line>.*):(?:ok|error:(?P<error>\d{1,5}))", re.ASCII), _startup),
    # GrblHAL and FluidNC greet as well: "GrblHAL 1.1f ['$' or '$HELP' for help]".
    (
        re.compile(r"(Grbl\w*) (\S+) \[(.*)\]", re.ASCII),
        lambda found: Banner(found[1], found[2], found[3]),
    ),
)


def _status(line: str) -> Message:
    head, *fields = line[1:-1].split("|")
    try:
        return _report(head, fields)
    except ValueError:  # a field that is no number of its kind: the line was damaged
        return Unknown(line)


def _report(head: str, fields: list[str]) -> Status:
    name, _, substate = head.partition(":")
    found, others = _named(fields)
    if ("MPos" in found) == ("WPos" in found):
        raise ValueError("a report has exactly one position")
    feed, spindle = _speeds(found)
    return Status(
        state=State(name),
        substate=_whole(substate) if substate else None,
        machine=_given(found, "MPos", _vector),
        work=_given(found, "WPos", _vector),
        buffer=_given(found, "Bf", _pair),
        line=_given(found, "Ln", _whole),
        feed=feed,
        spindle=spindle,
        pins=found.get("Pn", ""),
        work_offset=_given(found, "WCO", _vector),
        overrides=_given(found, "Ov", _triple),
        accessories=found.get("A", ""),
        others=others,
    )


def _speeds(found: dict[str, str]) -> tuple[float | None, float | None]:
    """Feed and spindle of ``FS:500,8000``, or the feed of ``F:500``."""
    if "FS" in found:
        feed, spindle = _vector(found["FS"])
        return feed, spindle
    if "F" in found:
        (feed,) = _vector(found["F"])
        return feed, None
    return None, None


def _named(fields: list[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Fields of the grammar by their tag, and the others as they came."""
    found: dict[str, str] = {}
    others = []
    for text in fields:
        tag, colon, value = text.partition(":")
        if tag in found:
            raise ValueError(f"{tag} stands twice")
        if tag in _TAGS and colon:
            found[tag] = value
        else:
            others.append(text)
    return found, tuple(others)


_TAGS: Final = frozenset({"MPos", "WPos", "Bf", "Ln", "F", "FS", "Pn", "WCO", "Ov", "A"})


def _given(found: dict[str, str], tag: str, read: Callable[[str], _T]) -> _T | None:
    return read(found[tag]) if tag in found else None


# float() and int() would take "nan", "1e5" and "1_0", none of which Grbl can print.
_NUMBER: Final = re.compile(r"-?\d{1,12}(\.\d{1,6})?", re.ASCII)
_WHOLE: Final = re.compile(r"\d{1,9}", re.ASCII)


def _vector(text: str) -> Vector:
    parts = text.split(",")
    if not all(_NUMBER.fullmatch(part) for part in parts):
        raise ValueError(f"{text} is no vector")
    return tuple(float(part) for part in parts)


def _whole(text: str) -> int:
    if not _WHOLE.fullmatch(text):
        raise ValueError(f"{text} is no whole number")
    return int(text)


def _pair(text: str) -> tuple[int, int]:
    first, second = (_whole(part) for part in text.split(","))
    return first, second


def _triple(text: str) -> tuple[int, int, int]:
    first, second, third = (_whole(part) for part in text.split(","))
    return first, second, third


def message_bytes(message: Message) -> bytes:
    """One message as the board sends it, terminated."""
    return message_line(message).encode("latin-1") + b"\r\n"


def message_line(message: Message) -> str:
    """One message as text; `parsed` is its inverse."""
    match message:
        case Ok():
            return "ok"
        case Error(number=code):
            return f"error:{code}"
        case Alarm(number=code):
            return f"ALARM:{code}"
        case Banner():
            return f"{message.firmware} {message.version} [{message.hint}]"
        case Feedback():
            return f"[{message.tag}:{message.text}]"
        case Setting(number=code):
            return f"${code}={message.value}"
        case StartupLine(line=line, error=error):
            return f">{line}:" + ("ok" if error is None else f"error:{error}")
        case Status():
            return f"<{'|'.join(_status_fields(message))}>"
        case Unknown():
            return message.text


def _status_fields(status: Status) -> Iterator[str]:
    """Fields in the order of report.c."""
    substate = "" if status.substate is None else f":{status.substate}"
    yield f"{status.state.value}{substate}"
    if status.machine is not None:
        yield f"MPos:{_coordinates(status.machine)}"
    if status.work is not None:
        yield f"WPos:{_coordinates(status.work)}"
    if status.buffer is not None:
        yield f"Bf:{status.buffer[0]},{status.buffer[1]}"
    if status.line is not None:
        yield f"Ln:{status.line}"
    if status.feed is not None:
        yield _feed_field(status.feed, status.spindle)
    if status.pins:
        yield f"Pn:{status.pins}"
    if status.work_offset is not None:
        yield f"WCO:{_coordinates(status.work_offset)}"
    if status.overrides is not None:
        yield "Ov:" + ",".join(map(str, status.overrides))
    if status.accessories:
        yield f"A:{status.accessories}"
    yield from status.others


def _coordinates(values: Vector) -> str:
    return ",".join(f"{value:.3f}" for value in values)


def _feed_field(feed: float, spindle: float | None) -> str:
    return f"F:{feed:.0f}" if spindle is None else f"FS:{feed:.0f},{spindle:.0f}"


def error_name(number: int) -> str:
    """Name of an error, such as ``error:9 (locked by an alarm or a jog)``."""
    return f"error:{number} ({ERRORS.get(number, 'unknown')})"


def alarm_name(number: int) -> str:
    """Name of an alarm, such as ``ALARM:1 (hard limit)``."""
    return f"ALARM:{number} ({ALARMS.get(number, 'unknown')})"


def error_remedy(number: int) -> str:
    """What an operator can do about an error."""
    return ERROR_REMEDIES.get(number, "see the controller's manual")


def alarm_remedy(number: int) -> str:
    """What an operator can do about an alarm."""
    return ALARM_REMEDIES.get(number, "see the controller's manual, then home")
