"""What the Baumer OX200 sends: its blocks as values, their layout, and blocks cut into frames.

The layout that both directions share is here; it is drawn in `wire`, which puts frames together.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from drivers.arrays import frozen

FRAME_BYTES = 1400  # the longest datagram that the sensor sends
HEADER = struct.Struct("<IBBH")
HEAD = struct.Struct("<B4?BfIIHI")
MEASUREMENT = struct.Struct("<B4?B2?7ffIIH")


class Content(IntEnum):
    """What a block carries (the manual's MessageType)."""

    MEASUREMENT = 0
    Z = 1
    INTENSITY = 2
    Z_AND_INTENSITY = 3


POINTS = {
    Content.Z: np.dtype([("x", "<i2"), ("z", "<u2")]),
    Content.INTENSITY: np.dtype([("x", "<i2"), ("intensity", "<u2")]),
    Content.Z_AND_INTENSITY: np.dtype([("x", "<i2"), ("z", "<u2"), ("intensity", "<u2")]),
}


class FrameType(IntEnum):
    """A frame's part in its block."""

    SINGLE = 0
    FIRST = 1
    CONSECUTIVE = 2


@dataclass(frozen=True, slots=True)
class State:
    """What the sensor says about itself in every block."""

    parametrising: bool
    time_synced: bool
    valid: bool  # of the measured values, not of the points
    alarm: bool
    quality: int  # 0 good, 1 weak signal, 2 no signal
    rate_hz: float
    seconds: int
    microseconds: int
    encoder: int


@dataclass(frozen=True, slots=True, eq=False)
class ProfileMessage:
    """One block of points; of a torn one `arrived` says which came, the others are 0."""

    block: int
    state: State
    content: Content
    x: NDArray[np.int16]  # (n,)
    z: NDArray[np.uint16]  # (n,), or (0,) where the content has none
    intensity: NDArray[np.uint16]  # likewise
    arrived: NDArray[np.bool_]  # (n,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "x", _exact("x", self.x, np.int16))
        object.__setattr__(self, "z", _exact("z", self.z, np.uint16))
        object.__setattr__(self, "intensity", _exact("intensity", self.intensity, np.uint16))
        object.__setattr__(self, "arrived", frozen(self.arrived, np.bool_))
        columns = {"x": self.x, "z": self.z, "intensity": self.intensity}
        for name, column in columns.items():
            due = len(self.arrived) if name in (POINTS[self.content].names or ()) else 0
            if column.shape != (due,):
                raise ValueError(f"{self.content.name} block: {column.shape} {name}, not ({due},)")

    @property
    def torn(self) -> bool:
        """Whether frames of this block did not come."""
        return not self.arrived.all()


@dataclass(frozen=True, slots=True)
class MeasurementMessage:
    """One block of the seven values that the sensor measures itself."""

    block: int
    state: State
    outputs: tuple[bool, bool]
    values: tuple[float, ...]  # seven, in the order set on the sensor's page


Message = ProfileMessage | MeasurementMessage


def encode_profile(message: ProfileMessage, *, frame_bytes: int = FRAME_BYTES) -> list[bytes]:
    """Return the datagrams of a block, in the order of sending, none above `frame_bytes`."""
    if message.torn:
        raise ValueError(f"block {message.block} is torn: only a whole one can be sent")
    points = np.empty(len(message.x), dtype=POINTS[message.content])
    for name in points.dtype.names or ():
        points[name] = getattr(message, name)
    head = HEAD.pack(message.content, *_flags(message.state), *_clock(message.state), len(points))
    return _cut(message.block, head + points.tobytes(), frame_bytes)


def encode_measurement(message: MeasurementMessage) -> bytes:
    """Return the one datagram of a measurement block."""
    state = message.state
    head = (Content.MEASUREMENT, *_flags(state), *message.outputs, *message.values)
    body = MEASUREMENT.pack(*head, *_clock(state))
    return HEADER.pack(message.block, FrameType.SINGLE, 0, 0) + body


def _cut(block: int, body: bytes, frame_bytes: int) -> list[bytes]:
    room = frame_bytes - HEADER.size
    if room < HEAD.size:
        raise ValueError(f"frames of {frame_bytes} B: {HEADER.size + HEAD.size} B is the least")
    if len(body) <= room:
        return [HEADER.pack(block, FrameType.SINGLE, 0, 0) + body]
    pieces = [body[start : start + room] for start in range(0, len(body), room)]
    headers = [HEADER.pack(block, FrameType.FIRST, 0, len(pieces))]
    headers += [HEADER.pack(block, FrameType.CONSECUTIVE, 0, i) for i in range(1, len(pieces))]
    return [header + piece for header, piece in zip(headers, pieces, strict=True)]


def _flags(state: State) -> tuple[bool, bool, bool, bool, int]:
    return state.parametrising, state.time_synced, state.valid, state.alarm, state.quality


def _clock(state: State) -> tuple[float, int, int, int]:
    return state.rate_hz, state.seconds, state.microseconds, state.encoder


def _exact(name: str, values: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return `values` frozen in a narrower type that holds them all."""
    array = np.asarray(values)
    if array.size and array.dtype != dtype:
        limits = np.iinfo(np.dtype(dtype))
        if array.min() < limits.min or array.max() > limits.max:
            raise ValueError(f"{name}: {array.min()} to {array.max()} is beyond {limits.dtype}")
    return frozen(array, dtype)
