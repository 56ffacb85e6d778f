"""Each loop over the points, or over what stands for them, against its naive twin."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from reconstruction.arrays import FloatArray
from reconstruction.fitting.cells import bounds, heap_up
from reconstruction.fitting.crossing import _first_crossing, crossings
from reconstruction.fitting.frames import frames
from reconstruction.fitting.linking import _flood, apart, link, neighbours_of
from reconstruction.fitting.nearness import nearest_way
from reconstruction.fitting.spanning import _uncross, span, spanning_tree

SEEDS = st.integers(0, 2**32 - 1)


def scattered(seed: int, count: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(-3.0, 5.0, (count, 2))


@given(SEEDS, st.integers(1, 60))
@settings(max_examples=50, deadline=None)
def test_bounds_are_the_least_and_greatest_coordinates(seed: int, count: int) -> None:
    points = scattered(seed, count)
    low, high = bounds(points)
    np.testing.assert_array_equal(low, points.min(axis=0))
    np.testing.assert_array_equal(high, points.max(axis=0))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", [0, 1])
def test_bounds_are_infinite_if_any_coordinate_is_no_number(bad: float, column: int) -> None:
    points = scattered(0, 9)
    points[5, column] = bad
    assert np.isinf(bounds(points)).all()


def naive_heaps(points: FloatArray, low: FloatArray, edge: float) -> dict[tuple[int, int], list]:
    heaps: dict[tuple[int, int], list] = {}
    for point in points:
        box = math.floor((point[0] - low[0]) / edge), math.floor((point[1] - low[1]) / edge)
        heaps.setdefault(box, []).append(point)
    return heaps


@given(SEEDS, st.integers(2, 80), st.floats(0.2, 3.0))
@settings(max_examples=50, deadline=None)
def test_heaps_are_the_points_of_a_box_and_their_mean(seed: int, count: int, edge: float) -> None:
    points = scattered(seed, count)
    low, high = points.min(axis=0), points.max(axis=0)
    heaps = heap_up(points, low, high, edge)
    naive = naive_heaps(points, low, heaps.lattice.edge_mm)
    means = sorted(np.mean(held, axis=0).tolist() for held in naive.values())
    np.testing.assert_allclose(sorted(heaps.places_mm.tolist()), means, atol=1e-12)
    assert heaps.counts.sum() == count
    numbers = heaps.of_points(points, np.arange(len(naive)))
    for held in naive.values():
        (number,) = set(numbers[(points[:, None] == held).all(axis=2).any(axis=1)].tolist())
        np.testing.assert_allclose(heaps.places_mm[number], np.mean(held, axis=0), atol=1e-12)


def test_points_outside_the_lattice_belong_to_no_heap() -> None:
    points = np.array([[0.5, 0.5], [1.5, 0.5], [9.0, 0.5], [-0.1, 0.5]])
    heaps = heap_up(points, np.zeros(2), np.full(2, 1.9), 1.0)
    assert heaps.counts.sum() == 2
    np.testing.assert_array_equal(heaps.of_points(points, np.array([7, 8])), [7, 8, -1, -1])


@given(SEEDS, st.integers(2, 5))
@settings(max_examples=30, deadline=None)
def test_coarsened_heaps_are_those_of_wider_boxes(seed: int, times: int) -> None:
    points = scattered(seed, 100)
    low, high = points.min(axis=0), points.max(axis=0)
    fine = heap_up(points, low, high, 0.3)
    coarse = fine.coarsened(times)
    naive = naive_heaps(points, low, times * fine.lattice.edge_mm)
    means = sorted(np.mean(held, axis=0).tolist() for held in naive.values())
    np.testing.assert_allclose(sorted(coarse.places_mm.tolist()), means, atol=1e-12)
    own = coarse.places_mm[coarse.of_points(points, np.arange(len(naive)))]
    assert np.abs(own - points).max() <= times * fine.lattice.edge_mm


@given(SEEDS, st.integers(2, 60))
@settings(max_examples=50, deadline=None)
def test_neighbours_are_those_within_both_reaches(seed: int, count: int) -> None:
    places = scattered(seed, count)
    reach = np.random.default_rng(seed).uniform(0.1, 3.0, count)
    starts, neighbours = neighbours_of(places, reach)
    near = cdist(places, places) <= np.minimum(reach[:, None], reach[None, :])
    np.fill_diagonal(near, val=False)
    for n in range(count):
        found = sorted(neighbours[starts[n] : starts[n + 1]].tolist())
        assert found == np.flatnonzero(near[n]).tolist()


def sees(place: FloatArray, other: FloatArray, frame: FloatArray, reach: float) -> bool:
    """Whether another place lies in the ellipse that one sees."""
    along = float((other - place) @ frame[:2]) / frame[2]
    across = float((other - place) @ [-frame[1], frame[0]])
    return bool(along**2 + across**2 <= reach**2)


@given(SEEDS, st.integers(2, 40))
@settings(max_examples=50, deadline=None)
def test_neighbours_with_a_direction_see_each_other_in_their_ellipses(
    seed: int, count: int
) -> None:
    places, rng = scattered(seed, count), np.random.default_rng(seed)
    reach, angle = rng.uniform(0.1, 2.0, count), rng.uniform(0.0, math.pi, count)
    looks = np.column_stack([np.cos(angle), np.sin(angle), rng.uniform(1.0, 3.0, count)])
    starts, neighbours = neighbours_of(places, reach, looks)
    for n in range(count):
        mutual = [
            m
            for m in range(count)
            if m != n
            and sees(places[n], places[m], looks[n], reach[n])
            and sees(places[m], places[n], looks[m], reach[m])
        ]
        assert sorted(neighbours[starts[n] : starts[n + 1]].tolist()) == mutual


@given(SEEDS, st.integers(2, 40))
@settings(max_examples=30, deadline=None)
def test_places_of_another_kind_are_no_neighbours(seed: int, count: int) -> None:
    places, kind = scattered(seed, count), np.random.default_rng(seed).integers(0, 3, count)
    starts, neighbours = neighbours_of(places, np.full(count, 2.0))
    kept, of_kind = apart(starts, neighbours, kind)
    for n in range(count):
        before = neighbours[starts[n] : starts[n + 1]]
        after = of_kind[kept[n] : kept[n + 1]]
        assert after.tolist() == before[kind[before] == kind[n]].tolist()


def naive_frame(hood: FloatArray, sizes: list[int]) -> tuple[FloatArray, float, float]:
    """Direction, deviation about a parabola and slenderness of the most slender neighbourhood."""
    best, chosen, direction = math.inf, hood, np.zeros(2)
    for size in sizes:
        near = hood[:size] - hood[:size].mean(axis=0)
        values, vectors = np.linalg.eigh(near.T @ near)
        ratio = values[0] / values[1] * (size - 1) / (size - 2) * (1 + 4 / size)
        if ratio < best:
            best, chosen, direction = ratio, hood[:size], vectors[:, 1]
    along, across = chosen @ direction, chosen @ [-direction[1], direction[0]]
    left = across - np.polyval(np.polyfit(along, across, 2), along)
    return direction, math.sqrt((left**2).sum() / (len(left) - 3)), 1.0 / math.sqrt(best)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_frames_are_principal_axes_of_the_most_slender_neighbourhood(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 10.0, 80)
    places = np.stack([x, 0.1 * x**2 + rng.normal(0.0, 0.2, 80)], axis=1)
    near = np.argsort(cdist(places, places), axis=1)[:, :27]
    sizes = [6, 9, 13, 19, 27]
    found = frames(places, near, np.array(sizes))
    for n in range(0, 80, 7):
        direction, across, slender = naive_frame(places[near[n]], sizes)
        assert abs(found[n, :2] @ direction) == pytest.approx(1.0)
        assert found[n, 2] == pytest.approx(across, rel=1e-6)
        assert found[n, 3] == pytest.approx(slender)
        assert found[n, 4] == pytest.approx(naive_frame(places[near[n]], [27])[2])


def test_the_deviation_of_a_few_places_is_about_a_line() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0.0, 10.0, (40, 2)) * [1.0, 0.1]
    near = np.argsort(cdist(places, places), axis=1)[:, :5]
    found = frames(places, near, np.array([5]))
    for n in range(40):
        hood = places[near[n]]
        along, across = hood @ found[n, :2], hood @ [-found[n, 1], found[n, 0]]
        left = across - np.polyval(np.polyfit(along, across, 1), along)
        assert found[n, 2] == pytest.approx(math.sqrt((left**2).sum() / 3), rel=1e-6, abs=1e-9)


def test_the_frames_of_a_band_tell_its_thickness_also_with_another_three_bands_off() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(0.0, 100.0, 2000)
    y = rng.uniform(-0.5, 0.5, 2000) + np.where(rng.random(2000) < 0.5, 0.0, 3.0)
    places = np.stack([x, y], axis=1)
    near = np.argsort(cdist(places[:200], places), axis=1)[:, :128]
    found = frames(places, near, np.array([8, 12, 18, 27, 40, 60, 90, 128]))
    # Within a tenth: of a hood of a dozen places the deviation is known to a fifth, of 200 hoods
    # the median to a fiftieth, and the most slender look a little thinner than they are.
    assert np.median(found[:, 2]) * math.sqrt(12.0) == pytest.approx(1.0, rel=0.1)


def naive_crossing(one: FloatArray, other: FloatArray) -> bool:
    """Solve for where the lines meet."""
    arms = np.column_stack([one[1] - one[0], other[0] - other[1]])
    if abs(np.linalg.det(arms)) < 1e-12:
        return False
    shares = np.linalg.solve(arms, other[0] - one[0])
    return bool(((shares > 0.0) & (shares < 1.0)).all())


@given(SEEDS, st.integers(1, 12), st.integers(1, 12))
@settings(max_examples=50, deadline=None)
def test_crossings_are_where_the_lines_meet_within_both_ways(seed: int, k: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    ways, others = rng.uniform(0.0, 1.0, (k, 2, 2)), rng.uniform(0.0, 1.0, (m, 2, 2))
    naive = [[naive_crossing(one, other) for other in others] for one in ways]
    np.testing.assert_array_equal(crossings(ways, others), naive)
    pairs = [(i, j) for i in range(k) for j in range(i + 1, k) if naive_crossing(ways[i], ways[j])]
    assert _first_crossing(ways) == (pairs[0] if pairs else (-1, -1))


@given(SEEDS, st.integers(1, 30), st.integers(1, 20))
@settings(max_examples=30, deadline=None)
def test_the_nearest_way_is_the_one_that_no_other_is_nearer_than(
    seed: int, count: int, ways: int
) -> None:
    rng = np.random.default_rng(seed)
    places, starts = rng.uniform(0.0, 1.0, (count, 2)), rng.uniform(0.0, 1.0, (ways, 2))
    arms = rng.uniform(-0.5, 0.5, (ways, 2))
    way, away = nearest_way(places, starts, arms)
    shares = np.linspace(0.0, 1.0, 2001)[:, None, None]
    dense = np.linalg.norm((starts + shares * arms)[:, None] - places[:, None], axis=3).min(axis=0)
    np.testing.assert_allclose(away, dense.min(axis=1), atol=1e-3)
    np.testing.assert_allclose(dense[np.arange(count), way], dense.min(axis=1), atol=1e-3)


def naive_steps(near: np.ndarray, seed: int) -> dict[int, int]:
    """Steps from a seed, breadth first."""
    steps, queue = {seed: 0}, deque([seed])
    while queue:
        here = queue.popleft()
        for other in np.flatnonzero(near[here]):
            if int(other) not in steps:
                steps[int(other)] = steps[here] + 1
                queue.append(int(other))
    return steps


@given(SEEDS, st.integers(2, 50), st.floats(0.3, 2.5))
@settings(max_examples=50, deadline=None)
def test_slabs_are_what_hangs_together_at_one_step_of_the_flood(
    seed: int, count: int, reach: float
) -> None:
    places = scattered(seed, count)
    near = cdist(places, places) <= reach
    np.fill_diagonal(near, val=False)
    slab, pairs, levels = _flood(*neighbours_of(places, np.full(count, reach)))
    touching = {(min(a, b), max(a, b)) for a, b in slab[np.argwhere(near)] if a != b}
    assert {tuple(pair) for pair in pairs.tolist()} == touching
    for here in range(count):
        steps = naive_steps(near, here)
        level = levels[slab[here]]
        # A flood's own seed is its only place at step 0; from there its levels are the steps.
        if level == 0:
            assert all(levels[slab[place]] == step for place, step in steps.items())
        same = near & (levels[slab][:, None] == levels[slab][None, :])
        assert set(naive_steps(same, here)) == set(np.flatnonzero(slab == slab[here]).tolist())


def test_a_ring_of_places_is_a_closed_run_and_a_row_an_open_one() -> None:
    angle = np.linspace(0.0, math.tau, 60, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    row = np.stack([np.linspace(3.0, 6.0, 31), np.zeros(31)], axis=1)
    both = np.vstack([ring, row])
    runs = link(both, *neighbours_of(both, np.full(91, 0.25)))
    assert sorted(runs.closed) == [False, True]
    assert runs.flaws <= 1  # where the two sides of the flood meet
    assert len(set(runs.run_of_place[:60])) == len(set(runs.run_of_place[60:])) == 1
    slots = runs.slot_of_place[60:]
    assert (np.diff(slots) >= 0).all() or (np.diff(slots) <= 0).all()


def test_a_spur_and_a_hole_in_a_band_are_flaws_and_no_runs() -> None:
    x, y = np.meshgrid(np.arange(60.0), np.arange(3.0))
    band = np.stack([x.ravel(), y.ravel()], axis=1)
    hole = (np.abs(band[:, 0] - 40.5) < 1.0) & (band[:, 1] == 1.0)
    spur = np.array([[20.0, 3.4], [20.0, 4.8]])
    places = np.vstack([band[~hole], spur])
    runs = link(places, *neighbours_of(places, np.full(len(places), 1.5)))
    assert runs.closed == (False,)
    assert runs.flaws >= 1
    assert (runs.run_of_place == 0).all()


@given(SEEDS, st.integers(2, 40))
@settings(max_examples=50, deadline=None)
def test_the_spanning_tree_is_as_short_as_the_textbook_one(seed: int, count: int) -> None:
    places = scattered(seed, count)
    parents, lengths = spanning_tree(places)
    assert (parents < 0).sum() == 1
    shortest = minimum_spanning_tree(cdist(places, places)).sum()
    assert lengths.sum() == pytest.approx(shortest)
    children = np.flatnonzero(parents >= 0)
    steps = np.linalg.norm(places[children] - places[parents[children]], axis=1)
    np.testing.assert_allclose(lengths[children], steps)


@given(SEEDS, st.integers(3, 25))
@settings(max_examples=40, deadline=None)
def test_an_uncrossed_path_keeps_its_points_and_cannot_be_shortened_by_a_turn(
    seed: int, count: int
) -> None:
    places = scattered(seed, count)
    order = np.arange(count)
    _uncross(places, order)
    assert sorted(order.tolist()) == list(range(count))

    def length(way: np.ndarray) -> float:
        return float(np.linalg.norm(np.diff(places[way], axis=0), axis=1).sum())

    for i in range(count - 1):
        for j in range(i + 2, count):
            turned = np.concatenate([order[: i + 1], order[i + 1 : j + 1][::-1], order[j + 1 :]])
            assert length(turned) >= length(order) - 1e-9


def test_single_file_is_refused_where_the_points_fill_a_band() -> None:
    rng = np.random.default_rng(1)
    angle = rng.uniform(0.0, math.tau, 150)
    for band, follows in ((0.01, True), (0.6, False)):
        radius = 1.0 + rng.uniform(-band / 2, band / 2, 150)
        ring = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        assert (span(ring) is not None) == follows


def test_a_branch_of_a_single_file_is_a_run_of_its_own() -> None:
    stem = np.stack([np.arange(40.0), np.zeros(40)], axis=1)
    branch = np.stack([np.full(9, 20.3), np.arange(1.0, 10.0)], axis=1)
    runs = span(np.vstack([stem, branch]))
    assert runs is not None
    assert sorted(len(run) for run in runs) == [9, 40]
