r"""The header of a .ply file, and its vertices in any of the three encodings.

After Turk 1994, "The PLY Polygon File Format", and the sized type names that came later.
A header is a list of elements, each with a count and properties; the body has them in order::

    element face 2        \  stepped over, lists and all
    element vertex 3       | x, y and z are picked out, the rest is left
    element edge 1        /  not looked at
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final, Literal

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.clouds.lines import RowLayout, line_blocks, text_rows
from reconstruction.clouds.ply_lists import ListedRecords, listed_rows, skip_listed
from reconstruction.clouds.records import check_record, check_room, record_layout, record_rows
from reconstruction.clouds.rows import BLANK, IGNORED, LIST, X
from reconstruction.clouds.source import (
    AGAIN,
    HEAD_BYTES,
    Damaged,
    shortened,
    truncated,
    whole_number,
)

Encoding = Literal["ascii", "binary_little_endian", "binary_big_endian"]

_TYPES: Final = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_ENCODINGS: Final[dict[str, Encoding]] = {
    "ascii": "ascii",
    "binary_little_endian": "binary_little_endian",
    "binary_big_endian": "binary_big_endian",
}


@dataclass(frozen=True, slots=True)
class Property:
    """One value of an element, or a list of them with its length in front."""

    name: str
    type: str  # as numpy names it, without byte order
    length_type: str | None = None  # of a list


@dataclass(frozen=True, slots=True)
class Element:
    """A table of the body."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def fixed(self) -> bool:
        """Whether all its records have the same size."""
        return all(entry.length_type is None for entry in self.properties)

    @property
    def record_bytes(self) -> int:
        """The size of a record whose lists are empty."""
        types = (entry.length_type or entry.type for entry in self.properties)
        return sum(np.dtype(name).itemsize for name in types)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """What a .ply file says about its body."""

    encoding: Encoding
    before: tuple[Element, ...]  # elements before the vertices
    vertex: Element
    body: int  # bytes before the body
    lines: int  # lines before the body


def parse_header(head: bytes) -> PlyHeader:
    """Read the header out of a file's first bytes.

    Raises
    ------
    Damaged
        If this is no .ply file, or its header is cut or makes no sense.
    """
    lines = _header_lines(head)
    body = sum(len(line) + 1 for line in lines)
    words = [line.decode("latin-1").split() for line in lines]
    encoding: Encoding | None = None
    elements: list[tuple[str, int, list[Property]]] = []
    for number, entry in enumerate(words, 1):
        match entry:
            case ["format", name, _] if name in _ENCODINGS:
                encoding = _ENCODINGS[name]
            case ["element", name, count]:
                what = f"line {number}: the count of {name!r}"
                elements.append((name, whole_number(count.encode("latin-1"), what), []))
            case ["property", *rest] if elements:
                elements[-1][2].append(_property(rest, number))
            case [] | ["ply"] | ["comment" | "obj_info", *_] | ["end_header"]:
                pass
            case _:
                text = lines[number - 1].strip()
                raise Damaged(f"line {number} of its header is {shortened(text)}; {AGAIN}")
    if encoding is None:
        raise Damaged(f"its header has no format line; {AGAIN}")
    tables = [Element(name, count, tuple(entries)) for name, count, entries in elements]
    return _header(encoding, tables, body, len(lines))


def _header_lines(head: bytes) -> list[bytes]:
    """Cut the header into lines, without newlines, up to ``end_header``."""
    if head.split(b"\n", 1)[0].strip() != b"ply":
        raise Damaged("is no .ply file, its first line is not 'ply'; check the extension")
    lines: list[bytes] = []
    start = 0
    while (end := head.find(b"\n", start)) >= 0:
        lines.append(head[start:end])
        if lines[-1].strip() == b"end_header":
            return lines
        start = end + 1
    raise Damaged(f"truncated: its header has no end_header line; {AGAIN}")


def _property(words: list[str], line: int) -> Property:
    match words:
        case ["list", length, type_, name] if type_ in _TYPES and length in _TYPES:
            entry = Property(name, _TYPES[type_], _TYPES[length])
        case [type_, name] if type_ in _TYPES:
            entry = Property(name, _TYPES[type_])
        case _:
            text = shortened(" ".join(words).encode("latin-1"))
            raise Damaged(f"line {line}: no such property type: {text}; {AGAIN}")
    if entry.length_type in {"f4", "f8", "i8", "u8"}:
        raise Damaged(f"line {line}: the length of {entry.name!r} is no small integer; {AGAIN}")
    return entry


