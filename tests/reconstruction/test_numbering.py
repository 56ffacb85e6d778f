"""Numbering: counter-clockwise from the reference line, with everything that hangs on a point."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.numbering import number_contour, signed_area
from reconstruction.ordering import Contour
from tests.reconstruction.part_cases import star

Segment = frozenset[tuple[float, float]]


def random_contour(rng: np.random.Generator) -> Contour:
    count = int(rng.integers(4, 40))
    points = star(rng, count) + rng.uniform(-30.0, 30.0, 2)
    closed = bool(rng.random() < 0.5)
    bridged = rng.random(count) < 0.3
    bridged[-1] |= not closed
    visited = np.ones(60, dtype=np.bool_)
    cells = rng.permutation(60)[:count]
    return Contour(points, rng.integers(1, 99, count), bridged, closed, cells, visited)


def other_way(contour: Contour, *, back: bool, shift: int) -> Contour:
    """The same contour, told from another start and perhaps backwards."""
    count = len(contour.points_mm)
    order = (np.arange(count) + shift) % count
    order = order[::-1] if back else order
    flags = segments(contour)
    points = contour.points_mm[order]
    bridged = np.array([flags[pair] for pair in pairs_of(points)])
    return Contour(
        points,
        contour.counts[order],
        bridged,
        contour.closed,
        contour.cells[order],
        contour.visited,
    )


def pairs_of(points: np.ndarray) -> list[Segment]:
    corners = [(float(x), float(y)) for x, y in points]
    return [frozenset(pair) for pair in zip(corners, corners[1:] + corners[:1], strict=True)]


def segments(contour: Contour) -> dict[Segment, bool]:
    """Which segments, by their two ends, are bridged."""
    return dict(zip(pairs_of(contour.points_mm), contour.bridged.tolist(), strict=True))


contours = st.integers(0, 2**32 - 1).map(np.random.default_rng).map(random_contour)


@given(contours, st.floats(-40.0, 40.0))
@settings(max_examples=150, deadline=None)
def test_numbering_runs_counter_clockwise_from_the_point_nearest_to_the_line(
    contour: Contour, line_mm: float
) -> None:
    numbered = number_contour(contour, reference_x_mm=line_mm)
    assert signed_area(numbered.points_mm) > 0.0
    points = contour.points_mm
    upper = points[points[:, 1] >= points[:, 1].mean()]
    first = numbered.points_mm[0]
    assert first[1] >= points[:, 1].mean()
    assert abs(first[0] - line_mm) == np.abs(upper[:, 0] - line_mm).min()


@given(contours, st.booleans(), st.integers(0, 40))
@settings(max_examples=150, deadline=None)
def test_what_hangs_on_a_point_or_a_segment_stays_there(
    contour: Contour,
    back: bool,  # noqa: FBT001 (hypothesis draws it)
    shift: int,
) -> None:
    told = other_way(contour, back=back, shift=shift)
    numbered = number_contour(told, reference_x_mm=0.0)
    assert segments(numbered) == segments(contour)
    assert numbered.closed is contour.closed
    known = {tuple(p): (c, n) for p, c, n in zip(*row_lists(contour), strict=True)}
    assert {tuple(p): (c, n) for p, c, n in zip(*row_lists(numbered), strict=True)} == known


def row_lists(contour: Contour) -> tuple[list[list[float]], list[int], list[int]]:
    return contour.points_mm.tolist(), contour.counts.tolist(), contour.cells.tolist()


@given(contours, st.booleans(), st.integers(0, 40))
@settings(max_examples=100, deadline=None)
def test_it_does_not_matter_where_or_which_way_the_walk_went(
    contour: Contour,
    back: bool,  # noqa: FBT001 (hypothesis draws it)
    shift: int,
) -> None:
    one = number_contour(contour, reference_x_mm=1.0)
    other = number_contour(other_way(contour, back=back, shift=shift), reference_x_mm=1.0)
    np.testing.assert_array_equal(one.points_mm, other.points_mm)
    np.testing.assert_array_equal(one.bridged, other.bridged)


def test_the_line_is_met_above_the_middle_of_the_contour_not_below() -> None:
    corners = np.array([[0.0, -5.0], [4.0, 0.0], [0.5, 5.0], [-4.0, 0.5]])
    none = np.zeros(4, dtype=np.bool_)
    contour = Contour(corners, np.ones(4, dtype=int), none, True, np.arange(4), none)  # noqa: FBT003
    numbered = number_contour(contour, reference_x_mm=0.0)
    assert numbered.points_mm[0].tolist() == [0.5, 5.0]


def test_the_area_of_a_rectangle_has_the_sign_of_its_sense() -> None:
    corners = np.array([[1.0, 1.0], [4.0, 1.0], [4.0, 3.0], [1.0, 3.0]])
    assert signed_area(corners) == pytest.approx(6.0)
    assert signed_area(corners[::-1]) == pytest.approx(-6.0)
