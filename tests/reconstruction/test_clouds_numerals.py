"""Numerals: the kernel says what Python says, or says that it does not know."""

import math
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from reconstruction.clouds.numerals import number, slow_number


def kernel_number(text: str) -> tuple[float, bool]:
    data = np.frombuffer(b"<" + text.encode() + b">", np.uint8)
    return number(data, 1, len(data) - 1)


def same_bits(a: float, b: float) -> bool:
    return struct.pack("d", a) == struct.pack("d", b)


decimals = st.builds(
    lambda sign, whole, fraction, exponent: f"{sign}{whole}{fraction}{exponent}",
    st.sampled_from(["", "-", "+"]),
    st.integers(0, 10**19).map(str),
    st.one_of(st.just(""), st.just("."), st.integers(0, 10**12).map(lambda d: f".{d}")),
    st.one_of(st.just(""), st.integers(-40, 40).map(lambda p: f"e{p}")),
)


@given(st.one_of(decimals, st.floats(allow_nan=False, allow_infinity=False).map(repr)))
@example("9007199254740993")  # 2**53 + 1: a tie, to even
@example("9007199254740993e1")
@example("9223372036854775807")  # the largest int64
@example("92233720368547757999")
@example("8.5e-22")
@example("1e23")  # the nearest double to a power that is none
@example("-0.0")
@example("4.9406564584124654e-324")
@example("0e99999999999999999999")
@settings(max_examples=800, deadline=None)
def test_a_number_that_the_kernel_knows_is_pythons_to_the_last_bit(text: str) -> None:
    value, known = kernel_number(text)
    assert not known or same_bits(value, float(text))


def test_a_number_halfway_between_two_doubles_is_never_guessed_wrong() -> None:
    rng = np.random.default_rng(5)
    known_ones = 0
    for mantissa in rng.integers(2**52, 2**53, 3000).tolist():
        for power in (0, 3, 11):
            tie = str((2 * mantissa + 1) << power)  # exactly between two doubles
            for text in (tie, f"{tie[:-2]}.{tie[-2:]}", f"{int(tie) + 1}e-3", f"{int(tie) - 1}e2"):
                value, known = kernel_number(text)
                assert not known or same_bits(value, float(text)), text
                known_ones += known
        half = f"{mantissa}.5"  # a tie again, by division this time
        value, known = kernel_number(half)
        assert not known or same_bits(value, float(half)), half
    assert known_ones > 10_000


def test_the_kernel_knows_almost_all_numbers_that_programs_write() -> None:
    values = np.random.default_rng(1).normal(0, 100, 2000).tolist()
    for form in ("{:.6f}", "{:.9g}", "{!r}"):
        assert all(kernel_number(form.format(value))[1] for value in values), form
    assert sum(kernel_number(f"{value:.18e}")[1] for value in values) > 1700


@pytest.mark.parametrize(
    "text",
    ["1_000", "1.2.3", "--1", "+", "-", ".", "e5", "1e", "1e+", "0x10", "1,5", "1d5", "abc", "1 2"],
)
def test_what_is_no_number_is_left_open_and_then_refused(text: str) -> None:
    assert not kernel_number(text)[1]
    with pytest.raises(ValueError, match=r"underscore|convert"):
        slow_number(text.encode())


@pytest.mark.parametrize("text", ["nan", "NaN", "-nan", "+NAN", ""])
def test_nan_and_an_empty_field_are_known_to_be_nan(text: str) -> None:
    value, known = kernel_number(text)
    assert known
    assert math.isnan(value)


@pytest.mark.parametrize("text", ["inf", "-Infinity", "1e999", '"2.5"', "0.1" + 30 * "0"])
def test_rare_numerals_are_read_by_python(text: str) -> None:
    assert not kernel_number(text)[1]
    assert slow_number(text.encode()) == float(text.strip('"'))
