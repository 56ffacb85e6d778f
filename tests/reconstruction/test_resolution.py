"""The paper's resolution rule, and the floors under it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruction.resolution import choose_resolution
from reconstruction.thickness import Thickness


def cloud(*, width_mm: float, radius_mm: float) -> Thickness:
    return Thickness(sigma_mm=width_mm / 4.0, radius_mm=radius_mm, spacing_mm=0.1)


@pytest.mark.parametrize(
    ("radius_mm", "cell_mm"),
    [(5.0, 2.0), (19.999, 2.0), (20.0, 2.0), (20.001, 4.0), (50.0, 4.0), (math.inf, 4.0)],
)
def test_twice_the_width_serves_radii_above_ten_widths_and_the_width_below(
    radius_mm: float, cell_mm: float
) -> None:
    found = choose_resolution(
        cloud(width_mm=2.0, radius_mm=radius_mm), sampling_mm=0.1, size_mm=100.0
    )
    assert (found.cell_mm, found.rule_mm) == (cell_mm, cell_mm)
    assert found.reason == ("twice the width" if cell_mm > 2.0 else "the width")


def test_no_cell_is_finer_than_one_and_a_half_sampling_distances() -> None:
    found = choose_resolution(cloud(width_mm=0.1, radius_mm=50.0), sampling_mm=2.0, size_mm=100.0)
    assert (found.cell_mm, found.rule_mm) == (3.0, 0.2)
    assert "sampling" in found.reason


def test_no_cell_is_so_coarse_that_fewer_than_twelve_go_around() -> None:
    # The outline of a slice is about three times its larger side.
    found = choose_resolution(cloud(width_mm=2.0, radius_mm=50.0), sampling_mm=0.1, size_mm=8.0)
    assert (found.cell_mm, found.rule_mm) == (2.0, 4.0)
    assert "small" in found.reason


def test_the_operators_resolution_overrules_all_and_the_rule_is_still_told() -> None:
    found = choose_resolution(
        cloud(width_mm=2.0, radius_mm=50.0), sampling_mm=9.0, size_mm=8.0, given_mm=0.8
    )
    assert (found.cell_mm, found.rule_mm, found.reason) == (0.8, 4.0, "given")


lengths = st.floats(1e-3, 1e3)


@given(lengths, lengths, lengths, lengths)
def test_the_cell_stays_between_its_floor_and_its_ceiling(
    width_mm: float, radius_mm: float, sampling_mm: float, size_mm: float
) -> None:
    found = choose_resolution(
        cloud(width_mm=width_mm, radius_mm=radius_mm), sampling_mm=sampling_mm, size_mm=size_mm
    )
    assert found.cell_mm <= size_mm / 4.0 * (1.0 + 1e-12)
    assert found.cell_mm >= min(1.5 * sampling_mm, size_mm / 4.0) * (1.0 - 1e-12)
