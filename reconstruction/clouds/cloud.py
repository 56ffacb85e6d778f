"""A cloud of points, and the door from a path or an array to one.

A cloud is opened once (its header is read and checked) and passed over as often as a stage needs:
every pass reads the file anew, chunk by chunk, so that memory is bounded by the chunk and not by
the file. Coordinates are in the file's own unit; the caller knows it, most formats do not.
"""

from __future__ import annotations

import math
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, frozen
from reconstruction.clouds.npy import open_npy
from reconstruction.clouds.pcd import open_pcd
from reconstruction.clouds.ply import open_ply
from reconstruction.clouds.source import Damaged, Source, grouped
from reconstruction.clouds.text import open_csv, open_text
from reconstruction.errors import UnreadableCloud

_OPENERS: Final[dict[str, Callable[[Path], Source]]] = {
    ".ply": open_ply,
    ".pcd": open_pcd,
    ".xyz": open_text,
    ".pts": open_text,
    ".txt": open_text,
    ".csv": open_csv,
    ".npy": open_npy,
}
EXTENSIONS: Final = tuple(_OPENERS)


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Consecutive points of a cloud, and how many invalid ones stood among them."""

    points: FloatArray  # (k, 3), k >= 1, finite, in the file's unit
    skipped: int  # rows with a NaN or an infinity, left out

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points))


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points that are read when they are asked for.

    `path` is None for a cloud in memory.
    """

    path: Path | None
    source: Source

    @property
    def format(self) -> str:
        """The format, such as ``pcd binary_compressed``, ``csv`` or ``array``."""
        return self.source.format

    @property
    def point_count(self) -> int | None:
        """Rows that the header promises, invalid ones included; None where it does not say."""
        return self.source.point_count

    def chunks(self, points: int = 1 << 20) -> Iterator[Chunk]:
        """Pass over all points once; may be called again.

        Parameters
        ----------
        points
            The most points of one chunk. No chunk is empty.

        Raises
        ------
        UnreadableCloud
            While iterating: where the file is damaged, and at the end if no point was finite.
        """
        if points < 1:
            raise ValueError(f"chunks of {points} points: at least 1 expected")
        return _finite_chunks(self, points)


def open_cloud(path: Path | str) -> Cloud:
    """Open a point cloud file, chosen by its extension (`EXTENSIONS`).

    Raises
    ------
    UnreadableCloud
        Missing, no file, not permitted, empty, of an unknown format, or with a wrong header.
    """
    path = Path(path)
    with _blaming(path):
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise Damaged("is a folder; name the cloud file in it")
        if not stat.S_ISREG(status.st_mode):
            raise Damaged("is no regular file; it is read several times, so save it to disk first")
        opener = _OPENERS.get(path.suffix.lower())
        if opener is None:
            raise Damaged(
                f"unknown extension {path.suffix!r}; convert it to one of {' '.join(EXTENSIONS)}"
            )
        if status.st_size == 0:
            raise Damaged("the file is empty; copy or export it again")
        return Cloud(path, opener(path))


def array_cloud(points_mm: ArrayLike) -> Cloud:
    """Wrap points in memory, (n, 3) of any real type, as a cloud.

    A read-only float64 array is shared, any other is copied.

    Raises
    ------
    ValueError
        For another shape, or values that are not real numbers.
    """
    array = np.asarray(points_mm)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points_mm: shape (n, 3) expected, got {array.shape}")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"points_mm: real numbers expected, got {array.dtype}")
    with np.errstate(over="ignore", invalid="ignore"):
        return Cloud(None, _Held(frozen(array)))


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """The source of a cloud that is an array."""

    points: FloatArray

    @property
    def format(self) -> str:
        return "array"

    @property
    def point_count(self) -> int:
        return len(self.points)

    def rows(self, points: int) -> Iterator[FloatArray]:
        for start in range(0, len(self.points), points):
            yield self.points[start : start + points]


def _finite_chunks(cloud: Cloud, points: int) -> Iterator[Chunk]:
    # One chunk is held back: invalid rows after it have no chunk of their own to be counted in.
    held: Chunk | None = None
    skipped = 0
    with _blaming(cloud.path):
        for rows in cloud.source.rows(points):
            finite = _finite(rows)
            skipped += len(rows) - len(finite)
            if len(finite):
                if held is not None:
                    yield held
                held, skipped = Chunk(finite, skipped), 0
        if held is None:
            raise _nothing_finite(skipped)
        yield replace(held, skipped=held.skipped + skipped)


def _finite(rows: FloatArray) -> FloatArray:
    """Drop rows that are not finite, and close the array for writing."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(rows.sum())
    if not math.isfinite(total):  # an invalid row, or a harmless overflow of the sum
        rows = rows[np.isfinite(rows).all(axis=1)]
    rows.flags.writeable = False
    return rows


def _nothing_finite(skipped: int) -> Damaged:
    if skipped == 0:
        return Damaged("holds no points; scan or export it again")
    return Damaged(
        f"none of its {grouped(skipped)} points is finite, all have NaN or infinite coordinates; "
        "export it again with the valid points"
    )


@contextmanager
def _blaming(path: Path | None) -> Iterator[None]:
    """Turn what can go wrong with a file into one line that names it."""
    name = "the array" if path is None else str(path)
    try:
        yield
    except Damaged as damage:
        raise UnreadableCloud(f"{name}: {damage}") from damage
    except FileNotFoundError as lost:
        raise UnreadableCloud(f"{name}: there is no such file; check the path") from lost
    except PermissionError as denied:
        raise UnreadableCloud(
            f"{name}: no permission to read it; ask its owner, or chmod +r"
        ) from denied
    except OSError as failure:
        raise UnreadableCloud(
            f"{name}: {failure.strerror or failure}; check the path and the disk"
        ) from failure
