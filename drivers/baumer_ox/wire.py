"""The UDP stream of the Baumer OX200: blocks cut into frames, both directions.

After the OX200 operating manual (V2 pages 35-39, V4 pages 43-45), little-endian. The manual calls x
unsigned; the maker's SDK reads it signed, and it must be: 0 is the middle of the laser plane.

    frame        u32 block | u8 frame type | u8 | u16 frames in the block, or index of this one
                 then a piece of the body
    profile      u8 content | 4 bool | u8 quality | f32 rate | u32 s | u32 us | u16 encoder | u32 n
                 then n points: i16 x [, u16 z] [, u16 intensity]
    measurement  u8 0 | 4 bool | u8 quality | 2 bool | 7 f32 | then rate to encoder as above

A frame may end inside a point, and a block that lost frames keeps the places of what is missing.
One block is open at a time: a sensor sends a block's frames back to back, so a frame of the next
one says that the rest of this one will not come.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from drivers.arrays import frozen
from drivers.errors import FrameError

FRAME_BYTES = 1400  # the longest datagram that the sensor sends
_HEADER = struct.Struct("<IBBH")
_HEAD = struct.Struct("<B4?BfIIHI")
_MEASUREMENT = struct.Struct("<B4?B2?7ffIIH")
_IDS = 1 << 32  # block ids wrap here
_FAR = 1 << 24  # ids; an hour of blocks at 5 kHz: a longer jump is another sequence, not a loss
_NEAR = 64  # ids between two blocks of one march
_MARCH = 8  # blocks that march on behind us until we believe that the sensor restarted
_MOST_POINTS = 1 << 16  # the sensor has about 2 000; this bounds what one block may hold


class Content(IntEnum):
    """What a block carries (the manual's MessageType)."""

    MEASUREMENT = 0
    Z = 1
    INTENSITY = 2
    Z_AND_INTENSITY = 3


_POINTS = {
    Content.Z: np.dtype([("x", "<i2"), ("z", "<u2")]),
    Content.INTENSITY: np.dtype([("x", "<i2"), ("intensity", "<u2")]),
    Content.Z_AND_INTENSITY: np.dtype([("x", "<i2"), ("z", "<u2"), ("intensity", "<u2")]),
}
_NOTHING = np.empty(0, dtype=np.uint16)
_LARGEST_BODY = _HEAD.size + 6 * _MOST_POINTS


class _FrameType(IntEnum):
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
            due = len(self.arrived) if name in (_POINTS[self.content].names or ()) else 0
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


@dataclass(frozen=True, slots=True)
class Gap:
    """Blocks that never came, or not their first frame, without which nothing can be told."""

    first: int
    lost: int


@dataclass(frozen=True, slots=True)
class BadFrame:
    """A datagram, or a whole block, that breaks the grammar; a loss shows in the next `Gap`."""

    reason: str


Message = ProfileMessage | MeasurementMessage
Event = Message | Gap | BadFrame


def encode_profile(message: ProfileMessage, *, frame_bytes: int = FRAME_BYTES) -> list[bytes]:
    """Return the datagrams of a block, in the order of sending, none above `frame_bytes`."""
    if message.torn:
        raise ValueError(f"block {message.block} is torn: only a whole one can be sent")
    points = np.empty(len(message.x), dtype=_POINTS[message.content])
    for name in points.dtype.names or ():
        points[name] = getattr(message, name)
    head = _HEAD.pack(message.content, *_flags(message.state), *_clock(message.state), len(points))
    return _cut(message.block, head + points.tobytes(), frame_bytes)


def encode_measurement(message: MeasurementMessage) -> bytes:
    """Return the one datagram of a measurement block."""
    state = message.state
    head = (Content.MEASUREMENT, *_flags(state), *message.outputs, *message.values)
    body = _MEASUREMENT.pack(*head, *_clock(state))
    return _HEADER.pack(message.block, _FrameType.SINGLE, 0, 0) + body


def _cut(block: int, body: bytes, frame_bytes: int) -> list[bytes]:
    room = frame_bytes - _HEADER.size
    if room < _HEAD.size:
        raise ValueError(f"frames of {frame_bytes} B: {_HEADER.size + _HEAD.size} B is the least")
    if len(body) <= room:
        return [_HEADER.pack(block, _FrameType.SINGLE, 0, 0) + body]
    pieces = [body[start : start + room] for start in range(0, len(body), room)]
    headers = [_HEADER.pack(block, _FrameType.FIRST, 0, len(pieces))]
    headers += [_HEADER.pack(block, _FrameType.CONSECUTIVE, 0, i) for i in range(1, len(pieces))]
    return [header + piece for header, piece in zip(headers, pieces, strict=True)]


def _flags(state: State) -> tuple[bool, bool, bool, bool, int]:
    return state.parametrising, state.time_synced, state.valid, state.alarm, state.quality


def _clock(state: State) -> tuple[float, int, int, int]:
    return state.rate_hz, state.seconds, state.microseconds, state.encoder


class Assembler:
    """Frames in, blocks out. Whatever is fed, it raises nothing and holds one block.

    `ignored` counts duplicates and frames of blocks that were closed already, `restarts` how often
    the numbering began anew.
    """

    def __init__(self) -> None:
        self.ignored = 0
        self.restarts = 0
        self._open_block: _Block | None = None
        self._expected: int | None = None  # every block before this one is accounted for
        self._stale = _Stale()

    def feed(self, datagram: bytes) -> Iterator[Event]:
        """Take one datagram and yield what it completes, tears or proves lost; exhaust it."""
        try:
            frame = _parse(datagram)
        except FrameError as wrong:
            yield BadFrame(str(wrong))
            return
        place = self._place(frame.block)
        if place is _Place.STALE:
            self.ignored += 1
            return
        if place is _Place.RESTART:
            yield from self.flush()
            self.restart()
            self.restarts += 1
        block = self._open_block
        if block is None or block.number != frame.block:
            block = yield from self._open(frame.block)
        yield from self._add(block, frame)

    def flush(self) -> Iterator[Event]:
        """Close the open block as it is: nothing more of it will come."""
        block, self._open_block = self._open_block, None
        if block is None:
            return
        if block.count:
            try:
                message = block.assembled()
            except FrameError as wrong:
                yield BadFrame(str(wrong))  # not accounted for: the next block shows the gap
                return
            self._expected = _after(block.number)
            yield message
            return
        self._expected = _after(block.number)
        if block.joined:
            self.ignored += len(block.frames)
        else:
            yield Gap(block.number, 1)

    def restart(self) -> None:
        """Forget the open block and the numbering: what comes next is the first, without a gap."""
        self._open_block, self._expected, self._stale = None, None, _Stale()

    def _place(self, number: int) -> _Place:
        """Where a block stands in the numbering, which wraps."""
        ahead = 0 if self._expected is None else (number - self._expected) % _IDS
        if ahead < _FAR:
            self._stale = _Stale()
            return _Place.NEXT
        self._stale = self._stale.followed_by(number)
        restarted = _IDS - ahead > _FAR or self._stale.blocks >= _MARCH
        return _Place.RESTART if restarted else _Place.STALE

    def _open(self, number: int) -> Generator[Event, None, _Block]:
        yield from self.flush()
        expected, self._expected = self._expected, number
        self._open_block = block = _Block(number, joined=expected is None)
        if expected is not None and expected != number:
            yield Gap(expected, (number - expected) % _IDS)
        return block

    def _add(self, block: _Block, frame: _Frame) -> Iterator[Event]:
        if frame.index in block.frames:
            self.ignored += 1
            return
        try:
            block.add(frame)
        except FrameError as wrong:
            yield BadFrame(str(wrong))
            return
        if len(block.frames) == block.count:
            yield from self.flush()


class _Place(Enum):
    NEXT = "the open block or a later one"
    STALE = "before what is accounted for"
    RESTART = "of another numbering"


@dataclass(frozen=True, slots=True)
class _Stale:
    """A run of frames behind us: how many blocks it marched on, and where it is."""

    blocks: int = 0
    last: int = 0

    def followed_by(self, number: int) -> _Stale:
        step = (number - self.last) % _IDS
        if self.blocks and step == 0:
            return self
        return _Stale(self.blocks + 1 if self.blocks and step <= _NEAR else 1, number)


@dataclass(frozen=True, slots=True)
class _Frame:
    block: int
    index: int
    count: int  # frames in the block; 0 where only the first says it
    body: bytes


class _Block:
    """The frames of one block so far."""

    __slots__ = ("count", "frames", "joined", "number", "size")

    def __init__(self, number: int, *, joined: bool) -> None:
        self.number = number
        self.joined = joined  # nothing is known of what came before it
        self.count = 0
        self.size = 0
        self.frames: dict[int, bytes] = {}

    def add(self, frame: _Frame) -> None:
        highest = max(self.frames, default=0) if frame.count else frame.index
        count = frame.count or self.count
        if count and highest >= count:
            raise FrameError(f"block {self.number}: frame {highest} of {count}")
        if self.size + len(frame.body) > _LARGEST_BODY:
            raise FrameError(f"block {self.number}: more than {_LARGEST_BODY} B")
        self.count = count
        self.size += len(frame.body)
        self.frames[frame.index] = frame.body

    def assembled(self) -> Message:
        if len(self.frames) == self.count:
            whole = b"".join(self.frames[i] for i in range(self.count))
            return _decoded(self.number, whole, None)
        total = _body_bytes(self.frames[0])
        body, came = bytearray(total), np.zeros(total, dtype=np.bool_)
        for start, piece in self._placed(total):
            body[start : start + len(piece)] = piece
            came[start : start + len(piece)] = True
        return _decoded(self.number, bytes(body), came[_HEAD.size :])

    def _placed(self, total: int) -> list[tuple[int, bytes]]:
        """Where each frame belongs in a body with holes.

        Frames before the first hole follow each other, frames after the last hole end the body;
        those between two holes are as long as the first, as all but the last of this sensor are.
        """
        placed, hole, start = [], 0, 0
        while hole in self.frames:
            placed.append((start, self.frames[hole]))
            start, hole = start + len(self.frames[hole]), hole + 1
        last_hole, end = self.count - 1, total
        while last_hole in self.frames:
            end -= len(self.frames[last_hole])
            placed.append((end, self.frames[last_hole]))
            last_hole -= 1
        if start >= end:
            raise FrameError(f"block {self.number}: its frames leave no place for the lost ones")
        stride = len(self.frames[0])
        between = range(hole + 1, last_hole) if start == hole * stride else ()
        for index in between:
            piece = self.frames.get(index, b"")
            if len(piece) == stride and (index + 1) * stride <= end:
                placed.append((index * stride, piece))
        return placed


def _parse(datagram: bytes) -> _Frame:
    if len(datagram) <= _HEADER.size:
        raise FrameError(f"a datagram of {len(datagram)} B; a frame has more than {_HEADER.size}")
    block, kind, _, number = _HEADER.unpack_from(datagram)
    body = datagram[_HEADER.size :]
    if kind == _FrameType.CONSECUTIVE:
        if number == 0:
            raise FrameError(f"block {block}: a consecutive frame with index 0")
        return _Frame(block, number, 0, body)
    if kind not in (_FrameType.SINGLE, _FrameType.FIRST):
        raise FrameError(f"block {block}: frame type {kind}")
    count = number if kind == _FrameType.FIRST else 1
    total = _body_bytes(body)
    if count == 0 or (len(body) != total if count == 1 else len(body) >= total):
        raise FrameError(f"block {block}: {len(body)} B in the first of {count} for {total} B")
    if count > 1 and body[0] == Content.MEASUREMENT:
        raise FrameError(f"block {block}: measured values in {count} frames")
    return _Frame(block, 0, count, body)


def _body_bytes(body: bytes) -> int:
    """How long the body is that begins so."""
    if body[0] == Content.MEASUREMENT:
        return _MEASUREMENT.size
    if len(body) < _HEAD.size or body[0] > Content.Z_AND_INTENSITY:
        raise FrameError(f"content {body[0]}, {len(body)} B: no head of a profile")
    points: int = _HEAD.unpack_from(body)[-1]
    if points > _MOST_POINTS:
        raise FrameError(f"{points} points; {_MOST_POINTS} is the most")
    return _HEAD.size + points * _POINTS[Content(body[0])].itemsize


def _decoded(block: int, body: bytes, came: NDArray[np.bool_] | None) -> Message:
    """Decode a whole body; `came` says byte by byte which of its points' bytes did."""
    if len(body) != _body_bytes(body):
        raise FrameError(f"block {block}: {len(body)} B of {_body_bytes(body)}")
    if body[0] == Content.MEASUREMENT:
        return _decoded_measurement(block, body)
    kind, *said, _ = _HEAD.unpack_from(body)
    content, layout = Content(kind), _POINTS[Content(kind)]
    points = np.frombuffer(body, dtype=layout, offset=_HEAD.size)
    arrived: NDArray[np.bool_] = np.ones(len(points), dtype=np.bool_)
    if came is not None:
        arrived = np.all(came.reshape(len(points), layout.itemsize), axis=1)
        points = np.where(arrived, points, np.zeros(1, dtype=layout))  # no half points
    z = _NOTHING if content is Content.INTENSITY else points["z"]
    intensity = _NOTHING if content is Content.Z else points["intensity"]
    return ProfileMessage(block, State(*said), content, points["x"], z, intensity, arrived)


def _decoded_measurement(block: int, body: bytes) -> MeasurementMessage:
    _, *said = _MEASUREMENT.unpack(body)
    flags, outputs, values, clock = said[:5], said[5:7], said[7:14], said[14:]
    return MeasurementMessage(block, State(*flags, *clock), (outputs[0], outputs[1]), tuple(values))


def _after(number: int) -> int:
    return (number + 1) % _IDS


def _exact(name: str, values: ArrayLike, dtype: DTypeLike) -> NDArray[Any]:
    """Return `values` frozen in a narrower type that holds them all."""
    array = np.asarray(values)
    if array.size and array.dtype != dtype:
        limits = np.iinfo(np.dtype(dtype))
        if array.min() < limits.min or array.max() > limits.max:
            raise ValueError(f"{name}: {array.min()} to {array.max()} is beyond {limits.dtype}")
    return frozen(array, dtype)
