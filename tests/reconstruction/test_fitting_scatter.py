"""Noise that varies, noise that is akin, and noise that does neither."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact
from reconstruction.fitting.scatter import _drift, _medians
from reconstruction.fitting.section_fit import fit_chain, free_fit
from tests.reconstruction.fit_cases import chain_of, circle, noisy, superformula


def akin(count: int, sigma: float, neighbours: int, seed: int) -> FloatArray:
    """Noise of standard deviation sigma, a moving mean over so many neighbours."""
    white = np.random.default_rng(seed).normal(size=(count + neighbours - 1, 2))
    sums = np.vstack([np.zeros(2), white]).cumsum(axis=0)
    return sigma * (sums[neighbours:] - sums[:-neighbours]) / np.sqrt(neighbours)


@pytest.mark.parametrize("seed", range(3))
def test_even_independent_noise_is_taken_for_what_it_is(seed: int) -> None:
    points, share = noisy(superformula(), 2000, 0.5, seed)
    fit, _, _ = free_fit(points, chain_of(points, share, 0.5))
    assert fit.noise.inflation == 1.0
    np.testing.assert_allclose(fit.noise.relative, 1.0)
    assert np.sqrt(fit.noise.variance_mm2) == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
def test_kinship_over_ten_neighbours_counts_ten_points_as_one(seed: int) -> None:
    share = np.sort(np.random.default_rng(seed).random(2000))
    points = circle()(share) + akin(2000, 0.5, 10, seed)
    curve = fit_chain(points, chain_of(points, share, 0.5), exact=Exact.NEVER)
    assert 6 < curve.inflation < 16
    assert curve.edf < 12
    assert curve.sigma_mm == pytest.approx(0.5, rel=0.1)


def test_noise_that_grows_along_the_curve_is_found_where_it_is() -> None:
    rng = np.random.default_rng(4)
    share = np.sort(rng.random(3000))
    sigma = np.where((share > 0.3) & (share < 0.7), 1.0, 0.2)
    points = circle()(share) + sigma[:, None] * rng.normal(size=(3000, 2))
    fit, _, _ = free_fit(points, chain_of(points, share, 0.6))
    found = np.sqrt(fit.noise.variance_mm2 * fit.noise.relative)
    at = fit.t / fit.spans
    loud, quiet = (at > 0.36) & (at < 0.64), (at < 0.24) | (at > 0.76)
    assert np.median(found[loud]) == pytest.approx(1.0, rel=0.15)
    assert np.median(found[quiet]) == pytest.approx(0.2, rel=0.25)


def test_noise_that_grows_with_the_spacing_is_weighted_by_it() -> None:
    rng = np.random.default_rng(5)
    share = np.cumsum(np.exp(1.2 * np.sin(np.arange(300) / 300 * 4 * np.pi)))
    spacing = np.diff(share, append=2 * share[-1] - share[-2])
    share /= share[-1] + spacing[-1]
    points = circle()(share) + 0.3 * spacing[:, None] * rng.normal(size=(300, 2))
    fit, _, _ = free_fit(points, chain_of(points, share, 0.5))
    slope = np.polyfit(np.log(spacing), np.log(fit.noise.relative[np.argsort(fit.t)]), 1)[0]
    assert 1.2 < slope < 2.6  # the truth is 2


def test_medians_by_group_are_those_of_each_group_by_itself() -> None:
    rng = np.random.default_rng(6)
    values, at = rng.random(300), rng.integers(0, 7, 300)
    at[at == 4] = 5  # a group of none
    weights = rng.integers(1, 5, 300).astype(float)
    found = _medians(values, weights, at, 7)
    for group in range(7):
        mine = np.repeat(values[at == group], weights[at == group].astype(int))
        if not len(mine):
            assert found[group] == 0.0
            continue
        low, high = np.quantile(mine, 0.5, method="inverted_cdf"), np.quantile(mine, 0.5)
        assert min(low, high) - 1e-12 <= found[group] <= max(low, high) + 1e-12


def test_a_rounded_corner_does_not_make_its_stretch_look_noisy() -> None:
    """A few points far off in one stretch of twelve: its mean square is five times as high."""
    rng = np.random.default_rng(7)
    share = np.sort(rng.random(720))
    squares = rng.normal(size=720) ** 2
    squares[(share > 0.5) & (share < 0.505)] = 60.0
    relative = _drift(squares, np.ones(720), share, closed=True)
    assert relative.max() / relative.min() < 1.5
    squares[(share > 0.5) & (share < 0.7)] *= 9.0
    relative = _drift(squares, np.ones(720), share, closed=True)
    inside = (share > 0.54) & (share < 0.66)
    assert np.median(relative[inside]) / np.median(relative[share < 0.4]) == pytest.approx(
        9, rel=0.4
    )
