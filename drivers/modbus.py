"""A Modbus bus, RTU or TCP, over a ByteLink: deadlines, quarantine and retries are ours.

An RTU reply does not say which register it answers for, so one that comes late is taken for the
answer to the next question: a wrong value that looks right. With 20 % late replies a common client
returned 79 of 400 wrong without retries and 27 with three. The rules that leave none:

* after any doubt, a **quarantine**: say nothing for longer than the slowest reply, then throw away
  everything that came;
* an RTU reply is good only when the line is then silent for 5 ms (or 3.5 characters), and for as
  long as answers take there: what was heard may have been an echo of the last reply, and the
  answer itself comes now;
* a reply matches its question in id, function, count, transaction, and in all of a write's echo;
* an RTU answer that was heard, byte for byte, a moment ago, and not to this question, may be that
  one come twice, with its own lost: it is good when it comes again;
* reads are asked up to three times, writes never again.

What no rule can help: a device slower than `slowest_reply_s`, and a doubled *question* about a
value that changes meanwhile, whose second answer stands for one that is lost.
"""

from __future__ import annotations

import math
import struct
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import Enum
from statistics import median
from threading import RLock

from pymodbus.framer import FramerRTU
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, WriteSingleCoilRequest
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.links import ByteLink
from drivers.modbus_wire import (
    EXCEPTIONS,
    Question,
    match_rtu,
    match_tcp,
    rtu_frame,
    tcp_frame,
    without_echo,
)

_LONGEST_WAIT_S = 0.05  # the laser's lease is renewed at least so often
_READ_TRIES = 3
_DISTRUST_S = 60.0  # after a doubt
_REMEMBERED = 16  # answers
_LONGEST_HEARD = 1024  # bytes of what came to one question, twice or late
_LONGER_THAN_USUAL = 1.5
_PASSING = (6, 8)  # busy, and Leadshine's "your request had a bad CRC": a read may ask again
_RTU_BITS_A_CHARACTER = 11
_FIFO_CHARACTERS = 64
_TURNROUND_S = 0.015  # of a device that was asked something just before
_RECITED = 0xFFFF  # our own transactions begin at 1
_SWITCHED = {False: "off", True: "on"}


class Framing(Enum):
    """How a PDU travels."""

    RTU = "rtu"
    TCP = "tcp"


class Echo(Enum):
    """Whether a two-wire adapter hears itself."""

    NONE = "none"
    DISCARDED = "discarded"


@dataclass(frozen=True, slots=True)
class BusTally:
    """What the bus went through since it was opened."""

    requests: int = 0  # frames sent
    retries: int = 0
    no_replies: int = 0
    frame_errors: int = 0
    refusals: int = 0
    discarded_bytes: int = 0  # came when nothing was due


def rtu_silence_s(baud: int) -> float:
    """Silence between RTU frames: 3.5 characters, and at least 5 ms for adapters that batch."""
    return max(0.005, 3.5 * _RTU_BITS_A_CHARACTER / baud)


