"""Corners that are noted while points are sorted save a reading, and change nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reconstruction import paper, slicing
from reconstruction.paper import PaperSettings, PlaneRule, draw_section
from reconstruction.slices import Frame, Slice
from reconstruction.slicing import Cutting, cut_cloud
from reconstruction.survey import Axis
from tests.reconstruction.part_cases import chunks_of
from tests.reconstruction.test_slicing import scan


@pytest.mark.parametrize("axis", list(Axis))
@pytest.mark.parametrize("in_memory", [10, 10**6])
def test_every_slice_of_a_cloud_has_the_corners_of_its_points(
    axis: Axis, in_memory: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(slicing, "_IN_MEMORY", in_memory)
    cut = cut_cloud(chunks_of(scan()[:, np.argsort(axis.planar)], 313), axis)
    for piece in cut.slices():
        if len(piece.points_mm) == 0:
            assert piece.corners_mm is None
            continue
        np.testing.assert_array_equal(piece.corners_mm[0], piece.points_mm.min(axis=0))
        np.testing.assert_array_equal(piece.corners_mm[1], piece.points_mm.max(axis=0))
        np.testing.assert_array_equal(cut.slice_at(piece.index).corners_mm, piece.corners_mm)


def test_a_level_without_points_has_no_corners() -> None:
    rows = scan(strays=0)
    gap = np.abs(rows[:, 2] - np.median(rows[:, 2])) > 3.0
    cut = cut_cloud(chunks_of(rows[gap]), Axis.Z, spacing_mm=0.75)
    assert (cut.counts == 0).any()
    for piece in cut.slices():
        assert (piece.corners_mm is None) == (len(piece.points_mm) == 0)


def fullest(cut: Cutting) -> Slice:
    return cut.slice_at(int(np.argmax(cut.counts)))


@pytest.mark.parametrize("axis", list(Axis))
@pytest.mark.parametrize("plane", list(PlaneRule))
def test_a_section_is_the_same_with_and_without_noted_corners(axis: Axis, plane: PlaneRule) -> None:
    piece = fullest(cut_cloud(chunks_of(scan()[:, np.argsort(axis.planar)]), axis))
    settings = PaperSettings(plane=plane)
    with_them, _ = draw_section(piece, settings, None)
    without, _ = draw_section(replace(piece, corners_mm=None), settings, None)
    one, other = (each.curve.control_points_mm for each in (with_them, without))
    np.testing.assert_array_equal(one, other)
    assert with_them.resolution == without.resolution


def test_points_whose_corners_were_noted_are_not_read_for_them_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    piece = fullest(cut_cloud(chunks_of(scan()), Axis.Z))
    turned = Frame(piece.frame.origin_mm, [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    read: list[int] = []
    bounding_box = paper.bounding_box
    monkeypatch.setattr(
        paper, "bounding_box", lambda points: (read.append(len(points)), bounding_box(points))[1]
    )
    draw_section(piece, PaperSettings(), None)
    assert read == []
    # In a plane that is turned, the corners of the part's frame say too little.
    draw_section(replace(piece, frame=turned), PaperSettings(), None)
    draw_section(replace(piece, corners_mm=None), PaperSettings(), None)
    assert read == [len(piece.points_mm)] * 2


@pytest.mark.parametrize("corners", [np.zeros((2, 2)), [[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]]])
def test_corners_that_are_none_are_refused(corners: np.ndarray) -> None:
    with pytest.raises(ValueError, match="slice 3: corners"):
        Slice(3, np.zeros((1, 3)), Frame(np.zeros(3), np.eye(3)), corners)
