"""Whatever is given: chains, a word for what could not be ordered, or the named error."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.topology import STRAY, UNORDERED, find_chains
from tests.reconstruction.topology_cases import ellipse, scene


def ring(count: int = 2000) -> FloatArray:
    rng = np.random.default_rng(0)
    outline = ellipse(50, 50)
    return scene(outline, rng, per_mm=count / (100 * math.pi), band_mm=1.0).points_mm


@pytest.mark.parametrize("count", range(4))
def test_fewer_than_four_points_are_too_few(count: int) -> None:
    with pytest.raises(TooFewPoints, match=f"^{count} points"):
        find_chains(ring()[:count])


@pytest.mark.parametrize("count", [4, 100, 10_000])
def test_points_in_one_place_are_too_few(count: int) -> None:
    with pytest.raises(TooFewPoints, match="one place"):
        find_chains(np.full((count, 2), 7.0))


def test_points_in_three_places_are_too_few() -> None:
    with pytest.raises(TooFewPoints, match="3 places"):
        find_chains(np.repeat([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], 50, axis=0))


@pytest.mark.parametrize("shape", [(5, 3), (5,), (2, 5, 2)])
def test_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        find_chains(np.ones(shape))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e150])
@pytest.mark.parametrize("count", [100, 5000])
def test_what_is_no_length_is_refused(bad: float, count: int) -> None:
    points = ring(count)
    points[count // 2, 1] = bad
    with pytest.raises(ValueError, match="finite lengths"):
        find_chains(points)


@pytest.mark.parametrize("count", [50, 500, 5000])
@pytest.mark.parametrize("even", [True, False])
def test_collinear_points_are_an_open_straight_run(count: int, even: bool) -> None:  # noqa: FBT001
    rng = np.random.default_rng(count)
    share = np.linspace(0.0, 1.0, count) if even else rng.uniform(0.0, 1.0, count)
    points = rng.permutation(share[:, None] * np.array([[90.0, 40.0]]))
    for chain in find_chains(points).chains:
        assert not chain.closed
        across = chain.nodes_mm @ np.array([-40.0, 90.0]) / math.hypot(40.0, 90.0)
        assert np.abs(across).max() < 1e-6
        along = np.diff(chain.nodes_mm[:, 0])
        assert (along * np.sign(along.sum()) >= -1e-9).all()


def test_far_away_in_space_the_same_loop_is_found() -> None:
    (chain,) = find_chains(ring() + 1e9).chains
    assert chain.closed
    radius = np.linalg.norm(chain.nodes_mm - 1e9, axis=1)
    assert np.abs(radius - 50.0).max() < 0.5


@pytest.mark.parametrize("count", [2000, 20_000])
def test_one_point_far_away_is_a_stray(count: int) -> None:
    near = ring(count)
    found = find_chains(np.vstack([near, [[1e9, 1e9]]]))
    (chain,) = found.chains
    assert chain.closed
    assert found.strays.tolist() == [len(near)]


@pytest.mark.parametrize("count", [2000, 20_000])
def test_whole_numbers_are_points_too(count: int) -> None:
    points = np.round(10 * ring(count)).astype(np.int64)
    (chain,) = find_chains(points).chains
    assert chain.closed


@pytest.mark.parametrize("count", [400, 20_000])
def test_a_heap_without_an_order_is_named_with_its_points(count: int) -> None:
    rng = np.random.default_rng(1)
    heap = rng.uniform(0.0, 10.0, (count, 2))
    found = find_chains(heap)
    assert found.chains == ()
    assert len(found.unordered) > 0.9 * count


def test_a_heap_beside_a_loop_does_not_keep_it_from_being_found() -> None:
    rng = np.random.default_rng(2)
    heap = rng.uniform(80.0, 90.0, (400, 2))
    found = find_chains(np.vstack([ring(), heap]))
    assert [chain.closed for chain in found.chains] == [True]
    assert set(found.unordered.tolist()) <= set(range(2000, 2400))
    assert (found.chain_of_point[2000:] < 0).mean() > 0.95


coordinates = st.one_of(
    st.floats(-1e12, 1e12),
    st.floats(-1.0, 1.0),
    st.integers(-5, 5).map(float),
    st.sampled_from([0.0, 1e-300, 1e99, -1e99, 5e-324]),
)


# An end of a run that nothing supports is dropped, and the gap before it goes with it.
LOST_END = [-5.1e11, -2.1e11, 0.0, 0.75, 0.0, 0.0, -2.7e11, 0.0, -3.8e11, 0.5, 0.0, 0.0, 1.0]


@given(arrays.arrays(np.float64, st.tuples(st.integers(4, 40), st.just(2)), elements=coordinates))
@example(np.array([[x, 1e99 if n == 7 else 0.0] for n, x in enumerate(LOST_END)]))
@settings(max_examples=200, deadline=None)
def test_any_points_are_ordered_or_named(points: FloatArray) -> None:
    try:
        found = find_chains(points)
    except TooFewPoints:
        return
    assert found.chain_of_point.shape == (len(points),)
    assert set(found.chain_of_point.tolist()) <= {STRAY, UNORDERED, *range(len(found.chains))}
    for chain in found.chains:
        assert np.isfinite(chain.nodes_mm).all()
        assert np.isfinite(chain.sigma_mm).all()


@given(st.integers(0, 2**32 - 1), st.integers(4, 4000), st.floats(0.0, 1.0), st.floats(0.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_any_mixture_of_rings_lines_and_dust_comes_through(
    seed: int, count: int, dust: float, noise: float
) -> None:
    rng = np.random.default_rng(seed)
    angle, kind = rng.uniform(0.0, math.tau, count), rng.integers(0, 3, count)
    ring_, radius = np.stack([np.cos(angle), np.sin(angle)], axis=1), rng.choice([2.0, 9.0], count)
    points = np.where(kind[:, None] == 0, radius[:, None] * ring_, angle[:, None] * [3.0, -1.0])
    points = points + rng.normal(0.0, noise, points.shape) * rng.choice([0.0, 1.0], (count, 1))
    dusty = rng.uniform(0.0, 1.0, count) < dust
    points[dusty] = rng.uniform(-20.0, 20.0, (int(dusty.sum()), 2))
    found = find_chains(points)
    accounted = len(found.strays) + len(found.unordered) + int((found.chain_of_point >= 0).sum())
    assert accounted == count
