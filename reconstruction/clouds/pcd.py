"""The header of a .pcd file, and its points in any of the three encodings.

Version 0.7 of the Point Cloud Library's format. In ``binary_compressed`` the fields stand one
after the other, packed as one LZF stream::

    x x x ... y y y ... z z z ... rgb rgb rgb ...

so three readers go through the stream, each from the start of its own field: the work is up to
three times that of unpacking it once, the memory is the chunk, not the cloud.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Literal

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.clouds.lines import RowLayout, line_blocks, text_rows
from reconstruction.clouds.lzf import LARGEST_RATIO, unpacked
from reconstruction.clouds.numerals import Bytes
from reconstruction.clouds.records import check_record, check_room, record_layout, record_rows
from reconstruction.clouds.rows import BLANK, IGNORED, X
from reconstruction.clouds.source import (
    AGAIN,
    HEAD_BYTES,
    Damaged,
    grouped,
    shortened,
    truncated,
    whole_number,
)

Encoding = Literal["ascii", "binary", "binary_compressed"]

_KEYS: Final = frozenset(
    b"VERSION FIELDS COLUMNS SIZE TYPE COUNT WIDTH HEIGHT VIEWPOINT POINTS DATA".split()
)
_ENCODINGS: Final[dict[bytes, Encoding]] = {
    b"ascii": "ascii",
    b"binary": "binary",
    b"binary_compressed": "binary_compressed",
}
_TYPES: Final = frozenset(b"F2 F4 F8 I1 I2 I4 I8 U1 U2 U4 U8".split())
_BLOCK_BYTES: Final = 1 << 18
_SIZES_BYTES: Final = 8  # the packed and the unpacked size, before the stream


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a point."""

    name: str
    type: str  # as numpy names it
    count: int

    @property
    def bytes(self) -> int:
        """Its size in one point."""
        return int(np.dtype(self.type).itemsize) * self.count


@dataclass(frozen=True, slots=True)
class PcdHeader:
    """What a .pcd file says about its body."""

    encoding: Encoding
    fields: tuple[Field, ...]
    points: int
    body: int  # bytes before the body
    lines: int  # lines before the body

    @property
    def record_bytes(self) -> int:
        """The size of one point."""
        return sum(field.bytes for field in self.fields)

    @property
    def axes(self) -> tuple[int, int, int]:
        """Which fields are x, y and z."""
        names = [field.name for field in self.fields]
        return names.index("x"), names.index("y"), names.index("z")


def parse_header(head: bytes) -> PcdHeader:
    """Read the header out of a file's first bytes.

    Raises
    ------
    Damaged
        If this is no .pcd file, or its header is cut or makes no sense.
    """
    entries: dict[bytes, list[bytes]] = {}
    start = lines = 0
    while (end := head.find(b"\n", start)) >= 0:
        words = head[start:end].split()
        start, lines = end + 1, lines + 1
        if not words or words[0].startswith(b"#"):
            continue
        if words[0] not in _KEYS:
            raise Damaged(
                f"is no .pcd file, line {lines} of its header is {shortened(b' '.join(words))}; "
                "check the extension"
            )
        entries[words[0]] = words[1:]
        if words[0] == b"DATA":
            return _header(entries, start, lines)
    raise Damaged(f"is no .pcd file, or truncated: its header has no DATA line; {AGAIN}")


def _header(entries: Mapping[bytes, list[bytes]], body: int, lines: int) -> PcdHeader:
    data = b" ".join(entries[b"DATA"])
    if data not in _ENCODINGS:
        raise Damaged(
            f"its data are {shortened(data)}; save it as ascii, binary or binary_compressed"
        )
    return PcdHeader(_ENCODINGS[data], _fields(entries), _point_count(entries), body, lines)


def _fields(entries: Mapping[bytes, list[bytes]]) -> tuple[Field, ...]:
    names = entries.get(b"FIELDS", entries.get(b"COLUMNS", []))
    counts = entries.get(b"COUNT", [b"1"] * len(names))
    sizes, types = entries.get(b"SIZE", []), entries.get(b"TYPE", [])
    if not len(names) == len(sizes) == len(types) == len(counts):
        raise Damaged(f"its header has FIELDS, SIZE, TYPE and COUNT of different length; {AGAIN}")
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        label = name.decode("latin-1").lower()
        if kind + size not in _TYPES:
            raise Damaged(f"field {label!r} has no known type: {shortened(kind + size)}; {AGAIN}")
        fields.append(
            Field(
                label,
                (kind.lower() + size).decode("ascii"),
                whole_number(count, f"the COUNT of field {label!r}"),
            )
        )
    first = {field.name: field for field in reversed(fields)}
    if any(axis not in first or first[axis].count != 1 for axis in "xyz"):
        raise Damaged("its FIELDS have no single x, y and z; export it with coordinates")
    return tuple(fields)


def _point_count(entries: Mapping[bytes, list[bytes]]) -> int:
    sizes = {
        key: whole_number(b" ".join(entries[key]), key.decode("ascii"))
        for key in (b"WIDTH", b"HEIGHT", b"POINTS")
        if key in entries
    }
    product = sizes.get(b"WIDTH", 0) * sizes.get(b"HEIGHT", 1)
    points = sizes.get(b"POINTS", product)
    if b"WIDTH" in sizes and points != product:
        raise Damaged(
            f"its header says {grouped(points)} points, but WIDTH x HEIGHT is {grouped(product)}; "
            f"{AGAIN}"
        )
    return points


