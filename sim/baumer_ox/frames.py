r"""Profiles as the OX200 sends them in UDP (manual V2, pages 35 to 39), little-endian.

::

    header  u32 block | u8 0 single, 1 first, 2 consecutive | u8 0 | u16 count (of a first frame)
                                                                       or index (of a consecutive)
    body    u8 message 1 Z, 2 I, 3 ZI | bool parametrising, NTP, valid, alarm | u8 quality
            | f32 rate | u32 s | u32 us | u16 encoder | u32 n | n points of u16

    point   Z: x z    I: x i    ZI: x z i        x in two's complement; z = 0 is no return

The manual calls x unsigned; the maker's own library reads it as signed (its ProfilePacket.h). What
z tells of no return is in neither: 0 is inferred. A body too long for a datagram is cut wherever
the datagram ends, be it within a point.
"""

from __future__ import annotations

import struct
from enum import Enum

import numpy as np

from sim.baumer_ox.reading import Reading
from sim.sensor import SimProfile

_HEADER = struct.Struct("<IBBH")
_BODY_HEAD = struct.Struct("<B4BBfIIHI")
FEWEST_BYTES = _HEADER.size + _BODY_HEAD.size  # of the first datagram
_SINGLE, _FIRST, _CONSECUTIVE = 0, 1, 2


class Encoding(Enum):
    """What is told of a point, by the message's number."""

    Z = 1
    I = 2  # noqa: E741 (the manual's name)
    ZI = 3


def profile_body(reading: Reading, profile: SimProfile, encoding: Encoding) -> bytes:
    """One profile, before it is cut into frames; the encoder input is not wired."""
    points = _points(profile, encoding)
    by_ntp, encoder = False, 0
    head = _BODY_HEAD.pack(
        encoding.value, reading.parametrising, by_ntp, reading.valid, reading.alarm,
        reading.quality, reading.rate_hz, *reading.clock, encoder, len(profile.reasons),
    )  # fmt: skip
    return head + points


def frames(body: bytes, block: int, most_bytes: int) -> list[bytes]:
    """Cut a body into datagrams of at most `most_bytes`, headers included."""
    room = most_bytes - _HEADER.size
    parts = [body[start : start + room] for start in range(0, len(body), room)]
    if len(parts) == 1:
        return [_HEADER.pack(block, _SINGLE, 0, 0) + body]
    first = _HEADER.pack(block, _FIRST, 0, len(parts)) + parts[0]
    return [first] + [
        _HEADER.pack(block, _CONSECUTIVE, 0, index) + part
        for index, part in enumerate(parts[1:], start=1)
    ]


def _points(profile: SimProfile, encoding: Encoding) -> bytes:
    x, z = profile.counts.T
    told = {Encoding.Z: (x, z), Encoding.I: (x, profile.intensity)}
    columns = told.get(encoding, (x, z, profile.intensity))
    points = np.empty((len(x), len(columns)), "<u2")
    for place, column in enumerate(columns):
        points[:, place] = column  # from int32 it wraps: two's complement of a negative x
    return points.tobytes()
