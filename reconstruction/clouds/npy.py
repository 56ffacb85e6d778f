"""NumPy's own array files, (n, 3 or more columns), in either memory order.

Format: numpy.lib.format, versions 1 to 3. The header is matched, not evaluated, and pickles are
never opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.clouds.records import check_record, check_room, record_layout, record_rows
from reconstruction.clouds.source import AGAIN, HEAD_BYTES, Damaged, shortened, truncated

_MAGIC: Final = b"\x93NUMPY"
_DESCR: Final = re.compile(rb"""['"]descr['"]\s*:\s*(?:['"]([^'"]*)['"]|[^,}]*)""")
_ORDER: Final = re.compile(rb"""['"]fortran_order['"]\s*:\s*(True|False)""")
_SHAPE: Final = re.compile(rb"""['"]shape['"]\s*:\s*\(([\d\s,]*)\)""")
_REAL: Final = re.compile(rb"[<>|=]?(f2|f4|f8|f16|[iu][1248])")


@dataclass(frozen=True, slots=True)
class NpyHeader:
    """Where the numbers of an array file start, and how they lie."""

    dtype: str  # such as "<f4"
    columns_first: bool  # Fortran order: all x, then all y, ...
    rows: int
    columns: int
    body: int  # bytes before the numbers


def parse_header(head: bytes) -> NpyHeader:
    """Read the header out of a file's first bytes.

    Raises
    ------
    Damaged
        If this is no array file, or the array is not (n, 3 or more) of real numbers.
    """
    text, body = _header_text(head)
    descr, order, shape = _DESCR.search(text), _ORDER.search(text), _SHAPE.search(text)
    if descr is None or order is None or shape is None:
        raise Damaged(f"its array header cannot be read; {AGAIN}")
    name = descr[1] or b""
    if not _REAL.fullmatch(name):
        raise Damaged(f"its values are {shortened(name or descr[0])}; save real numbers, (n, 3)")
    sizes = [part.strip() for part in shape[1].split(b",") if part.strip()]
    if len(sizes) != 2 or any(not size.isdigit() or len(size) > 18 for size in sizes):
        raise Damaged(f"its shape is {shortened(shape[1])}; save an array (n, 3)")
    rows, columns = (int(size) for size in sizes)
    if columns < 3:
        raise Damaged(f"it has {columns} columns; x, y and z are needed, save an array (n, 3)")
    return NpyHeader(name.decode("ascii"), order[1] == b"True", rows, columns, body)


def _header_text(head: bytes) -> tuple[bytes, int]:
    if not head.startswith(_MAGIC):
        raise Damaged("is no .npy file, its first bytes are wrong; save it with numpy.save")
    width = 2 if head[6:7] == b"\x01" else 4
    body = 8 + width + int.from_bytes(head[8 : 8 + width], "little")
    if len(head) < min(body, HEAD_BYTES):
        raise truncated(body, len(head), by="its array header", unit="bytes")
    if body > HEAD_BYTES:
        raise Damaged(f"its array header claims {body} bytes; {AGAIN}")
    return head[8 + width : body], body


@dataclass(frozen=True, slots=True)
class NpySource:
    """The rows of an array file."""

    path: Path
    header: NpyHeader

    @property
    def format(self) -> str:
        """The array's type, too."""
        return f"npy {np.dtype(self.header.dtype).name}"

    @property
    def point_count(self) -> int:
        """The array's length."""
        return self.header.rows

    def rows(self, points: int) -> Iterator[FloatArray]:
        """Read rows, or the same stretch of three columns, `points` at a time."""
        with self.path.open("rb") as file:
            if self.header.columns_first:
                yield from _column_rows(file, self.header, points)
                return
            item = np.dtype(self.header.dtype).itemsize
            layout = record_layout(
                [self.header.dtype] * 3, [0, item, 2 * item], self.header.columns * item
            )
            file.seek(self.header.body)
            yield from record_rows(file, layout, self.header.rows, points)


def open_npy(path: Path) -> NpySource:
    """Read and check the header of an array file."""
    with path.open("rb") as file:
        header = parse_header(file.read(HEAD_BYTES))
    record = header.columns * np.dtype(header.dtype).itemsize
    check_record(record)
    check_room(header.rows, record, path.stat().st_size - header.body)
    return NpySource(path, header)


def _column_rows(file: BinaryIO, header: NpyHeader, points: int) -> Iterator[FloatArray]:
    item = np.dtype(header.dtype).itemsize
    for start in range(0, header.rows, points):
        rows = np.empty((min(points, header.rows - start), 3))
        for axis in range(3):
            file.seek(header.body + (axis * header.rows + start) * item)
            column = file.read(len(rows) * item)
            if len(column) < len(rows) * item:
                raise Damaged(f"became shorter while it was read; {AGAIN}")
            with np.errstate(over="ignore", invalid="ignore"):
                rows[:, axis] = np.frombuffer(column, dtype=header.dtype)
        yield rows
