"""The cut: every point once, in its slice or set aside, whatever the chunks and the pile."""

from __future__ import annotations

import math
import tracemalloc
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction import slicing
from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.reduction import Box
from reconstruction.setting_aside import Aside
from reconstruction.slicing import Cutting, cut_cloud
from reconstruction.survey import Axis
from tests.reconstruction.part_cases import chunks_of, turned_part


def scan(*, seed: int = 0, strays: int = 40, rows: int = 40, points_a_row: int = 150) -> FloatArray:
    """A cylinder of 20 mm, shuffled, with strays that fill a far larger box."""
    rng = np.random.default_rng(seed)
    part = turned_part(
        rng,
        lambda height: np.full(len(height), 20.0),
        rows=rows,
        row_mm=0.75,
        points_a_row=points_a_row,
        noise_mm=0.1,
    )
    far = rng.uniform(-90.0, 90.0, (strays, 3))
    return np.asarray(rng.permutation(np.concatenate([part, far])))


def rows_of(points: FloatArray) -> Counter[tuple[float, ...]]:
    return Counter(tuple(row) for row in points.tolist())


def assert_same_slices(one: Cutting, other: Cutting) -> None:
    assert (one.spacing, one.aside) == (other.spacing, other.aside)
    np.testing.assert_array_equal(one.counts, other.counts)
    for left, right in zip(one.slices(), other.slices(), strict=True):
        np.testing.assert_array_equal(left.points_mm, right.points_mm)
        np.testing.assert_array_equal(left.frame.origin_mm, right.frame.origin_mm)


@pytest.mark.parametrize("axis", list(Axis))
@pytest.mark.parametrize("crop", [None, Box(np.full(3, -30.0), np.full(3, 22.0))])
def test_every_point_is_in_one_slice_or_set_aside(axis: Axis, crop: Box | None) -> None:
    points = scan()[:, np.argsort(axis.planar)]
    cut = cut_cloud(chunks_of(points, 999), axis, crop=crop)
    slices = list(cut.slices())
    assert cut.counts.tolist() == [len(piece.points_mm) for piece in slices]
    assert {reason: len(some) for reason, some in cut.aside_mm.items()} == cut.aside
    everything = np.concatenate([*(s.points_mm for s in slices), *cut.aside_mm.values()])
    assert rows_of(everything) == rows_of(points)
    if crop is not None:
        outside = ~((points >= crop.low_mm) & (points <= crop.high_mm)).all(axis=1)
        assert rows_of(cut.aside_mm[Aside.CROPPED]) == rows_of(points[outside])
        assert cut.aside[Aside.CROPPED] > 0


@pytest.mark.parametrize("axis", list(Axis))
def test_slices_come_from_the_lowest_up_in_right_handed_frames_at_their_middle(axis: Axis) -> None:
    cut = cut_cloud(chunks_of(scan()[:, np.argsort(axis.planar)]), axis)
    slices = list(cut.slices())
    assert [piece.index for piece in slices] == list(range(len(slices)))
    assert len(slices[0].points_mm) > 0
    assert len(slices[-1].points_mm) > 0
    step = cut.spacing.step_mm
    middles = [piece.frame.origin_mm[axis.column] for piece in slices]
    np.testing.assert_allclose(np.diff(middles), step)
    for piece in slices:
        assert np.linalg.det(piece.frame.axes) == pytest.approx(1.0)
        np.testing.assert_array_equal(piece.frame.axes[2], np.eye(3)[axis.column])
        heights = piece.frame.to_plane(piece.points_mm)[:, 2]
        assert np.abs(heights).max(initial=0.0) <= step / 2.0 * (1.0 + 1e-9)


def test_one_slice_by_its_number_is_the_one_of_the_row() -> None:
    cut = cut_cloud(chunks_of(scan()), Axis.Z)
    for piece in cut.slices():
        np.testing.assert_array_equal(cut.slice_at(piece.index).points_mm, piece.points_mm)


