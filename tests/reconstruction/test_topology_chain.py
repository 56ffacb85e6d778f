"""A chain and its other reading."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.crossing import Strand, uncross
from reconstruction.fitting.thinning import Row


def row_of(*places: tuple[float, float]) -> FloatArray:
    return np.array(places, dtype=np.float64)


SQUARE = row_of((0, 0), (1, 0), (2, 0), (2, 2), (0, 2))
ONES = np.ones(5)


def test_what_is_not_in_doubt_has_no_other_reading() -> None:
    assert Chain(SQUARE, ONES, closed=True, gaps=(2,)).other_reading() == ()


def test_a_loop_in_doubt_may_be_open_at_its_widest_gap() -> None:
    chain = Chain(SQUARE, np.arange(5.0), closed=True, gaps=(0, 2), ambiguous=True)
    (other,) = chain.other_reading()
    assert not other.closed
    np.testing.assert_array_equal(other.nodes_mm[0], [2, 2])
    np.testing.assert_array_equal(other.sigma_mm, [3, 4, 0, 1, 2])
    assert other.gaps == (2,)  # from (0, 0) on


def test_a_run_in_doubt_may_be_a_loop_whose_last_way_is_a_gap() -> None:
    (other,) = Chain(SQUARE, ONES, closed=False, gaps=(0,), ambiguous=True).other_reading()
    assert other.closed
    assert other.gaps == (0, 4)


def test_a_run_with_a_gap_wider_than_its_ends_are_apart_may_be_two() -> None:
    places = row_of((0, 0), (1, 0), (2, 0), (2, 9), (1, 9), (0, 2))
    chain = Chain(places, np.ones(6), closed=False, gaps=(2,), ambiguous=True)
    one, other = chain.other_reading()
    np.testing.assert_array_equal(np.vstack([one.nodes_mm, other.nodes_mm]), places)
    assert len(one.nodes_mm) == 3
    assert one.gaps == other.gaps == ()


def strand(places: FloatArray, *, closed: bool, gaps: tuple[int, ...] = ()) -> Strand:
    ones = np.ones(len(places))
    return Strand(Row(places, ones, ones, closed, gaps), 0, ambiguous=False)


def test_a_knot_is_untied_without_a_doubt() -> None:
    x = np.arange(60.0)
    places = np.stack([x, np.zeros(60)], axis=1)
    knot = row_of((30.6, 0.5), (30.2, -0.5), (30.9, -0.5))
    (found,) = uncross([strand(np.vstack([places[:31], knot, places[31:]]), closed=False)])
    assert not found.ambiguous
    assert len(found.row.nodes) >= 60


def test_a_gap_that_crosses_is_cut_rather_than_what_was_seen() -> None:
    bow = row_of((0, 0), (10, 0), (10, 10), (5, 10), (5, -5), (0, -5))
    (found,) = uncross([strand(bow, closed=True, gaps=(3,))])
    assert found.ambiguous
    assert not found.row.closed
    np.testing.assert_array_equal(found.row.nodes[0], [5, -5])


def test_of_two_rows_that_cross_the_longer_way_is_cut_and_both_are_in_doubt() -> None:
    one = strand(row_of((0, 0), (1, 0), (9, 0), (10, 0)), closed=False)
    other = strand(row_of((5, -2), (5, -1), (5, 1), (5, 2)), closed=False)
    found = uncross([one, other])
    assert len(found) == 3
    assert all(each.ambiguous for each in found)


@pytest.mark.parametrize("closed", [True, False])
def test_what_does_not_cross_stays_as_it_is(closed: bool) -> None:  # noqa: FBT001
    (found,) = uncross([strand(SQUARE, closed=closed)])
    np.testing.assert_array_equal(found.row.nodes, SQUARE)
    assert not found.ambiguous
