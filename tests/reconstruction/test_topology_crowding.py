"""A row with as many points beside it as within its thickness runs through a heap."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.fitting.crowding import count_beside, is_crowded
from reconstruction.fitting.thinning import Row
from reconstruction.fitting.topology import find_chains


def naive_count(
    nodes: FloatArray, tangents: FloatArray, half: FloatArray, places: FloatArray
) -> tuple[int, int]:
    """Places in the rectangle of each node, and in the two beside it, from 1.3 to 2.3 halves."""
    within = beside = 0
    for node, tangent, wide in zip(nodes, tangents, half, strict=True):
        along = np.abs((places - node) @ tangent) <= wide
        across = np.abs((places - node) @ np.array([-tangent[1], tangent[0]]))
        within += int((along & (across <= wide)).sum())
        beside += int((along & (across > 1.3 * wide) & (across <= 2.3 * wide)).sum())
    return within, beside


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(0, 60))
@settings(max_examples=50, deadline=None)
def test_points_within_and_beside_are_those_in_the_rectangles_of_the_nodes(
    seed: int, looks: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    nodes, places = rng.uniform(0.0, 10.0, (looks, 2)), rng.uniform(0.0, 10.0, (count, 2))
    angle, half = rng.uniform(0.0, math.tau, looks), rng.uniform(0.1, 3.0, looks)
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = count_beside(nodes, tangents, half, places)
    assert found == naive_count(nodes, tangents, half, places)


def straight(sigma: float) -> Row:
    x = np.linspace(0.0, 40.0, 81)
    nodes = np.stack([x, np.zeros_like(x)], axis=1)
    return Row(nodes, np.full(81, sigma), np.full(81, 1.0), closed=False)


@pytest.mark.parametrize("noise", ["uniform", "normal", "laplace"])
def test_a_row_along_a_band_is_not_crowded_whatever_its_noise(noise: str) -> None:
    rng = np.random.default_rng(0)
    across = {
        "uniform": rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), 4000),
        "normal": rng.normal(0.0, 1.0, 4000),
        "laplace": rng.laplace(0.0, math.sqrt(0.5), 4000),
    }[noise]
    places = np.stack([rng.uniform(0.0, 40.0, 4000), across], axis=1)
    assert not is_crowded(straight(1.0), places)


def test_a_row_through_an_area_is_crowded() -> None:
    places = np.random.default_rng(0).uniform([0.0, -6.0], [40.0, 6.0], (4000, 2))
    assert is_crowded(straight(1.0), places)


def test_bands_three_thicknesses_apart_do_not_crowd_each_other() -> None:
    rng = np.random.default_rng(0)
    band = 2.0 * math.sqrt(3.0)
    lane = 3.0 * band * rng.integers(-1, 2, 6000)
    places = np.stack([rng.uniform(0.0, 40.0, 6000), lane + rng.uniform(-band / 2, band / 2, 6000)],
                      axis=1)  # fmt: skip
    assert not is_crowded(straight(1.0), places)


@pytest.mark.parametrize("count", [400, 2000, 20_000])
@pytest.mark.parametrize("shape", ["square", "disc", "cloud", "twice as long as wide"])
def test_heaps_of_any_shape_are_named_and_not_threaded(shape: str, count: int) -> None:
    named = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        heap = rng.uniform(0.0, 10.0, (count, 2))
        if shape == "disc":
            angle, radius = math.tau * rng.random(count), np.sqrt(rng.random(count))
            heap = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        elif shape == "cloud":
            heap = rng.normal(0.0, 3.0, (count, 2))
        elif shape != "square":
            heap[:, 0] *= 2.0
        found = find_chains(heap)
        named += not found.chains and len(found.unordered) > 0.9 * count
    # A straight row that takes a whole heap for its band may be longer than three thicknesses.
    assert named >= 9
