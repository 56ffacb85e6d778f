"""A plane's frame takes points in and out again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reconstruction.slices import Frame, Slice


def random_frame(seed: int) -> Frame:
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Frame(rng.uniform(-50.0, 50.0, 3), axes * np.sign(np.linalg.det(axes)))


frames = st.builds(random_frame, st.integers(0, 2**32 - 1))


@given(frames)
def test_what_goes_into_the_plane_comes_out_where_it_was(frame: Frame) -> None:
    points = np.random.default_rng(0).uniform(-100.0, 100.0, (20, 3))
    np.testing.assert_allclose(frame.to_part(frame.to_plane(points)), points, atol=1e-11)


@given(frames)
def test_plane_points_lie_in_the_plane_and_the_origin_is_their_zero(frame: Frame) -> None:
    flat = np.random.default_rng(0).uniform(-100.0, 100.0, (20, 2))
    lifted = frame.to_part(flat)
    np.testing.assert_allclose((lifted - frame.origin_mm) @ frame.axes[2], 0.0, atol=1e-11)
    np.testing.assert_allclose(frame.to_plane(lifted)[:, :2], flat, atol=1e-11)
    np.testing.assert_array_equal(frame.to_plane(frame.origin_mm[None]), np.zeros((1, 3)))


def test_a_slice_keeps_its_points_from_later_changes() -> None:
    points = np.zeros((4, 3))
    piece = Slice(0, points, Frame(np.zeros(3), np.eye(3)))
    points[0] = 7.0
    assert (piece.points_mm == 0.0).all()
    with pytest.raises(ValueError, match="read-only"):
        piece.points_mm[0] = 7.0
