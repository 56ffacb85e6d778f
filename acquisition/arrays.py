"""The array vocabulary of this package: the drivers', whose arrays it keeps."""

from __future__ import annotations

from drivers.arrays import FloatArray, IntArray, frozen

__all__ = ["FloatArray", "IntArray", "frozen"]
