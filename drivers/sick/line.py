r"""The half duplex line of a SICK Profiler 2: one question, one answer, silence after an error.

::

    request  |  turn_s  reply  |  request ...
             '-- at most turn_s + the reply's time on the wire --'

Nobody speaks while an answer may come, or both are lost (E007). After an error the line rests until
nothing late can arrive; after silence until the sensor has forgotten a request that lost a byte,
for which it waits 2 s.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Final

from drivers.errors import DriverError, FrameError, NoReply, Refused
from drivers.links import ByteLink
from drivers.sick.wire import AROUND, ERRORS, MISHEARD, MOST_DATA, Decoder, Frame, encoded

FORGETS_S: Final = 2.0  # a command must be whole within it (page 111)
_LATENCY_S: Final = 0.05  # of this host and its adapter; the manual's times are the sensor's own
_SLICE_S: Final = 0.02
_QUIET_S: Final = 0.03  # longer than an adapter holds bytes back
_NOISY_S: Final = 1.0  # of bytes that nobody asked for, until we say so
_BITS_A_CHARACTER: Final = 10


def turn_s(baud: int) -> float:
    """How long the sensor takes to begin its reply, at most (page 111)."""
    return {9600: 1.8e-3, 19200: 1.0e-3}.get(baud, 204e-6)


@dataclass(frozen=True, slots=True)
class Question:
    """A request, and how many bytes of data its answer has."""

    request: Frame
    answer_bytes: int


class SickLine:
    """Questions over a link, in steps that never wait longer than 20 ms.

    Parameters
    ----------
    link : ByteLink
        The port; this line is its only holder, and whoever opened it closes it.
    """

    def __init__(
        self, link: ByteLink, *, baud: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.clock = clock
        self.bad = 0  # answers that were none
        self._asked = self._timeouts = 0
        self._link = link
        self._baud = baud
        self._rests_until_s = 0.0
        self._due_s = 0.0
        self._decoder = Decoder()

    @property
    def address(self) -> str:
        """The address of the link, for messages."""
        return self._link.address

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        timeouts = self._timeouts
        return {"asked": self._asked, "timeouts": timeouts, "damaged": self.bad - timeouts}

    def ask(self, question: Question) -> bytes:
        """Ask what changes nothing, and wait for the answer's data; asked twice at most.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            The sensor said no; `code` is its own, 0xE001 to 0xE008.
        """
        steps = self.steps(question)
        while True:
            try:
                next(steps)
            except StopIteration as done:
                return bytes(done.value)

    def steps(self, question: Question) -> Generator[None, None, bytes]:
        """As `ask`, but one short wait a step."""
        try:
            return (yield from self._exchanged(question))
        except (NoReply, FrameError):
            self.bad += 1
        try:
            return (yield from self._exchanged(question))
        except (NoReply, FrameError):
            self.bad += 1
            raise

    def rest(self) -> None:
        """Give up the question that is under way: its answer goes by before the next is asked."""
        longest = AROUND + MOST_DATA
        gone_s = self.clock() + self._wire_s(longest) + _LATENCY_S
        self._rests_until_s = max(self._rests_until_s, gone_s)

    def _exchanged(self, question: Question) -> Generator[None, None, bytes]:
        yield from self._rested()
        data = encoded(question.request)
        self._decoder = Decoder()
        sent_s = self.clock()
        self._asked += 1
        self._link.write(data)
        bytes_due = len(data) + AROUND + question.answer_bytes
        deadline_s = sent_s + self._wire_s(bytes_due) + turn_s(self._baud) + _LATENCY_S
        frames: deque[Frame] = deque()
        while not frames and (left_s := deadline_s - self.clock()) > 0.0:
            frames.extend(self._decoder.feed(self._link.read(min(left_s, _SLICE_S))))
            yield
        if not frames:  # a caller that was away for long finds its answer in the port
            frames.extend(self._decoder.feed(self._link.read(0.0)))
            frames.extend(self._decoder.flush())
        if not frames:
            self._rest_after_silence(sent_s)
        # What came may be another's answer, and ours still on its way.
        self._due_s = deadline_s
        return self._sound(question, frames)

    def _sound(self, question: Question, frames: deque[Frame]) -> bytes:
        said = f"sick at {self.address}: command {question.request.command:04X}"
        if not frames and self._decoder.dropped:
            raise FrameError(f"{said}: {self._decoder.dropped} bytes of no frame; check the cable")
        if not frames:
            self._timeouts += 1
            raise NoReply(
                f"{said}: no answer; is the sensor on, are baud rate and the wires A and B right?"
            )
        frame = frames.popleft()
        if frame.command in ERRORS:
            raise self._error(said, frame.command)
        if frame.command != question.request.command or len(frame.data) != question.answer_bytes:
            self._rests_until_s = max(self._due_s, self.clock() + _QUIET_S)
            raise FrameError(
                f"{said}: answered {frame.command:04X} with {len(frame.data)} B;"
                f" {question.answer_bytes} B were due"
            )
        return frame.data

    def _error(self, said: str, code: int) -> DriverError:
        message = f"{said}: E{code & 0xFFF:03X}, {ERRORS[code]}"
        if code in MISHEARD:
            self._rests_until_s = max(self._due_s, self.clock() + _QUIET_S)
            return FrameError(f"{message}; check the cable")
        return Refused(message, code=code)

    def _rest_after_silence(self, sent_s: float) -> None:
        self._rests_until_s = max(self.clock() + _QUIET_S, sent_s + FORGETS_S)

    def _rested(self) -> Iterator[None]:
        """Let late bytes go by, each of which makes the silence begin anew."""
        gives_up_s = max(self.clock(), self._rests_until_s) + _NOISY_S
        while (left_s := self._rests_until_s - self.clock()) > 0.0:
            self._hush(self._link.read(min(left_s, _SLICE_S)), gives_up_s)
            yield
        while late := self._link.read(0.0):
            self._hush(late, gives_up_s)
            yield

    def _hush(self, heard: bytes, gives_up_s: float) -> None:
        if heard and self.clock() >= gives_up_s:
            raise FrameError(
                f"sick at {self.address}: the line is never quiet; does another device talk on it?"
            )
        if heard:
            self._rests_until_s = max(self._rests_until_s, self.clock() + _QUIET_S)

    def _wire_s(self, count: int) -> float:
        return count * _BITS_A_CHARACTER / self._baud
