"""The UDP stream of the Baumer OX200: blocks cut into frames, and frames put together here.

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

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from drivers.baumer_ox.encoding import (
    FRAME_BYTES,
    HEAD,
    HEADER,
    MEASUREMENT,
    POINTS,
    Content,
    FrameType,
    MeasurementMessage,
    Message,
    ProfileMessage,
    State,
    encode_measurement,
    encode_profile,
)
from drivers.errors import FrameError

__all__ = [
    "FRAME_BYTES",
    "Assembler",
    "BadFrame",
    "Content",
    "Event",
    "Gap",
    "MeasurementMessage",
    "Message",
    "ProfileMessage",
    "State",
    "encode_measurement",
    "encode_profile",
]

_IDS = 1 << 32  # block ids wrap here
_FAR = 1 << 24  # ids; an hour of blocks at 5 kHz: a longer jump is another sequence, not a loss
_NEAR = 64  # ids between two blocks of one march
_MARCH = 8  # blocks that march on behind us until we believe that the sensor restarted
_MOST_POINTS = 1 << 16  # the sensor has about 2 000; this bounds what one block may hold
_NOTHING = np.empty(0, dtype=np.uint16)
_LARGEST_BODY = HEAD.size + 6 * _MOST_POINTS


@dataclass(frozen=True, slots=True)
class Gap:
    """Blocks that never came, or not their first frame, without which nothing can be told."""

    first: int
    lost: int


@dataclass(frozen=True, slots=True)
class BadFrame:
    """A datagram, or a whole block, that breaks the grammar; a loss shows in the next `Gap`."""

    reason: str


Event = Message | Gap | BadFrame


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
        return _decoded(self.number, bytes(body), came[HEAD.size :])

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
    if len(datagram) <= HEADER.size:
        raise FrameError(f"a datagram of {len(datagram)} B; a frame has more than {HEADER.size}")
    block, kind, _, number = HEADER.unpack_from(datagram)
    body = datagram[HEADER.size :]
    if kind == FrameType.CONSECUTIVE:
        if number == 0:
            raise FrameError(f"block {block}: a consecutive frame with index 0")
        return _Frame(block, number, 0, body)
    if kind not in (FrameType.SINGLE, FrameType.FIRST):
        raise FrameError(f"block {block}: frame type {kind}")
    count = number if kind == FrameType.FIRST else 1
    total = _body_bytes(body)
    if count == 0 or (len(body) != total if count == 1 else len(body) >= total):
        raise FrameError(f"block {block}: {len(body)} B in the first of {count} for {total} B")
    if count > 1 and body[0] == Content.MEASUREMENT:
        raise FrameError(f"block {block}: measured values in {count} frames")
    return _Frame(block, 0, count, body)


def _body_bytes(body: bytes) -> int:
    """How long the body is that begins so."""
    if body[0] == Content.MEASUREMENT:
        return MEASUREMENT.size
    if len(body) < HEAD.size or body[0] > Content.Z_AND_INTENSITY:
        raise FrameError(f"content {body[0]}, {len(body)} B: no head of a profile")
    points: int = HEAD.unpack_from(body)[-1]
    if points > _MOST_POINTS:
        raise FrameError(f"{points} points; {_MOST_POINTS} is the most")
    return HEAD.size + points * POINTS[Content(body[0])].itemsize


def _decoded(block: int, body: bytes, came: NDArray[np.bool_] | None) -> Message:
    """Decode a whole body; `came` says byte by byte which of its points' bytes did."""
    if len(body) != _body_bytes(body):
        raise FrameError(f"block {block}: {len(body)} B of {_body_bytes(body)}")
    if body[0] == Content.MEASUREMENT:
        return _decoded_measurement(block, body)
    kind, *said, _ = HEAD.unpack_from(body)
    content, layout = Content(kind), POINTS[Content(kind)]
    points = np.frombuffer(body, dtype=layout, offset=HEAD.size)
    arrived: NDArray[np.bool_] = np.ones(len(points), dtype=np.bool_)
    if came is not None:
        arrived = np.all(came.reshape(len(points), layout.itemsize), axis=1)
        points = np.where(arrived, points, np.zeros(1, dtype=layout))  # no half points
    z = _NOTHING if content is Content.INTENSITY else points["z"]
    intensity = _NOTHING if content is Content.Z else points["intensity"]
    return ProfileMessage(block, State(*said), content, points["x"], z, intensity, arrived)


def _decoded_measurement(block: int, body: bytes) -> MeasurementMessage:
    _, *said = MEASUREMENT.unpack(body)
    flags, outputs, values, clock = said[:5], said[5:7], said[7:14], said[14:]
    return MeasurementMessage(block, State(*flags, *clock), (outputs[0], outputs[1]), tuple(values))


def _after(number: int) -> int:
    return (number + 1) % _IDS
