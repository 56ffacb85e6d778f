"""The UDP stream of RIFTEK RF62X sensors: one datagram is one profile, and their numbering.

After RIFTEK-LLC/RF627-Protocol `src/RF627protocol.c`, RF62X-Core `src/rf62X_types.h` and
Pallob-Gain/Riftek-RF62X-emulator `lib/RFProfile.V1.js` @68da08a; little-endian::

     0 u8  data type: 0x10 0x12 pixels, 0x11 0x13 profile, 0x20 profile by polynomial
     1 u8  flags, bit 0: intensity follows        2 u16 device type      4 u32 serial
     8 u64 system time                           16 u8 major  17 u8 minor of the protocol
    18 u8  where what comes at 48 begins         19 u8  where the points begin
    20 u32 packet count                          24 u32 measure count
    28 u16 z range mm   30 u16 x range mm        32 u16 discrete value (0x20: f32 scale)
    48 u32 exposure     52 u32 laser             56 u32 step count of the encoder
    60 u8  direction    61 u16 bytes of points   63 u8  bytes of one point
    64 n x {i16 x, u16 z}, then n x u8 intensity where the flag says so

x mm = x * x range / discrete, z mm = z * z range / discrete, and z = 0 is no return.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError

_HEAD = struct.Struct("<BBHIQBBBBIIHH")
_DISCRETE = struct.Struct("<H")
_SCALE = struct.Struct("<f")
_STATE = struct.Struct("<IIIBHB")
_POINT = np.dtype([("x", "<i2"), ("z", "<u2")])
_PIXELS, _BY_TABLE, _BY_POLYNOMIAL = (0x10, 0x12), (0x11, 0x13), (0x20,)
_HAS_INTENSITY = 0x01
_KNOWN_MAJOR = 1
_NUMBERS = 1 << 32
_NEAR = 64  # behind us: a datagram that came late
_FAR = 1 << 24  # ahead: another numbering
_MARCH = 8  # late ones in a row: the sensor restarted


@dataclass(frozen=True, slots=True, eq=False)
class ProfileMessage:
    """One profile as it was sent."""

    packet: int
    measure: int
    serial: int
    device_type: int
    system_time: int
    step: int  # of the encoder
    exposure: int
    x_scale_mm: float
    z_scale_mm: float
    x: NDArray[np.int16]
    z: NDArray[np.uint16]
    intensity: NDArray[np.uint8]  # (n,), or (0,) where none is sent


@dataclass(frozen=True, slots=True)
class Pixels:
    """A line in pixels of the sensor's camera: nothing says how many mm they are."""

    packet: int


@dataclass(frozen=True, slots=True)
class Gap:
    """Datagrams that never came, and measurements that the sensor did not send."""

    lost: int
    unsent: int


@dataclass(frozen=True, slots=True)
class BadFrame:
    """A datagram that breaks the grammar."""

    reason: str


Event = ProfileMessage | Pixels | Gap | BadFrame


def decode(datagram: bytes) -> ProfileMessage | Pixels:
    """Read one datagram.

    Raises
    ------
    FrameError
        It is none of this sensor's; says why.
    """
    if len(datagram) < _HEAD.size:
        raise FrameError(f"a datagram of {len(datagram)} B; its head alone has {_HEAD.size}")
    kind, flags, device_type, serial, time, major, minor, state_at, points_at, packet, measure, \
        z_range_mm, x_range_mm = _HEAD.unpack_from(datagram)  # fmt: skip
    if major != _KNOWN_MAJOR:
        raise FrameError(f"protocol {major}.{minor}; {_KNOWN_MAJOR}.x is known here")
    if kind in _PIXELS:
        return Pixels(packet)
    x_scale_mm, z_scale_mm = _scales(datagram, kind, x_range_mm, z_range_mm)
    if len(datagram) < state_at + _STATE.size:
        raise FrameError(f"{len(datagram)} B; its state ends at {state_at + _STATE.size}")
    exposure, _, step, _, size, point_size = _STATE.unpack_from(datagram, state_at)
    points, intensity = _points(datagram, points_at, size, point_size, flags)
    return ProfileMessage(
        packet, measure, serial, device_type, time, step, exposure, x_scale_mm, z_scale_mm,
        points["x"], points["z"], intensity,
    )  # fmt: skip