@given(st.integers(1, 7000))
@settings(max_examples=15, deadline=None)
def test_the_chunks_of_the_stream_change_nothing(size: int) -> None:
    points = scan()
    size = max(size, 40)  # below that the survey is what takes the time
    assert_same_slices(
        cut_cloud(chunks_of(points, size), Axis.Z), cut_cloud(chunks_of(points), Axis.Z)
    )


@pytest.mark.parametrize("size", [313, 100_000])
def test_a_pile_in_a_file_gives_the_slices_of_one_in_memory(
    size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = scan()
    small = cut_cloud(chunks_of(points, size), Axis.Z)
    monkeypatch.setattr(slicing, "_IN_MEMORY", 10)
    large = cut_cloud(chunks_of(points, size), Axis.Z)
    assert large.pile._memory is None
    assert_same_slices(small, large)
    assert_same_slices(small, large)  # and a second time
    np.testing.assert_array_equal(small.box.low_mm, large.box.low_mm)
    np.testing.assert_array_equal(small.box.high_mm, large.box.high_mm)


def test_the_box_is_that_of_what_was_kept() -> None:
    cut = cut_cloud(chunks_of(scan()), Axis.Z)
    kept = np.concatenate([piece.points_mm for piece in cut.slices()])
    np.testing.assert_array_equal(cut.box.low_mm, kept.min(axis=0))
    np.testing.assert_array_equal(cut.box.high_mm, kept.max(axis=0))


def test_a_large_cloud_is_cut_in_less_memory_than_it_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    chunk, chunks = 20_000, 40

    def points() -> Iterator[FloatArray]:
        for seed in range(chunks):  # the stream holds one chunk at a time
            yield scan(seed=seed, strays=0, rows=100, points_a_row=chunk // 100)

    monkeypatch.setattr(slicing, "_IN_MEMORY", 10)
    monkeypatch.setattr("reconstruction.survey._SAMPLE", 5000)
    cut_cloud(chunks_of(scan()), Axis.Z)  # compiles
    tracemalloc.start()
    try:
        cut = cut_cloud(points, Axis.Z)
        seen = sum(len(piece.points_mm) for piece in cut.slices())
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert seen == chunk * chunks
    # The grid of boxes has at most 136^3 counts of 8 bytes, held twice while it is labelled; to
    # that come some copies of a chunk. The cloud would be 19 MB.
    grid = 8 * math.prod(cut_grid(cut))
    assert peak < 4 * grid + 12 * 24 * chunk
    assert peak < 24 * chunk * chunks / 2 + 4 * grid


def cut_grid(cut: Cutting) -> tuple[int, ...]:
    """Shape of the finest grid of boxes over the core, by its own description."""
    sides = cut.survey.core.sides_mm
    return tuple(int(8 * math.ceil((side / sides.max() * 128 + 3) / 8)) for side in sides)


def test_no_more_points_set_aside_are_remembered_than_are_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slicing, "_DRAWN", 25)
    points = scan(strays=90)
    cut = cut_cloud(chunks_of(points, 500), Axis.Z)
    assert cut.aside[Aside.STRAY] > 60
    assert len(cut.aside_mm[Aside.STRAY]) == 25


def test_a_spacing_that_makes_millions_of_slices_is_refused() -> None:
    with pytest.raises(TooFewPoints, match="choose a larger --spacing-mm"):
        cut_cloud(chunks_of(scan()), Axis.Z, spacing_mm=1e-6)


def test_a_cloud_of_lonely_points_only_is_refused() -> None:
    corners = 10.0 * np.array([[i, j, k] for i in range(3) for j in range(3) for k in range(3)])
    with pytest.raises(TooFewPoints, match="everything looks stray"):
        cut_cloud(chunks_of(corners), Axis.Z)


def test_a_crop_that_leaves_nothing_is_refused() -> None:
    with pytest.raises(TooFewPoints):
        cut_cloud(chunks_of(scan()), Axis.Z, crop=Box(np.full(3, 500.0), np.full(3, 501.0)))
