"""Strays and the table plate are set aside, what belongs to the part is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.setting_aside import Aside, Keep, find_part
from reconstruction.slicing import cut_cloud
from reconstruction.survey import Axis, survey_cloud
from tests.reconstruction.part_cases import chunks_of, turned_part


def cylinder(radius_mm: float = 20.0, *, seed: int = 0) -> FloatArray:
    return turned_part(
        np.random.default_rng(seed),
        lambda height: np.full(len(height), radius_mm),
        rows=60,
        row_mm=1.0,
        points_a_row=300,
        noise_mm=0.1,
    )


def disc(radius_mm: float, height_mm: float, *, inner_mm: float = 0.0, count: int) -> FloatArray:
    rng = np.random.default_rng(9)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    radius = np.sqrt(rng.uniform(inner_mm**2, radius_mm**2, count))
    height = rng.normal(height_mm, 0.05, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def find(points: FloatArray, axis: Axis = Axis.Z) -> Keep:
    passing = chunks_of(points)
    return find_part(passing, survey_cloud(passing, axis), axis)


def kept(points: FloatArray, found: Keep, axis: Axis = Axis.Z) -> BoolArray:
    """Which points are in a kept box above the plate, (n,)."""
    boxes = np.floor((points - found.corner_mm) / found.edge_mm).astype(int)
    known = ((boxes >= 0) & (boxes < found.boxes.shape)).all(axis=1)
    within = np.zeros(len(points), dtype=np.bool_)
    within[known] = found.boxes[tuple(boxes[known].T)]
    return np.asarray(within & (points[:, axis.column] > found.plate_top_mm))


def test_a_part_alone_is_kept_whole() -> None:
    points = cylinder()
    found = find(points)
    assert found.plate_top_mm == -math.inf
    assert kept(points, found).all()


@pytest.mark.parametrize("far_mm", [45.0, 500.0])
def test_a_stray_cluster_and_lonely_points_are_not_the_part(far_mm: float) -> None:
    part = cylinder()
    rng = np.random.default_rng(1)
    cluster = rng.normal([far_mm, 0.0, 30.0], 0.5, (100, 3))  # 0.6 % of the part
    lonely = rng.uniform(-1.0, 1.0, (30, 3)) * [5.0, 5.0, 20.0] + [0.0, 0.0, 30.0]
    points = np.concatenate([part, cluster, lonely])
    found = kept(points, find(points))
    assert found[: len(part)].all()
    assert not found[len(part) : len(part) + 100].any()
    assert not found[len(part) + 100 :].any()


def test_strays_are_counted_and_shown_by_the_cut() -> None:
    part = cylinder()
    cluster = np.random.default_rng(1).normal([45.0, 0.0, 30.0], 0.5, (100, 3))
    cut = cut_cloud(chunks_of(np.concatenate([cluster, part])), Axis.Z)
    assert cut.aside == {Aside.CROPPED: 0, Aside.STRAY: 100, Aside.PLATE: 0}
    np.testing.assert_array_equal(cut.aside_mm[Aside.STRAY], cluster)


def test_a_second_cluster_the_size_of_a_handle_is_kept() -> None:
    part = cylinder()
    angle = np.random.default_rng(2).uniform(-1.2, 1.2, 600)  # 3 % of the part, 6 mm away from it
    noise = np.random.default_rng(3).normal(0.0, 0.4, (600, 3))
    handle = np.column_stack(
        [20.0 + 14.0 * np.cos(angle), 0.0 * angle, 30.0 + 14.0 * np.sin(angle)]
    )
    points = np.concatenate([part, handle + noise])
    assert kept(points, find(points))[len(part) :].mean() > 0.98


@pytest.mark.parametrize("axis", list(Axis))
def test_the_table_plate_is_set_aside_and_the_part_on_it_kept(axis: Axis) -> None:
    part, plate = cylinder(), disc(60.0, -0.5, count=12_000)
    turn = np.argsort(axis.planar)
    points = np.concatenate([part, plate])[:, turn]
    found = find(points, axis)
    # The plate's noise is 0.05 mm, its upper side 4 sigma above its middle.
    assert -0.5 < found.plate_top_mm < 0.5
    chosen = kept(points, found, axis)
    assert not chosen[len(part) :].any()
    above = part[:, 2] > 1.0
    assert chosen[: len(part)][above].all()


def test_plate_points_are_counted_as_plate() -> None:
    part, plate = cylinder(), disc(60.0, -2.0, count=12_000)
    cut = cut_cloud(chunks_of(np.concatenate([part, plate])), Axis.Z)
    assert cut.aside[Aside.PLATE] == pytest.approx(12_000, rel=0.002)
    assert cut.counts.sum() + sum(cut.aside.values()) == len(part) + len(plate)


def test_the_flat_bottom_of_a_part_is_no_plate() -> None:
    points = np.concatenate([cylinder(), disc(20.0, 0.0, count=6000)])
    found = find(points)
    assert found.plate_top_mm == -math.inf
    assert kept(points, found).all()


def test_a_foot_that_sticks_out_in_one_direction_only_is_no_plate() -> None:
    foot = disc(60.0, 0.0, count=12_000)
    points = np.concatenate([cylinder(), foot[np.abs(foot[:, 1]) < 18.0]])
    assert find(points).plate_top_mm == -math.inf


def test_a_thin_cloud_is_looked_at_in_coarser_boxes() -> None:
    dense, thin = cylinder(), cylinder()[::20]
    assert find(thin).edge_mm > find(dense).edge_mm
    assert kept(thin, find(thin)).all()


def test_rows_that_stand_apart_from_a_densely_scanned_foot_are_the_part() -> None:
    rng = np.random.default_rng(4)
    dense = [(h, 900) for h in np.arange(0.0, 20.0, 0.2)]
    heights = dense + [(h, 800) for h in np.arange(20.0, 100.0, 2.0)]
    rings = []
    for height, count in heights:
        angle = rng.uniform(0.0, 2.0 * np.pi, count)
        radius = 20.0 + rng.normal(0.0, 0.05, count)
        rings.append(
            np.column_stack(
                [radius * np.cos(angle), radius * np.sin(angle), np.full(count, height)]
            )
        )
    points = np.concatenate(rings)
    assert kept(points, find(points)).all()


def dome(*, seed: int, rows: int = 20, row_mm: float = 0.65) -> FloatArray:
    """A flat paraboloid 80 mm wide, in rows: its last outlines stand 3 to 7 mm apart."""
    rng = np.random.default_rng(seed)
    height = (np.arange(rows) + 0.5) * row_mm
    radius = 40.0 * np.sqrt(1.0 - height / (rows * row_mm))
    rows_of_points = np.repeat(np.arange(rows), np.round(2.0 * math.pi * radius).astype(int))
    angle = rng.uniform(0.0, 2.0 * math.pi, len(rows_of_points))
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[rows_of_points, None]
    around += rng.normal(0.0, 0.3, around.shape)
    return np.column_stack([around, height[rows_of_points]])


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("lost_share", [0.0, 0.2], ids=["whole", "with gaps"])
def test_the_last_outlines_of_a_flat_dome_are_the_part(seed: int, lost_share: float) -> None:
    rng = np.random.default_rng(seed)
    points = dome(seed=seed)
    turn = np.arctan2(points[:, 1], points[:, 0])
    begun = rng.uniform(-math.pi, math.pi, 20)[np.floor(points[:, 2] / 0.65).astype(int)]
    points = points[np.mod(turn - begun, math.tau) >= lost_share * math.tau]
    body = cylinder(40.0, seed=seed) - [0.0, 0.0, 60.0]
    points = np.concatenate([points, np.repeat(body, 3, axis=0)])
    top = points[:, 2] > 10.0
    # Single points whose noise takes them out of every outline may be missing.
    assert kept(points, find(points))[top].mean() > 0.95
    assert kept(-points, find(-points))[top].mean() > 0.95


def test_a_cluster_inside_of_a_dome_is_stray() -> None:
    points = np.concatenate([dome(seed=1), cylinder(40.0, seed=1) - [0.0, 0.0, 60.0]])
    cluster = np.random.default_rng(4).normal([0.0, 0.0, -6.0], 0.5, (100, 3))
    found = kept(np.concatenate([points, cluster]), find(np.concatenate([points, cluster])))
    assert not found[len(points) :].any()
