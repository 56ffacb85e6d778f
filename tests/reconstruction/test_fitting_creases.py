"""Corners stay corners; tight bends do not become them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.misfits import _between, _difference
from reconstruction.fitting.section import resolve_section
from reconstruction.fitting.section_fit import fit_chain
from reconstruction.nurbs import curve_derivatives
from tests.reconstruction.fit_cases import (
    along,
    chain_of,
    distances_to,
    ellipse,
    noisy,
    shuffled,
    superformula,
)

SQUARE = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0], [0.0, 0.0]])
EVEN = np.linspace(0, 1, 2000, endpoint=False)


def nearest_mm(places: FloatArray, corner: FloatArray) -> float:
    return float(np.linalg.norm(places - corner, axis=1).min())


@pytest.mark.parametrize("count", [2000, 20_000], ids=["single points", "gathered"])
def test_a_square_keeps_its_four_corners_and_becomes_one_closed_curve(count: int) -> None:
    outline = along(SQUARE)
    points, share = noisy(outline, count, 0.1, 1)
    curve = fit_chain(shuffled(points), chain_of(points, share, 0.1))
    assert curve.closed
    assert len(curve.creases) == 4
    assert curve.sigma_mm == pytest.approx(0.1, rel=0.15)
    for corner in SQUARE[:4]:
        assert nearest_mm(curve(np.array(curve.creases)), corner) < 0.1
    off = distances_to(curve(EVEN), outline)
    assert np.sqrt(np.mean(off**2)) < 0.02


@pytest.mark.parametrize("count", [2000, 20_000], ids=["single points", "gathered"])
def test_the_band_along_the_walls_of_a_square_covers_them(count: int) -> None:
    # Four walls of three degrees of freedom: one square alone may be covered by 80 %.
    covered = []
    for seed in range(10):
        points, share = noisy(along(SQUARE), count, 0.1, seed)
        curve = fit_chain(shuffled(points), chain_of(points, share, 0.1))
        off = distances_to(curve(EVEN), along(SQUARE))
        covered.append(np.mean(off <= 1.96 * curve.deviation_mm(EVEN)))
    assert 0.9 < np.mean(covered) < 0.99


def test_a_corner_is_a_threefold_knot_where_the_tangent_jumps() -> None:
    points, share = noisy(along(SQUARE), 2000, 0.1, 2)
    curve = fit_chain(points, chain_of(points, share, 0.1))
    for u in curve.creases:
        assert np.isclose(curve.curve.knots, u, atol=1e-12).sum() >= 3
        sides = np.mod([u - 1e-6, u + 1e-6], 1.0)
        before, after = curve_derivatives(curve.curve, sides, 1)[1]
        turn = np.degrees(np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after))
        assert turn == pytest.approx(90, abs=4)
        np.testing.assert_allclose(*curve(sides), atol=1e-3)


def test_an_open_angle_has_one_crease() -> None:
    points, share = noisy(along(SQUARE[:3]), 1500, 0.1, 3)
    curve = fit_chain(shuffled(points), chain_of(points, share, 0.1, pieces=60, closed=False))
    assert not curve.closed
    assert len(curve.creases) == 1
    assert nearest_mm(curve(np.array(curve.creases)), SQUARE[1]) < 0.1
    ends = np.array([curve(0.0), curve(1.0)])
    np.testing.assert_allclose(ends, SQUARE[[0, 2]], atol=0.4)


@pytest.mark.parametrize(("count", "sigma"), [(2000, 0.05), (2000, 0.5), (10_000, 2.0)])
@pytest.mark.parametrize("name", ["ellipse", "superformula"])
def test_a_round_bend_is_no_crease(name: str, count: int, sigma: float) -> None:
    outline = {"ellipse": ellipse(), "superformula": superformula()}[name]
    points, share = noisy(outline, count, sigma, 4)
    assert fit_chain(points, chain_of(points, share, sigma)).creases == ()


def rounded_square(radius: float) -> FloatArray:
    """The square with one corner, (100, 0), rounded."""
    turn = np.linspace(0, np.pi / 2, 200)
    middle = np.array([100 - radius, radius])
    bend = middle + radius * np.column_stack([np.sin(turn), -np.cos(turn)])
    return np.vstack([SQUARE[:1], bend, SQUARE[2:]])


def test_corners_are_found_in_shuffled_points_that_nobody_ordered() -> None:
    found = []
    for seed in range(6):
        points, _ = noisy(along(SQUARE), 600, 0.1, seed)
        (curve,) = resolve_section(shuffled(points, seed)).curves
        found.append(len(curve.creases))
    assert found.count(4) >= 5


@pytest.mark.parametrize("radius", [3.0, 10.0])
def test_a_round_corner_among_sharp_ones_stays_round_and_the_others_sharp(radius: float) -> None:
    outline = along(rounded_square(radius))
    for seed in range(3):
        points, _ = noisy(outline, 20_000, 0.3, seed)
        (curve,) = resolve_section(shuffled(points, seed)).curves
        assert len(curve.creases) == 3
        assert nearest_mm(curve(np.array(curve.creases)), SQUARE[1]) > 90
        assert distances_to(curve(EVEN), outline).max() < 0.3


def test_a_nose_with_a_radius_of_the_noise_does_not_overshoot() -> None:
    """Two straight flanks and a round tip of 4 mm, noise 2 mm: a corner would stand 3 mm out."""
    turn = np.linspace(-1.0, 1.0, 400)
    tip = 4 * np.column_stack([-np.cos(turn), np.sin(turn)])
    flank = np.array([np.sin(1.0), np.cos(1.0)]) * 70
    nose = np.vstack([tip[0] + flank * [1, -1], tip, tip[-1] + flank])
    outline = along(nose)
    points, share = noisy(outline, 10_000, 2.0, 5)
    curve = fit_chain(points, chain_of(points, share, 2.0, closed=False))
    assert curve(EVEN)[:, 0].min() == pytest.approx(-4.0, abs=0.6)


def test_the_difference_of_two_misfits_is_that_of_a_search_along_fine_lines() -> None:
    turn = np.linspace(0.0, 2.0, 121)
    one = 10 * np.column_stack([np.cos(turn), np.sin(turn)])
    other = 11 * np.column_stack([np.cos(turn), np.sin(turn)])
    points = np.random.default_rng(6).uniform(-15, 15, (3000, 2))
    low, high = one.min(axis=0) - 1.5, one.max(axis=0) + 1.5
    rows = _between(points, low, high)
    np.testing.assert_array_equal(rows, np.flatnonzero(((points >= low) & (points <= high)).all(1)))
    counted = np.isin(cKDTree(one).query(points[rows])[1], [0, 120], invert=True)
    squares = []
    for line in (one, other):
        share = np.linspace(0, 120, 120_001)
        fine = np.column_stack([np.interp(share, np.arange(121), axis) for axis in line.T])
        squares.append(np.minimum(cKDTree(fine).query(points[rows])[0] ** 2, 1.5**2))
    naive = (squares[0] - squares[1])[counted].sum()
    difference, count = _difference(points[rows], one, other, 1.5)
    assert count == counted.sum() > 500
    assert difference == pytest.approx(naive, abs=0.1)