@dataclass(frozen=True, slots=True)
class PcdSource:
    """The points of a .pcd file."""

    path: Path
    header: PcdHeader

    @property
    def format(self) -> str:
        """The encoding, too."""
        return f"pcd {self.header.encoding}"

    @property
    def point_count(self) -> int:
        """The count of the header."""
        return self.header.points

    def rows(self, points: int) -> Iterator[FloatArray]:
        """Read the points."""
        if self.header.encoding == "binary_compressed":
            yield from _compressed_rows(self.path, self.header, points)
            return
        with self.path.open("rb") as file:
            file.seek(self.header.body)
            if self.header.encoding == "ascii":
                yield from text_rows(line_blocks(file), _row_layout(self.header), points)
            else:
                layout = _record_layout(self.header)
                yield from record_rows(file, layout, self.header.points, points)


def open_pcd(path: Path) -> PcdSource:
    """Read the header and check that the points can be there."""
    with path.open("rb") as file:
        header = parse_header(file.read(HEAD_BYTES))
        check_record(header.record_bytes)
        room = path.stat().st_size - header.body
        if header.encoding == "ascii":
            # A digit and a separator a value; the last separator may be missing.
            check_room(header.points, 2 * sum(field.count for field in header.fields), room + 1)
        elif header.encoding == "binary":
            check_room(header.points, header.record_bytes, room)
        else:
            file.seek(header.body)
            _check_packed(header, file.read(_SIZES_BYTES), room - _SIZES_BYTES)
    return PcdSource(path, header)


def _check_packed(header: PcdHeader, sizes: bytes, room: int) -> None:
    packed, whole = (int.from_bytes(part, "little") for part in (sizes[:4], sizes[4:]))
    if packed > room:
        raise truncated(packed, max(room, 0), unit="packed bytes")
    if whole != header.points * header.record_bytes or whole > LARGEST_RATIO * packed:
        raise Damaged(
            f"its header promises {grouped(header.points)} points of {header.record_bytes} bytes, "
            f"its {grouped(packed)} packed bytes say they are {grouped(whole)}; {AGAIN}"
        )


def _record_layout(header: PcdHeader) -> np.dtype[np.void]:
    fields = [header.fields[axis] for axis in header.axes]
    offsets = [sum(field.bytes for field in header.fields[:axis]) for axis in header.axes]
    return record_layout(["<" + field.type for field in fields], offsets, header.record_bytes)


def _row_layout(header: PcdHeader) -> RowLayout:
    columns = [sum(field.count for field in header.fields[:axis]) for axis in header.axes]
    kinds = np.full(sum(field.count for field in header.fields), IGNORED, np.int8)
    kinds[columns] = np.arange(X, X + 3)
    return RowLayout(
        kinds=kinds,
        whole=kinds,
        delimiter=BLANK,
        line=header.lines + 1,
        most=header.points,
        promised=header.points,
    )


def _compressed_rows(path: Path, header: PcdHeader, points: int) -> Iterator[FloatArray]:
    with ExitStack() as files:
        columns = [
            _Column(files.enter_context(path.open("rb")), header, axis) for axis in header.axes
        ]
        for start in range(0, header.points, points):
            rows = np.empty((min(points, header.points - start), 3))
            for axis, column in enumerate(columns):
                column.read_into(rows[:, axis])
            yield rows


class _Column:
    """One field of a compressed file, read from its first value to its last."""

    def __init__(self, file: BinaryIO, header: PcdHeader, field: int) -> None:
        self._type = np.dtype("<" + header.fields[field].type)
        self._pieces = unpacked(_packed_blocks(file, header.body))
        self._piece: Bytes = np.empty(0, np.uint8)
        before = sum(entry.bytes for entry in header.fields[:field])
        self._to_skip = before * header.points

    def read_into(self, values: FloatArray) -> None:
        """Fill (k,) with the next values, as they are in the file."""
        raw = np.empty(len(values) * self._type.itemsize, np.uint8)
        filled = 0
        while filled < len(raw):
            self._ensure_piece()
            part = self._piece[: len(raw) - filled]
            raw[filled : filled + len(part)] = part
            self._piece = self._piece[len(part) :]
            filled += len(part)
        with np.errstate(invalid="ignore"):
            values[:] = raw.view(self._type)

    def _ensure_piece(self) -> None:
        while len(self._piece) == 0:
            piece = next(self._pieces, None)
            if piece is None:
                raise Damaged(f"its packed data end before the last point; {AGAIN}")
            skipped = min(self._to_skip, len(piece))
            self._to_skip -= skipped
            self._piece = piece[skipped:]


def _packed_blocks(file: BinaryIO, body: int) -> Iterator[bytes]:
    file.seek(body)
    left = int.from_bytes(file.read(_SIZES_BYTES)[:4], "little")
    while left > 0 and (block := file.read(min(left, _BLOCK_BYTES))):
        left -= len(block)
        yield block
