"""Modbus frames: what is asked, and whether the bytes that came are its answer.

    RTU   | id | function data | crc lo hi |
    TCP   | transaction | 0 0 | length | id | function data |

pymodbus writes the requests and computes the CRC. The replies are matched here, because its framers
look for *a* frame and we need *the* answer: ``handleFrame`` skips a foreign reply in silence and
returns what follows, cannot tell a bad CRC from bytes still to come, waits for the length that
garbage announces, and hands over a success with too few registers. Here a reply to one question is
known but for its values, head and length, and a byte that cannot belong to it is an error at once.

Pure functions; a match that needs more bytes is None, one that can never come is FrameError.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from drivers.errors import FrameError

# A transceiver that turns round may drop or raise the line for a bit or two. No device has these
# as its id (0 is broadcast, 248 to 255 are reserved), so they are never the start of a reply.
_TURNROUND_NOISE = b"\x00\xff"
_EXCEPTION = 0x80
_TCP_HEAD = struct.Struct(">HHHB")
_LONGEST_PDU = 253

EXCEPTIONS = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "device failure",
    5: "acknowledged, takes long",
    6: "device busy",
    7: "negative acknowledge",
    8: "memory parity, or on a Leadshine drive a request with a bad CRC",
    10: "gateway path unavailable",
    11: "gateway target does not respond",
}


@dataclass(frozen=True, slots=True)
class Question:
    """A request, and all that is known of its answer beforehand."""

    request: ModbusPDU  # with the device's id and, on TCP, the transaction's
    reply_head: bytes  # the PDU begins so: function and byte count, or the whole echo of a write
    reply_size: int  # bytes of the whole PDU
    wish: str  # for messages, such as "read 2 holding registers from 0x6002"

    @property
    def device_id(self) -> int:
        """Whom it asks."""
        return self.request.dev_id


def rtu_frame(request: ModbusPDU) -> bytes:
    """The bytes of a request on a serial line."""
    return FramerRTU(DecodePDU(is_server=True)).buildFrame(request)


def tcp_frame(request: ModbusPDU) -> bytes:
    """The bytes of a request on a TCP connection."""
    return FramerSocket(DecodePDU(is_server=True)).buildFrame(request)


def without_echo(received: bytes, sent: bytes) -> bytes | None:
    """What follows the local echo of a two-wire adapter; None while the echo is still coming.

    Raises
    ------
    FrameError
        The echo differs: somebody else spoke at the same time.
    """
    if received[: len(sent)] != sent[: len(received)]:
        raise FrameError(f"the echo of {sent.hex(' ')} came back as {received.hex(' ')}")
    return received[len(sent) :] if len(received) >= len(sent) else None


def match_rtu(received: bytes, question: Question) -> bytes | None:
    """The PDU that answers `question`, an exception's included; None while it is not whole.

    Raises
    ------
    FrameError
        The bytes are no answer to it, whatever may still come, or more came than the answer.
    """
    frame = received.lstrip(_TURNROUND_NOISE)
    if frame and frame[0] != question.device_id:
        raise FrameError(f"a reply of {question.device_id} began with {received[:8].hex(' ')}")
    size = _pdu_size(frame[1:], question)
    if size is None or len(frame) < size + 3:
        return None
    body, checksum, rest = frame[: size + 1], frame[size + 1 : size + 3], frame[size + 3 :]
    if FramerRTU.compute_CRC(body) != int.from_bytes(checksum, "big"):
        raise FrameError(f"bad CRC of {frame[: size + 3].hex(' ')}")
    if rest.strip(_TURNROUND_NOISE):
        # Of two frames nobody can say which is the answer and which came late.
        raise FrameError(f"{len(rest)} bytes more than the reply: {rest[:8].hex(' ')}")
    return body[1:]


def match_tcp(received: bytes, question: Question) -> bytes | None:
    """The same on TCP; replies to other transactions are late ones, and skipped."""
    while len(received) >= _TCP_HEAD.size:
        transaction, protocol, length, device_id = _TCP_HEAD.unpack_from(received)
        if protocol or not 3 <= length <= _LONGEST_PDU + 1:
            raise FrameError(f"no Modbus TCP header: {received[:7].hex(' ')}")
        if transaction == question.request.transaction_id:
            if device_id != question.device_id:
                raise FrameError(f"{question.device_id} was asked, {device_id} answered")
            return _whole_pdu(received[7 : 6 + length], length - 1, question)
        received = received[6 + length :]
    return None


def _whole_pdu(pdu: bytes, announced: int, question: Question) -> bytes | None:
    size = _pdu_size(pdu, question)
    if size is not None and size != announced:
        raise FrameError(f"a reply of {announced} bytes, {size} were due: {pdu[:8].hex(' ')}")
    return pdu if len(pdu) == announced else None


def _pdu_size(pdu: bytes, question: Question) -> int | None:
    """Bytes of the PDU that begins so; None while that cannot be told."""
    head = question.reply_head
    if not pdu:
        return None
    if pdu[0] == head[0] | _EXCEPTION:
        return 2
    if pdu[: len(head)] != head[: len(pdu)]:
        raise FrameError(f"{pdu[: len(head)].hex(' ')} came where {head.hex(' ')} was due")
    return question.reply_size
