"""Pairs against all possible choices, and counts that pairs can connect."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.correspondence import connect_pairs, counts_between
from tests.reconstruction.part_cases import ring


def naive_choices(count: int, pairs: int) -> list[tuple[int, ...]]:
    """All ways to take `pairs` of the segments k to k + 1 of which no two share a point."""
    return [
        chosen
        for chosen in combinations(range(count - 1), pairs)
        if all(b - a >= 2 for a, b in pairwise(chosen))
    ]


def pairs_of(groups: list[int], count: int) -> tuple[int, ...]:
    """The segments inside the groups of two."""
    return tuple(a for a, b in pairwise([*groups, count]) if b - a == 2)


@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.data())
@settings(max_examples=150, deadline=None)
def test_the_pairs_are_the_nearest_points_of_all_choices(
    seed: int, count: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-10.0, 10.0, (count, 3)) * rng.choice([1e-3, 1.0, 1e3])
    pairs = data.draw(st.integers(0, count // 2))
    groups = connect_pairs(points, count - pairs).tolist()
    assert groups[0] == 0
    assert {b - a for a, b in pairwise([*groups, count])} <= {1, 2}
    assert len(groups) == count - pairs
    # Distances within 5 % of the mean one count as equal: each pair is rounded by half of that.
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    best = min(steps[list(choice)].sum() for choice in naive_choices(count, pairs))
    found = steps[list(pairs_of(groups, count))].sum()
    assert found <= best + pairs * 0.05 * steps.mean() + 1e-9 * steps.mean()


@pytest.mark.parametrize(("count", "pairs"), [(8, 1), (9, 3), (12, 2), (12, 4), (12, 6), (13, 5)])
def test_equal_distances_spread_the_pairs_as_evenly_as_any_choice(count: int, pairs: int) -> None:
    groups = connect_pairs(ring(10.0, count), count - pairs).tolist()

    def unevenness(choice: tuple[int, ...]) -> float:
        pace = pairs / count
        return sum(abs(n + 0.5 - pace * (k + 1)) for n, k in enumerate(choice))

    best = min(unevenness(choice) for choice in naive_choices(count, pairs))
    assert unevenness(pairs_of(groups, count)) == pytest.approx(best, abs=1e-9)


def test_the_papers_example_of_15_onto_10_makes_5_pairs() -> None:
    points: FloatArray = np.cumsum([0, 1, 3, 1, 3, 3, 1, 3, 3, 1, 3, 3, 1, 3, 3], dtype=float)
    groups = connect_pairs(points[:, None], 10).tolist()
    assert pairs_of(groups, 15) == (0, 2, 5, 8, 11)


def test_equal_counts_connect_one_to_one() -> None:
    assert connect_pairs(ring(10.0, 9), 9).tolist() == list(range(9))


@pytest.mark.parametrize("smaller", [0, 4, 10, -1])
def test_more_than_twice_as_many_points_are_refused(smaller: int) -> None:
    with pytest.raises(ValueError, match="cannot be connected in pairs"):
        connect_pairs(ring(10.0, 9), smaller)


def test_intermediate_counts_keep_every_step_within_what_pairs_connect() -> None:
    for before in range(4, 120):
        for after in range(4, 120):
            row = (before, *counts_between(before, after), after)
            for a, b in pairwise(row):
                assert max(a, b) <= 2 * min(a, b), row
            assert sorted(row, reverse=after < before) == list(row)


@given(st.integers(4, 10_000), st.integers(4, 10_000))
def test_intermediate_counts_are_none_up_to_twice_and_never_many(before: int, after: int) -> None:
    row = counts_between(before, after)
    small, big = sorted((before, after))
    assert (row == ()) is (big <= 2 * small)
    assert len(row) <= np.log2(big / small) + 1
    assert row == counts_between(after, before)[::-1]
