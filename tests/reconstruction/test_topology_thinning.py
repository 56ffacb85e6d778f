"""What thins a run to a row, beside naive twins: feet on it, parabolas in its windows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from reconstruction.arrays import FloatArray
from reconstruction.fitting.regression import _NOTHING, _parabola, _without_the_worst, regress
from reconstruction.fitting.thinning import _project

SEEDS = st.integers(0, 2**32 - 1)


def naive_foot(place: FloatArray, ring: FloatArray, ups: FloatArray) -> float:
    """Place along an open polyline by trying every segment."""
    best, along = math.inf, 0.0
    for k in range(len(ring) - 1):
        arm = ring[k + 1] - ring[k]
        share = float((place - ring[k]) @ arm / (arm @ arm))
        share = max(share, -2.0 if k == 0 else 0.0)
        share = min(share, 3.0 if k == len(ring) - 2 else 1.0)
        away = float(np.linalg.norm(ring[k] + share * arm - place))
        if away < best:
            best, along = away, float(ups[k] + share * (ups[k + 1] - ups[k]))
    return along


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_the_foot_of_a_place_is_the_nearest_on_the_segments_around(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.arange(8.0)
    ring = np.stack([x, rng.uniform(-0.3, 0.3, 8)], axis=1)
    places = np.stack([rng.uniform(-0.5, 7.5, 40), rng.uniform(-0.4, 0.4, 40)], axis=1)
    at = np.clip(places[:, 0].astype(np.int64), 0, 6)
    ups = np.concatenate([[0.0], rng.uniform(0.5, 2.0, 7).cumsum()])
    found, off = _project(places, ring, ups, at, closed=False)
    naive = [naive_foot(place, ring, ups) for place in places]
    np.testing.assert_allclose(found, naive, atol=1e-12)
    dense = np.stack([np.interp(np.linspace(0, 7, 7001), x, ring[:, k]) for k in (0, 1)], axis=1)
    inner = (found > 0.0) & (found < ups[-1])
    nearest = cdist(places[inner], dense).min(axis=1)
    np.testing.assert_allclose(off[inner], nearest, atol=1e-3)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_around_a_loop_the_foot_is_sought_over_the_seam(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.arange(12) * math.tau / 12
    radius = rng.uniform(0.9, 1.1, 12)
    nodes = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ring = np.vstack([nodes, nodes[:1]])
    turn = rng.uniform(0.0, math.tau, 60)
    away = rng.uniform(0.8, 1.2, 60)
    places = away[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    at = (turn / math.tau * 12).astype(np.int64) + rng.integers(-1, 2, 60)
    ups = np.concatenate([[0.0], rng.uniform(0.5, 2.0, 12).cumsum()])
    along, off = _project(places, ring, ups, np.clip(at, 0, 11), closed=True)
    for n, place in enumerate(places):
        feet = []
        for k in range(12):
            arm = ring[k + 1] - ring[k]
            share = min(max(float((place - ring[k]) @ arm / (arm @ arm)), 0.0), 1.0)
            far = float(np.linalg.norm(ring[k] + share * arm - place))
            feet.append((far, float(ups[k] + share * (ups[k + 1] - ups[k]))))
        assert off[n] == pytest.approx(min(feet)[0], abs=1e-12)
        nearest = [foot % ups[-1] for far, foot in feet if far < min(feet)[0] + 1e-12]
        assert any(along[n] % ups[-1] == pytest.approx(foot, abs=1e-9) for foot in nearest)


def naive_middle(along: FloatArray, places: FloatArray, at: float, window: float) -> FloatArray:
    """Value of the weighted parabola in the middle of a window, and the scatter across it."""
    u = along - at
    near = np.abs(u) < window
    weights = 1.0 - (u[near] / window) ** 2  # polyfit squares them
    fits = [np.polyfit(u[near], column[near], 2, w=weights) for column in places.T]
    slope = np.array([fit[1] for fit in fits]) / np.hypot(fits[0][1], fits[1][1])
    curves = [np.polyval(fit, u) for fit in fits]
    misfits = places - np.stack(curves, axis=1)
    across = (misfits @ np.array([slope[1], -slope[0]]))[near]
    return np.array([fits[0][2], fits[1][2], np.sqrt((across**2).sum() / (near.sum() - 3))])


@given(SEEDS, st.booleans())
@settings(max_examples=30, deadline=None)
def test_nodes_are_the_middles_of_weighted_parabolas(seed: int, closed: bool) -> None:  # noqa: FBT001
    rng = np.random.default_rng(seed)
    along = np.sort(rng.uniform(0.0, 20.0, 400))
    places = np.stack([np.cos(along / 4), np.sin(along / 3)], axis=1)
    places += rng.normal(0.0, 0.01, places.shape) + 1e6
    grid = np.linspace(2.0, 18.0, 9)
    nothing = np.full(9, np.inf)
    period = 20.0 if closed else np.inf
    # 50 points in a window of 1.25 are enough, and the middle of one is known: it does not grow.
    middles, sigma, close = regress(along, places, grid, nothing, np.full(9, 2.5), period)
    naive = np.array([naive_middle(along, places - 1e6, at, 1.25) for at in grid])
    np.testing.assert_allclose(middles - 1e6, naive[:, :2], atol=1e-6)
    np.testing.assert_allclose(sigma, naive[:, 2], rtol=1e-4)
    np.testing.assert_array_equal(close, [(np.abs(along - at) <= 0.5).sum() for at in grid])


def test_windows_of_a_closed_row_reach_over_its_seam() -> None:
    along = np.sort(np.random.default_rng(0).uniform(0.0, 10.0, 300))
    angle = along / 10.0 * math.tau
    places = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    grid, nothing, window = np.array([0.0, 9.99]), np.full(2, np.inf), np.full(2, 1.0)
    middles, _, _ = regress(along, places, grid, nothing, window, 10.0)
    later = np.sort(np.mod(along + 5.0, 10.0))
    moved = np.roll(places, -int(np.searchsorted(along, 5.0)), axis=0)
    again, _, _ = regress(later, moved, np.array([5.0, 4.99]), nothing, window, 10.0)
    np.testing.assert_allclose(middles, again, atol=1e-12)


@given(SEEDS, st.integers(6, 40))
@settings(max_examples=30, deadline=None)
def test_the_variance_of_a_middle_is_that_of_weighted_least_squares(seed: int, count: int) -> None:
    along = np.sort(np.random.default_rng(seed).uniform(-1.0, 1.0, count))
    places = np.stack([along, along**2], axis=1)
    fit = _parabola(along, places, np.zeros(2), 0.0, 1.0, 0, count, count, _NOTHING, np.inf, np.inf)
    weights = (1.0 - along**2) ** 2
    variances = []
    for degree in (1, 2):
        powers = np.vander(along, degree + 1, increasing=True)
        variances.append(float(np.linalg.inv(powers.T @ (weights[:, None] * powers))[0, 0]))
    bent = fit[4] != 0.0 or fit[5] != 0.0
    assert fit[6] == pytest.approx(variances[1] if bent else variances[0], rel=1e-6)
    # A parabola is only taken where it is known as well as a line would be, or well enough.
    assert not bent or fit[6] <= max(0.6, variances[0]) * (1 + 1e-9)


def test_a_stray_has_no_say_in_a_window() -> None:
    along = np.linspace(0.0, 2.0, 41)
    places = np.stack([along, np.zeros(41)], axis=1)
    places[18, 1] = 5.0
    none = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, np.inf)
    with_it = _parabola(along, places, np.zeros(2), 1.0, 1.0, 0, 41, 41, none, np.inf, np.inf)
    without = _parabola(along, places, np.zeros(2), 1.0, 1.0, 0, 41, 41, none, 0.1, np.inf)
    assert abs(with_it[1]) > 0.1
    np.testing.assert_allclose(without[:6], (1.0, 0.0, 1.0, 0.0, 0.0, 0.0), atol=1e-12)


def test_among_few_places_a_stray_is_found_though_it_draws_the_line_to_itself() -> None:
    along = np.array([0.0, 0.1, 0.2, 1.0, 1.8, 1.9, 2.0])
    places = np.stack([along, np.zeros(7)], axis=1)
    places[3, 1] = 1.0
    grid, window = np.array([1.0]), np.array([1.25])
    drawn, _, _ = regress(along, places, grid, np.array([np.inf]), window, np.inf)
    straight, _, _ = regress(along, places, grid, np.array([0.15]), window, np.inf)
    assert drawn[0, 1] > 0.3
    assert straight[0, 1] == pytest.approx(0.0, abs=1e-12)


def naive_parabola(u: FloatArray, places: FloatArray, window: float) -> list[FloatArray]:
    return [np.polyfit(u, column, 2, w=1.0 - (u / window) ** 2) for column in places.T]


def naive_across(fits: list[FloatArray], u: FloatArray, places: FloatArray) -> FloatArray:
    """How far places lie from a parabola, across its slope in the middle."""
    slope = np.array([fit[1] for fit in fits]) / np.hypot(fits[0][1], fits[1][1])
    misfits = places - np.stack([np.polyval(fit, u) for fit in fits], axis=1)
    return np.asarray(np.abs(misfits @ np.array([slope[1], -slope[0]])))


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_what_lies_far_from_a_first_parabola_has_no_say_in_the_second(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = np.sort(rng.uniform(-1.25, 1.25, 60))
    places = np.stack([along, 0.2 * along**2], axis=1) + rng.normal(0.0, 0.02, (60, 2))
    places[rng.integers(0, 60, 4), 1] += 0.4
    spread = 0.04
    middles, sigma, close = regress(along, places, np.zeros(1), np.array([spread]),
                                    np.array([1.25]), np.inf)  # fmt: skip
    far = 4.0 * spread + 1e-9
    first = naive_parabola(along, places, 1.25)
    kept = naive_across(first, along, places) <= far
    second = naive_parabola(along[kept], places[kept], 1.25)
    np.testing.assert_allclose(middles[0], [second[0][2], second[1][2]], atol=1e-9)
    across = naive_across(second, along, places)
    near = across <= far
    scatter = math.sqrt((across[near] ** 2).sum() / (near.sum() - 3))
    assert sigma[0] == pytest.approx(scatter, rel=1e-6)
    assert close[0] == (near & (np.abs(along) <= 0.5)).sum()


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_among_few_the_place_farthest_from_the_fit_to_the_others_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = np.sort(rng.uniform(-1.0, 1.0, 12))
    places = np.stack([along, rng.normal(0.0, 0.03, 12)], axis=1)
    places[rng.integers(3, 9), 1] += rng.choice([0.0, 0.6])
    far, window, origin = 0.15, 1.25, np.zeros(2)

    def fitted(left_out: int) -> tuple[float, ...]:
        return _parabola(along, places, origin, 0.0, window, 0, 12, left_out, _NOTHING, np.inf,
                         np.inf)  # fmt: skip

    worst, expected = 1.25 * far, fitted(12)
    for n in range(12):
        fit = fitted(n)
        bends = [np.array([fit[4], fit[2], fit[0]]), np.array([fit[5], fit[3], fit[1]])]
        across = float(naive_across(bends, along[n : n + 1], places[n : n + 1])[0])
        if across > worst:
            worst, expected = across, fit
    found = _without_the_worst(along, places, origin, 0.0, window, 0, 12, fitted(12), far, np.inf)
    np.testing.assert_allclose(found, expected, atol=1e-12)
