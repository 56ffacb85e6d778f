"""Decimal text to the nearest float64, the same bits as Python's ``float``.

Three steps, each exact or silent (Clinger 1990, doi:10.1145/93542.93557, for the first):

1. up to 2**53 and a power of ten up to 22: one correctly rounded multiplication or division;
2. up to 19 digits: the product or quotient in double-double, about 2**-100 relative, accepted if
   the rounding to double is the same at both ends of the error band;
3. all the rest (more digits, huge exponents, words): left to the caller, who asks ``float``.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]

_POWERS: Final = np.array([float(10**power) for power in range(23)])  # all of them exact
_MOST: Final = 922_337_203_685_477_579  # ten times this and 9 more still is an int64
_EXACT: Final = 1 << 53
_LARGEST: Final = 9_200_000_000_000_000_000  # rounds to a double below 2**63
_BAND: Final = 2.0**-98
_SPLITTER: Final = 134_217_729.0  # 2**27 + 1
_PLUS: Final = ord("+")
_MINUS: Final = ord("-")
_POINT: Final = ord(".")
_ZERO: Final = ord("0")


@njit(cache=True)
def number(data: Bytes, first: int, last: int) -> tuple[float, bool]:
    """Return the value of data[first:last] and whether it is known; an empty field is NaN."""
    if first == last or _is_nan(data, first, last):
        return np.nan, True
    negative = data[first] == _MINUS
    at = first + 1 if negative or data[first] == _PLUS else first
    mantissa, whole_end = _digits(data, at, last, 0)
    at, count, power = whole_end, whole_end - at, 0
    if at < last and data[at] == _POINT:
        mantissa, fraction_end = _digits(data, at + 1, last, mantissa)
        power = at + 1 - fraction_end
        count -= power
        at = fraction_end
    if at < last and count > 0 and data[at] | 32 == ord("e"):
        shift, at = _exponent(data, at + 1, last)
        power += shift
    if at != last or count == 0 or mantissa < 0:
        return np.nan, False
    value, known = _scaled(mantissa, power)
    return (-value if negative else value), known


@njit(cache=True)
def _is_nan(data: Bytes, first: int, last: int) -> bool:
    # Organised clouds are full of it, so it may not be left to the slow path.
    at = first + 1 if data[first] == _MINUS or data[first] == _PLUS else first
    if last - at != 3:
        return False
    return bool(
        data[at] | 32 == ord("n")
        and data[at + 1] | 32 == ord("a")
        and data[at + 2] | 32 == ord("n")
    )


@njit(cache=True)
def _digits(data: Bytes, at: int, last: int, mantissa: int) -> tuple[int, int]:
    """Append digits to a mantissa; -1 when it no longer fits. Returns where they end."""
    while at < last:
        digit = int(data[at]) - _ZERO
        if digit < 0 or digit > 9:
            break
        mantissa = mantissa * 10 + digit if 0 <= mantissa <= _MOST else -1
        at += 1
    return mantissa, at


@njit(cache=True)
def _exponent(data: Bytes, at: int, last: int) -> tuple[int, int]:
    """Return the signed exponent and its end, -1 where there is none."""
    negative = at < last and data[at] == _MINUS
    if negative or (at < last and data[at] == _PLUS):
        at += 1
    value, end = _digits(data, at, last, 0)
    if end == at:
        return 0, -1
    if value < 0 or value > 9999:
        value = 9999
    return (-value if negative else value), end


@njit(cache=True)
def _scaled(mantissa: int, power: int) -> tuple[float, bool]:
    """Return mantissa times ten to the power, rounded once, and whether that is certain."""
    if mantissa == 0 or power == 0:
        return float(mantissa), True
    if power < -22 or power > 22 or mantissa > _LARGEST:
        return np.nan, False
    high = float(mantissa)
    scale = _POWERS[abs(power)]
    if mantissa <= _EXACT:
        return (high * scale if power > 0 else high / scale), True
    low = float(mantissa - np.int64(high))
    if power > 0:
        first = high * scale
        second = _product_error(high, scale, first) + low * scale
    else:
        first = high / scale
        product = first * scale
        second = ((high - product) - _product_error(first, scale, product) + low) / scale
    return _rounded(first, second)


@njit(cache=True)
def _rounded(first: float, second: float) -> tuple[float, bool]:
    total = first + second
    rest = second - (total - first)
    band = abs(total) * _BAND
    return total, total + (rest + band) == total and total + (rest - band) == total


@njit(cache=True)
def _product_error(a: float, b: float, product: float) -> float:
    """Return what rounding took from a * b, exactly (Dekker 1971, doi:10.1007/BF01397083)."""
    a_high = _SPLITTER * a - (_SPLITTER * a - a)
    b_high = _SPLITTER * b - (_SPLITTER * b - b)
    a_low, b_low = a - a_high, b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def slow_number(text: bytes) -> float:
    """Read a numeral that `number` leaves open, by Python itself.

    Raises
    ------
    ValueError
        If it is no number in a data file, as ``1_000`` is not.
    """
    if b"_" in text:
        raise ValueError("underscore in a number")
    word: Any = text.strip(b'"')
    return float(word)
