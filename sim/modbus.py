"""The answering end of a Modbus wire: requests found in the bytes, served by units, answered.

After the *Modbus Application Protocol* V1.1b3 and *Modbus over Serial Line* V1.02, whose order of
checks is kept: function (1), quantity and value (3), address (2). A request is 253 bytes at most::

    RTU   | id | function data | crc lo hi |           one wire, many units
    TCP   | transaction | 0 0 | length | id | function data |     one session a connection

The requests are read here and not by the code that writes them for the drivers, so that a frame
wrongly built is not wrongly understood. The CRC is pymodbus's.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from pymodbus.framer import FramerRTU

from sim.device import ModbusRefusal, ModbusUnit

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _NO_TARGET = 1, 2, 3, 11
_MOST_WORDS_READ, _MOST_WORDS_WRITTEN = 125, 123
_MOST_BITS_READ, _MOST_BITS_WRITTEN = 2000, 1968
_EXCEPTION = 0x80
_BROADCAST = 0
_FLASH_PAGE = 0x02
_WRITES = (5, 6, 15, 16)
_LONGEST_RTU = 256
_TCP_HEAD = struct.Struct(">HHHB")
_LENGTHS = range(2, 255)  # of id and PDU


@runtime_checkable
class ComplainsOfCrc(Protocol):
    """A unit that answers a request with a bad CRC, where the standard wants silence."""

    crc_refusal: int  # the exception's code


@runtime_checkable
class Flashes(Protocol):
    """A unit that takes more of function 5 than on and off, which the standard does not have."""

    def flash(self, address: int, word: int, now_s: float) -> None:
        """Do function 5 at an address of the page 0x02."""
        ...


class RtuServer:
    """All units of one serial line.

    A request's end is told by its length. Silence within a request discards it; after a bad CRC
    nothing is heard until the line was silent.

    Parameters
    ----------
    silence_s
        The standard's 3.5 characters are 0.3 ms at 115200 baud; a pty delivers in bursts, and its
        reader is not always called in time.
    """

    def __init__(self, units: Mapping[int, ModbusUnit], *, silence_s: float = 0.02) -> None:
        for device_id in units:
            if device_id not in range(1, 248):
                raise ValueError(f"Modbus: {device_id} is no id of a serial line, 1 to 247 are")
        self._units = dict(units)
        self._silence_s = silence_s
        self._received = b""
        self._heard_s = -1.0
        self._deaf = False

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes off the line; return the answers."""
        answers = self._after_silence(now_s)
        if data:
            answers += self._listen(data, now_s)
            self._heard_s = now_s
        return answers

    def tick(self, now_s: float) -> bytes:
        """Let time pass for the units; answer what only silence ends."""
        for unit in self._units.values():
            unit.tick(now_s)
        return self._after_silence(now_s)

    def _after_silence(self, now_s: float) -> bytes:
        """Forget a request that broke off; a whole one of a function unknown is refused."""
        if now_s - self._heard_s < self._silence_s:
            return b""
        frame, self._received, self._deaf = self._received, b"", False
        if len(frame) < 4 or _rtu_size(frame) is not None or not _sound(frame):
            return b""
        return self._served(frame, now_s)

    def _listen(self, data: bytes, now_s: float) -> bytes:
        if self._deaf:
            return b""
        self._received += data
        answers = b""
        while (size := _rtu_size(self._received)) and len(self._received) >= size:
            frame, self._received = self._received[:size], self._received[size:]
            if not _sound(frame):
                self._received, self._deaf = b"", True
                return answers + self._complaint(frame)
            answers += self._served(frame, now_s)
        if len(self._received) > _LONGEST_RTU:
            self._received, self._deaf = b"", True
        return answers

    def _served(self, frame: bytes, now_s: float) -> bytes:
        device_id, pdu = frame[0], frame[1:-2]
        if device_id == _BROADCAST:
            self._broadcast(pdu, now_s)
        if (unit := self._units.get(device_id)) is None:
            return b""
        unit.heard(now_s)
        return _closed(frame[:1] + answer(unit, pdu, now_s))

    def _broadcast(self, pdu: bytes, now_s: float) -> None:
        """Let everybody do it and nobody answer, not even a refusal."""
        for unit in self._units.values():
            unit.heard(now_s)
            if pdu[0] in _WRITES:
                answer(unit, pdu, now_s)

    def _complaint(self, frame: bytes) -> bytes:
        unit: object = self._units.get(frame[0])
        if not isinstance(unit, ComplainsOfCrc):
            return b""
        return _closed(bytes([frame[0], frame[1] | _EXCEPTION, unit.crc_refusal]))


