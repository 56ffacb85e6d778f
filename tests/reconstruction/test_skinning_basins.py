"""What is inside of points with holes between them."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.errors import Unfittable
from reconstruction.skinning.basins import inside_of

MARGIN = 12  # nodes around


def box(size: int) -> np.ndarray:
    """Nodes of the six sides of a cube, in a grid that reaches beyond it."""
    taken = np.zeros((size + 2 * MARGIN,) * 3, dtype=np.bool_)
    low, high = MARGIN, MARGIN + size - 1
    taken[low : high + 1, low : high + 1, low : high + 1] = True
    taken[low + 1 : high, low + 1 : high, low + 1 : high] = False
    return taken


def test_a_wide_hole_in_a_wall_is_bridged() -> None:
    taken = box(40)
    taken[MARGIN + 16 : MARGIN + 24, MARGIN + 16 : MARGIN + 24, MARGIN + 39] = False
    inside = inside_of(taken, 1.0, grain_mm=1.0, margin_mm=0.9 * MARGIN)
    middle = MARGIN + 20
    assert inside[middle, middle, middle]
    assert inside[middle, middle, MARGIN + 37]  # just below the hole
    assert not inside[middle, middle, MARGIN + 42]  # and above it
    assert abs(int(inside.sum()) - 39**3) < 0.06 * 39**3


def test_a_slot_is_outside_though_its_walls_are_as_near_as_four_grains() -> None:
    taken = box(40)
    # Open at the top, between two walls; there are holes of two nodes in them.
    taken[MARGIN + 18 : MARGIN + 23, MARGIN + 1 : MARGIN + 39, MARGIN + 39] = False
    for wall in (MARGIN + 17, MARGIN + 23):
        taken[wall, MARGIN : MARGIN + 40, MARGIN + 12 : MARGIN + 40] = True
        taken[wall, MARGIN + 10 : MARGIN + 12, MARGIN + 20 : MARGIN + 22] = False
    taken[MARGIN + 17 : MARGIN + 24, MARGIN : MARGIN + 40, MARGIN + 12] = True
    inside = inside_of(taken, 1.0, grain_mm=1.5, margin_mm=0.9 * MARGIN)
    middle = MARGIN + 20
    assert not inside[middle, middle, MARGIN + 16 :].any()
    assert inside[middle, middle, MARGIN + 6]
    assert inside[MARGIN + 8, middle, middle]
    assert inside[MARGIN + 32, middle, middle]


def test_a_part_that_is_thin_everywhere_has_no_inside_to_begin_from() -> None:
    taken = np.zeros((60, 60, 30), dtype=np.bool_)
    taken[12:48, 12:48, 14] = taken[12:48, 12:48, 16] = True
    with pytest.raises(Unfittable, match="thin everywhere"):
        inside_of(taken, 1.0, grain_mm=1.5, margin_mm=10.0)
