"""Signed 32-bit numbers in two registers of 16 bits, the high word first."""

from __future__ import annotations

from typing import Final

_WORD: Final = 0x10000


def words_of(value: int) -> tuple[int, int]:
    """Split a signed 32-bit number into its high and low word; ValueError if it is wider."""
    if not -(1 << 31) <= value < 1 << 31:
        raise ValueError(f"{value} does not fit into 32 bits")
    return (value >> 16) % _WORD, value % _WORD


def value_of(high: int, low: int) -> int:
    """Join the high and low word of a signed 32-bit number."""
    value = high << 16 | low
    return value - (1 << 32) if high & 0x8000 else value
