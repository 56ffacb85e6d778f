"""Outlines side by side: seams, numbering, even spacing; and how a surface ends beyond them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.aligning import _DENSER, _EVEN, _HASTE, _slide, align
from reconstruction.skinning.branch import End, Ending
from reconstruction.skinning.ends import Apex, Brim, brim_or_apex
from tests.reconstruction.skinning_cases import outline, ring


def lobed(turn: float, *, shift: int = 0, count: int = 240) -> np.ndarray:
    """A three-lobed ring, turned; its numbering begins somewhere else."""
    angle = np.arange(count) * (math.tau / count)
    radius = 20.0 + 4.0 * np.cos(3.0 * (angle - turn))
    corners = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.roll(corners, shift, axis=0)


def test_columns_of_one_shape_are_straight_however_each_outline_is_numbered() -> None:
    rng = np.random.default_rng(1)
    outlines = [outline(lobed(0.3, shift=int(rng.integers(240))), z) for z in np.arange(8.0)]
    stations = align(outlines, 96)
    flat = stations.places_mm[:, :, :2]
    assert np.abs(flat - flat[0]).max() < 0.05


def test_columns_follow_a_shape_that_twists() -> None:
    """Half-way at least: nearness holds columns back, the lobes turn them."""
    outlines = [outline(lobed(0.04 * k), float(k)) for k in range(12)]
    places = align(outlines, 96).places_mm[:, :, :2]
    turns = np.unwrap(np.arctan2(places[..., 1], places[..., 0]), axis=0)
    assert 0.22 < (turns[-1] - turns[0]).mean() < 0.45


def test_a_reversed_outline_runs_with_the_others() -> None:
    outlines = [outline(lobed(0.3), 0.0), outline(lobed(0.3), 1.0, hole=True)]
    places = align(outlines, 96).places_mm[:, :, :2]
    assert np.abs(places[1] - places[0]).max() < 0.05


def test_stations_stay_on_their_outline_in_order_and_apart() -> None:
    outlines = [outline(lobed(0.8 * k), float(k)) for k in range(6)]
    stations = align(outlines, 96)
    assert (np.diff(stations.shares, axis=1) > 0.3 / 96).all()
    assert (np.ptp(stations.shares, axis=1) < 1.0).all()
    radii = np.hypot(stations.places_mm[..., 0], stations.places_mm[..., 1])
    assert radii.min() > 15.9
    assert radii.max() < 24.1


def test_cells_know_their_column() -> None:
    outlines = [outline(ring(10.0), z) for z in (0.0, 1.0, 2.0)]
    stations = align(outlines, 60)
    for places, columns, each in zip(
        stations.places_mm, stations.columns_of_cells(), outlines, strict=True
    ):
        around = np.vstack([places, places[:1]])
        low = np.floor(columns).astype(int)
        part = (columns - low)[:, None]
        expected = (1 - part) * around[low] + part * around[low + 1]
        off = np.linalg.norm(expected - each.moments.means_mm, axis=1)
        assert off.max() < 0.02  # a chord's sagitta


def stack(radii: list[float], step: float = 1.0):
    return [outline(ring(r), step * k) for k, r in enumerate(radii)]


def test_a_dome_ends_in_an_apex_where_its_area_runs_out() -> None:
    heights = np.array([6.0, 7.0, 8.0, 9.0, 9.6])
    outlines = [outline(ring(math.sqrt(100 - h * h)), h) for h in heights]
    found = brim_or_apex(outlines, End(Ending.CLOSED, 10.6), last=True)
    assert isinstance(found, Apex)
    assert not found.sharp
    assert found.point_mm == pytest.approx([0.0, 0.0, 10.0], abs=0.08)


def test_a_cone_ends_in_a_tip() -> None:
    outlines = stack([5.0, 4.0, 3.0, 2.0, 1.0])
    found = brim_or_apex(outlines, End(Ending.CLOSED, 5.0), last=True)
    assert isinstance(found, Apex)
    assert found.sharp
    assert found.point_mm == pytest.approx([0.0, 0.0, 5.0], abs=0.02)


def test_a_tube_is_carried_on_half_way_and_capped() -> None:
    found = brim_or_apex(stack([5.0] * 5), End(Ending.CLOSED, 5.0), last=True)
    assert isinstance(found, Brim)
    assert found.height_mm == pytest.approx(4.5)
    below = brim_or_apex(stack([5.0] * 5), End(Ending.UNSEEN, 0.0), last=False)
    assert isinstance(below, Brim)
    assert below.height_mm == pytest.approx(-0.5)


def test_a_ridge_does_not_run_out_in_a_point() -> None:
    outlines = [
        outline(ring(1.0) * [8.0 * r, r], float(k)) for k, r in enumerate([4.0, 3.0, 2.0, 1.0])
    ]
    found = brim_or_apex(outlines, End(Ending.CLOSED, 4.0), last=True)
    assert isinstance(found, Brim)


def test_a_joint_is_a_level_brim_at_its_height() -> None:
    outlines = stack([5.0, 4.0, 3.0, 2.0])
    found = brim_or_apex(outlines, End(Ending.JOINED, 3.4, 0), last=True)
    assert isinstance(found, Brim)
    assert found.height_mm == 3.4
    row = found.row_mm(align(outlines, 24).places_mm, last=True)
    assert row[:, 2] == pytest.approx(np.full(24, 3.4))
    assert np.hypot(row[:, 0], row[:, 1]) == pytest.approx(np.full(24, 1.6), abs=0.02)


def test_one_outline_alone_has_level_ends() -> None:
    alone = [replace(outline(ring(5.0), 2.0))]
    found = brim_or_apex(alone, End(Ending.CLOSED, 3.0), last=True)
    assert isinstance(found, Brim)
    assert found.height_mm == 2.5


def naive_slide(
    tables: FloatArray, shares: FloatArray, pinned: IntArray, sweeps: int, *, cyclic: bool
) -> FloatArray:
    """All stations at once, a sweep after the other; (k, size, 3), (k, m) -> (k, m)."""
    (rows, count), size = shares.shape, tables.shape[1]
    steps = np.roll(tables, -1, axis=1) - tables
    lengths = np.linalg.norm(steps, axis=2).sum(axis=1)
    row = np.arange(rows)[:, None]
    for _ in range(sweeps):
        low = np.floor(shares * size).astype(np.int64)
        part = (shares * size - low)[..., None]
        places = tables[row, low % size] + part * steps[row, low % size]
        ways = [np.roll(places, step, axis=0) - places for step in (-1, 1)]
        held = np.full((rows, 1), 2.0)
        if not cyclic:
            ways[0][-1] = ways[1][0] = 0.0
            held[[0, -1]] -= 1.0
        tangents = steps[row, low % size]
        tangents = tangents / np.linalg.norm(tangents, axis=2, keepdims=True)
        pull = (tangents * (ways[0] + ways[1])).sum(axis=2) / (held * lengths[:, None])
        before, after = np.roll(shares, 1, axis=1), np.roll(shares, -1, axis=1)
        before[:, 0] -= 1.0
        after[:, -1] += 1.0
        move = _HASTE * (pull + _EVEN * (0.5 * (before + after) - shares)) / (1.0 + _EVEN)
        fresh = shares + np.clip(move, -0.3 / count, 0.3 / count)
        for k in range(rows):
            for m in range(1, count):
                fresh[k, m] = max(fresh[k, m], fresh[k, m - 1] + _DENSER / count)
            if fresh[k, -1] > fresh[k, 0] + 1.0 - _DENSER / count:
                most = fresh[k, 0] + 1.0 - _DENSER / count * (count - np.arange(1, count))
                fresh[k, 1:] = np.minimum(fresh[k, 1:], most)
        fresh[:, pinned] = shares[:, pinned]
        shares = fresh
    return shares


@pytest.mark.parametrize("cyclic", [False, True])
@pytest.mark.parametrize("pinned", [[], [0, 9, 20]])
def test_stations_slide_as_they_do_one_by_one(*, cyclic: bool, pinned: list[int]) -> None:
    rng = np.random.default_rng(3)
    tables = np.stack([np.column_stack([lobed(0.1 * k), np.full(240, float(k))]) for k in range(6)])
    tables += rng.normal(0.0, 0.02, tables.shape)
    shares = rng.uniform(-0.2, 1.2, (6, 1)) + np.arange(48) / 48 + rng.uniform(0, 0.01, (6, 48))
    columns = np.array(pinned, dtype=np.int64)
    expected = naive_slide(tables, shares, columns, 24, cyclic=cyclic)
    found = _slide(tables, shares.copy(), columns, 24, cyclic=cyclic)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
