"""Reduction against a dictionary of cells, on both of its ways through memory."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction import reduction
from reconstruction.arrays import FloatArray
from reconstruction.reduction import Box, Cells, bounding_box, reduce_points

Size = tuple[float, float, float]
WAYS = {"dense": 8_000_000, "sorted": 0}  # boxes up to which the grid is dense


@pytest.fixture(params=list(WAYS))
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(reduction, "_DENSE_BOXES", WAYS[request.param])
    return str(request.param)


def naive_cells(
    points: FloatArray, size: Size, origin: FloatArray
) -> dict[tuple[int, ...], tuple[int, FloatArray]]:
    """Cell by cell in a dictionary: how many points, and their mean."""
    boxes: dict[tuple[int, ...], list[FloatArray]] = defaultdict(list)
    for point in points:
        key = tuple(
            0 if math.isinf(side) else math.floor((value - corner) / side)
            for value, corner, side in zip(point, origin, size, strict=True)
        )
        boxes[key].append(point)
    return {key: (len(inside), np.mean(inside, axis=0)) for key, inside in boxes.items()}


def assert_same(cells: Cells, expected: dict[tuple[int, ...], tuple[int, FloatArray]]) -> None:
    found = [tuple(int(i) for i in box) for box in cells.lattice]
    assert found == sorted(expected), "the cells come in order of their lattice indices"
    assert cells.counts.tolist() == [expected[box][0] for box in found]
    means = np.array([expected[box][1] for box in found])
    np.testing.assert_allclose(cells.centres_mm, means, rtol=0.0, atol=1e-11)


# Powers of two and eighths: borders are hit exactly, and both ways compute without rounding.
sides = st.sampled_from([0.25, 0.5, 1.0, 2.0, math.inf])
eighths = st.integers(-64, 64).map(lambda n: n / 8.0)
places = st.tuples(eighths, eighths, eighths)


@pytest.mark.parametrize("limit", WAYS.values(), ids=WAYS.keys())
@given(
    points=st.lists(places, min_size=1, max_size=60),
    size=st.tuples(sides, sides, sides),
    origin=st.none() | places,
    given_box=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_every_cell_holds_what_a_dictionary_holds_even_on_the_borders(
    limit: int,
    points: list[tuple[float, float, float]],
    size: Size,
    origin: tuple[float, float, float] | None,
    given_box: bool,  # noqa: FBT001 (hypothesis draws it)
) -> None:
    cloud = np.array(points)
    within = Box(cloud.min(axis=0) - 0.125, cloud.max(axis=0) + 3.0) if given_box else None
    start = cloud.min(axis=0) if within is None else within.low_mm
    corner = start if origin is None else np.array(origin)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reduction, "_DENSE_BOXES", limit)
        cells = reduce_points(
            cloud,
            size_mm=size,
            origin_mm=None if origin is None else np.array(origin),
            within=within,
        )
    assert_same(cells, naive_cells(cloud, size, corner))


@pytest.mark.parametrize("size", [(0.7, 1.3, math.inf), (3.1, 0.9, 2.3), (math.inf, 1.1, 0.7)])
def test_a_random_cloud_far_from_the_origin_is_reduced_as_by_the_dictionary(
    way: str, size: Size
) -> None:
    rng = np.random.default_rng(5)
    cloud = rng.normal([-350.0, 120.0, 7.0], 6.0, (4000, 3))
    origin = np.array([0.3, -0.2, 0.1])
    cells = reduce_points(cloud, size_mm=size, origin_mm=origin)
    assert_same(cells, naive_cells(cloud, size, origin))
    assert cells.counts.sum() == len(cloud)


@given(
    st.integers(0, 2**32 - 1),
    st.tuples(*[st.floats(0.05, 5.0)] * 3),
    st.floats(-1e4, 1e4),
)
@settings(max_examples=60, deadline=None)
def test_whatever_the_rounding_no_point_is_lost_and_no_centre_leaves_its_cell(
    seed: int, size: Size, shift: float
) -> None:
    rng = np.random.default_rng(seed)
    # On the borders as they come out in floating point.
    cloud = shift + rng.integers(-6, 6, (200, 3)) * np.array(size)
    origin = np.full(3, shift)
    cells = reduce_points(cloud, size_mm=size, origin_mm=origin)
    assert cells.counts.sum() == len(cloud)
    np.testing.assert_allclose(
        cells.counts @ cells.centres_mm, cloud.sum(axis=0), rtol=0.0, atol=1e-6
    )
    away = cells.centres_mm - origin - cells.lattice * np.array(size)
    slack = 1e-11 * max(1.0, abs(shift))
    assert (away >= -slack).all()
    assert (away <= np.array(size) + slack).all()


def test_no_points_make_no_cells() -> None:
    cells = reduce_points(np.empty((0, 3)), size_mm=(1.0, 1.0, 1.0))
    assert len(cells) == 0
    assert cells.lattice.shape == cells.centres_mm.shape == (0, 3)


def test_cells_cannot_be_written_to() -> None:
    cells = reduce_points(np.zeros((2, 3)), size_mm=(1.0, 1.0, 1.0))
    for array in (cells.lattice, cells.centres_mm, cells.counts):
        assert not array.flags.writeable


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("size", [(0.5, 0.5, 0.5), (0.5, 0.5, math.inf), (math.inf, 0.5, 0.5)])
@pytest.mark.parametrize("boxed", [True, False], ids=["within a box", "without a box"])
def test_what_is_not_finite_is_refused_on_every_axis(
    way: str,
    bad: float,
    column: int,
    size: Size,
    boxed: bool,  # noqa: FBT001 (a parameter of the test, not of a caller)
) -> None:
    cloud = np.full((5, 3), 0.4)
    cloud[3, column] = bad
    within = Box(np.zeros(3), np.ones(3)) if boxed else None
    with pytest.raises(ValueError, match="finite"):
        reduce_points(cloud, size_mm=size, within=within)


@pytest.mark.parametrize("column", [0, 1, 2])
@pytest.mark.parametrize("beyond", [-0.1, -0.4, -30.0, 30.0, 1e12])
def test_a_point_outside_the_given_box_is_refused_or_counted_in_its_own_cell(
    way: str, column: int, beyond: float
) -> None:
    cloud = np.full((5, 3), 0.4)
    cloud[3, column] = beyond
    with pytest.raises(ValueError, match="within the box"):
        reduce_points(cloud, size_mm=(0.5, 0.5, 0.5), within=Box(np.zeros(3), np.ones(3)))


@pytest.mark.parametrize("size", [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, math.nan)])
def test_a_side_that_is_not_positive_is_refused(size: Size) -> None:
    with pytest.raises(ValueError, match="positive"):
        reduce_points(np.zeros((1, 3)), size_mm=size)


@pytest.mark.parametrize("shape", [(3,), (4, 2), (2, 3, 1)])
def test_points_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        reduce_points(np.zeros(shape), size_mm=(1.0, 1.0, 1.0))


def test_strided_and_single_precision_points_are_reduced_like_their_copies() -> None:
    cloud: Any = np.random.default_rng(2).normal(size=(300, 6)).astype(np.float32)
    strided = reduce_points(cloud[:, ::2], size_mm=(0.5, 0.5, math.inf))
    copied = reduce_points(np.array(cloud[:, ::2], dtype=np.float64), size_mm=(0.5, 0.5, math.inf))
    np.testing.assert_array_equal(strided.lattice, copied.lattice)
    np.testing.assert_array_equal(strided.centres_mm, copied.centres_mm)


@given(st.lists(places, min_size=1, max_size=40))
@settings(max_examples=60, deadline=None)
def test_a_bounding_box_is_what_numpy_says(points: list[tuple[float, float, float]]) -> None:
    cloud = np.array(points)
    box = bounding_box(cloud)
    np.testing.assert_array_equal(box.low_mm, cloud.min(axis=0))
    np.testing.assert_array_equal(box.high_mm, cloud.max(axis=0))
    np.testing.assert_array_equal(box.sides_mm, np.ptp(cloud, axis=0))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", [0, 3, 6])
def test_a_bounding_box_of_what_is_not_finite_is_refused(bad: float, row: int) -> None:
    cloud = np.random.default_rng(1).normal(size=(7, 3))
    cloud[row, row % 3] = bad
    with pytest.raises(ValueError, match="finite"):
        bounding_box(cloud)
