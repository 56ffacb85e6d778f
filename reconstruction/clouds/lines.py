"""Blocks of whole lines, and the points in them, chunk by chunk.

`line_blocks` reads and knows no numbers; `text_rows` parses and knows no file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.clouds.numerals import Bytes, slow_number
from reconstruction.clouds.rows import (
    FINE,
    LIST,
    TOO_FEW,
    Scan,
    fields,
    line_end,
    pass_rows,
    scan_rows,
)
from reconstruction.clouds.source import AGAIN, Damaged, grouped, shortened, truncated

_BLOCK_BYTES: Final = 1 << 20
_LONGEST_LINE: Final = 1 << 20
_OPEN_NUMERALS: Final = 3 << 10


@dataclass(frozen=True, slots=True)
class Block:
    """Whole lines; a last line without a newline comes alone and is marked as cut."""

    text: bytes
    cut: bool


@dataclass(frozen=True, slots=True, eq=False)
class RowLayout:
    """How the rows of a text file are to be read."""

    kinds: NDArray[np.int8]  # per column IGNORED, X, Y, Z or LIST; columns beyond are not looked at
    whole: NDArray[np.int8]  # the same for a last line without newline, where none may be missing
    delimiter: int  # a byte; BLANK stands for any run of blanks and tabs
    line: int  # the number of the first line after the header
    most: int  # no more rows than this, by the size of the file
    promised: int | None = None  # rows, if the file says it
    promise: str = "header"  # where it says it
    passed_over: int = 0  # rows of other things before the points
    more_follows: bool = False  # whether other things may stand after the promised rows


def line_blocks(file: BinaryIO, size: int = _BLOCK_BYTES) -> Iterator[Block]:
    """Cut a file at newlines into blocks of about `size` bytes.

    Raises
    ------
    Damaged
        For a line of more than 1 MB.
    """
    carried = b""
    while piece := file.read(size):
        end = piece.rfind(b"\n") + 1
        if end == 0:
            carried += piece
        else:
            yield Block(carried + piece[:end], cut=False)
            carried = piece[end:]
        if len(carried) > _LONGEST_LINE:
            raise Damaged("a line is longer than 1 MB, so this is no point list; export it as text")
    if carried:
        yield Block(carried, cut=True)


def text_rows(blocks: Iterable[Block], layout: RowLayout, points: int) -> Iterator[FloatArray]:
    """Read the rows of a text file, as fresh arrays (k, 3) with k <= points.

    Raises
    ------
    Damaged
        At a row that is malformed, with its line number; where rows are missing, or too many.
    """
    reader = _RowReader(layout, points)
    for block in blocks:
        yield from reader.feed(block)
        if reader.complete:
            break
    yield from reader.close()


@dataclass(slots=True)
class _RowReader:
    """Feeds blocks to the kernel and keeps what lasts from one to the next."""

    layout: RowLayout
    points: int
    line: int = 0
    seen: int = 0  # rows handed out
    filled: int = 0  # rows waiting
    to_pass: int = 0
    rows: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    left_open: IntArray = field(default_factory=lambda: np.empty((_OPEN_NUMERALS, 5), np.int64))

    def __post_init__(self) -> None:
        self.line = self.layout.line
        self.to_pass = self.layout.passed_over
        self._renew()

    @property
    def complete(self) -> bool:
        """Whether nothing after this is ours."""
        return self.layout.more_follows and self.seen + self.filled == self.layout.promised

    def feed(self, block: Block) -> Iterator[FloatArray]:
        """Read a block; yields each chunk that became full."""
        data = np.frombuffer(block.text, np.uint8)
        at, self.line, self.to_pass = pass_rows(data, 0, self.line, self.to_pass)
        kinds = self.layout.whole if block.cut else self.layout.kinds
        while at < len(data) and not self.complete:
            scan = self._scan(data, at, kinds)
            self._settle(data, scan, block)
            at, self.line, self.filled = scan.at, scan.line, scan.filled
            self._check_not_too_many()
            if self.filled == len(self.rows):
                yield self._take()

    def close(self) -> Iterator[FloatArray]:
        """Hand out the rest and check the count."""
        there, promised = self.seen + self.filled, self.layout.promised
        if self.filled:
            yield self._take()
        if promised is not None and there < promised:
            raise truncated(promised, there, by=self.layout.promise)

    def _scan(self, data: Bytes, at: int, kinds: NDArray[np.int8]) -> Scan:
        scan: Scan = scan_rows(
            data,
            at,
            self.line,
            self.layout.delimiter,
            kinds,
            self.rows,
            self.filled,
            self.left_open,
        )
        return scan

    def _take(self) -> FloatArray:
        rows = self.rows[: self.filled]
        self.seen += self.filled
        self._renew()
        return rows

    def _renew(self) -> None:
        self.filled = 0
        self.rows = np.empty((max(1, min(self.points, self.layout.most - self.seen)), 3))

    def _settle(self, data: Bytes, scan: Scan, block: Block) -> None:
        """Read what the kernel left open, then raise what it found."""
        for row, axis, first, last, line in self.left_open[: scan.open].tolist():
            text = data[first:last].tobytes()
            try:
                self.rows[row, axis] = slow_number(text)
            except ValueError as error:
                raise self._not_a_number(text, line, row, block) from error
        if scan.fault != FINE:
            text = data[scan.at : line_end(data, scan.at)].tobytes()
            raise self._malformed(text, scan, block)
        if block.cut and self._lacks_a_value(block.text):
            raise self._cut_off(block.text, scan.line - 1, scan.filled - 1)

    def _lacks_a_value(self, last_line: bytes) -> bool:
        # "1,2," is a missing z in the middle of a file, but a cut at its end.
        values = fields(last_line, self.layout.delimiter)
        return len(values) == len(self.layout.kinds) and values[-1] == b""

    def _not_a_number(self, text: bytes, line: int, row: int, block: Block) -> Damaged:
        if block.cut:
            return self._cut_off(block.text, line, row)
        remedy = "write decimal points, not commas" if b"," in text else "correct or remove it"
        return Damaged(f"line {line}: {shortened(text)} is not a number; {remedy}")

    def _malformed(self, text: bytes, scan: Scan, block: Block) -> Damaged:
        if block.cut:
            return self._cut_off(text, scan.line, scan.filled)
        if scan.fault != TOO_FEW:
            return Damaged(
                f"line {scan.line}: a list without its length: {shortened(text)}; {AGAIN}"
            )
        there = len(fields(text, self.layout.delimiter))
        lists = " and more" if LIST in self.layout.kinds else ""
        return Damaged(
            f"line {scan.line}: {there} columns, {len(self.layout.kinds)}{lists} are needed: "
            f"{shortened(text)}; correct or remove it"
        )

    def _cut_off(self, text: bytes, line: int, row: int) -> Damaged:
        whole, promised = self.seen + row, self.layout.promised
        if promised is not None and whole < promised:
            return truncated(promised, whole, by=self.layout.promise)
        return Damaged(f"truncated: the last line, {line}, breaks off: {shortened(text)}; {AGAIN}")

    def _check_not_too_many(self) -> None:
        there, promised = self.seen + self.filled, self.layout.promised
        if promised is not None and there > promised:
            raise Damaged(
                f"{self.layout.promise} promises {grouped(promised)} points, more follow; "
                "correct the count"
            )
