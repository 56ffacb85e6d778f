"""Points out of binary records of one fixed size, whatever else the records hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray
from reconstruction.clouds.source import AGAIN, Damaged, grouped, truncated

_BLOCK_BYTES: Final = 1 << 20  # stays in the cache between reading and converting
_LARGEST_RECORD: Final = 1 << 20


def record_layout(types: Sequence[str], offsets: Sequence[int], size: int) -> np.dtype[np.void]:
    """Lay out a record of `size` bytes that has x, y, z of `types` at `offsets`."""
    return np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": list(types),
            "offsets": list(offsets),
            "itemsize": size,
        }
    )


def check_record(size: int) -> None:
    """Refuse a header that describes points of more than 1 MB each.

    Raises
    ------
    Damaged
        If it does.
    """
    if size > _LARGEST_RECORD:
        raise Damaged(f"its header describes points of {grouped(size)} bytes each; {AGAIN}")


def check_room(count: int, record_bytes: int, bytes_there: int) -> None:
    """Compare what a header promises with the size of what follows it.

    Raises
    ------
    Damaged
        If the records cannot all be there.
    """
    if count * record_bytes > bytes_there:
        raise truncated(count, max(bytes_there, 0) // record_bytes)


def record_rows(
    file: BinaryIO, layout: np.dtype[np.void], count: int, points: int
) -> Iterator[FloatArray]:
    """Read `count` records from where `file` stands, as arrays (k, 3) with k <= points."""
    block = np.empty(max(1, _BLOCK_BYTES // layout.itemsize), dtype=layout)
    for start in range(0, count, points):
        rows = np.empty((min(points, count - start), 3))
        for first in range(0, len(rows), len(block)):
            part = rows[first : first + len(block)]
            records = block[: len(part)]
            there = file.readinto(records.view(np.uint8))  # type: ignore[attr-defined]
            if there < records.nbytes:
                raise truncated(count, start + first + there // layout.itemsize)
            unpack(records, part)
        yield rows


def unpack(records: NDArray[np.void], rows: FloatArray) -> None:
    """Write x, y, z of records (k,) into rows (k, 3)."""
    # A float128 may overflow, a signalling NaN complain: both are invalid points, and counted.
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            rows[:, axis] = records[name]
