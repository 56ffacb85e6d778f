"""Every byte both ways as lines of text, which a person reads and a test replays.

    # loftscan wire log: serial:///dev/ttyUSB0
    12.034718 > 3f                # ?
    12.036201 < 3c 49 64 6c 65    # <Idle

Monotonic seconds; ``>`` what we sent, ``<`` what came; hex; after ``#`` what of it is printable. A
line is written out at once, so that the log of a killed program ends where the program did.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from threading import Lock
from typing import TextIO

from drivers.errors import LinkLost
from drivers.links import ByteLink, descriptor_of


class Direction(Enum):
    """Seen from the driver."""

    SENT = ">"
    CAME = "<"


@dataclass(frozen=True, slots=True)
class WireRecord:
    """One write, or what one read returned."""

    time_s: float
    direction: Direction
    data: bytes

    def __str__(self) -> str:
        remark = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in self.data)
        return f"{self.time_s:.6f} {self.direction.value} {self.data.hex(' ')}  # {remark}"


class LoggedLink:
    """A link that writes down what passes; made by `logged`."""

    def __init__(
        self,
        link: ByteLink,
        file: TextIO,
        clock: Callable[[], float],
        close_file: Callable[[], None],
    ) -> None:
        self._link = link
        self._file = file
        self._clock = clock
        self._close_file = close_file
        self._owner = Lock()
        self.failure = ""  # why the log ends early: a full disk must not keep "laser off" back
        self._line(f"# loftscan wire log: {link.address}")

    @property
    def address(self) -> str:
        """The address of the link inside."""
        return self._link.address

    def fileno(self) -> int | None:
        """The descriptor of the link inside: what a guard says on it is not written down here."""
        return descriptor_of(self._link)

    def read(self, timeout_s: float) -> bytes:
        """Read, and write down what came."""
        data = self._link.read(timeout_s)
        if data:
            self._line(str(WireRecord(self._clock(), Direction.CAME, data)))
        return data

    def write(self, data: bytes) -> None:
        """Write down what is about to be sent, and send it."""
        if data:
            self._line(str(WireRecord(self._clock(), Direction.SENT, data)))
        self._link.write(data)

    def close(self) -> None:
        """Close the link, and the file if it was opened here."""
        self._link.close()
        with self._owner, suppress(OSError):  # a full disk again; `failure` has said so
            self._close_file()

    def _line(self, text: str) -> None:
        with self._owner:
            if self.failure:
                return
            try:
                self._file.write(text + "\n")
                self._file.flush()
            except (OSError, ValueError) as full:  # ValueError: the file was closed
                self.failure = str(full)


def logged(link: ByteLink, to: Path | TextIO, clock: Callable[[], float]) -> LoggedLink:
    """Wrap `link` so that every byte both ways is appended to a file, or to one already open."""
    if isinstance(to, Path):
        file = to.open("a", encoding="ascii")
        return LoggedLink(link, file, clock, file.close)
    return LoggedLink(link, to, clock, lambda: None)


def read_wire_log(file: Path) -> tuple[WireRecord, ...]:
    """Read a log back.

    Raises
    ------
    ValueError
        A line that is none, such as the torn last one of a machine that lost power; names it.
    """
    return parse_wire_log(file.read_text(encoding="ascii"), name=str(file))


def parse_wire_log(text: str, *, name: str = "wire log") -> tuple[WireRecord, ...]:
    """Read the text of a log; comments and empty lines say nothing."""
    if text and not text.endswith("\n"):
        raise ValueError(f"{name}: the last line is torn; remove it")
    return tuple(_records(text, name))


def _records(text: str, name: str) -> Iterator[WireRecord]:
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].split(maxsplit=2)
        if not content:
            continue
        try:
            time_s, sign, digits = content
            yield WireRecord(_seconds(time_s), Direction(sign), bytes.fromhex(digits))
        except ValueError as wrong:
            raise ValueError(
                f"{name}, line {number}: {line!r} is not 'seconds > hex' ({wrong})"
            ) from wrong


def _seconds(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is no time")
    return value


class TranscriptDiffers(AssertionError):  # noqa: N818 (the house names errors after the fact)
    """The driver under test did not do what the log says."""


class ReplayedLink:
    """A link that answers as a log says; made by `replayed`."""

    def __init__(
        self, records: Iterable[WireRecord], wait: Callable[[float], None], name: str
    ) -> None:
        self._records = _joined(records)
        self._wait = wait
        self._name = name
        self._closed = False

    @property
    def address(self) -> str:
        """The name of the log."""
        return self._name

    def read(self, timeout_s: float) -> bytes:
        """Return what came at this place of the log; nothing where a write is due."""
        self._raise_if_closed()
        if self._records and self._records[0].direction is Direction.CAME:
            return self._records.pop(0).data
        self._wait(timeout_s)
        return b""

    def write(self, data: bytes) -> None:
        """Compare with what was sent at this place of the log, whatever its chunks were."""
        self._raise_if_closed()
        due = self._records[0] if self._records else None
        if due is None or due.direction is Direction.CAME or not due.data.startswith(data):
            raise TranscriptDiffers(f"{self._name}: wrote {data.hex(' ')}, the log has {due}")
        rest = due.data[len(data) :]
        self._records[:1] = [WireRecord(due.time_s, due.direction, rest)] if rest else []

    def close(self) -> None:
        """Close; may be called again."""
        self._closed = True

    def raise_if_unused(self) -> None:
        """Fail when the log goes on and the driver did not."""
        if self._records:
            raise TranscriptDiffers(
                f"{self._name}: {len(self._records)} lines unused, the next is {self._records[0]}"
            )

    def _raise_if_closed(self) -> None:
        if self._closed:
            raise LinkLost(f"{self._name}: the link was closed")


@contextmanager
def replayed(
    records: Sequence[WireRecord],
    *,
    wait: Callable[[float], None] = lambda _: None,
    name: str = "replay",
) -> Iterator[ReplayedLink]:
    """Replay a log to a driver; leaving the block, all of it must have been used.

    Parameters
    ----------
    wait
        Called with the timeout by a read that finds nothing: advance the test's clock there.

    Raises
    ------
    TranscriptDiffers
        A write that differs, or lines that were not used.
    """
    link = ReplayedLink(records, wait, name)
    yield link
    link.raise_if_unused()


def _joined(records: Iterable[WireRecord]) -> list[WireRecord]:
    """Join neighbouring writes: how a driver cuts its bytes into writes is its own affair."""
    joined: list[WireRecord] = []
    for record in records:
        last = joined[-1] if joined else None
        if last and last.direction is record.direction is Direction.SENT:
            joined[-1] = WireRecord(last.time_s, last.direction, last.data + record.data)
        else:
            joined.append(record)
    return joined
