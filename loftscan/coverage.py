"""How much a slice has seen: of a ring, the share of the angles around the axis that have points.

Of other slices, the share of their profiles' places that hold a point.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.frames import Kinematics, part_points
from acquisition.patterns import SliceKind
from acquisition.poses import Sweep
from drivers.profiler import Reason

_CELLS = 360  # a degree each: no plan has stops so dense that a whole turn would show gaps


def sweep_coverage(sweep: Sweep, kinematics: Kinematics, kind: SliceKind = SliceKind.RING) -> float:
    """Share of the degrees of a turn, or of the places, in which a slice has a point, 0 to 1."""
    if kind is SliceKind.RING:
        return share_of_turn(part_points(sweep, kinematics))
    return share_measured(count_reasons(sweep))


def count_reasons(sweep: Sweep) -> NDArray[np.int64]:
    """Places of a sweep's profiles by `Reason`, (6,)."""
    reasons = np.zeros(len(Reason), np.int64)
    for profile in sweep.profiles:
        reasons += np.bincount(profile.reasons, minlength=len(Reason))
    return reasons


def share_measured(reasons: NDArray[np.int64]) -> float:
    """Share of places (6,) by `Reason` that hold a point; 0 of none."""
    return float(reasons[Reason.MEASURED] / max(1, reasons.sum()))


def share_of_turn(points_mm: NDArray[np.float64]) -> float:
    """The same for points (n, 2) or (n, 3) around the origin or the z axis."""
    turn = np.arctan2(points_mm[:, 1], points_mm[:, 0]) / math.tau % 1.0
    cells = np.minimum((turn * _CELLS).astype(np.int64), _CELLS - 1)
    return len(np.unique(cells)) / _CELLS
