"""Arc cells against a search for the nearest vertex, point by point."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.moments import cells_of_points, gather, nearest_vertices


def hairpin(count: int = 200) -> tuple[FloatArray, FloatArray]:
    """Two close walls and a bend, open: vertices and left normals."""
    s = np.linspace(0, 1, count)
    x = np.where(s < 0.5, s * 80, (1 - s) * 80)
    y = 1.5 * np.tanh((s - 0.5) * 40)
    vertices = np.column_stack([x, y])
    tangents = np.gradient(vertices, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    return vertices, np.column_stack([-tangents[:, 1], tangents[:, 0]])


def test_every_point_finds_its_nearest_vertex_even_between_two_walls() -> None:
    vertices, _ = hairpin()
    rng = np.random.default_rng(1)
    points = vertices[rng.integers(0, 200, 3000)] + rng.normal(0, 0.8, (3000, 2))
    found = nearest_vertices(points, vertices, np.full(200, 40.0))
    squares = ((points[:, None, :] - vertices[None, :, :]) ** 2).sum(axis=2)
    chosen = squares[np.arange(3000), found]
    np.testing.assert_allclose(chosen, squares.min(axis=1), atol=1e-12)


def test_points_out_of_reach_are_counted_and_left_out() -> None:
    vertices, normals = hairpin()
    near = vertices[50:100]
    far = np.array([[-500.0, 3.0], [20.0, 60.0], [1e12, -1e12], [20.0, -9.0]])
    found = nearest_vertices(far[:3], vertices, np.full(200, 2.0))
    assert (found == -1).all()
    cells, _, left_out = gather(
        np.vstack([near, far]), vertices, normals, np.full(200, 2.0), closed=False
    )
    assert left_out == 4
    assert cells.total == 50


@pytest.mark.parametrize("with_heights", [True, False])
def test_cells_hold_count_mean_covariance_and_true_heights(with_heights: bool) -> None:  # noqa: FBT001
    turn = np.arange(60) / 60 * 2 * np.pi
    normals = -np.column_stack([np.cos(turn), np.sin(turn)])
    vertices = -40 * normals
    rng = np.random.default_rng(2)
    owner = rng.integers(0, 60, 5000)
    tangents = np.column_stack([normals[:, 1], -normals[:, 0]])[owner]
    points = vertices[owner] + rng.normal(0, 0.5, (5000, 1)) * normals[owner]
    points += rng.uniform(-1.6, 1.6, (5000, 1)) * tangents  # the step is 4.19
    heights = 100 + points[:, 0] + rng.normal(0, 0.1, 5000)
    cells, at, _ = gather(
        points, vertices, normals, np.full(60, 5.0), closed=True,
        heights_mm=heights if with_heights else None,
    )  # fmt: skip
    assert cells.total == 5000
    for row, vertex in enumerate(at):
        mine = owner == vertex
        own = np.column_stack([points[mine], heights[mine]])
        spread = np.cov(own.T, bias=True)
        assert cells.counts[row] == mine.sum()
        np.testing.assert_allclose(cells.means_mm[row], own[:, :2].mean(axis=0), atol=1e-9)
        plane = [spread[0, 0], spread[0, 1], spread[1, 1]]
        np.testing.assert_allclose(cells.covariances_mm2[row], plane, atol=1e-9)
        across = (own[:, :2] - vertices[vertex]) @ normals[vertex]
        outermost = own[[across.argmin(), across.argmax()], :2]
        np.testing.assert_allclose(cells.extremes_mm[row], outermost)
        if with_heights:
            assert cells.heights_mm[row] == pytest.approx(own[:, 2].mean())
            upward = [spread[2, 0], spread[2, 1], spread[2, 2]]
            np.testing.assert_allclose(cells.height_covariances_mm2[row], upward, atol=1e-7)
    assert len(cells.heights_mm) == (len(cells) if with_heights else 0)


def test_in_a_tight_bend_every_point_is_filed_on_its_own_wall_and_nothing_is_lost() -> None:
    vertices, normals = hairpin()
    rng = np.random.default_rng(3)
    owner = rng.integers(0, 200, 5000)
    points = vertices[owner] + 0.3 * rng.normal(size=(5000, 1)) * normals[owner]
    cells, at, left_out = gather(points, vertices, normals, np.full(200, 2.0), closed=False)
    assert left_out == 0
    np.testing.assert_allclose(cells.counts @ cells.means_mm, points.sum(axis=0), rtol=1e-9)
    second = cells.covariances_mm2[:, 0] + cells.means_mm[:, 0] ** 2
    assert cells.counts @ second == pytest.approx((points[:, 0] ** 2).sum())
    assert np.linalg.norm(cells.means_mm - vertices[at], axis=1).max() < 1.0  # walls: 3 apart


def test_a_point_by_itself_is_a_cell_of_one() -> None:
    points = np.array([[1.0, 2.0], [3.0, 4.0]])
    cells = cells_of_points(points, np.array([5.0, 6.0]))
    assert cells.total == 2
    np.testing.assert_array_equal(cells.means_mm, points)
    np.testing.assert_array_equal(cells.heights_mm, [5.0, 6.0])
    assert not cells.covariances_mm2.any()
    np.testing.assert_array_equal(cells.only(np.array([1])).means_mm, points[1:])
