"""The first look: rows, levels and density, and a sample that chunking does not change."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction import survey as module
from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.survey import Axis, Spacing, SpacingRule, choose_spacing, survey_cloud
from tests.reconstruction.part_cases import chunks_of, turned_part


def cylinder(*, rows: int, row_mm: float, points_a_row: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return turned_part(
        rng,
        lambda height: np.full(len(height), 20.0),
        rows=rows,
        row_mm=row_mm,
        points_a_row=points_a_row,
        noise_mm=0.1,
    )


def spacing_of(points: FloatArray, axis: Axis = Axis.Z, given_mm: float | None = None) -> Spacing:
    return choose_spacing(survey_cloud(chunks_of(points), axis), axis, given_mm=given_mm)


def phase(heights: FloatArray, spacing: Spacing) -> FloatArray:
    """How far heights lie from the middle of the nearest slice, in steps."""
    steps = (heights - spacing.middle_mm) / spacing.step_mm
    return np.asarray(steps - np.round(steps))


@pytest.mark.parametrize("axis", list(Axis))
def test_a_frame_of_the_stacking_axis_is_right_handed(axis: Axis) -> None:
    axes = np.eye(3)[list(axis.planar)]
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[2, "xyz".index(axis.value)] == 1.0


@pytest.mark.parametrize("axis", list(Axis))
@pytest.mark.parametrize("base_mm", [0.0, -37.3])
def test_the_rows_of_a_scanner_that_wrote_row_by_row_become_the_slices(
    axis: Axis, base_mm: float
) -> None:
    points = cylinder(rows=31, row_mm=1.25, points_a_row=600)[:, np.argsort(axis.planar)]
    points[:, axis.column] += base_mm
    found = spacing_of(points, axis)
    assert found.rule is SpacingRule.ROWS
    assert found.step_mm == pytest.approx(1.25, rel=1e-9)
    np.testing.assert_allclose(phase(points[:, axis.column], found), 0.0, atol=1e-6)


def test_a_scanner_that_wrote_column_by_column_shows_its_rows_too() -> None:
    angle, height = np.meshgrid(np.linspace(0.0, 6.2, 500), np.arange(40) * 0.8, indexing="ij")
    points = np.column_stack([20.0 * np.cos(angle.ravel()), 20.0 * np.sin(angle.ravel())])
    found = spacing_of(np.column_stack([points, height.ravel()]))
    assert found.rule is SpacingRule.ROWS
    assert found.step_mm == pytest.approx(0.8, rel=1e-9)


@pytest.mark.parametrize("rows", [6, 25, 100])
def test_levels_of_a_shuffled_cloud_become_the_slices(rows: int) -> None:
    rng = np.random.default_rng(3)
    points = rng.permutation(cylinder(rows=rows, row_mm=2.0, points_a_row=500))
    points[:, 2] += rng.uniform(-0.2, 0.2, len(points))
    found = spacing_of(points)
    assert found.rule is SpacingRule.LEVELS
    # Over all levels the step may drift by a tenth of one: each level has a slice of its own.
    assert found.step_mm == pytest.approx(2.0, rel=0.1 / rows)
    assert np.abs(phase(points[:, 2], found)).max() < 0.25


@pytest.mark.parametrize("height_mm", [0.7, 3.4, 9.3])
def test_a_stray_between_levels_does_not_move_them(height_mm: float) -> None:
    rows = cylinder(rows=6, row_mm=2.0, points_a_row=240)
    strays = np.array([[60.0, 0.0, height_mm], [0.0, 60.0, height_mm + 0.2]])
    found = spacing_of(np.concatenate([rows, strays]))
    assert found.rule is SpacingRule.LEVELS
    assert found.step_mm == pytest.approx(2.0, rel=1e-9)


def test_a_thin_cloud_has_several_rows_to_a_slice() -> None:
    # 12 points around 126 mm, rows 0.5 mm apart: slices half as far apart as points in them need
    # sqrt(0.5 * 126 / 12 / 0.5) = 3.2, that is 4 rows.
    points = cylinder(rows=100, row_mm=0.5, points_a_row=12)
    found = spacing_of(points)
    assert found.rule is SpacingRule.ROWS
    assert found.step_mm == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(("count", "slices"), [(400, 5), (6000, 30), (50_000, 100)])
def test_without_rows_or_levels_the_density_decides(count: int, slices: int) -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform([-20.0, -20.0, 10.0], [20.0, 20.0, 60.0], (count, 3))
    found = spacing_of(points)
    assert found.rule is SpacingRule.DENSITY
    # The inner 99 % of the heights are divided.
    assert found.step_mm == pytest.approx(50.0 / slices, rel=0.03)
    lowest = points[:, 2].min()
    assert found.middle_mm == pytest.approx(lowest + found.step_mm / 2.0, abs=1e-9)


def test_a_spacing_that_is_given_is_kept_and_only_put_in_step() -> None:
    points = cylinder(rows=31, row_mm=1.25, points_a_row=60)
    found = spacing_of(points, given_mm=2.5)
    assert (found.step_mm, found.rule) == (2.5, SpacingRule.GIVEN)


def test_strays_are_in_the_box_and_not_in_the_core() -> None:
    points = cylinder(rows=40, row_mm=1.0, points_a_row=200)
    found = survey_cloud(chunks_of(np.concatenate([points, [[500.0, -400.0, 900.0]]])), Axis.Z)
    assert found.box.high_mm.tolist() == [500.0, found.box.high_mm[1], 900.0]
    assert found.box.low_mm[1] == -400.0
    assert (found.core.high_mm < [45.0, 45.0, 65.0]).all()
    assert (found.core.high_mm >= points.max(axis=0) - 1e-9).all()
    assert (found.core.low_mm <= points.min(axis=0) + 1e-9).all()


@given(st.integers(1, 3000), st.integers(1, 50), st.lists(st.integers(1, 700), max_size=30))
@settings(max_examples=100, deadline=None)
def test_the_sample_is_every_kth_point_whatever_the_chunks(
    count: int, wanted: int, cuts: list[int]
) -> None:
    stream = np.arange(3.0 * count).reshape(count, 3)
    thinning = module._Thinning(wanted)
    for chunk in np.split(stream, np.unique(np.cumsum([0, *cuts]).clip(0, count))):
        thinning.add(chunk)
    stride = 2 ** max(0, math.ceil(math.log2(count / (2 * wanted))))
    np.testing.assert_array_equal(thinning.points, stream[::stride])
    assert len(thinning.points) <= 2 * wanted


@pytest.mark.parametrize("size", [7, 100, 1000, 99_999])
def test_a_survey_does_not_depend_on_the_chunks(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SAMPLE", 500)
    points = np.random.default_rng(0).uniform(-5.0, 5.0, (3000, 3))
    whole, parts = (survey_cloud(chunks_of(points, n), Axis.Z) for n in (10**6, size))
    assert whole.points == parts.points == 3000
    np.testing.assert_array_equal(whole.sample_mm, parts.sample_mm)
    np.testing.assert_array_equal(whole.box.low_mm, parts.box.low_mm)
    np.testing.assert_array_equal(whole.core.high_mm, parts.core.high_mm)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_than_four_points_are_no_cloud(count: int) -> None:
    with pytest.raises(TooFewPoints, match=f"^{count} points"):
        survey_cloud(chunks_of(np.ones((count, 3))), Axis.Z)


def test_points_in_one_place_are_no_cloud() -> None:
    with pytest.raises(TooFewPoints, match="all 9 points lie in one place"):
        survey_cloud(chunks_of(np.ones((9, 3))), Axis.Z)
