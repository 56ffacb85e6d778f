"""Binary .ply records with lists in them: of a size each that only the record itself tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.clouds.numerals import Bytes
from reconstruction.clouds.records import record_layout, unpack
from reconstruction.clouds.source import AGAIN, Damaged, truncated

LITTLE, BIG = 0, 1  # the byte that comes first

_BLOCK_BYTES: Final = 1 << 20
_LARGEST_RECORD: Final = 1 << 26


@dataclass(frozen=True, slots=True)
class ListedRecords:
    """The layout of an element that has lists."""

    types: tuple[str, ...]  # numpy's names, with byte order
    length_types: tuple[str | None, ...]  # of a list's length; None for a scalar
    axes: tuple[int, ...]  # 0, 1, 2 for x, y, z, else -1
    name: str

    @property
    def sizes(self) -> IntArray:
        """Bytes of a value, (k,)."""
        return np.array([np.dtype(name).itemsize for name in self.types], dtype=np.int64)

    @property
    def lengths(self) -> IntArray:
        """Bytes of a list's length, 0 for a scalar, negative if the length is signed; (k,)."""
        return np.array([_length_code(name) for name in self.length_types], dtype=np.int64)

    @property
    def order(self) -> int:
        """LITTLE or BIG."""
        return BIG if self.types[0].startswith(">") else LITTLE


def _length_code(name: str | None) -> int:
    if name is None:
        return 0
    return np.dtype(name).itemsize * (-1 if name.startswith("i") else 1)


def listed_rows(
    file: BinaryIO, layout: ListedRecords, count: int, points: int
) -> Iterator[FloatArray]:
    """Read x, y and z of `count` records from where `file` stands, as arrays (k, 3)."""
    packed, picks = _packed(layout)
    walk = _Walk(file, layout, count, picks, packed.itemsize)
    for start in range(0, count, points):
        rows = np.empty((min(points, count - start), 3))
        filled = 0
        while filled < len(rows):
            records = walk.records(len(rows) - filled).view(packed)[:, 0]
            unpack(records, rows[filled : filled + len(records)])
            filled += len(records)
        yield rows


def skip_listed(file: BinaryIO, layout: ListedRecords, count: int) -> int:
    """Step over `count` records; returns their bytes."""
    walk = _Walk(file, layout, count, np.full(len(layout.types), -1), 0)
    while walk.passed < count:
        walk.records(count - walk.passed)
    return walk.bytes_passed


def _packed(layout: ListedRecords) -> tuple[np.dtype[np.void], IntArray]:
    """Lay out x, y, z alone, and say where in it each property goes (-1: nowhere)."""
    columns = [layout.axes.index(axis) for axis in range(3)]
    types = [layout.types[column] for column in columns]
    offsets = [0, *np.cumsum([np.dtype(name).itemsize for name in types]).tolist()]
    picks = np.full(len(layout.types), -1, dtype=np.int64)
    picks[columns] = offsets[:3]
    return record_layout(types, offsets[:3], offsets[3]), picks


@dataclass(slots=True)
class _Walk:
    """Steps through the records of an element, a block of the file at a time."""

    file: BinaryIO
    layout: ListedRecords
    count: int
    picks: IntArray
    packed_bytes: int
    passed: int = 0
    bytes_passed: int = 0
    block: bytes = b""
    at: int = 0  # the first byte of the block not yet read

    def records(self, most: int) -> NDArray[np.uint8]:
        """Between 1 and `most` further records, packed, (k, packed bytes)."""
        while True:
            # No record is shorter than a byte, so there are no more of them than bytes.
            rows = min(most, len(self.block) - self.at)
            packed = np.empty((rows, self.packed_bytes), np.uint8)
            if walked := self._walk(packed):
                return packed[:walked]
            self._read_on()

    def _walk(self, packed: NDArray[np.uint8]) -> int:
        layout, data = self.layout, np.frombuffer(self.block, np.uint8)
        end, rows, sound = walk_records(
            data, self.at, layout.sizes, layout.lengths, layout.order, self.picks, packed
        )
        if not sound and rows == 0:
            where = f"record {self.passed + 1} of {layout.name!r}"
            raise Damaged(f"{where} has a list of negative length; {AGAIN}")
        self.passed += rows
        self.bytes_passed += end - self.at
        self.at = end
        return int(rows)

    def _read_on(self) -> None:
        rest = self.block[self.at :]
        if len(rest) > _LARGEST_RECORD:
            raise Damaged(f"record {self.passed + 1} of {self.layout.name!r} is endless; {AGAIN}")
        # A record longer than the block: twice as much each time, not a block more.
        more = self.file.read(max(_BLOCK_BYTES, len(rest)))
        if not more:
            unit = "points" if self.layout.name == "vertex" else f"records of {self.layout.name!r}"
            raise truncated(self.count, self.passed, unit=unit)
        self.block, self.at = rest + more, 0


@njit(cache=True)
def walk_records(
    data: Bytes,
    start: int,
    sizes: IntArray,
    lengths: IntArray,
    order: int,
    picks: IntArray,
    packed: NDArray[np.uint8],
) -> tuple[int, int, bool]:
    """Copy the picked bytes of each whole record from data[start:] into `packed` (k, bytes).

    Returns
    -------
    Where the next record starts, how many were read, and False if a list of negative length
    ended it.
    """
    for row in range(len(packed)):
        at = start
        for column in range(len(sizes)):
            width = abs(lengths[column])
            repeats = 1
            if width:
                if at + width > len(data):
                    return start, row, True
                repeats = _integer(data, at, lengths[column], order)
                if repeats < 0:
                    return start, row, False
            end = at + width + repeats * sizes[column]
            if end > len(data):
                return start, row, True
            if picks[column] >= 0:
                for byte in range(sizes[column]):
                    packed[row, picks[column] + byte] = data[at + byte]
            at = end
        start = at
    return start, len(packed), True


@njit(cache=True)
def _integer(data: Bytes, at: int, length: int, order: int) -> int:
    """Read the integer of abs(length) bytes at `at`, signed where length is negative."""
    width = abs(length)
    value = 0
    for byte in range(width):
        place = at + byte if order == BIG else at + width - 1 - byte
        value = value * 256 + int(data[place])
    if length < 0 and value >= 1 << (8 * width - 1):
        value -= 1 << (8 * width)
    return value
