"""A slice out of a damaged file, if every column of it is proven by its own CRC-32. Pure.

A slice file says what it holds twice: before each column (a local header: name, size, CRC) and in
the directory at its end. Damage to one of the two, to the checksum, or a cut-off end leaves the
columns as they were::

    [header x.npy column][header x.npy column] ... [directory][end][sha256]
       found by walking from the start, or by the directory

Nothing is guessed: a column whose CRC is wrong is not used, and a slice needs them all.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from io import BytesIO

from acquisition.poses import Sweep
from acquisition.sweep_codec import BROKEN, COLUMNS, TIMING_COLUMNS, column_of, sweep_of

_LOCAL = struct.Struct("<4s5H3L2H")
_LOCAL_SIGNATURE = b"PK\x03\x04"


def salvaged(data: bytes) -> Sweep | None:
    """The sweep of a damaged slice file; None when a column is not proven."""
    found = dict(_by_directory(data))
    found.update(_by_walking(data))
    turned = set(found) > set(COLUMNS)
    names = (*COLUMNS, *TIMING_COLUMNS) if turned else COLUMNS
    if set(found) != set(names):
        return None
    try:
        return sweep_of({name: column_of(found[name]) for name in names})
    except (*BROKEN, ValueError):
        return None


def _by_walking(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Columns as the headers before them tell, from the start until one makes no sense."""
    place = 0
    for name in (*COLUMNS, *TIMING_COLUMNS):
        if len(data) < place + _LOCAL.size:
            return
        signature, _, _, _, _, _, crc, _, size, name_length, extra = _LOCAL.unpack_from(data, place)
        start = place + _LOCAL.size + name_length + extra
        column = data[start : start + size]
        if signature != _LOCAL_SIGNATURE or zlib.crc32(column) != crc or not size:
            return
        if data[place + _LOCAL.size : start] == f"{name}.npy".encode():
            yield name, column
        place = start + size


def _by_directory(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Columns as the directory at the end tells; what is before them is not looked at."""
    try:
        with zipfile.ZipFile(BytesIO(data)) as archive:
            members = archive.infolist()
    except (*BROKEN, ValueError):
        return
    for member in members:
        name = member.filename.removesuffix(".npy")
        start = member.header_offset + _LOCAL.size + len(member.filename)
        column = data[start : start + member.file_size]
        if name in (*COLUMNS, *TIMING_COLUMNS) and column and zlib.crc32(column) == member.CRC:
            yield name, column
