"""From a slice's points to outlines that know where their points truly lie."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.section import resolve_section
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.slices import Frame, Slice


def circle(
    radius: float,
    count: int,
    rng: np.random.Generator,
    *,
    x: float = 0.0,
    turn: float = math.tau,
) -> FloatArray:
    angle = rng.uniform(0.0, turn, count)
    points = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points[:, 0] += x
    return points + rng.normal(0.0, 0.05, points.shape)


def slab(rng: np.random.Generator, slope: float) -> Slice:
    """A slab of a cone about y, 2 mm thick; the radius grows by `slope` a mm of height."""
    angle, height = rng.uniform(0.0, math.tau, 4000), rng.uniform(-1.0, 1.0, 4000)
    radius = 20.0 + slope * height + rng.normal(0.0, 0.02, 4000)
    frame = Frame(np.array([0.0, 50.0, 0.0]), np.eye(3)[[2, 0, 1]])
    return Slice(
        7,
        frame.to_part(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])),
        frame,
    )


def test_a_slab_of_a_cone_keeps_the_slope_of_its_wall() -> None:
    drawn = draw_outlines(slab(np.random.default_rng(1), slope=0.5))
    (only,) = drawn.outlines
    assert (drawn.index, drawn.height_mm, only.height_mm) == (7, 50.0, 50.0)
    moments = only.moments
    assert moments.total == 4000
    # Along y in the part frame; each cell's height goes with the distance from the axis.
    away = moments.means_mm[:, [0, 2]]
    outward = away / np.linalg.norm(away, axis=1, keepdims=True)
    weights = moments.counts / moments.counts.sum()
    within = np.einsum("mi,mi->m", moments.covariances_mm2[:, [0, 2]][:, :, 1], outward)
    radius, height = np.linalg.norm(away, axis=1), moments.means_mm[:, 1] - 50.0
    between = (radius - weights @ radius) * (height - weights @ height)
    slope = (
        weights
        @ (within + between)
        / (weights @ (moments.covariances_mm2[:, 1, 1] + (height - weights @ height) ** 2))
    )
    assert slope == pytest.approx(0.5, abs=0.01)
    assert weights @ moments.means_mm[:, 1] == pytest.approx(50.0, abs=0.05)


def test_flat_points_have_no_height_in_their_moments() -> None:
    rng = np.random.default_rng(2)
    points = np.column_stack([circle(20.0, 800, rng), np.full(800, 3.0)])
    (only,) = draw_outlines(Slice(0, points, Frame(np.array([0.0, 0.0, 3.0]), np.eye(3)))).outlines
    assert only.moments.means_mm[:, 2] == pytest.approx(3.0, abs=1e-12)
    assert only.moments.covariances_mm2[:, 2] == pytest.approx(0.0, abs=1e-20)


def test_heights_stay_with_their_points_where_a_slice_has_several_curves() -> None:
    rng = np.random.default_rng(3)
    points = np.vstack([circle(5.0, 300, rng, x=20), circle(9.0, 500, rng, x=-20)])
    order = rng.permutation(800)
    found = resolve_section(points[order], heights_mm=points[order, 0] / 10)
    assert len(found.curves) == 2
    for curve in found.curves:
        np.testing.assert_allclose(
            curve.cells.heights_mm, curve.cells.means_mm[:, 0] / 10, atol=1e-12
        )


def test_heights_of_another_length_are_refused() -> None:
    points = circle(5.0, 100, np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"heights_mm: shape \(100,\) expected, got \(99,\)"):
        resolve_section(points, heights_mm=np.zeros(99))


def test_a_contour_in_another_is_a_hole() -> None:
    rng = np.random.default_rng(4)
    points = np.vstack([circle(20.0, 900, rng), circle(9.0, 500, rng)])
    drawn = draw_outlines(Slice(0, np.column_stack([points, np.zeros(1400)]), upright()))
    assert [each.hole for each in drawn.outlines] == [False, True]
    assert not drawn.runs


def test_an_open_run_is_listed_apart() -> None:
    rng = np.random.default_rng(5)
    points = np.vstack([circle(20.0, 900, rng), circle(9.0, 400, rng, x=50, turn=2.0)])
    drawn = draw_outlines(Slice(0, np.column_stack([points, np.zeros(1300)]), upright()))
    assert len(drawn.outlines) == len(drawn.runs) == 1
    assert not drawn.runs[0].hole


def test_a_slice_with_three_points_says_so_and_is_no_error() -> None:
    drawn = draw_outlines(Slice(3, np.zeros((3, 3)), upright()))
    assert drawn.outlines == drawn.runs == ()
    assert drawn.strays == 3
    assert drawn.notes == ("3 points; a curve needs 4",)


def upright() -> Frame:
    return Frame(np.zeros(3), np.eye(3))
