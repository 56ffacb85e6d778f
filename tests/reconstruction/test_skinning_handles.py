"""Handles that hardly are: cut or closed; those that are there stay."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, label

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.skinning.handles import (
    _is_simple,
    euler_number,
    leftovers,
    without_weak_handles,
)

WEAK = 0.15
CORNERS = np.ones((3, 3, 3), int)


def smeared(solid: BoolArray, width: float = 1.0) -> FloatArray:
    """What a field is of a solid: a step from -0.5 to 0.5, smeared."""
    return np.asarray(gaussian_filter(solid.astype(float), width) - 0.5)


def slotted_block() -> BoolArray:
    """A block with a slot from below that is open to three sides; two legs and a back."""
    solid = np.zeros((40, 30, 40), np.bool_)
    solid[5:35, 5:25, 5:35] = True
    solid[18:22, :, :28] = False
    return solid


def rings(values: FloatArray) -> int:
    """Handles of a body without cavities, by its parts and its Euler number."""
    inside = values > 0.0
    assert label(inside, CORNERS)[1] == 1
    assert label(~inside)[1] == 1
    return 1 - euler_number(inside)


def test_the_euler_number_is_that_of_parts_cavities_and_rings() -> None:
    ball = np.zeros((9, 9, 9), np.bool_)
    ball[2:7, 2:7, 2:7] = True
    ring, shell = ball.copy(), ball.copy()
    ring[4, 4, :] = False
    shell[4, 4, 4] = False
    two = np.zeros((9, 9, 9), np.bool_)
    two[0, 0, 0] = two[8, 8, 8] = True
    assert [euler_number(each) for each in (ball, ring, shell, two)] == [1, 0, 2, 2]


def naively_simple(around: BoolArray) -> bool:
    """By the definition: one part of it by corners, and one of the rest by faces beside it."""
    at = np.abs(np.indices((3, 3, 3)) - 1).sum(axis=0)
    _, parts = label(around, CORNERS)
    theirs, _ = label(~around & (at > 0) & (at < 3))
    beside = theirs[(at == 1) & (theirs > 0)]
    return bool(parts == 1 and len(np.unique(beside)) == 1)


def test_a_voxel_is_simple_as_the_definition_has_it() -> None:
    rng = np.random.default_rng(5)
    for _ in range(2000):
        around = rng.random((3, 3, 3)) < rng.uniform(0.1, 0.9)
        around[1, 1, 1] = False
        bits = int(around.ravel() @ (1 << np.arange(27)))
        assert _is_simple(bits) == naively_simple(around)


def test_a_web_in_a_slot_is_cut_and_nothing_else_is_touched() -> None:
    values = smeared(slotted_block())
    webbed = values.copy()
    webbed[17:23, 12:15, 10:12] = np.maximum(webbed[17:23, 12:15, 10:12], 0.05)
    assert (rings(values), rings(webbed)) == (0, 1)
    mended = without_weak_handles(webbed, WEAK)
    assert rings(mended) == 0
    changed = np.argwhere(mended != webbed)
    assert np.all(changed.min(axis=0) >= (16, 11, 9))
    assert np.all(changed.max(axis=0) <= (23, 15, 12))
    assert np.all(mended[19:21, 5:25, 6:26] < 0.0)  # the slot is free


def test_a_hole_in_a_wall_is_closed_where_that_takes_less() -> None:
    solid = np.zeros((40, 30, 40), np.bool_)
    solid[5:35, 12:18, 5:35] = True
    values = smeared(solid)
    holed = values.copy()
    holed[19:21, 8:22, 19:21] = np.minimum(holed[19:21, 8:22, 19:21], -0.05)
    assert rings(holed) == 1
    mended = without_weak_handles(holed, WEAK)
    assert rings(mended) == 0
    changed = np.argwhere(mended != holed)
    assert len(changed)
    assert np.all(changed.min(axis=0) >= (19, 8, 19))
    assert np.all(changed.max(axis=0) < (21, 22, 21))


def test_a_handle_stays_where_there_is_one() -> None:
    ring = np.zeros((40, 40, 20), np.bool_)
    at = np.stack(np.meshgrid(*(np.arange(n) for n in ring.shape), indexing="ij"))
    away = np.hypot(at[0] - 19.5, at[1] - 19.5)
    ring[np.hypot(away - 12.0, at[2] - 9.5) < 4.0] = True
    values = smeared(ring)
    np.testing.assert_array_equal(without_weak_handles(values, WEAK), values)
    assert rings(values) == 1


@pytest.mark.parametrize("inside", [True, False])
def test_a_body_without_handles_leaves_nothing_over(inside: bool) -> None:  # noqa: FBT001
    assert list(leftovers(smeared(slotted_block()), inside=inside)) == []


def test_noise_on_a_ball_leaves_one_sphere() -> None:
    at = np.stack(np.meshgrid(*(np.arange(40.0),) * 3, indexing="ij"))
    ball = np.sqrt(((at - 19.5) ** 2).sum(axis=0)) < 12.0
    noise = gaussian_filter(np.random.default_rng(2).normal(size=ball.shape), 1.5)
    values = smeared(ball, 2.0) + 0.3 * noise / noise.std()
    inside, _ = label(values > 0.0, CORNERS)
    values[inside != inside[20, 20, 20]] = -WEAK  # stray parts
    outside, _ = label(values <= 0.0)
    values[(outside != outside[0, 0, 0]) & (values <= 0.0)] = WEAK  # and cavities
    before = rings(values)
    assert before > 3
    assert rings(without_weak_handles(values, 1.0)) < before / 3
