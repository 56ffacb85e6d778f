"""Caps: every polygon edge once whatever the polygon, and the true area where it is simple."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.caps import triangulate_polygon
from reconstruction.numbering import signed_area
from tests.reconstruction.part_cases import star


def assert_every_edge_is_used_once(corners: FloatArray) -> None:
    count = len(corners)
    triangles = triangulate_polygon(corners)
    assert triangles.shape == (count - 2, 3)
    half_edges = Counter((int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3))
    assert set(half_edges.values()) == {1}
    outer = {(k, (k + 1) % count) for k in range(count)}
    assert outer <= set(half_edges)
    assert all((b, a) in half_edges for a, b in half_edges if (a, b) not in outer)
    assert not any((b, a) in half_edges for a, b in outer)


def assert_no_triangle_overlaps(corners: FloatArray) -> None:
    a, b, c = corners[triangulate_polygon(corners)].swapaxes(0, 1)
    areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (areas > 0.0).all()
    # Turned the right way, they can only add up to the polygon if they cover it once.
    assert areas.sum() == pytest.approx(signed_area(corners), rel=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(3, 150))
@settings(max_examples=80, deadline=None)
def test_a_simple_polygon_is_covered_exactly(seed: int, count: int) -> None:
    corners = star(np.random.default_rng(seed), count)
    assert_every_edge_is_used_once(corners)
    assert_no_triangle_overlaps(corners)


def comb(teeth: int) -> FloatArray:
    """A comb whose teeth stand close: long thin dents and corners in straight lines."""
    lower = [(x, 0) for x in range(2 * teeth)]
    upper = [
        corner
        for k in reversed(range(teeth))
        for corner in ((2 * k + 1, 10), (2 * k, 10), (2 * k, 1), (2 * k - 1, 1))
    ]
    return np.array([*lower, *upper[:-2]], dtype=float)


def spiral(turns: float, count: int) -> FloatArray:
    """A band wound up on itself."""
    angle = np.linspace(0.0, turns * 2.0 * np.pi, count)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outer, inner = (2.0 + angle)[:, None] * way, (1.0 + angle)[:, None] * way
    return np.concatenate([outer, inner[::-1]])


@pytest.mark.parametrize(
    "corners",
    [comb(2), comb(12), spiral(0.8, 30), spiral(3.5, 120)],
    ids=["small comb", "comb", "crescent", "spiral"],
)
def test_dents_spirals_and_straight_corners_are_covered_exactly(corners: FloatArray) -> None:
    assert signed_area(corners) > 0.0
    assert_every_edge_is_used_once(corners)
    assert_no_triangle_overlaps(corners)


@given(st.lists(st.integers(1, 4), min_size=1, max_size=25))
@settings(max_examples=100, deadline=None)
def test_a_skyline_with_all_its_corners_in_lines_is_covered_exactly(heights: list[int]) -> None:
    ground = [(float(x), 0.0) for x in range(len(heights) + 1)]
    roofs = [(float(x + side), float(h)) for x, h in enumerate(heights) for side in (0, 1)]
    # Where two roofs are of one height their common corner comes once.
    line = [p for p, q in zip(roofs, [*roofs[1:], (-1.0, -1.0)], strict=True) if p != q]
    corners = np.array([*ground, *line[::-1]])
    assert_every_edge_is_used_once(corners)
    assert_no_triangle_overlaps(corners)


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=40))
@settings(max_examples=150, deadline=None)
def test_whatever_crosses_itself_or_repeats_a_point_every_edge_is_used_once(
    corners: list[tuple[int, int]],
) -> None:
    assert_every_edge_is_used_once(np.array(corners, dtype=float))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_corners_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match="at least 3 corners"):
        triangulate_polygon(np.zeros((count, 2)))
