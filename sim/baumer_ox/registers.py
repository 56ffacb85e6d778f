"""The OX200's registers as its manual lists them (V2, pages 26 and 27; OX100 V2, pages 19 to 21).

::

    holding    0 request parametrisation mode   1 leave it   501 load setup
    input      0..32 vendor   40..88 product id, type, serial   200..223 readings   401 setup

A value of 32 bits has its low word first; a text its first character in the high byte, and texts
follow each other without regard to words. The 16-bit readings from 2500 on are not there: what was
read of the manual does not tell how they are scaled.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from sim.baumer_ox.reading import Reading

REQUEST_PARAMETRISATION = 0
LEAVE_PARAMETRISATION = 1
LOAD_SETUP = 501

VENDOR = 0
DEVICE_INFO = 40
READINGS = 200
ACTIVE_SETUP = 401

VENDOR_BYTES = 65
PRODUCT_ID_BYTES = 9
TYPE_BYTES = 65
SERIAL_BYTES = 20

_NAN_WORDS = (0x0000, 0x7FC0)
_VALUES = 7  # always; those that nobody parametrised are NaN


def vendor_words(vendor: str) -> list[int]:
    """Registers 0 to 32."""
    return _text_words(_text(vendor, VENDOR_BYTES) + b"\0")


def device_info_words(product_id: str, sensor_type: str, serial: str) -> list[int]:
    """Registers 40 to 88; the type begins in the low byte of register 44."""
    return _text_words(
        _text(product_id, PRODUCT_ID_BYTES)
        + _text(sensor_type, TYPE_BYTES)
        + _text(serial, SERIAL_BYTES)
        + bytes(4)  # String[2] of padding fills two registers in the manual's table
    )


def reading_words(reading: Reading, nearest_mm: float) -> list[int]:
    """Registers 200 to 223; the sensor is parametrised to measure the nearest z, and no more."""
    status = reading.parametrising << 0 | reading.valid << 2 | reading.alarm << 3
    switching_outputs = 0
    seconds, microseconds = reading.clock
    return [
        status,
        reading.quality,
        switching_outputs,
        *_float_words(nearest_mm),
        *_NAN_WORDS * (_VALUES - 1),
        *_float_words(reading.rate_hz),
        *_low_word_first(seconds),
        *_low_word_first(microseconds),
        0,
    ]


def part_of(areas: Mapping[int, Sequence[int]], first: int, count: int) -> list[int] | None:
    """Read from one of several areas, by their first address; None where there is none."""
    for start, words in areas.items():
        if start <= first and first + count <= start + len(words):
            return list(words[first - start : first - start + count])
    return None


def _text(text: str, size: int) -> bytes:
    return text.encode("ascii").ljust(size, b"\0")


def _text_words(data: bytes) -> list[int]:
    return list(struct.unpack(f">{len(data) // 2}H", data))


def _float_words(value: float) -> tuple[int, int]:
    (bits,) = struct.unpack(">I", struct.pack(">f", value))
    return _low_word_first(bits)


def _low_word_first(bits: int) -> tuple[int, int]:
    return bits & 0xFFFF, bits >> 16
