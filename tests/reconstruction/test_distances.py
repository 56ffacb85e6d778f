"""Distances to a polygon against all segments one by one, and matplotlib's inside test."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path

from reconstruction.arrays import FloatArray
from reconstruction.distances import distances_to_nearest, polygon_distances
from tests.reconstruction.part_cases import star


def naive_distances(points: FloatArray, polygon: FloatArray, *, closed: bool = True) -> FloatArray:
    """To every segment; (n, 2), (m, 2) -> (n,), unsigned."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    if not closed:
        a, b = a[:-1], b[:-1]
    along = b - a
    squares = np.maximum((along**2).sum(axis=1), 1e-300)
    from_start = points[:, None] - a
    share = np.clip((from_start * along).sum(axis=2) / squares, 0.0, 1.0)
    away = np.linalg.norm(from_start - share[:, :, None] * along, axis=2)
    return np.asarray(away.min(axis=1))


def probes(rng: np.random.Generator, polygon: FloatArray) -> FloatArray:
    """Points near the outline, around it, and far away."""
    near = polygon[rng.integers(0, len(polygon), 60)] + rng.normal(0.0, 0.3, (60, 2))
    around = rng.uniform(-25.0, 25.0, (80, 2))
    far = rng.normal(0.0, 1.0, (20, 2)) * 10.0 ** rng.uniform(1.0, 4.0, (20, 1))
    return np.concatenate([near, around, far])


@given(st.integers(0, 2**32 - 1), st.integers(3, 120), st.booleans())
@settings(max_examples=120, deadline=None)
def test_distances_are_those_of_all_segments_and_negative_inside(
    seed: int,
    corners: int,
    repeated: bool,  # noqa: FBT001 (hypothesis draws it)
) -> None:
    rng = np.random.default_rng(seed)
    polygon = star(rng, corners)
    points = probes(rng, polygon)
    outline = Path(np.concatenate([polygon, polygon[:1]]), closed=True)
    if repeated:
        polygon = np.repeat(polygon, rng.integers(1, 4, corners), axis=0)
    found = polygon_distances(points, polygon)
    expected = naive_distances(points, polygon)
    np.testing.assert_allclose(np.abs(found), expected, rtol=1e-9, atol=1e-9)
    clear = expected > 1e-9
    np.testing.assert_array_equal((found < 0)[clear], outline.contains_points(points)[clear])


@given(st.integers(0, 2**32 - 1), st.integers(3, 60))
@settings(max_examples=40, deadline=None)
def test_a_polygon_run_the_other_way_changes_only_the_signs(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = star(rng, corners)
    points = probes(rng, polygon)
    forth, back = polygon_distances(points, polygon), polygon_distances(points, polygon[::-1])
    clear = np.abs(forth) > 1e-9
    np.testing.assert_allclose(forth[clear], -back[clear], rtol=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
@settings(max_examples=60, deadline=None)
def test_lines_tangles_and_needles_have_their_unsigned_distances_too(
    seed: int, corners: int
) -> None:
    rng = np.random.default_rng(seed)
    # Crossing itself, with repeated corners, stretched to a needle by up to a million.
    polygon = rng.integers(-4, 5, (corners, 2)) * [1.0, 10.0 ** -rng.integers(0, 7)]
    if (polygon == polygon[0]).all():
        polygon[0, 0] += 1.0
    points = rng.uniform(-6.0, 6.0, (50, 2))
    found = np.abs(polygon_distances(points, polygon))
    np.testing.assert_allclose(found, naive_distances(points, polygon), rtol=1e-9, atol=1e-9)


def test_points_on_the_outline_have_no_distance() -> None:
    polygon = star(np.random.default_rng(4), 50)
    middles = (polygon + np.roll(polygon, -1, axis=0)) / 2.0
    found = polygon_distances(np.concatenate([polygon, middles]), polygon)
    np.testing.assert_allclose(found, 0.0, atol=1e-12)


def test_a_circle_of_many_segments_has_its_radius_as_distance() -> None:
    angle = np.arange(2000) * (2.0 * math.pi / 2000)
    circle = 50.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    radii = np.array([0.0, 10.0, 49.0, 51.0, 80.0, 5000.0])
    points = np.stack([radii, np.zeros(6)], axis=1)
    # The middle of a chord lies 50 (1 - cos(pi / 2000)) = 6e-5 mm inside the circle.
    np.testing.assert_allclose(polygon_distances(points, circle), radii - 50.0, atol=7e-5)


def test_no_points_have_no_distances() -> None:
    assert polygon_distances(np.empty((0, 2)), np.eye(3)[:, :2]).shape == (0,)


@pytest.mark.parametrize("x_mm", [-3.0, 0.5, 4.0])
def test_a_segment_there_and_back_is_all_outside(x_mm: float) -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    found = polygon_distances(np.array([[x_mm, 0.0]]), line)
    assert found[0] == pytest.approx(max(-x_mm, 0.0, x_mm - 1.0))


@given(st.integers(0, 2**32 - 1), st.integers(2, 40))
@settings(max_examples=60, deadline=None)
def test_an_open_line_has_no_segment_from_its_end_to_its_start(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    line = np.column_stack([np.arange(corners), rng.uniform(-2.0, 2.0, corners)])
    points = rng.uniform(-6.0, corners + 6.0, (50, 2))
    found = polygon_distances(points, line, closed=False)
    expected = naive_distances(points, line, closed=False)
    np.testing.assert_allclose(np.abs(found), expected, rtol=1e-9, atol=1e-9)


def test_the_left_of_an_open_line_is_negative() -> None:
    line = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 5.0]])
    points = np.array([[-3.0, 1.0], [5.0, 1.0], [5.0, -1.0], [25.0, 9.0], [25.0, 4.0]])
    signs = np.sign(polygon_distances(points, line, closed=False))
    assert signs.tolist() == [-1.0, -1.0, 1.0, -1.0, 1.0]


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_of_several_polygons_the_nearest_counts_with_its_own_sign(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    polygons = [
        (star(rng, int(corners)) * rng.uniform(0.01, 1.0) + rng.normal(0.0, 20.0, 2), bool(closed))
        for corners, closed in rng.integers([3, 0], [60, 2], (count, 2))
    ]
    points = np.concatenate([probes(rng, polygon) for polygon, _ in polygons])
    found = distances_to_nearest(points, polygons)
    apart = np.array([polygon_distances(points, one, closed=closed) for one, closed in polygons])
    naive = np.array([naive_distances(points, one, closed=closed) for one, closed in polygons])
    np.testing.assert_allclose(np.abs(found), naive.min(axis=0), rtol=1e-9, atol=1e-9)
    nearest = np.abs(apart).argmin(axis=0)
    np.testing.assert_array_equal(found, apart[nearest, np.arange(len(points))])
