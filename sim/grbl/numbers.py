"""Numbers as the firmware reads, keeps and prints them: eight digits, single precision.

A float of 32 bits tells a thousandth of a degree apart up to about 45 turns; what a host sees go
wrong beyond them must go wrong here.
"""

from __future__ import annotations

import math

import numpy as np

from sim.grbl.refusal import Error, Refusal

_DIGITS = 8  # those after them are dropped
_MOST = 2**31 - 1  # a count of steps has 32 bits
MM_PER_INCH = 25.4


def single(value: float) -> float:
    """The nearest number of single precision."""
    return float(np.float32(value))


def degrees_of(steps: int, steps_per_deg: float) -> float:
    """What the firmware calls mm, and what are degrees of a table."""
    return float(np.float32(steps) / np.float32(steps_per_deg))


def steps_of(degrees: float, steps_per_deg: float) -> int:
    """Whole steps, halves away from zero."""
    steps = float(np.float32(degrees) * np.float32(steps_per_deg))
    return int(math.copysign(min(math.floor(abs(steps) + 0.5), _MOST), steps))


def read_number(text: str, start: int) -> tuple[float, int]:
    """Read a number without an exponent at `start`; return it and where it ends."""
    at = start + (text[start : start + 1] in ("+", "-"))
    whole, at = _digits(text, at)
    fraction = ""
    if text[at : at + 1] == ".":
        fraction, at = _digits(text, at + 1)
    if not whole + fraction:
        raise Refusal(Error.BAD_NUMBER)
    kept = (whole + fraction)[:_DIGITS]
    exponent = len(whole) - len(kept)
    value = single(min(int(kept) * 10.0**exponent, _MOST))
    return (-value if text[start] == "-" else value), at


def _digits(text: str, start: int) -> tuple[str, int]:
    at = start
    while at < len(text) and text[at] in "0123456789":
        at += 1
    return text[start:at], at


def printed(value: float, decimals: int) -> str:
    """The firmware's decimals: halves go away from zero, and -0.0004 is -0.000."""
    scaled = np.float32(abs(value))
    for factor in (100,) * (decimals // 2) + (10,) * (decimals % 2):
        scaled *= np.float32(factor)  # rounds each time, as there
    digits = str(int(scaled + np.float32(0.5))).rjust(decimals + 1, "0")
    point = len(digits) - decimals
    text = f"{digits[:point]}.{digits[point:]}" if decimals else digits
    return f"-{text}" if value < 0.0 else text
