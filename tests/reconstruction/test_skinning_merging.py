"""Cells merged where there are more than a net can use."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.skinning.merging import Cells, merged_for, moved_along
from reconstruction.skinning.outlines import Moments
from tests.reconstruction.skinning_parts import torus_net, tube_net

MANY = 60_000


def crowd(spans: tuple[float, float], seed: int) -> tuple[Cells, np.ndarray]:
    """Far more cells than a net can use, in two parts; every hundredth is a single point."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(2, 9, MANY).astype(np.float64)
    counts[::100] = 1.0
    arms = rng.normal(size=(MANY, 3, 3))
    whole = Moments(counts, rng.normal(size=(MANY, 3)), arms @ arms.swapaxes(1, 2))
    parts = tuple(
        Moments(whole.counts[rows], whole.means_mm[rows], whole.covariances_mm2[rows])
        for rows in (slice(0, 20_000), slice(20_000, MANY))
    )
    u, v = rng.random((2, MANY)) * np.array(spans)[:, None]
    return Cells(parts, u, v), counts


def test_merged_cells_hold_what_their_points_hold() -> None:
    """Beside the plain way: number, sum and squares of everything in a group."""
    net = tube_net()
    cells, counts = crowd(net.spans, 1)
    found = merged_for(net, cells)
    assert found.groups is not None
    assert len(found.moments) < MANY / 2
    whole = Moments.together(cells.parts)
    second = whole.covariances_mm2 + np.einsum("mi,mj->mij", whole.means_mm, whole.means_mm)
    for group in np.random.default_rng(2).integers(0, len(found.moments), 50):
        held = found.groups == group
        share = counts[held] / counts[held].sum()
        mean = share @ whole.means_mm[held]
        spread = np.einsum("m,mij->ij", share, second[held]) - np.outer(mean, mean)
        assert found.moments.counts[group] == pytest.approx(counts[held].sum())
        assert found.moments.means_mm[group] == pytest.approx(mean, abs=1e-12)
        assert found.moments.covariances_mm2[group] == pytest.approx(spread, abs=1e-9)
        assert found.u[group] == pytest.approx(share @ cells.u[held])


def test_single_points_stay_alone() -> None:
    cells, counts = crowd(tube_net().spans, 3)
    found = merged_for(tube_net(), cells)
    assert found.groups is not None
    sizes = np.bincount(found.groups)
    assert (sizes[found.groups[counts == 1.0]] == 1).all()


def test_few_cells_are_left_as_they_are() -> None:
    cells, _ = crowd(tube_net().spans, 4)
    few = Cells(cells.parts[:1], cells.u[:20_000], cells.v[:20_000])
    found = merged_for(tube_net(), few)
    assert found.groups is None
    assert len(found.moments) == 20_000


def test_cells_go_where_those_went_that_they_were_merged_into() -> None:
    """Over the seam, too, and not over the ends of an open direction."""
    net = torus_net()
    cells, _ = crowd(net.spans, 5)
    found = merged_for(net, cells)
    u, v = np.mod(found.u + 0.3, net.spans[0]), np.mod(found.v - 0.2, net.spans[1])
    moved = moved_along(cells, found, u, v, net)
    assert np.mod(moved.u - cells.u + 1.0, net.spans[0]) == pytest.approx(1.3)
    assert np.mod(moved.v - cells.v + 1.0, net.spans[1]) == pytest.approx(0.8)
    open_net = tube_net()
    cells, _ = crowd(open_net.spans, 6)
    found = merged_for(open_net, cells)
    moved = moved_along(cells, found, found.u, found.v + 1.0, open_net)
    assert moved.v.max() == open_net.spans[1]
