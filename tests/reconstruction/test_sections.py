"""Residuals are sums that add up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.sections import measure_residual

distances = st.lists(st.floats(-50.0, 50.0), max_size=60).map(
    lambda row: np.array(row, dtype=float)
)


@given(distances)
@settings(deadline=None)  # the first of them compiles the kernel
def test_a_residual_says_what_numpy_says(some: np.ndarray) -> None:
    found = measure_residual(some, range_mm=5.0)
    assert found.count == found.bins.sum() == len(some)
    if len(some):
        assert found.rms_mm == pytest.approx(np.sqrt(np.mean(some**2)), abs=1e-12)
        assert found.mean_mm == pytest.approx(np.mean(some), abs=1e-12)
        assert found.max_mm == np.abs(some).max()


@given(distances, distances)
@settings(deadline=None)
def test_two_residuals_add_up_to_that_of_all_points(one: np.ndarray, other: np.ndarray) -> None:
    both = measure_residual(one, range_mm=5.0).plus(measure_residual(other, range_mm=5.0))
    whole = measure_residual(np.concatenate([one, other]), range_mm=5.0)
    assert (both.count, both.max_mm) == (whole.count, whole.max_mm)
    assert both.total_mm == pytest.approx(whole.total_mm, abs=1e-9)
    assert both.squares_mm2 == pytest.approx(whole.squares_mm2, abs=1e-9)
    np.testing.assert_array_equal(both.bins, whole.bins)


def test_the_outer_bins_hold_everything_beyond_and_the_middle_one_the_zero() -> None:
    found = measure_residual(np.array([-99.0, -5.0, 0.0, 5.0, 99.0]), range_mm=5.0)
    middle = np.searchsorted(found.edges_mm, 0.0, side="right") - 1
    assert (found.bins[0], found.bins[middle], found.bins[-1]) == (2, 1, 2)
    assert found.max_mm == 99.0
    assert (found.edges_mm[0], found.edges_mm[-1]) == (-5.0, 5.0)


def test_no_points_have_no_mean() -> None:
    nothing = measure_residual(np.empty(0), range_mm=5.0)
    assert math.isnan(nothing.rms_mm)
    assert math.isnan(nothing.mean_mm)
    assert nothing.max_mm == 0.0


def test_different_bins_do_not_add_up() -> None:
    with pytest.raises(ValueError, match="do not add up"):
        measure_residual(np.ones(3), range_mm=5.0).plus(measure_residual(np.ones(3), range_mm=4.0))


def test_bins_are_those_of_numpy_at_their_very_edges_too() -> None:
    edges = np.linspace(-5.0, 5.0, 2002)
    beside = np.concatenate([edges, np.nextafter(edges, 9.0), np.nextafter(edges, -9.0)])
    found = measure_residual(beside, range_mm=5.0)
    expected, _ = np.histogram(np.clip(beside, -5.0, 5.0), bins=edges)
    np.testing.assert_array_equal(found.bins, expected)
