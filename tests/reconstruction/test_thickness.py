"""Thickness and curvature against numpy's polyfit, and against bands of known noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.thickness import Thickness, _fit_growing, _fit_parabola, estimate_thickness

WINDOWS = (8, 12, 16, 24, 32)


def naive_parabola(hood: FloatArray) -> tuple[float, float, float]:
    """Principal axes by eigenvectors, the parabola by polyfit."""
    centred = hood - hood.mean(axis=0)
    variances, axes = np.linalg.eigh(centred.T @ centred / len(hood))
    along, across = centred @ axes[:, 1], centred @ axes[:, 0]
    parabola = np.polyfit(along, across, 2)
    left = float(((across - np.polyval(parabola, along)) ** 2).sum())
    freedom = len(hood) - 3
    median = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3  # of chi squared, Wilson and Hilferty
    return math.sqrt(left / median), 2.0 * abs(parabola[0]), max(0.0, variances[0]) / variances[1]


def naive_growing(hood: FloatArray) -> tuple[float, float]:
    """Sigma of the first flat window in a row of flat ones, curvature of the last."""
    fits = [naive_parabola(hood[:window]) for window in WINDOWS]
    flat = [fit[2] < 0.05 for fit in fits]
    if not any(flat):
        return fits[-1][0], fits[-1][1]
    first = flat.index(True)
    last = first
    while last + 1 < len(flat) and flat[last + 1]:
        last += 1
    return fits[first][0], fits[last][1]


def hoods(rng: np.random.Generator, count: int, points: int) -> FloatArray:
    """Neighbourhoods on arcs of random bend, noise, size, tilt and place, nearest first."""
    made = []
    for _ in range(count):
        along = rng.uniform(-1.0, 1.0, points)
        along = along[np.argsort(np.abs(along))]
        across = rng.uniform(-0.8, 0.8) * along**2 + rng.normal(0, rng.uniform(0.01, 0.3), points)
        tilt = rng.uniform(0.0, 2.0 * math.pi)
        turn = np.array([[math.cos(tilt), math.sin(tilt)], [-math.sin(tilt), math.cos(tilt)]])
        arc = np.stack([along, across], axis=1) @ turn
        made.append(10.0 ** rng.uniform(-2, 2) * arc + rng.uniform(-100, 100, 2))
    return np.array(made)


@given(st.integers(0, 2**32 - 1), st.integers(8, 40))
@settings(max_examples=100, deadline=None)
def test_a_parabola_is_the_one_that_polyfit_finds(seed: int, points: int) -> None:
    hood = hoods(np.random.default_rng(seed), 1, points)[0]
    expected = naive_parabola(hood)
    if expected[2] < 0.9:  # else the principal axes are anybody's choice
        np.testing.assert_allclose(_fit_parabola(hood), expected, rtol=1e-5, atol=1e-8)


def test_windows_grow_while_they_are_flat() -> None:
    many = hoods(np.random.default_rng(8), 80, WINDOWS[-1])
    found = _fit_growing(many, np.array(WINDOWS))
    np.testing.assert_allclose(found, [naive_growing(hood) for hood in many], rtol=1e-5, atol=1e-8)


def circle(seed: int, radius_mm: float, sigma_mm: float, count: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    exact = radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(exact + rng.normal(0.0, sigma_mm, (count, 2)))


# The median of 192 probes of about 100 points each: 1 / sqrt(2 * 100) = 7 % a probe, about 1 % in
# all, were the probes independent; the windows of a ring overlap, so 10 % is asked.
@pytest.mark.parametrize(("radius_mm", "sigma_mm"), [(50.0, 0.5), (50.0, 0.1), (20.0, 0.2)])
@pytest.mark.parametrize("seed", range(3))
def test_the_noise_of_a_circle_is_found_within_a_tenth_and_its_radius_within_a_quarter(
    radius_mm: float, sigma_mm: float, seed: int
) -> None:
    found = estimate_thickness(circle(seed, radius_mm, sigma_mm, 6000))
    assert found.sigma_mm == pytest.approx(sigma_mm, rel=0.10)
    assert found.radius_mm == pytest.approx(radius_mm, rel=0.25)
    assert found.width_mm == 4.0 * found.sigma_mm


def test_a_straight_run_is_much_straighter_than_it_is_long() -> None:
    rng = np.random.default_rng(3)
    line = np.column_stack([rng.uniform(0.0, 100.0, 4000), rng.normal(0.0, 0.2, 4000)])
    found = estimate_thickness(line)
    assert found.sigma_mm == pytest.approx(0.2, rel=0.1)
    assert found.radius_mm > 100.0


def test_exact_points_have_no_thickness_and_a_line_of_them_no_bend() -> None:
    exact = estimate_thickness(circle(0, 30.0, 0.0, 3000))
    assert exact.sigma_mm < 1e-3
    # A window of 256 points reaches a = 8 mm to either side, where a circle's fourth power bends
    # the parabola by (6 / 7) a^2 / (4 R^2) = 1.5 %.
    assert exact.radius_mm == pytest.approx(30.0 / 1.015, rel=5e-3)
    line = estimate_thickness(np.column_stack([np.linspace(0.0, 9.0, 50), np.zeros(50)]))
    assert line.sigma_mm < 1e-12
    assert line.radius_mm > 1e9


def test_the_spacing_is_the_distance_to_the_next_point() -> None:
    angle = np.arange(360) * (2.0 * math.pi / 360)
    found = estimate_thickness(30.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert found.spacing_mm == pytest.approx(60.0 * math.sin(math.pi / 360), rel=1e-9)


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_all_lengths_scale_with_the_part(factor: float) -> None:
    points = circle(1, 40.0, 0.3, 2000)
    small, big = estimate_thickness(points), estimate_thickness(factor * points)
    for name in ("sigma_mm", "radius_mm", "spacing_mm"):
        assert getattr(big, name) == pytest.approx(factor * getattr(small, name), rel=1e-6)


def test_the_same_points_and_seed_give_the_same_estimate() -> None:
    points = circle(2, 40.0, 0.3, 20_000)
    assert estimate_thickness(points, seed=4) == estimate_thickness(points, seed=4)
    assert estimate_thickness(points, seed=4) != estimate_thickness(points, seed=5)


def test_points_in_one_place_have_no_thickness_at_all() -> None:
    assert estimate_thickness(np.ones((20, 2))) == Thickness(0.0, math.inf, 0.0)


@pytest.mark.parametrize("count", [0, 1, 7])
def test_fewer_than_eight_points_are_too_few(count: int) -> None:
    with pytest.raises(TooFewPoints, match=f"^{count} points"):
        estimate_thickness(np.random.default_rng(0).normal(size=(count, 2)))


@pytest.mark.parametrize("count", [8, 9, 13, 25])
def test_a_slice_smaller_than_the_windows_uses_what_there_is(count: int) -> None:
    found = estimate_thickness(circle(count, 10.0, 0.05, count))
    assert math.isfinite(found.sigma_mm)
    assert found.spacing_mm > 0.0