def _header(encoding: Encoding, elements: list[Element], body: int, lines: int) -> PlyHeader:
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise Damaged("has no element 'vertex', so no points; export it as a point cloud")
    place = names.index("vertex")
    vertex = elements[place]
    scalars = {entry.name.lower() for entry in vertex.properties if entry.length_type is None}
    if not {"x", "y", "z"} <= scalars:
        raise Damaged("its vertices have no x, y and z; export it with coordinates")
    return PlyHeader(encoding, tuple(elements[:place]), vertex, body, lines)


@dataclass(frozen=True, slots=True)
class PlySource:
    """The vertices of a .ply file."""

    path: Path
    header: PlyHeader
    start: int  # the first byte of the vertices; of the body in a text file

    @property
    def format(self) -> str:
        """The encoding, too."""
        return f"ply {self.header.encoding}"

    @property
    def point_count(self) -> int:
        """The count of the header."""
        return self.header.vertex.count

    def rows(self, points: int) -> Iterator[FloatArray]:
        """Read the vertices."""
        vertex = self.header.vertex
        with self.path.open("rb") as file:
            file.seek(self.start)
            if self.header.encoding == "ascii":
                yield from text_rows(line_blocks(file), _row_layout(self.header), points)
            elif vertex.fixed:
                yield from record_rows(file, _record_layout(self.header), vertex.count, points)
            else:
                yield from listed_rows(file, _listed(vertex, self.header), vertex.count, points)


def open_ply(path: Path) -> PlySource:
    """Read the header, step over what is before the vertices, and check that they can be there."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = parse_header(file.read(HEAD_BYTES))
        vertex = header.vertex
        check_record(vertex.record_bytes)
        if header.encoding == "ascii":
            # A digit and a separator a value; the last separator may be missing.
            check_room(vertex.count, 2 * len(vertex.properties), size - header.body + 1)
            return PlySource(path, header, header.body)
        start = _vertex_start(file, header, size)
    check_room(vertex.count, vertex.record_bytes, size - start)
    return PlySource(path, header, start)


def _vertex_start(file: BinaryIO, header: PlyHeader, size: int) -> int:
    start = header.body
    for element in header.before:
        if element.count * element.record_bytes > size - start:
            there = (size - start) // element.record_bytes
            raise truncated(element.count, there, unit=f"records of {element.name!r}")
        if element.fixed:
            start += element.count * element.record_bytes
        else:
            file.seek(start)
            start += skip_listed(file, _listed(element, header), element.count)
    return start


def _order(header: PlyHeader) -> str:
    return ">" if header.encoding == "binary_big_endian" else "<"


def _axis(entry: Property) -> int:
    """0, 1, 2 for x, y, z; -1 for what else there is."""
    return -1 if entry.length_type or len(entry.name) != 1 else "xyz".find(entry.name.lower())


def _record_layout(header: PlyHeader) -> np.dtype[np.void]:
    types, offsets, offset = ["", "", ""], [0, 0, 0], 0
    for entry in reversed(header.vertex.properties):  # so that the first of a name stays
        offset += np.dtype(entry.type).itemsize
        if (axis := _axis(entry)) >= 0:
            types[axis] = _order(header) + entry.type
            offsets[axis] = header.vertex.record_bytes - offset
    return record_layout(types, offsets, header.vertex.record_bytes)


def _listed(element: Element, header: PlyHeader) -> ListedRecords:
    return ListedRecords(
        types=tuple(_order(header) + entry.type for entry in element.properties),
        length_types=tuple(entry.length_type for entry in element.properties),
        axes=tuple(_axis(entry) for entry in element.properties),
        name=element.name,
    )


def _row_layout(header: PlyHeader) -> RowLayout:
    kinds = np.full(len(header.vertex.properties), IGNORED, np.int8)
    for column, entry in enumerate(header.vertex.properties):
        if entry.length_type is not None:
            kinds[column] = LIST
        elif (axis := _axis(entry)) >= 0 and X + axis not in kinds[:column]:
            kinds[column] = X + axis
    return RowLayout(
        kinds=kinds,
        whole=kinds,
        delimiter=BLANK,
        line=header.lines + 1,
        most=header.vertex.count,
        promised=header.vertex.count,
        passed_over=sum(element.count for element in header.before if element.properties),
        more_follows=True,
    )
