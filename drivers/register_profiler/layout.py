"""Where a profile stands in a device's registers, and the profile of the words that were read.

A column has its place by its number, and its value is z::

    registers   first   first + 1   ...          x = first_column_mm + column * column_pitch_mm
    columns       0         1       ...          z = value * z_mm_per_count + z_offset_mm

A value fills one register, two of them in either order, or is one bit of sixteen in a register, the
lowest first: then a set bit is a point at z = z_offset_mm and a clear one is none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from drivers.profiler import Profile, Reason

LAST_REGISTER = 0xFFFF
_MOST_COLUMNS = 0x10000
_BITS = 16


class Table(Enum):
    """Which registers, by the function that reads them."""

    HOLDING = 3
    INPUT = 4


class Packing(Enum):
    """How a value stands in registers."""

    WORD = "one register"
    TWO_WORDS = "two registers"
    BITS = "one bit, sixteen in a register"


class WordOrder(Enum):
    """Which of two registers has the high word."""

    HIGH_FIRST = "high first"
    LOW_FIRST = "low first"


@dataclass(frozen=True, slots=True)
class Flag:
    """A bit of a register, in the table of the columns."""

    register: int
    bit: int

    def __post_init__(self) -> None:
        _must_be_in("ready_register", self.register, 0, LAST_REGISTER)
        _must_be_in("ready_bit", self.bit, 0, _BITS - 1)


@dataclass(frozen=True, slots=True)
class Trigger:
    """A holding register, and what is written to it for one profile (function 6)."""

    register: int
    value: int = 1

    def __post_init__(self) -> None:
        _must_be_in("trigger_register", self.register, 0, LAST_REGISTER)
        _must_be_in("trigger_value", self.value, 0, 0xFFFF)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Everything that must be known of a device to read its profiles.

    Raises
    ------
    ValueError
        One line: what cannot be, and what to write instead.
    """

    table: Table = Table.INPUT
    first_register: int
    columns: int
    packing: Packing = Packing.WORD
    word_order: WordOrder = WordOrder.HIGH_FIRST
    signed: bool = False
    z_mm_per_count: float
    z_offset_mm: float = 0.0
    column_pitch_mm: float
    first_column_mm: float = 0.0
    missing: tuple[tuple[int, Reason], ...] = ()  # values that stand for no measurement, and why
    sequence_register: int | None = None  # counts profiles, in the table of the columns
    ready: Flag | None = None
    trigger: Trigger | None = None

    def __post_init__(self) -> None:
        _must_be_in("columns", self.columns, 1, _MOST_COLUMNS)
        _must_be_in("first_register", self.first_register, 0, LAST_REGISTER)
        last = self.first_register + self.words - 1
        if last > LAST_REGISTER:
            raise ValueError(
                f"first_register: {self.columns} columns from {self.first_register} on end at"
                f" {last}; the last register is {LAST_REGISTER}"
            )
        for name in ("z_mm_per_count", "column_pitch_mm"):
            _must_be_scale(name, getattr(self, name))
        for name in ("z_offset_mm", "first_column_mm"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)}; write a finite number")
        self._must_tell_reasons_apart()
        self._must_have_signs_of_their_own()

    def _must_tell_reasons_apart(self) -> None:
        first: dict[int, Reason] = {}
        for value, reason in self.missing:
            name = f"{reason.name.lower()}_value"
            _must_be_in(name, value, *self.range)
            if (other := first.setdefault(value, reason)) is not reason:
                raise ValueError(f"{name}: {value} stands for {other.name.lower()}_value, too")

    def _must_have_signs_of_their_own(self) -> None:
        signs = {"sequence_register": self.sequence_register}
        if self.ready is not None:
            signs["ready_register"] = self.ready.register
        for name, register in signs.items():
            if register is not None:
                _must_be_in(name, register, 0, LAST_REGISTER)
                if register in self.registers:
                    raise ValueError(f"{name}: {register} holds a column")

    @property
    def words(self) -> int:
        """Registers that the columns fill."""
        if self.packing is Packing.BITS:
            return -(-self.columns // _BITS)
        return self.columns * (2 if self.packing is Packing.TWO_WORDS else 1)

    @property
    def registers(self) -> range:
        """The columns' registers."""
        return range(self.first_register, self.first_register + self.words)

    @property
    def range(self) -> tuple[int, int]:
        """The least and the largest value."""
        bits = {Packing.WORD: 16, Packing.TWO_WORDS: 32, Packing.BITS: 1}[self.packing]
        if self.signed and self.packing is not Packing.BITS:
            return -(1 << bits - 1), (1 << bits - 1) - 1
        return 0, (1 << bits) - 1


def decoded(words: Sequence[int], layout: Layout, *, frame: int) -> Profile:
    """Return the profile of all the columns' registers.

    Parameters
    ----------
    words : of `layout.words` registers, 0 to 65535
    frame : what the profile is numbered; the device has no clock that is read
    """
    values = _values(np.asarray(words, dtype=np.int64), layout)
    counts = np.zeros((layout.columns, 2), dtype=np.int32)
    counts[:, 0] = np.arange(layout.columns)
    reasons = np.full(layout.columns, Reason.MEASURED, dtype=np.uint8)
    # A count is an int32: what does not fit cannot be told, and is told to be missing.
    reasons[values > np.iinfo(np.int32).max] = Reason.UNKNOWN
    for value, reason in layout.missing:
        reasons[values == value] = reason
    measured = reasons == Reason.MEASURED
    if layout.packing is Packing.BITS:
        reasons[values == 0] = Reason.NO_RETURN
    else:
        counts[measured, 1] = values[measured]
    return Profile(
        counts=counts,
        scale_mm=(layout.column_pitch_mm, layout.z_mm_per_count),
        offset_mm=(layout.first_column_mm, layout.z_offset_mm),
        reasons=reasons,
        intensity=np.empty(0, dtype=np.uint16),
        sensor_time_s=0.0,
        encoder=0,
        frame=frame,
    )


def _values(words: NDArray[np.int64], layout: Layout) -> NDArray[np.int64]:
    """One value a column, (columns,)."""
    if layout.packing is Packing.BITS:
        bits = words[:, None] >> np.arange(_BITS) & 1
        return np.asarray(bits.reshape(-1)[: layout.columns])
    size = 16
    if layout.packing is Packing.TWO_WORDS:
        pairs = words.reshape(-1, 2)
        high = 0 if layout.word_order is WordOrder.HIGH_FIRST else 1
        words, size = pairs[:, high] << 16 | pairs[:, 1 - high], 32
    if layout.signed:
        words = np.where(words >= 1 << size - 1, words - (1 << size), words)
    return words


def _must_be_in(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name}: {value}; write a whole number from {low} to {high}")


def _must_be_scale(name: str, value: float) -> None:
    if not math.isfinite(value) or value == 0.0:
        raise ValueError(f"{name} = {value}; it must be finite and not 0")
