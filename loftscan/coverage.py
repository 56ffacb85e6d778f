"""How much of a turn a slice has seen: the share of the angles around the axis that have points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.frames import Kinematics, part_points
from acquisition.poses import Sweep

_CELLS = 360  # a degree each: no plan has stops so dense that a whole turn would show gaps


def turn_coverage(sweep: Sweep, kinematics: Kinematics) -> float:
    """Share of the degrees of a turn in which a slice has a point, 0 to 1."""
    return share_of_turn(part_points(sweep, kinematics))


def share_of_turn(points_mm: NDArray[np.float64]) -> float:
    """The same for points (n, 2) or (n, 3) around the origin or the z axis."""
    turn = np.arctan2(points_mm[:, 1], points_mm[:, 0]) / math.tau % 1.0
    cells = np.minimum((turn * _CELLS).astype(np.int64), _CELLS - 1)
    return len(np.unique(cells)) / _CELLS
