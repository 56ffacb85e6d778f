"""The Modbus registers of the Baumer OX200 as values, both directions.

After the OX200 operating manual (V2 pages 26-27) and, for the rest of the same map, the OX100's
(V2 pages 19-21). A 32-bit value has its **low word first**; a text has two characters a word, the
first in the high byte. No register carries a profile, and none switches the laser.

    holding     0 enter parametrisation   1 leave it   501 load a setup
    input       0..32 vendor   40..88 device   200..223 measured values   401 active setup
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from drivers.errors import FrameError

ENTER_PARAMETRISATION = 0  # any value
LEAVE_PARAMETRISATION = 1  # any value
LOAD_SETUP = 501
ACTIVE_SETUP = 401
SETUPS = range(256)  # the active number is read as a UInt8


@dataclass(frozen=True, slots=True)
class Span:
    """Consecutive input registers."""

    first: int
    count: int


VENDOR = Span(0, 33)
DEVICE = Span(40, 49)
READINGS = Span(200, 24)

_VENDOR_BYTES = 65
_PRODUCT, _TYPE, _SERIAL = slice(0, 9), slice(9, 74), slice(74, 94)
_VALUES = 7


class Quality(IntEnum):
    """Of the signal that the measured values come from."""

    GOOD = 0
    WEAK_SIGNAL = 1
    NO_SIGNAL = 2


@dataclass(frozen=True, slots=True)
class Device:
    """Who the sensor is."""

    product_id: str
    sensor_type: str
    serial: str


@dataclass(frozen=True, slots=True)
class Readings:
    """The sensor's state and its seven measured values (registers 200..223)."""

    parametrising: bool
    time_synced: bool
    valid: bool  # the measured values may be interpreted
    alarm: bool
    quality: Quality
    outputs: tuple[bool, bool]
    values: tuple[float, ...]
    rate_hz: float
    seconds: int
    microseconds: int


def vendor(words: Sequence[int]) -> str:
    """Read the manufacturer's name."""
    return _text(_bytes(words, VENDOR)[:_VENDOR_BYTES])


def vendor_words(name: str) -> tuple[int, ...]:
    """Write the manufacturer's name."""
    return _words(_padded(name, _VENDOR_BYTES), VENDOR)


def device(words: Sequence[int]) -> Device:
    """Read who the sensor is; the product's id ends in the middle of a word."""
    data = _bytes(words, DEVICE)
    return Device(_text(data[_PRODUCT]), _text(data[_TYPE]), _text(data[_SERIAL]))


def device_words(who: Device) -> tuple[int, ...]:
    """Write who the sensor is."""
    texts = zip(
        (who.product_id, who.sensor_type, who.serial), (_PRODUCT, _TYPE, _SERIAL), strict=True
    )
    return _words(b"".join(_padded(text, at.stop - at.start) for text, at in texts), DEVICE)


def readings(words: Sequence[int]) -> Readings:
    """Read the state and the measured values.

    Raises
    ------
    FrameError
        The sensor gave a quality that the manual does not know.
    """
    if len(words) != READINGS.count:
        raise ValueError(f"{len(words)} words; the measured values are {READINGS.count}")
    status, quality, outputs = words[:3]
    if quality not in tuple(Quality):
        raise FrameError(f"baumer_ox: quality {quality} in input register {READINGS.first + 1}")
    return Readings(
        parametrising=bool(status & 1),
        time_synced=bool(status & 2),
        valid=bool(status & 4),
        alarm=bool(status & 8),
        quality=Quality(quality),
        outputs=(bool(outputs & 1), bool(outputs & 2)),
        values=tuple(float32(*words[3 + 2 * i : 5 + 2 * i]) for i in range(_VALUES)),
        rate_hz=float32(*words[17:19]),
        seconds=uint32(*words[19:21]),
        microseconds=uint32(*words[21:23]),
    )


def readings_words(said: Readings) -> tuple[int, ...]:
    """Write the state and the measured values; the last word is reserved."""
    flags = (said.parametrising, said.time_synced, said.valid, said.alarm)
    words = [sum(flag << bit for bit, flag in enumerate(flags)), said.quality]
    words.append(said.outputs[0] | said.outputs[1] << 1)
    for value in (*said.values, said.rate_hz):
        words += float32_words(value)
    for number in (said.seconds, said.microseconds):
        words += uint32_words(number)
    return (*words, 0)


def float32(low: int, high: int) -> float:
    """Read a Float32 from its two words in the order of their addresses."""
    (value,) = struct.unpack(">f", struct.pack(">HH", high, low))
    return float(value)


def float32_words(value: float) -> tuple[int, int]:
    """Write a Float32: the low word first."""
    high, low = struct.unpack(">HH", struct.pack(">f", value))
    return low, high


def uint32(low: int, high: int) -> int:
    """Read a UInt32 from its two words in the order of their addresses."""
    return high << 16 | low


def uint32_words(value: int) -> tuple[int, int]:
    """Write a UInt32: the low word first."""
    return value & 0xFFFF, value >> 16


def _bytes(words: Sequence[int], span: Span) -> bytes:
    if len(words) != span.count:
        raise ValueError(f"{len(words)} words; registers from {span.first} are {span.count}")
    return struct.pack(f">{span.count}H", *words)


def _words(data: bytes, span: Span) -> tuple[int, ...]:
    return struct.unpack(f">{span.count}H", data.ljust(2 * span.count, b"\0"))


def _text(data: bytes) -> str:
    """Read up to the first NUL; what is not ASCII is shown, not believed."""
    return data.partition(b"\0")[0].decode("ascii", errors="backslashreplace").strip()


def _padded(text: str, size: int) -> bytes:
    data = text.encode("ascii")
    if len(data) > size:
        raise ValueError(f"{text!r} is longer than {size} characters")
    return data.ljust(size, b"\0")
