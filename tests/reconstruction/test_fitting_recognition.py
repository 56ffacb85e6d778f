"""What is a circle, an ellipse, an arc or a line is returned as such; what is not, is not."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.fitting.curve import Exact
from reconstruction.fitting.section_fit import fit_chain
from tests.reconstruction.fit_cases import (
    Outline,
    chain_of,
    circle,
    distances_to,
    ellipse,
    noisy,
    rms_to,
    shuffled,
    superformula,
    wave,
)

EVEN = np.linspace(0, 1, 400, endpoint=False)


@pytest.mark.parametrize(("kind", "outline"), [("circle", circle()), ("ellipse", ellipse())])
def test_a_ring_is_recognised_and_sits_at_its_own_floor(kind: str, outline: Outline) -> None:
    squares = []
    for seed in range(6):
        points, share = noisy(outline, 2000, 0.5, seed)
        curve = fit_chain(shuffled(points), chain_of(points, share, 0.5))
        assert curve.kind == kind
        assert curve.curve.degree == 2
        assert curve.closed
        squares.append(rms_to(curve(EVEN), outline) ** 2)
    floor = 0.5 * np.sqrt({"circle": 3, "ellipse": 5}[kind] / 2000)
    assert np.sqrt(np.mean(squares)) < 1.35 * floor  # six seeds scatter by a fifth


@pytest.mark.parametrize("seed", range(4))
def test_lobes_of_two_percent_are_no_circle(seed: int) -> None:
    def lobed(share: np.ndarray) -> np.ndarray:
        radius = 50 * (1 + 0.02 * np.cos(10 * np.pi * share))
        return radius[:, None] * circle(1.0)(share)

    points, share = noisy(lobed, 2000, 0.1, seed)
    assert fit_chain(points, chain_of(points, share, 0.1)).kind == "free"


def test_a_superformula_is_no_ellipse() -> None:
    points, share = noisy(superformula(), 2000, 0.5, 1)
    assert fit_chain(points, chain_of(points, share, 0.5)).kind == "free"


def test_recognition_can_be_switched_off() -> None:
    points, share = noisy(circle(), 2000, 0.5, 1)
    curve = fit_chain(points, chain_of(points, share, 0.5), exact=Exact.NEVER)
    assert curve.kind == "free"
    assert curve.curve.degree == 3


@pytest.mark.parametrize("way", [1, -1], ids=["counter-clockwise", "clockwise"])
def test_a_recognised_ring_runs_the_way_of_its_chain(way: int) -> None:
    points, share = noisy(circle(), 500, 0.2, 2)
    curve = fit_chain(points, chain_of(points[::way], share, 0.2))
    x, y = curve(EVEN).T
    area = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert area == pytest.approx(way * np.pi * 2500, rel=0.01)


def test_an_arc_of_two_thirds_of_a_turn_is_exact_and_open() -> None:
    turn = np.radians(240)

    def bow(share: np.ndarray) -> np.ndarray:
        return 50 * np.column_stack([np.cos(turn * share), np.sin(turn * share)])

    points, share = noisy(bow, 1500, 0.3, 3)
    curve = fit_chain(shuffled(points), chain_of(points, share, 0.3, closed=False))
    assert curve.kind == "arc"
    assert not curve.closed
    radii = np.hypot(*(curve(EVEN) - [0.0, 0.0]).T)
    np.testing.assert_allclose(radii, 50, atol=0.1)
    ends = np.array([curve(0.0), curve(1.0)])
    np.testing.assert_allclose(ends, bow(np.array([0.0, 1.0])), atol=0.8)


def test_a_line_is_a_line_and_a_wave_is_not() -> None:
    points, share = noisy(lambda share: np.column_stack([100 * share, 30 * share]), 1500, 0.3, 4)
    straight = fit_chain(shuffled(points), chain_of(points, share, 0.3, closed=False))
    assert straight.kind == "line"
    assert straight.curve.degree == 1
    np.testing.assert_allclose(straight(1.0), [100, 30], atol=0.8)
    points, share = noisy(wave(), 1500, 0.3, 4)
    bent = fit_chain(shuffled(points), chain_of(points, share, 0.3, closed=False))
    assert bent.kind == "free"
    assert distances_to(bent(np.linspace(0.02, 0.98, 100)), wave()).max() < 0.2


@pytest.mark.parametrize("outline", [circle(), ellipse()], ids=["circle", "ellipse"])
def test_the_band_of_a_recognised_ring_covers_the_truth(outline: Outline) -> None:
    covered = []
    for seed in range(12):
        points, share = noisy(outline, 500, 0.5, seed)
        curve = fit_chain(points, chain_of(points, share, 0.5))
        covered.append(distances_to(curve(EVEN), outline) <= 1.96 * curve.deviation_mm(EVEN))
    assert 0.85 < np.mean(covered) <= 1.0