def _scales(datagram: bytes, kind: int, x_range_mm: int, z_range_mm: int) -> tuple[float, float]:
    """Mm a count, of x and of z."""
    try:
        if kind in _BY_TABLE:
            (discrete,) = _DISCRETE.unpack_from(datagram, _HEAD.size)
            if not discrete or not x_range_mm or not z_range_mm:
                raise FrameError(f"ranges of {x_range_mm} and {z_range_mm} mm over {discrete}")
            return x_range_mm / discrete, z_range_mm / discrete
        if kind in _BY_POLYNOMIAL:
            (scale,) = _SCALE.unpack_from(datagram, _HEAD.size)
            if not math.isfinite(scale) or scale <= 0.0:
                raise FrameError(f"a scale of {scale}")
            return scale, scale
    except struct.error as short:
        raise FrameError(f"{len(datagram)} B; its scale is missing") from short
    raise FrameError(f"data type {kind:#04x}")


def _points(
    datagram: bytes, begin: int, size: int, point_size: int, flags: int
) -> tuple[NDArray[np.void], NDArray[np.uint8]]:
    if point_size != _POINT.itemsize or size % _POINT.itemsize:
        raise FrameError(f"{size} B of points, {point_size} B each; {_POINT.itemsize} are known")
    count = size // _POINT.itemsize
    shades = count if flags & _HAS_INTENSITY else 0
    if begin < _HEAD.size or len(datagram) < begin + size + shades:
        raise FrameError(f"{len(datagram)} B; its {count} points end at {begin + size + shades}")
    points = np.frombuffer(datagram, _POINT, count, begin)
    return points, np.frombuffer(datagram, np.uint8, shades, begin + size)


class Stream:
    """Datagrams in, profiles and losses out. Whatever is fed, it raises nothing.

    A datagram that came twice, or late, is `ignored`; `restarts` counts how often the numbering
    began anew. A sensor, or a stand-in for one, that counts measurements alone is followed by them.
    """

    def __init__(self) -> None:
        self.ignored = 0
        self.restarts = 0
        self._last: tuple[int, int] | None = None  # packet, measure
        self._last_bytes = b""
        self._late = 0

    def feed(self, datagram: bytes) -> Iterator[Event]:
        """Take one datagram and yield what it says; exhaust it."""
        try:
            message = decode(datagram)
        except FrameError as wrong:
            yield BadFrame(str(wrong))
            return
        if isinstance(message, Pixels):
            yield message
            return
        if datagram == self._last_bytes or self._is_late(message.packet):
            self.ignored += 1
            return
        gap = self._gap(message)
        self._last, self._last_bytes = (message.packet, message.measure), datagram
        if gap.lost or gap.unsent:
            yield gap
        yield message

    def restart(self) -> None:
        """Forget the numbering: what comes next is the first, without a gap."""
        self._last, self._last_bytes, self._late = None, b"", 0

    def _is_late(self, packet: int) -> bool:
        """Whether it was overtaken; a sensor that restarted near its number marches on behind."""
        if self._last is None:
            return False
        behind = (self._last[0] - packet) % _NUMBERS
        if not 0 < behind <= _NEAR:
            self._late = 0
            return False
        self._late += 1
        return self._late < _MARCH

    def _gap(self, message: ProfileMessage) -> Gap:
        if self._last is None:
            return Gap(0, 0)
        packets = (message.packet - self._last[0]) % _NUMBERS
        measures = (message.measure - self._last[1]) % _NUMBERS
        if packets >= _FAR or (measures >= _FAR and packets):
            self.restarts += 1
            self._late = 0
            return Gap(0, 0)
        if not packets:
            return Gap(measures - 1 if 1 <= measures < _FAR else 0, 0)
        return Gap(packets - 1, max(measures - packets, 0))
