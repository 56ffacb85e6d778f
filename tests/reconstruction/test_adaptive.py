"""The next slice: where sections are not as their neighbours foretell, and where the part ends."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from loftscan.advising import answer
from reconstruction.adaptive import Kind, Level, choose, expected_mm, level_of, spans_between
from reconstruction.adaptive.foretelling import signed_distances, weights_at
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.slices import Frame, Slice

PLANE = Frame(np.zeros(3), np.eye(3))
Law = Callable[[float], float]


def ring_level(radius_mm: float, height_mm: float, seed: int = 0, *, dark: float = 0.0) -> Level:
    """A round section with noise of 0.01 mm; nothing in a share of the turn. Radius 0: no part."""
    rng = np.random.default_rng([seed, round(1e3 * height_mm)])
    turn = rng.uniform(dark, 1.0, 1500) * math.tau
    away = radius_mm + rng.normal(0.0, 0.01, 1500)
    points = np.column_stack([away * np.cos(turn), away * np.sin(turn), np.full(1500, height_mm)])
    frame = Frame(np.array([0.0, 0.0, height_mm]), np.eye(3))
    piece = Slice(0, points if radius_mm else np.empty((0, 3)), frame)
    return level_of(draw_outlines(piece, exact=Exact.NEVER), PLANE, height_mm)


def chosen(law: Law, tolerance_mm: float, start: range, most: int = 60) -> dict[int, Level]:
    """Slices of a round part on a grid of 0.5 mm, until there are enough."""
    levels = {k: ring_level(law(0.5 * k), 0.5 * k) for k in start}
    while len(levels) < most:
        asked = answer(levels, tuple(sorted(levels)), tolerance_mm)
        if asked.index is None:
            return levels
        assert asked.index not in levels
        levels[asked.index] = ring_level(law(0.5 * asked.index), 0.5 * asked.index)
    return levels


def test_a_cylinder_needs_no_slice_beyond_the_coarse_ones_and_its_ends() -> None:
    def law(height_mm: float) -> float:
        return 20.0 if height_mm <= 60.0 else 0.0

    places = sorted(chosen(law, 0.6, range(0, 161, 20)))
    beyond = [place for place in places if place % 20]
    # The foot is carried on by half a span: a slice beside it. The top, at place 120, is bisected.
    assert beyond[0] == 1
    assert set(beyond[1:]) <= set(range(121, 140))
    assert {120, 121} <= set(places)


def test_a_groove_draws_the_slices_to_itself() -> None:
    def law(height_mm: float) -> float:
        return 20.0 - 3.0 * math.exp(-(((height_mm - 33.0) / 4.0) ** 2))

    levels = chosen(law, 0.1, range(0, 161, 16))
    near = [place for place in levels if abs(0.5 * place - 33.0) <= 10.0]
    ends = [place for place in levels if place in (1, 159)]
    far = len(levels) - len(near) - len(ends)
    # 20 of 80 mm are the groove's; even spacing would put a quarter of the slices there.
    assert len(near) >= far
    # And it is enough: between neighbours a straight line in 20 mm, by the law itself.
    heights = np.array(sorted(levels)) * 0.5
    fine = np.linspace(0.0, 80.0, 2001)
    truth = np.array([law(h) for h in fine])
    apart = np.abs(np.interp(fine, heights, [law(h) for h in heights]) - truth)
    assert np.percentile(apart, 98.0) < 0.1


def test_where_contours_part_the_next_slice_is_between_them() -> None:
    one = ring_level(20.0, 0.0)
    left, right = ring_level(6.0, 10.0), ring_level(6.0, 10.0, 1)
    aside = np.array([10.0, 0.0])
    loops = (left.loops_mm[0] - aside, right.loops_mm[0] + aside)
    places = np.concatenate([left.places_mm - aside, right.places_mm + aside])
    two = Level(10.0, Kind.SECTION, loops, places, left.noise_mm, 0, 0.0, 75.0, 226.0)
    found = choose(spans_between([one, two]), [0, 20], 0.2)
    assert found is not None
    assert found.position == 10
    assert found.span.why == "contours part or join"


def test_a_section_with_gaps_that_its_neighbours_do_not_have_is_no_end_of_a_span() -> None:
    levels = [ring_level(20.0, 10.0 * k, dark=0.4 if k == 2 else 0.0) for k in range(5)]
    assert levels[2].gap_share > 0.1
    spans = spans_between(levels)
    assert (1, 3) in [(span.low, span.high) for span in spans]
    assert 2 not in [end for span in spans for end in (span.low, span.high)]


def test_noise_alone_asks_for_nothing() -> None:
    levels = {k: ring_level(20.0, 0.5 * k, seed=3) for k in (0, 1, 40, 80, 120, 159, 160)}
    # 0.01 mm of noise in 1500 points leave a contour uncertain by about 1 um.
    asked = answer(levels, tuple(levels), 0.3)
    assert asked.index is None
    spans = spans_between([levels[k] for k in sorted(levels)])
    assert expected_mm(spans[:-2]) < 0.005


def test_when_nothing_is_seen_nothing_is_asked_for() -> None:
    levels = {k: ring_level(0.0, 0.5 * k) for k in (0, 40, 80)}
    asked = answer(levels, (0, 40, 80), 0.1)
    assert asked.index is None
    assert "no slice shows anything" in asked.why


def test_damaged_slices_are_passed_over() -> None:
    levels = {k: ring_level(20.0, 0.5 * k) for k in (0, 1, 40, 80, 159, 160)}
    levels[60] = Level(30.0, Kind.UNREAD)
    assert answer(levels, tuple(sorted(levels)), 0.3).index is None


def test_distances_are_negative_in_the_material() -> None:
    level = ring_level(20.0, 0.0)
    found = signed_distances(np.array([[0.0, 0.0], [25.0, 0.0], [0.0, 19.0]]), level)
    # The polygon of 360 corners lies within 0.8 um of the circle; the fit's noise is about 1 um.
    assert found == pytest.approx([-20.0, 5.0, -1.0], abs=0.01)


def test_weights_give_a_cubic_back() -> None:
    nodes = [0.0, 1.0, 4.0, 9.0]

    def cubic(x: float) -> float:
        return 2.0 - x + 0.5 * x**2 - 0.1 * x**3

    assert weights_at(2.5, nodes) @ [cubic(x) for x in nodes] == pytest.approx(cubic(2.5))
