"""JSON documents whose every complaint names the file and the field.

A `Field` is one value of a parsed document together with where it stands, so that a wrong value is
reported as ``surface.json: patches[0].knots_u: ...`` and not as a traceback from numpy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import NoReturn, TypeVar

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.exporting.atomic import replacing

T = TypeVar("T")


class Misplaced(ValueError):  # noqa: N818 (the house names errors after the fact)
    """A field with a wrong value; the message begins with the file and the field."""


@dataclass(frozen=True, slots=True)
class Field:
    """A value of a document, its file, and its path in there ("" is the whole document)."""

    value: object
    file: str
    path: str = ""

    @property
    def where(self) -> str:
        """File and path, for messages."""
        return f"{self.file}: {self.path}" if self.path else self.file

    def refuse(self, complaint: str) -> NoReturn:
        """Raise ValueError with `complaint` behind the file and the field."""
        raise Misplaced(f"{self.where}: {complaint}")

    def child(self, name: str) -> Field:
        """Return the member `name` of an object."""
        if not isinstance(self.value, dict):
            self.refuse("an object expected")
        inner = Field(self.value.get(name), self.file, f"{self.path}.{name}".lstrip("."))
        if name not in self.value:
            inner.refuse("missing")
        return inner

    def items(self) -> Iterator[Field]:
        """Yield each entry of a list."""
        if not isinstance(self.value, list):
            self.refuse("a list expected")
        for index, entry in enumerate(self.value):
            yield Field(entry, self.file, f"{self.path}[{index}]")

    def integer(self) -> int:
        """Return a whole number."""
        if not isinstance(self.value, int) or isinstance(self.value, bool):
            self.refuse("a whole number expected")
        return self.value

    def number(self) -> float:
        """Return a finite number."""
        return float(self.array(()))

    def flag(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            self.refuse("true or false expected")
        return self.value

    def array(self, shape: tuple[int | None, ...]) -> FloatArray:
        """Return nested lists of finite numbers as an array; None in `shape` takes any length."""
        try:
            array = np.asarray(self.value)
        except ValueError as ragged:
            raise Misplaced(f"{self.where}: the rows differ in length") from ragged
        if array.dtype.kind not in "iuf":
            self.refuse("numbers expected")
        if array.ndim != len(shape) or any(
            wanted not in (None, found) for wanted, found in zip(shape, array.shape, strict=True)
        ):
            wanted = " x ".join("n" if length is None else str(length) for length in shape)
            self.refuse(f"numbers in the shape ({wanted}) expected, got {array.shape}")
        if not np.all(np.isfinite(array)):
            self.refuse("every number must be finite")
        return array.astype(np.float64)


def write_document(path: Path | str, document: Mapping[str, object]) -> None:
    """Write `document` as JSON; floats in their shortest form that reads back to the same bits."""
    text = json.dumps(document, allow_nan=False, ensure_ascii=False)
    with replacing(path) as file:
        file.write(text.encode())
        file.write(b"\n")


def read_document(path: Path | str, *, format_name: str, version: int) -> Field:
    """Read a document of ours and check its format, version and unit.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        Not JSON, not this format, a later version, or another unit.
    """
    path = Path(path)
    try:
        value = json.loads(path.read_bytes(), parse_float=_finite, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as damaged:
        raise ValueError(f"{path}: not a JSON document: {damaged}") from damaged
    document = Field(value, str(path))
    for name, wanted in (("format", format_name), ("version", version), ("unit", "mm")):
        field = document.child(name)
        if field.value != wanted or isinstance(field.value, bool):
            field.refuse(f"{wanted!r} expected, got {field.value!r}")
    return document


def checked(field: Field, build: Callable[[], T]) -> T:
    """Return what `build` makes; report its ValueError at `field` unless it has a place already."""
    try:
        return build()
    except Misplaced:
        raise
    except ValueError as wrong:
        raise Misplaced(f"{field.where}: {wrong}") from wrong


def _finite(digits: str) -> float:
    number = float(digits)
    if not isfinite(number):
        raise ValueError(f"{digits} is beyond a 64-bit float")
    return number


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")