class TcpSession:
    """One connection to a server of one or more units.

    A server of one unit answers to whatever id it is called by, as most do; one of several refuses
    unknown ids as a gateway. A request of another protocol is passed over. After a length that no
    request has, nothing can be found any more: the session is `lost`, to be closed.
    """

    def __init__(self, units: Mapping[int, ModbusUnit]) -> None:
        self.lost = False
        self._units = dict(units)
        self._received = b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes off the connection; return the answers."""
        self._received += data
        answers = b""
        while not self.lost and len(self._received) >= _TCP_HEAD.size:
            transaction, protocol, length, device_id = _TCP_HEAD.unpack_from(self._received)
            if length not in _LENGTHS:
                self.lost = True
                break
            if len(self._received) < 6 + length:
                break
            pdu, self._received = self._received[7 : 6 + length], self._received[6 + length :]
            if protocol == 0:
                reply = self._served(device_id, pdu, now_s)
                answers += _TCP_HEAD.pack(transaction, 0, len(reply) + 1, device_id) + reply
        return answers

    def tick(self, now_s: float) -> bytes:
        """Let time pass for the units."""
        for unit in self._units.values():
            unit.tick(now_s)
        return b""

    def _served(self, device_id: int, pdu: bytes, now_s: float) -> bytes:
        unit = self._units.get(device_id)
        if unit is None and len(self._units) == 1:
            (unit,) = self._units.values()
        if unit is None:
            return bytes([pdu[0] | _EXCEPTION, _NO_TARGET])
        unit.heard(now_s)
        return answer(unit, pdu, now_s)


def answer(unit: ModbusUnit, pdu: bytes, now_s: float) -> bytes:
    """The PDU that a unit answers a request's PDU with."""
    if (serve := _FUNCTIONS.get(pdu[0])) is None:
        return bytes([pdu[0] | _EXCEPTION, _ILLEGAL_FUNCTION])
    try:
        return pdu[:1] + serve(unit, pdu[1:], now_s)
    except ModbusRefusal as refusal:
        return bytes([pdu[0] | _EXCEPTION, refusal.code])


def _read_coils(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    return _counted(_packed(unit.read_coils(*_span(asked, 4, _MOST_BITS_READ), now_s)))


def _read_discrete(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    return _counted(_packed(unit.read_discrete(*_span(asked, 4, _MOST_BITS_READ), now_s)))


def _read_holding(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    words = unit.read_holding(*_span(asked, 4, _MOST_WORDS_READ), now_s)
    return _counted(struct.pack(f">{len(words)}H", *words))


def _read_input(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    words = unit.read_input(*_span(asked, 4, _MOST_WORDS_READ), now_s)
    return _counted(struct.pack(f">{len(words)}H", *words))


def _write_coil(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    if len(asked) == 4 and isinstance(unit, Flashes) and asked[0] == _FLASH_PAGE:
        address, word = struct.unpack(">HH", asked)
        unit.flash(address, word, now_s)
        return asked
    if len(asked) != 4 or asked[2:] not in (b"\xff\x00", b"\x00\x00"):
        raise ModbusRefusal(_ILLEGAL_VALUE)
    unit.write_coils(int.from_bytes(asked[:2], "big"), [asked[2] == 0xFF], now_s)
    return asked


def _write_register(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    if len(asked) != 4:
        raise ModbusRefusal(_ILLEGAL_VALUE)
    register, word = struct.unpack(">HH", asked)
    unit.write_registers(register, [word], now_s)
    return asked


def _write_coils(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    first, count = _span(asked, 5 + asked[4] if len(asked) > 4 else 0, _MOST_BITS_WRITTEN)
    if asked[4] != (count + 7) // 8:
        raise ModbusRefusal(_ILLEGAL_VALUE)
    unit.write_coils(first, [bool(asked[5 + k // 8] >> k % 8 & 1) for k in range(count)], now_s)
    return asked[:4]


def _write_registers(unit: ModbusUnit, asked: bytes, now_s: float) -> bytes:
    first, count = _span(asked, 5 + asked[4] if len(asked) > 4 else 0, _MOST_WORDS_WRITTEN)
    if asked[4] != 2 * count:
        raise ModbusRefusal(_ILLEGAL_VALUE)
    unit.write_registers(first, struct.unpack_from(f">{count}H", asked, 5), now_s)
    return asked[:4]


_FUNCTIONS: dict[int, Callable[[ModbusUnit, bytes, float], bytes]] = {
    1: _read_coils,
    2: _read_discrete,
    3: _read_holding,
    4: _read_input,
    5: _write_coil,
    6: _write_register,
    15: _write_coils,
    16: _write_registers,
}


def _span(asked: bytes, size: int, most: int) -> tuple[int, int]:
    """First address and count of a request of `size` bytes."""
    if len(asked) != size:
        raise ModbusRefusal(_ILLEGAL_VALUE)
    first, count = struct.unpack_from(">HH", asked)
    if not 1 <= count <= most:
        raise ModbusRefusal(_ILLEGAL_VALUE)
    if first + count > 0x10000:
        raise ModbusRefusal(_ILLEGAL_ADDRESS)
    return first, count


def _counted(payload: bytes) -> bytes:
    return bytes([len(payload)]) + payload


def _packed(states: Sequence[bool]) -> bytes:
    """Eight to a byte, the first lowest."""
    packed = bytearray((len(states) + 7) // 8)
    for k, state in enumerate(states):
        packed[k // 8] |= state << k % 8
    return bytes(packed)


def _rtu_size(frame: bytes) -> int | None:
    """Bytes of the request that begins so; None while, or because, that cannot be told."""
    function = frame[1] if len(frame) > 1 else 0
    if function in (15, 16):
        return 9 + frame[6] if len(frame) > 6 else None
    return 8 if 1 <= function <= 6 else None


def _sound(frame: bytes) -> bool:
    return FramerRTU.compute_CRC(frame[:-2]) == int.from_bytes(frame[-2:], "big")


def _closed(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
