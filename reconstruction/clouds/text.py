"""Points as plain text: .xyz, .pts, .txt and .csv.

A file has one delimiter, seen at its first row: semicolon before comma before blanks. So a comma
inside a field of a semicolon file is a decimal comma and an error, not a column. An empty field
between delimiters is a missing value: that point is invalid, and counted as such.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.clouds.lines import RowLayout, line_blocks, text_rows
from reconstruction.clouds.numerals import slow_number
from reconstruction.clouds.rows import BLANK, IGNORED, X, fields
from reconstruction.clouds.source import (
    AGAIN,
    HEAD_BYTES,
    Damaged,
    grouped,
    shortened,
    truncated,
    whole_number,
)

_UTF8_MARK: Final = b"\xef\xbb\xbf"
_UTF16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")
_BRACKETED: Final = re.compile(rb"\s*[\[(][^\])]*[\])]")
_NAME: Final = re.compile(rb"([xyz])(?:[\s_/-]+(?:um|\xc2\xb5m|mm|cm|dm|m|in|inch|ft))?")


@dataclass(frozen=True, slots=True)
class Preamble:
    """What stands before and in the first row of numbers."""

    start: int  # the first byte of the first row
    line: int  # its line number
    delimiter: int
    width: int  # its columns
    columns: tuple[int, int, int]  # those of x, y and z
    promised: int | None  # the number of points, if a line before says it
    promise: str  # which line


def parse_preamble(head: bytes, *, named: bool) -> Preamble:
    """Find the first row of numbers in a file's first bytes, and what its columns are.

    Parameters
    ----------
    named
        Whether a header line must name x, y and z; else it may, and they are the first three.

    Raises
    ------
    Damaged
        If there is no row, it has fewer than 3 columns, or the header names no x, y and z.
    """
    if head.startswith(_UTF16_MARKS):
        raise Damaged("is UTF-16 text; save it as UTF-8 or plain ASCII")
    names: bytes | None = None
    promised: int | None = None
    promise = ""
    for line, start, text in _contents(head):
        row = fields(text, _delimiter(text))
        if promised is None and len(row) == 1 and row[0].isdigit():
            promise = f"line {line}"
            promised = whole_number(row[0], promise)
        elif names is None and not any(map(_is_number, row)):
            names = text
        else:
            columns = _columns(names, row, _delimiter(text), line, named=named)
            return Preamble(start, line, _delimiter(text), len(row), columns, promised, promise)
    if promised:
        raise truncated(promised, 0, by=promise)
    raise Damaged("holds no row of numbers; write one point per line: x y z")


def _contents(head: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Line number, first byte and text of every line that is neither blank nor a comment."""
    start = len(_UTF8_MARK) if head.startswith(_UTF8_MARK) else 0
    for line, text in enumerate(head[start:].split(b"\n"), 1):
        content = text.strip(b" \t\r")
        if content and not content.startswith((b"#", b"//")):
            yield line, start, text
        start += len(text) + 1


def _delimiter(text: bytes) -> int:
    for candidate in b";,":
        if candidate in text:
            return candidate
    return BLANK


def _is_number(text: bytes) -> bool:
    try:
        slow_number(text)
    except ValueError:
        return False
    return True


def _columns(
    header: bytes | None, row: list[bytes], delimiter: int, line: int, *, named: bool
) -> tuple[int, int, int]:
    found = None
    if header is not None:
        bare = _BRACKETED.sub(b"", header.lower())
        names = [name.strip(b"\"' \t") for name in fields(bare, _delimiter(bare))]
        found = _named_columns(names)
        if found is None and named:
            shown = b", ".join(names)
            raise Damaged(f"its header names no x, y and z: {shortened(shown, 60)}; name them so")
        if found is not None and len(names) != len(row):
            raise Damaged(
                f"line {line}: {len(row)} columns, the header names {len(names)}; correct either"
            )
    if len(row) < 3:
        raise Damaged(
            f"line {line}: {len(row)} columns, x, y and z are needed: {shortened(b' '.join(row))}; "
            "write one point per line: x y z"
        )
    return found or (0, 1, 2)


def _named_columns(names: list[bytes]) -> tuple[int, int, int] | None:
    """Where x, y and z stand; a bare name goes before one with a unit."""
    places: dict[bytes, int] = {}
    for place, name in sorted(enumerate(names), key=lambda entry: len(entry[1])):
        if match := _NAME.fullmatch(name):
            places.setdefault(match[1], place)
    if len(places) < 3:
        return None
    return places[b"x"], places[b"y"], places[b"z"]


@dataclass(frozen=True, slots=True, eq=False)
class TextSource:
    """The rows of a text file without a header of a fixed form."""

    path: Path
    format: str
    preamble: Preamble

    @property
    def point_count(self) -> int | None:
        """The count that .pts files start with, where it is there."""
        return self.preamble.promised

    def rows(self, points: int) -> Iterator[FloatArray]:
        """Read the rows from the first to the end of the file."""
        preamble = self.preamble
        layout = RowLayout(
            kinds=_kinds(preamble, max(preamble.columns) + 1),
            whole=_kinds(preamble, preamble.width),
            delimiter=preamble.delimiter,
            line=preamble.line,
            most=_most_rows(self.path),
            promised=preamble.promised,
            promise=preamble.promise,
        )
        with self.path.open("rb") as file:
            file.seek(preamble.start)
            yield from text_rows(line_blocks(file), layout, points)


def _kinds(preamble: Preamble, width: int) -> NDArray[np.int8]:
    kinds = np.full(width, IGNORED, np.int8)
    for axis, column in enumerate(preamble.columns):
        kinds[column] = X + axis
    return kinds


def open_text(path: Path) -> TextSource:
    """Look at the first rows of an .xyz, .pts or .txt file."""
    return _open(path, named=False)


def open_csv(path: Path) -> TextSource:
    """Look at the first rows of a .csv file; a header there must name x, y and z."""
    return _open(path, named=True)


def _open(path: Path, *, named: bool) -> TextSource:
    with path.open("rb") as file:
        preamble = parse_preamble(file.read(HEAD_BYTES), named=named)
    room = _most_rows(path)
    if preamble.promised is not None and preamble.promised > room:
        raise Damaged(
            f"truncated: {preamble.promise} promises {grouped(preamble.promised)} points, "
            f"a file of this size holds at most {grouped(room)}; {AGAIN}"
        )
    return TextSource(path, path.suffix.lower().lstrip("."), preamble)


def _most_rows(path: Path) -> int:
    return path.stat().st_size // 3 + 1  # two delimiters and a newline
