"""Nearest places against a tree of scipy's, medians against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.nearness import medians_of, nearest_few


def clouds(rng: np.random.Generator) -> dict[str, FloatArray]:
    """Places (m, 2) of every kind."""
    turn = rng.uniform(0.0, 6.3, 900)
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) * rng.normal(1.0, 0.01, (900, 1))
    return {
        "a band": ring,
        "an area": rng.uniform(-1.0, 1.0, (700, 2)),
        "a line along an axis": np.column_stack([rng.uniform(0.0, 1.0, 300), np.zeros(300)]),
        "one far away": np.concatenate([ring, [[1e4, -3e4]]]),
        "two heaps": np.concatenate([rng.normal(0.0, 1e-3, (200, 2)), rng.normal(5, 1, (200, 2))]),
        "a few": rng.normal(0.0, 1.0, (5, 2)),
        "two": np.array([[0.0, 1.0], [0.0, 2.0]]),
    }


@pytest.mark.parametrize("name", clouds(np.random.default_rng(0)))
@pytest.mark.parametrize("few", [1, 4, 27])
def test_the_nearest_places_are_those_of_a_tree(name: str, few: int) -> None:
    places = clouds(np.random.default_rng(0))[name]
    count = min(few, len(places))
    distances, numbers = nearest_few(places, few)
    expected, theirs = cKDTree(places).query(places, k=list(range(1, count + 1)))
    np.testing.assert_allclose(distances, expected, rtol=1e-12, atol=1e-300)
    np.testing.assert_array_equal(numbers[:, 0], np.arange(len(places)))
    np.testing.assert_array_equal(numbers, theirs)


@pytest.mark.parametrize("few", [1, 2, 7, 8])
def test_medians_over_neighbours_are_those_of_numpy(few: int) -> None:
    rng = np.random.default_rng(few)
    values, neighbours = rng.normal(0.0, 1.0, (50, 3)), rng.integers(0, 50, (50, few))
    np.testing.assert_allclose(
        medians_of(values, neighbours), np.median(values[neighbours], axis=1), rtol=1e-14
    )
