"""The sensor between its line and the World: a `sim.device.Device` that answers memory reads.

After 8017035/ZMO9, pages 111 to 123. Two buffers hold profiles in turn; asking for the address
(400B) takes the newest into the buffer that is not being read. A frame that breaks the grammar is
answered E003, E004 or E005; what is not whole within 2 s is answered E003 and forgotten. What is
inferred of the memory (order of bytes, what addresses count) are settings here, too.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.sensor import SimProfile
from sim.world import World

_WHOLE_WITHIN_S = 2.0
_BUFFERS = (0x03062000, 0x03064000)
_HEADER_WORDS = 4
_POINTS_A_READ = 126


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfilerSettings:
    """How it counts, and what the manual leaves open."""

    points: int = 832
    x_mm_per_count: float = 0.005
    z_mm_per_count: float = 0.005
    z_offset_mm: float = 225.0
    big_endian: bool = True
    addresses_count_bytes: bool = False


class SickProfiler:
    """One sensor on its line."""

    def __init__(self, world: World, settings: ProfilerSettings | None = None) -> None:
        self._world = world
        self._told = settings or ProfilerSettings()
        self._held = b""
        self._since_s = 0.0
        self._buffer = 0
        self._words: dict[int, list[int]] = {}  # by buffer's address

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes off the line; answer what is whole."""
        said = self.tick(now_s)
        if data and not self._held:
            self._since_s = now_s
        self._held += data
        while self._held:
            start = self._held.find(b"\x02")
            self._held = self._held[start:] if start >= 0 else b""
            if len(self._held) < 2 or len(self._held) < 6 + 2 * self._held[1]:
                break
            size = 6 + 2 * self._held[1]
            frame, self._held = self._held[:size], self._held[size:]
            said += self._answered(frame, now_s)
        return said

    def tick(self, now_s: float) -> bytes:
        """Forget a request that did not become whole."""
        if self._held and now_s - self._since_s > _WHOLE_WITHIN_S:
            self._held = b""
            return _frame(0xE003)
        return b""

    def _answered(self, frame: bytes, now_s: float) -> bytes:
        if frame[-2] != 3:
            return _frame(0xE005)
        summed = 0
        for byte in frame[1:-2]:
            summed ^= byte
        if summed != frame[-1]:
            return _frame(0xE004)
        (command,) = struct.unpack_from(">H", frame, 2)
        if command == 0x400B:
            return _frame(0x400B, struct.pack(">I", self._newest(now_s)))
        if command == 0x0002:
            return self._read(frame[4:-2])
        return _frame(0xE001)

    def _newest(self, now_s: float) -> int:
        self._buffer = 1 - self._buffer
        address = _BUFFERS[self._buffer]
        profile = self._world.look(now_s)
        seen = 0 if profile is None else int(np.count_nonzero(profile.seen))
        if profile is not None:
            self._world.witness.note(
                now_s, "profile", table_rad=self._world.table.load(now_s),
                stage_mm=self._world.stage.load(now_s), seen=seen,
            )  # fmt: skip
        header = [self._told.points * 32] + [0] * (_HEADER_WORDS - 1)
        if self._told.addresses_count_bytes:
            header = header[: _HEADER_WORDS // 2]
        self._words[address] = header + self._points(profile)
        return address

    def _points(self, profile: SimProfile | None) -> list[int]:
        """X and Y of evenly chosen beams; both 7FFF where nothing was seen."""
        told = self._told
        words = np.full((told.points, 2), 0x7FFF)
        if profile is not None:
            sensor = self._world.bench.settings.sensor
            beams = np.linspace(0, len(profile.counts) - 1, told.points).round().astype(int)
            counts = profile.counts[beams]
            x = (counts[:, 0] * sensor.x_mm_per_count + sensor.x_offset_mm) / told.x_mm_per_count
            z_mm = counts[:, 1] * sensor.z_mm_per_count + sensor.z_offset_mm - told.z_offset_mm
            places = np.column_stack([x, z_mm / told.z_mm_per_count]).round().astype(int)
            fits = profile.seen[beams] & (np.abs(places) < 0x7FFF).all(axis=1)
            words[fits] = places[fits]
        return [int(word) & 0xFFFF for word in words.ravel()]

    def _read(self, data: bytes) -> bytes:
        if len(data) != 6:
            return _frame(0xE002)
        address, count, mode = struct.unpack(">IBB", data)
        size, step = mode >> 4, mode & 15
        if size not in (1, 2) or step == 0 or not 1 <= count <= (255, _POINTS_A_READ)[size - 1]:
            return _frame(0xE002)
        words = self._at(self._words, address)
        picked = [word for k in range(count) for word in words[k * step * size :][:size]]
        if len(picked) != count * size:
            return _frame(0xE002)
        order = ">" if self._told.big_endian else "<"
        return _frame(0x0002, struct.pack(f"{order}{len(picked)}H", *picked))

    def _at(self, buffers: Mapping[int, list[int]], address: int) -> list[int]:
        """The words from an address on; none where there is no memory."""
        for start, words in buffers.items():
            place, half = divmod(address - start, 2 if self._told.addresses_count_bytes else 1)
            if 0 <= place < len(words) and not half:
                return words[place:]
        return []


def _frame(command: int, data: bytes = b"") -> bytes:
    body = struct.pack(">BH", len(data) // 2, command) + data
    summed = 0
    for byte in body:
        summed ^= byte
    return b"\x02" + body + struct.pack("BB", 3, summed)