class ModbusBus:
    """One Modbus connection that several devices and threads may share; a `drivers.bus.Bus`.

    Parameters
    ----------
    timeout_s : float
        From handing over a request to the last byte of its reply, the time on the wire included.
    slowest_reply_s : float
        No device of this bus answers later than so long after it was asked.
    silence_s : float
        Around each RTU request and its reply; see `rtu_silence_s`.
    baud : int
        Of an RTU line: how long its bytes take, for those who say a recipe.
    clock, sleep
        Monotonic seconds; and how the quarantine is waited out, 50 ms at most at a time. The sleep
        may raise to give up; nothing has been sent then.
    """

    def __init__(
        self,
        link: ByteLink,
        framing: Framing = Framing.RTU,
        *,
        timeout_s: float,
        slowest_reply_s: float,
        silence_s: float = 0.005,
        echo: Echo = Echo.NONE,
        baud: int = 9600,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        if timeout_s <= 0 or slowest_reply_s < 0 or silence_s < 0:
            raise ValueError(f"{link.address}: times of a bus are positive")
        self._link = link
        self._framing = framing
        self._timeout_s = timeout_s
        self._slowest_reply_s = slowest_reply_s
        self._silence_s = silence_s if framing is Framing.RTU else 0.0
        self._echo = echo
        self._baud = baud
        self._clock = clock
        self._sleep = sleep
        # Re-entrant: a signal's handler may switch the laser off amid a request; the request then
        # finds no answer and says so.
        self._owner = RLock()
        self._speak_again_at_s = clock()
        self._silent_since_s = -math.inf  # that it was, until then
        self._doubted_s = -math.inf
        self._asked = b""
        self._heard: deque[tuple[float, bytes, bytes]] = deque(maxlen=_REMEMBERED)
        self._took_s: deque[float] = deque(maxlen=_REMEMBERED)
        if framing is Framing.RTU:  # whoever had the line before may have left a reply on its way
            self._quarantine()
        self._transaction = 0
        self._tally = BusTally()
        self._losses = 0

    @property
    def losses(self) -> int:
        """How often the link was lost: whoever was homed before one is not any more."""
        return self._losses

    def begin_anew(self) -> None:
        """The link was opened again: a new TCP connection brings nothing that is old."""
        self._silent_since_s = -math.inf
        if self._framing is Framing.TCP:
            self._speak_again_at_s = self._clock()

    @property
    def address(self) -> str:
        """The address of the link, for messages."""
        return self._link.address

    def framed(self, device_id: int, pdu: bytes) -> bytes:
        """A frame for somebody else to send or to expect; its transaction is none of ours."""
        if self._framing is Framing.RTU:
            body = bytes([device_id]) + pdu
            return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        return struct.pack(">HHHB", _RECITED, 0, len(pdu) + 1, device_id) + pdu

    def wire_s(self, size: int) -> float:
        """Seconds that so many bytes take; on a network none worth counting."""
        rtu = self._framing is Framing.RTU
        return size * _RTU_BITS_A_CHARACTER / self._baud if rtu else 0.0

    @property
    def quiet_s(self) -> float:
        """Silence after which nothing of a dead program is on its way here or there.

        A serial line: what its sender still holds (64 characters) and a reply's delay. A TCP
        connection keeps order by itself, and every answer names its question.
        """
        rtu = self._framing is Framing.RTU
        return _TURNROUND_S + self.wire_s(_FIFO_CHARACTERS) if rtu else 0.0

    def counters(self) -> dict[str, int]:
        """The tally by the names that all lines share; see `drivers.inspection`."""
        tally = self._tally
        return {
            "asked": tally.requests,
            "repeated": tally.retries,
            "timeouts": tally.no_replies,
            "damaged": tally.frame_errors,
            "refused": tally.refusals,
            "unasked_bytes": tally.discarded_bytes,
        }

    def tally(self) -> BusTally:
        """What happened so far."""
        return self._tally

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        """Holding registers (function 3); exactly `count` unsigned 16-bit values."""
        self._check(device_id, first, count, most=125)
        request = ReadHoldingRegistersRequest(dev_id=device_id, address=first, count=count)
        return _words(self._read(request, 2 * count, f"read {count} holding from {first:#06x}"))

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        """Input registers (function 4)."""
        self._check(device_id, first, count, most=125)
        request = ReadInputRegistersRequest(dev_id=device_id, address=first, count=count)
        return _words(self._read(request, 2 * count, f"read {count} input from {first:#06x}"))

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        """Coils (function 1)."""
        self._check(device_id, first, count, most=2000)
        request = ReadCoilsRequest(dev_id=device_id, address=first, count=count)
        packed = self._read(request, (count + 7) // 8, f"read {count} coils from {first:#06x}")
        return tuple(bool(packed[k // 8] >> k % 8 & 1) for k in range(count))

    def write_register(self, device_id: int, register: int, value: int) -> None:
        """One register (function 6)."""
        self._check(device_id, register, 1, most=1)
        _check_words([value])
        request = WriteSingleRegisterRequest(dev_id=device_id, address=register, registers=[value])
        self._write(request, request.encode(), f"write {value} to register {register:#06x}")

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        """Several registers in one frame (function 16)."""
        self._check(device_id, first, len(values), most=123)
        _check_words(values)
        request = WriteMultipleRegistersRequest(
            dev_id=device_id, address=first, registers=list(values)
        )
        wish = f"write {len(values)} registers from {first:#06x}"
        self._write(request, request.encode()[:4], wish)

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001 (a coil is one)
        """One coil (function 5)."""
        self._check(device_id, coil, 1, most=1)
        request = WriteSingleCoilRequest(dev_id=device_id, address=coil, bits=[value])
        self._write(request, request.encode(), f"switch coil {coil:#06x} {_SWITCHED[value]}")

    def write_coil_word(self, device_id: int, coil: int, word: int) -> None:
        """Function 5 with a word of the device's own, beside on and off."""
        self._check(device_id, coil, 1, most=1)
        _check_words([word])
        request = _CoilWord(device_id, coil, word)
        self._write(request, request.encode(), f"write {word} to coil {coil:#06x}")

    def _read(self, request: ModbusPDU, size: int, wish: str) -> bytes:
        """The payload of a read, asked again if need be."""
        question = Question(request, bytes([request.function_code, size]), size + 2, wish)
        with self._owner:
            for _ in range(_READ_TRIES - 1):
                try:
                    return self._ask_surely(question)[2:]
                except (NoReply, FrameError):
                    pass
                except Refused as refusal:
                    if refusal.code not in _PASSING:
                        raise
                self._count("retries")
            return self._ask_surely(question)[2:]

    def _ask_surely(self, question: Question) -> bytes:
        """Ask; and again when the answer may be another question's, come twice."""
        pdu = self._ask(question)
        if self._framing is Framing.TCP:
            return pdu
        if self._is_anothers(pdu, question):
            if self._clock() - self._doubted_s < _DISTRUST_S:
                self._quarantine()  # on such a wire, a third copy may be under way
            again = self._ask(question)
            if again != pdu:
                self._quarantine()
                self._count("frame_errors")
                raise FrameError(self._said(question, "two answers that differ"))
        return pdu

    def _is_anothers(self, pdu: bytes, question: Question) -> bool:
        """Whether the same was heard a moment ago, and not to this question."""
        asked, now_s = question.request.encode(), self._clock()
        return any(
            pdu in heard and other != asked and now_s - at_s <= self._slowest_reply_s
            for at_s, other, heard in self._heard
        )

    def _listen(self, wait_s: float) -> bytes:
        """What has arrived, after waiting for it; remembered with the last question sent."""
        with self._counting_losses():
            came = self._link.read(wait_s)
        if came:
            before = b""
            if self._heard and self._heard[-1][1] == self._asked:  # the rest of it, perhaps
                before = self._heard.pop()[2]
            self._heard.append((self._clock(), self._asked, (before + came)[-_LONGEST_HEARD:]))
        return came

    @contextmanager
    def _counting_losses(self) -> Iterator[None]:
        try:
            yield
        except LinkLost:
            self._losses += 1
            raise

    def _write(self, request: ModbusPDU, echoed: bytes, wish: str) -> None:
        head = bytes([request.function_code]) + echoed
        with self._owner:
            self._ask(Question(request, head, len(head), wish))

    def _check(self, device_id: int, first: int, count: int, *, most: int) -> None:
        """Refuse a caller's mistake before a byte is sent."""
        ids = range(1, 248) if self._framing is Framing.RTU else range(256)
        if device_id not in ids:
            raise ValueError(f"device id {device_id} is not from {ids[0]} to {ids[-1]}")
        if not 1 <= count <= most:
            raise ValueError(f"{count} at once; one frame holds from 1 to {most}")
        if not 0 <= first <= 0x10000 - count:
            raise ValueError(f"{count} from address {first} are not within 0 to 65535")

    def _ask(self, question: Question) -> bytes:
        """Send, and return the PDU of the answer; any doubt puts the bus in quarantine."""
        try:
            self._wait_for_silence()
            pdu = self._answer(question)
            self._hear_out()
        except (NoReply, FrameError) as doubt:
            self._quarantine()
            self._count("no_replies" if isinstance(doubt, NoReply) else "frame_errors")
            raise type(doubt)(self._said(question, str(doubt))) from doubt
        self._speak_again_at_s = self._clock()
        if pdu[0] == question.reply_head[0]:
            return pdu
        self._count("refusals")
        if pdu[1] in _PASSING:
            self._quarantine()
        name = EXCEPTIONS.get(pdu[1], "no standard code; see the device's manual")
        raise Refused(self._said(question, f"refused, code {pdu[1]} ({name})"), code=pdu[1])

    def _said(self, question: Question, what: str) -> str:
        return f"{self.address}: device {question.device_id}, {question.wish}: {what}"

    def _answer(self, question: Question) -> bytes:
        frame = self._frame(question)
        asked_s, self._asked = self._clock(), question.request.encode()
        deadline_s = asked_s + self._timeout_s
        # In doubt until answered: an interrupt, too, may leave a reply on its way.
        self._speak_again_at_s = deadline_s + self._slowest_reply_s
        self._count("requests")
        with self._counting_losses():
            self._link.write(frame)
        received = b""
        while (left_s := deadline_s - self._clock()) > 0:
            received += self._listen(min(left_s, _LONGEST_WAIT_S))
            if (pdu := self._match(received, frame, question)) is not None:
                self._took_s.append(self._clock() - asked_s)
                return pdu
        if received:
            raise FrameError(f"only {received.hex(' ')} in {self._timeout_s} s")
        raise NoReply(
            f"no answer in {self._timeout_s} s; is it powered, its id and the line's speed right?"
        )

    def _frame(self, question: Question) -> bytes:
        if self._framing is Framing.RTU:
            return rtu_frame(question.request)
        self._transaction = self._transaction % 0xFFFF + 1
        question.request.transaction_id = self._transaction
        return tcp_frame(question.request)

    def _match(self, received: bytes, sent: bytes, question: Question) -> bytes | None:
        if self._framing is Framing.TCP:
            return match_tcp(received, question)
        after = without_echo(received, sent) if self._echo is Echo.DISCARDED else received
        return None if after is None else match_rtu(after, question)

    def _hear_out(self) -> None:
        """Doubt an RTU answer that another follows; it does not say what it answers."""
        if self._framing is Framing.TCP:
            return
        silence_s = max(self._silence_s, _LONGER_THAN_USUAL * median(self._took_s))
        until_s = self._clock() + silence_s
        while (left_s := until_s - self._clock()) > 0:
            if came := self._listen(min(left_s, _LONGEST_WAIT_S)):
                self._count("discarded_bytes", len(came))
                raise FrameError(
                    f"{came.hex(' ')} followed the answer; is another master on the line?"
                )
        self._silent_since_s = self._clock()

    def _wait_for_silence(self) -> None:
        """Wait out a quarantine, then the silence before a request; throw away what came."""
        while (left_s := self._speak_again_at_s - self._clock()) > 0:
            self._sleep(min(left_s, _LONGEST_WAIT_S))
        if self._clock() - self._silent_since_s < self._silence_s:
            return
        patience_s = self._clock() + self._slowest_reply_s + 2 * self._silence_s
        while came := self._listen(self._silence_s):
            self._count("discarded_bytes", len(came))
            if self._clock() > patience_s:
                raise FrameError("the line does not fall silent; is another master on it?")

    def _quarantine(self) -> None:
        self._doubted_s = self._clock()
        self._speak_again_at_s = self._clock() + self._slowest_reply_s

    def _count(self, name: str, by: int = 1) -> None:
        self._tally = replace(self._tally, **{name: getattr(self._tally, name) + by})


class _CoilWord(WriteSingleCoilRequest):
    """A request of function 5 whose word is neither 0xFF00 nor 0."""

    def __init__(self, device_id: int, coil: int, word: int) -> None:
        super().__init__(dev_id=device_id, address=coil, bits=[True])
        self._payload = struct.pack(">HH", coil, word)

    def encode(self) -> bytes:
        return self._payload


def _words(payload: bytes) -> tuple[int, ...]:
    return struct.unpack(f">{len(payload) // 2}H", payload)


def _check_words(values: Sequence[int]) -> None:
    for value in values:
        if not 0 <= value <= 0xFFFF:
            raise ValueError(f"{value} is no 16-bit register value; split and wrap it first")
