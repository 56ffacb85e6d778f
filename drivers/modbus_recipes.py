"""Words of a recipe in Modbus: each is one request, and the one answer that is right."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Protocol

from drivers.recipes import Word, exactly

_LATENCY_S = 0.05  # of a device, beside what the wire takes; a late answer only costs the next try
_PAIR = struct.Struct(">HH")


class Framer(Protocol):
    """What makes a frame of a PDU; `drivers.modbus.ModbusBus` does."""

    def framed(self, device_id: int, pdu: bytes) -> bytes:
        """The bytes on the wire."""
        ...

    def wire_s(self, size: int) -> float:
        """Seconds that so many bytes take."""
        ...


def write_coil(bus: Framer, device_id: int, coil: int, word: int) -> Word:
    """Function 5, echoed."""
    pdu = b"\x05" + _PAIR.pack(coil, word)
    return _word(bus, device_id, pdu, exactly(bus.framed(device_id, pdu)), len(pdu))


def write_register(bus: Framer, device_id: int, register: int, value: int) -> Word:
    """Function 6, echoed."""
    pdu = b"\x06" + _PAIR.pack(register, value)
    return _word(bus, device_id, pdu, exactly(bus.framed(device_id, pdu)), len(pdu))


def write_registers(bus: Framer, device_id: int, first: int, values: Sequence[int]) -> Word:
    """Function 16, whose answer says where and how many."""
    place = b"\x10" + _PAIR.pack(first, len(values))
    data = struct.pack(f">B{len(values)}H", 2 * len(values), *values)
    return _word(bus, device_id, place + data, exactly(bus.framed(device_id, place)), len(place))


def long_without_bits(bus: Framer, device_id: int, first: int, mask: int) -> Word:
    """Function 3 of two words, high word first, and every answer that has none of these bits.

    They are too many to spell out with their checksums: none is looked for, and a recipe asks three
    times. The head of the answer is compared whole.
    """
    any_byte = b"[\x00-\xff]"
    bits = b"".join(_byte_without(mask >> shift & 0xFF) for shift in (24, 16, 8, 0))
    pdu = b"\x03" + _PAIR.pack(first, 2)
    head = bus.framed(device_id, b"\x03\x04" + bytes(4)).partition(b"\x03\x04")[0]
    return _word(bus, device_id, pdu, exactly(head) + b"\x03\x04" + bits + any_byte * 2, 6)


def _byte_without(mask: int) -> bytes:
    return b"[" + b"".join(b"\\x%02x" % each for each in range(256) if not each & mask) + b"]"


def coil_is_open(bus: Framer, device_id: int, coil: int) -> Word:
    """Function 1, and the answer that the coil is 0."""
    reply = exactly(bus.framed(device_id, b"\x01\x01\x00"))
    return _word(bus, device_id, b"\x01" + _PAIR.pack(coil, 1), reply, 4)


def without_bits(bus: Framer, device_id: int, function: int, register: int, mask: int) -> Word:
    """Function 3 or 4, and every answer whose upper byte is 0 and that has none of these bits.

    Each of them is spelled out with its checksum: a pattern cannot compute one.
    """
    values = (word for word in range(0x100) if not word & mask)
    heads = (bytes([function, 2, 0, value]) for value in values)
    replies = (exactly(bus.framed(device_id, head)) for head in heads)
    pdu = bytes([function]) + _PAIR.pack(register, 1)
    return _word(bus, device_id, pdu, b"|".join(replies), 4)


def _word(bus: Framer, device_id: int, pdu: bytes, reply: bytes, reply_size: int) -> Word:
    sent = bus.framed(device_id, pdu)
    around = len(sent) - len(pdu)
    within_s = _LATENCY_S + bus.wire_s(len(sent) + reply_size + around)
    return Word(sent, reply, min(within_s, 1.0))
