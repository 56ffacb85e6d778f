"""Points out of lines of text: the part that .ply, .pcd and the free formats share.

The kernel reads the columns it is told to and nothing else; what it cannot decide (numerals of
20 digits, words) it leaves open with its place, and Python settles that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.clouds.numerals import Bytes, number

# What a column is to us; X, Y, Z are 1, 2, 3 so that the axis is the kind less one.
IGNORED, X, Y, Z, LIST = 0, 1, 2, 3, 4
# What can be wrong with a row.
FINE, TOO_FEW, NO_LENGTH = 0, 1, 2

BLANK = ord(" ")
_NEWLINE = ord("\n")
_TAB = ord("\t")
_RETURN = ord("\r")
_HASH = ord("#")
_SLASH = ord("/")


class Scan(NamedTuple):
    """How far the kernel came in a block, and why it stopped."""

    at: int  # the first byte not read
    line: int  # the number of the line that starts there
    filled: int  # rows in the output
    open: int  # numerals left to Python
    fault: int  # FINE, TOO_FEW or NO_LENGTH: then the line at `at` is wrong


@njit(cache=True)
def scan_rows(
    data: Bytes,
    at: int,
    line: int,
    delimiter: int,
    kinds: NDArray[np.int8],
    rows: FloatArray,
    filled: int,
    left_open: IntArray,
) -> Scan:
    """Fill `rows` (k, 3) from whole lines of `data`, from byte `at` on.

    Stops at the end of the data, when the rows or the list of open numerals (m, 5: row, axis,
    first byte, last byte, line) are full, or at a faulty line. Blank lines and comments pass.
    """
    count = 0
    while at < len(data) and filled < len(rows) and count + 3 <= len(left_open):
        end = line_end(data, at)
        start = _skip_blanks(data, at, end)
        if holds_row(data, start, end):
            fault, count = _read_row(
                data, start, end, line, delimiter, kinds, rows, filled, left_open, count
            )
            if fault != FINE:
                return Scan(at, line, filled, count, fault)
            filled += 1
        at = end + 1
        line += 1
    return Scan(at, line, filled, count, FINE)


@njit(cache=True)
def pass_rows(data: Bytes, at: int, line: int, wanted: int) -> tuple[int, int, int]:
    """Step over `wanted` rows; returns the byte, the line, and how many rows are still wanted."""
    while at < len(data) and wanted > 0:
        end = line_end(data, at)
        if holds_row(data, _skip_blanks(data, at, end), end):
            wanted -= 1
        at = end + 1
        line += 1
    return at, line, wanted


@njit(cache=True)
def line_end(data: Bytes, at: int) -> int:
    """Where the line ends: its newline, or the end of the data."""
    while at < len(data) and data[at] != _NEWLINE:
        at += 1
    return at


@njit(cache=True)
def holds_row(data: Bytes, start: int, end: int) -> bool:
    """Whether the line whose first character is at `start` is neither blank nor a comment."""
    if start == end or data[start] == _HASH:
        return False
    return not (data[start] == _SLASH and start + 1 < end and data[start + 1] == _SLASH)


@njit(cache=True)
def _read_row(
    data: Bytes,
    at: int,
    end: int,
    line: int,
    delimiter: int,
    kinds: NDArray[np.int8],
    rows: FloatArray,
    row: int,
    left_open: IntArray,
    count: int,
) -> tuple[int, int]:
    """Read one line into rows[row]; returns the fault and the number of open numerals."""
    for kind in kinds:
        first, last, at = _next_field(data, at, end, delimiter)
        if first < 0:
            return TOO_FEW, count
        if kind == LIST:
            at = _skip_list(data, first, last, at, end, delimiter)
            if at < 0:
                return NO_LENGTH, count
        elif kind != IGNORED:
            value, known = number(data, first, last)
            rows[row, kind - 1] = value
            if not known:
                _note(left_open[count], row, kind - 1, first, last, line)
                count += 1
    return FINE, count


@njit(cache=True)
def _note(entry: IntArray, row: int, axis: int, first: int, last: int, line: int) -> None:
    entry[0], entry[1], entry[2], entry[3], entry[4] = row, axis, first, last, line


@njit(cache=True)
def _skip_list(data: Bytes, first: int, last: int, at: int, end: int, delimiter: int) -> int:
    """Step over as many fields as data[first:last] says; -1 if it is no length."""
    length, known = number(data, first, last)
    if not known or not (0 <= length <= end) or length != np.floor(length):
        return -1
    for _ in range(int(length)):
        first, last, at = _next_field(data, at, end, delimiter)
    return at


@njit(cache=True)
def _next_field(data: Bytes, at: int, end: int, delimiter: int) -> tuple[int, int, int]:
    """First and last byte of the next field and where to go on; first is -1 if there is none."""
    if at > end:
        return -1, -1, at
    first = _skip_blanks(data, at, end)
    if delimiter == BLANK:
        last = first
        while last < end and not _is_blank(data[last]):
            last += 1
        return (first if last > first else -1), last, last
    stop = at
    while stop < end and data[stop] != delimiter:
        stop += 1
    first = min(first, stop)
    last = stop
    while last > first and _is_blank(data[last - 1]):
        last -= 1
    return first, last, stop + 1


@njit(cache=True)
def _skip_blanks(data: Bytes, at: int, end: int) -> int:
    while at < end and _is_blank(data[at]):
        at += 1
    return at


@njit(cache=True)
def _is_blank(byte: int) -> bool:
    return byte in (BLANK, _TAB, _RETURN)


def fields(line: bytes, delimiter: int) -> list[bytes]:
    """Cut one line into fields as the kernel does; for headers and complaints."""
    if delimiter == BLANK:
        blanked = line.replace(b"\t", b" ").replace(b"\r", b" ")
        return [field for field in blanked.split(b" ") if field]
    return [field.strip(b" \t\r") for field in line.split(bytes([delimiter]))]
