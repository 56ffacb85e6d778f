"""A curve does not wind about in a band that is thick on one side."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting import section_fit
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import resolve_section
from reconstruction.fitting.section_fit import free_fit
from reconstruction.fitting.straying import doubted, windings
from tests.reconstruction.fit_cases import (
    along,
    chain_of,
    distances_to,
    noisy,
    shuffled,
    superformula,
    wave,
)

CORNERS = [[200.0, 0.0], [400.0, 0.0], [400.0, 320.0], [0.0, 320.0], [0.0, 0.0], [200.0, 0.0]]
PLATE = along(np.array(CORNERS))
ROUND_MM = 1440.0
TOP = (520 / ROUND_MM, 920 / ROUND_MM)
LOUD_MM = 12.0


def plate(seed: int, *, kin: int) -> FloatArray:
    """Half of 900 points on the top, sigma 12 mm, the others 2 mm; so many neighbours akin."""
    rng = np.random.default_rng(seed)
    share = np.sort(np.concatenate([rng.random(450), rng.uniform(*TOP, 450)]))
    white = rng.normal(size=(900 + kin - 1, 2)).cumsum(axis=0)
    sums = np.vstack([np.zeros(2), white])
    noise = (sums[kin:] - sums[:-kin]) / np.sqrt(kin)
    sigma = np.where((share > TOP[0]) & (share < TOP[1]), LOUD_MM, 2.0)
    return rng.permutation(PLATE(share) + sigma[:, None] * noise)


def length_mm(curve: FittedCurve) -> float:
    return float(np.linalg.norm(np.diff(curve(np.linspace(0, 1, 2001)), axis=0), axis=1).sum())


@pytest.mark.parametrize(("kin", "seed"), [(1, 1), (8, 0), (8, 1), (8, 6)])
def test_where_the_noise_is_six_times_louder_the_curve_does_not_wind(kin: int, seed: int) -> None:
    points = plate(seed, kin=kin)
    (curve,) = resolve_section(points, exact=Exact.NEVER).curves
    off = distances_to(curve(np.linspace(0, 1, 2000)), PLATE)
    assert length_mm(curve) == pytest.approx(ROUND_MM, rel=0.05)
    # Eight akin on 112 a hundred millimetres: 14 independent ones, of 12 mm, leave 3.2 mm and more.
    assert np.sqrt(np.mean(off**2)) < 5.0
    assert off.max() < 25.0


def test_the_first_look_alone_would_have_wound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(section_fit, "_RETRIES", 0)
    (curve,) = resolve_section(plate(6, kin=8), exact=Exact.NEVER).curves
    assert length_mm(curve) > 1.2 * ROUND_MM


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
@pytest.mark.parametrize(("count", "sigma"), [(300, 0.5), (2000, 0.05), (12_000, 0.5)])
def test_a_sound_fit_is_as_long_as_its_chain_everywhere(
    count: int,
    sigma: float,
    closed: bool,  # noqa: FBT001
) -> None:
    points, share = noisy(superformula() if closed else wave(), count, sigma, 1)
    chain = chain_of(points, share, sigma, closed=closed)
    fit, _, _ = free_fit(shuffled(points), chain)
    wound = windings(fit, chain)
    assert wound.shape == (fit.spans,)
    assert wound.max() < 1.15
    assert np.median(wound) == pytest.approx(1.0, abs=0.1)


def test_a_gap_has_no_length_to_compare_with() -> None:
    points, share = noisy(superformula(), 2000, 0.5, 2, gap=(0.40, 0.46))
    chain = chain_of(points, share, 0.5)
    fit, _, _ = free_fit(shuffled(points), chain)
    wound = windings(fit, chain)
    assert wound.max() < 1.15
    assert (wound == 0.0).mean() == pytest.approx(0.06, abs=0.05)


def test_doubt_falls_on_the_points_that_lie_where_it_winds() -> None:
    points, share = noisy(superformula(), 2000, 0.5, 3)
    fit, _, _ = free_fit(points, chain_of(points, share, 0.5))
    wound = np.ones(fit.spans)
    wound[40:50] = 1.6
    doubt = doubted(fit, wound)
    inside = (fit.t >= 38) & (fit.t < 52)
    np.testing.assert_array_equal(doubt > 1, inside)
