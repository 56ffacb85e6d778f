"""Profiles as an RF62X sends them, written a second time from the public sources.

RIFTEK-LLC/RF627-Protocol `src/RF627protocol.c` and Pallob-Gain/Riftek-RF62X-emulator
`lib/RFProfile.V1.js` name the fields; all little-endian, one datagram a profile::

    0 general, 28 B | 28 ranges, 20 B | 48 hardware, 16 B | 64 points of 4 B | intensity, 1 B each
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.sensor import Sensor, SimProfile

DISCRETE = 16384
_CALIBRATED, _WITH_INTENSITY = 0x11, 1
_GENERAL = struct.Struct("<2B H I Q 4B 2I")
_RANGES = struct.Struct("<3H 14x")
_HARDWARE = struct.Struct("<3I B H B")


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """What changes from profile to profile beside the points."""

    packet: int
    measure: int
    time_ns: int
    exposure_ns: int


def datagram(profile: SimProfile, sensor: Sensor, serial: int, count: Count) -> bytes:
    """Give one profile; x and z in parts of the ranges, z from where the range begins."""
    x_mm = profile.counts[:, 0] * sensor.x_mm_per_count + sensor.x_offset_mm
    z_mm = profile.counts[:, 1] * sensor.z_mm_per_count + sensor.z_offset_mm
    x_range_mm, z_range_mm = ranges_mm(sensor)
    points = np.zeros((len(profile.reasons), 2), "<u2")
    points[:, 0] = _parts(x_mm, x_range_mm)  # from int64 it wraps: two's complement
    points[:, 1] = np.maximum(_parts(z_mm - sensor.near_mm, z_range_mm), 1)  # 0 is kept for none
    points[~profile.seen] = 0
    body = points.tobytes()
    shades = np.minimum(profile.intensity, 255).astype(np.uint8).tobytes()
    general = _GENERAL.pack(
        _CALIBRATED, _WITH_INTENSITY, 627, serial, count.time_ns % 2**64, 1, 0, 48, 64,
        count.packet % 2**32, count.measure % 2**32,
    )  # fmt: skip
    hardware = _HARDWARE.pack(count.exposure_ns, 42, 0, 0, len(body), 4)
    return general + _RANGES.pack(z_range_mm, x_range_mm, DISCRETE) + hardware + body + shades


def ranges_mm(sensor: Sensor) -> tuple[int, int]:
    """Width at the end of the range, and the range, in the whole mm of such a sensor."""
    return int(np.ceil(2.0 * sensor.far_mm * sensor.steepest)), int(
        np.ceil(sensor.far_mm - sensor.near_mm)
    )


def _parts(mm: NDArray[np.floating], range_mm: int) -> NDArray[np.int64]:
    return np.rint(mm * DISCRETE / range_mm).astype(np.int64)
