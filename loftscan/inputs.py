"""What a person names as input: a cloud in millimetres that can be passed over again."""

from __future__ import annotations

import hashlib
import math
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.clouds import Cloud, array_cloud, open_cloud
from reconstruction.reduction import Box

_IN_MEMORY = 4_000_000  # points, 96 MB
_TYPICAL_MM = 100.0
_IMPLAUSIBLE_MM = (0.1, 5_000.0)  # a part on a lab station is neither dust nor a car


class Unit(Enum):
    """Length of one unit of a cloud file, by the name that a person types."""

    MM = "mm"
    CM = "cm"
    M = "m"
    UM = "um"
    INCH = "inch"

    @property
    def in_mm(self) -> float:
        """Millimetres in one unit."""
        return {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}[self.value]


@dataclass(slots=True)
class Input:
    """A cloud in millimetres and where it came from; a context, because it may hold a file.

    The first pass parses the file; small clouds are then held in memory and large text files in a
    temporary binary one, so that no number is parsed twice. Large binary files are read anew.
    """

    cloud: Cloud
    unit: Unit
    points: int = 0  # finite points, known after the first pass
    invalid: int = 0  # rows with a NaN or an infinity
    _held: Cloud | None = None
    _stack: ExitStack = field(default_factory=ExitStack)

    @property
    def name(self) -> str:
        """What the input is called in reports."""
        return self.cloud.path.name if self.cloud.path else "array"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def chunks(self) -> Iterator[FloatArray]:
        """Pass over the points once, (k, 3) at a time, in mm."""
        if self._held is None and self._is_quick_to_read():
            yield from self._read()
            return
        if self._held is None:
            self._hold()
        assert self._held is not None
        for chunk in self._held.chunks():
            yield chunk.points

    def _is_quick_to_read(self) -> bool:
        """Whether the cloud itself is as good as a copy: an array, or a large binary file."""
        large = (self.cloud.point_count or 0) > _IN_MEMORY
        return self.cloud.path is None or (large and not _is_text(self.cloud))

    def _read(self) -> Iterator[FloatArray]:
        """Pass over the cloud in mm; the counts are those of the latest whole pass."""
        points = invalid = 0
        for chunk in self.cloud.chunks():
            points += len(chunk.points)
            invalid += chunk.skipped
            yield chunk.points * self.unit.in_mm
        self.points, self.invalid = points, invalid

    def _hold(self) -> None:
        """Read the cloud once and keep it: in memory, or from 4 million points on in a file."""
        kept: list[FloatArray] = []
        held = 0
        spill: Path | None = None
        for chunk in self._read():
            kept.append(chunk)
            held += len(chunk)
            if held > _IN_MEMORY:
                spill = spill or self._temporary()
                _append(spill, kept)
                kept.clear()
        if spill is None:
            self._held = array_cloud(_read_only(np.concatenate(kept)))
        else:
            self._held = _reopen(spill, self.points)

    def _temporary(self) -> Path:
        folder = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="loftscan-"))
        return Path(folder) / "points.npy"


def open_input(source: Path | str | ArrayLike, unit: Unit) -> Input:
    """Open a cloud file by its path, or wrap an (n, 3) array.

    Raises
    ------
    UnreadableCloud
        For a file that cannot be one.
    ValueError
        For an array of another shape.
    """
    if isinstance(source, (str, Path)):
        return Input(open_cloud(source), unit)
    return Input(array_cloud(source), unit)


def _is_text(cloud: Cloud) -> bool:
    return cloud.format in {"xyz", "pts", "txt", "csv"} or "ascii" in cloud.format


_HEADER = 128


def _append(path: Path, chunks: list[FloatArray]) -> None:
    if not path.exists():
        path.write_bytes(b" " * _HEADER)
    with path.open("ab") as file:
        for chunk in chunks:
            file.write(np.ascontiguousarray(chunk).data)


def _reopen(path: Path, points: int) -> Cloud:
    """Give the file its .npy header, now that the count is known."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({points}, 3), }}"
    head = b"\x93NUMPY\x01\x00" + (_HEADER - 10).to_bytes(2, "little")
    with path.open("r+b") as file:
        file.write(head + text.ljust(_HEADER - 11).encode("ascii") + b"\n")
    return open_cloud(path)


def _read_only(array: FloatArray) -> FloatArray:
    array.flags.writeable = False
    return array


def judge_size(box: Box, unit: Unit) -> str | None:
    """A sentence on a part of implausible size, None for a plausible one."""
    widest = float(box.sides_mm.max())
    low, high = _IMPLAUSIBLE_MM
    if low <= widest <= high:
        return None
    sizes = {each: widest / unit.in_mm * each.in_mm for each in Unit}
    guess = min(sizes, key=lambda each: abs(math.log(sizes[each] / _TYPICAL_MM)))
    return (
        f"the part is {_readable(widest)} wide in --unit {unit.value}, is that right? "
        f"With --unit {guess.value} it would be {_readable(sizes[guess])}"
    )


def _readable(length_mm: float) -> str:
    if length_mm >= 1000.0:
        return f"{length_mm / 1000.0:.3g} m"
    return f"{length_mm:.3g} mm" if length_mm >= 0.1 else f"{length_mm * 1000.0:.3g} µm"


def parse_crop(text: str) -> Box:
    """Read ``xmin,xmax,ymin,ymax,zmin,zmax`` in mm; an empty place means no limit.

    Raises
    ------
    ValueError
        For anything else, naming what was expected.
    """
    parts = text.split(",")
    if len(parts) != 6:
        raise ValueError(f"--crop {text!r}: six numbers xmin,xmax,ymin,ymax,zmin,zmax expected")
    try:
        values = [float(part) if part.strip() else math.nan for part in parts]
    except ValueError as error:
        raise ValueError(f"--crop {text!r}: {error}; leave a place empty for no limit") from error
    if any(
        part.strip() and not math.isfinite(value) for part, value in zip(parts, values, strict=True)
    ):
        raise ValueError(
            f"--crop {text!r}: finite numbers expected; leave a place empty for no limit"
        )
    low, high = np.array(values[0::2]), np.array(values[1::2])
    low, high = np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)
    if (low >= high).any():
        raise ValueError(f"--crop {text!r}: every minimum must be below its maximum")
    return Box(low, high)


def hash_file(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def parse_place(text: str) -> tuple[float, float]:
    """Read --axis-at X,Y.

    Raises
    ------
    ValueError
    """
    try:
        first, second = (float(word) for word in text.split(","))
    except ValueError as wrong:
        raise ValueError(f"--axis-at {text!r}: two numbers in mm expected, as 0,0") from wrong
    if not (math.isfinite(first) and math.isfinite(second)):
        raise ValueError(f"--axis-at {text!r}: finite numbers in mm expected")
    return first, second
