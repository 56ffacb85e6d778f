"""A part's faces in a tree of upright boxes: halved at the median until a few remain.

The tree is complete, in heap order: node i has the children 2 i + 1 and 2 i + 2, the leaves are
the last `leaves` nodes, and leaf j holds faces j * m to (j + 1) * m of m each. Some faces stand in
it twice to fill the last places; a ray that is blocked twice is blocked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.arrays import FloatArray
from sim.solids import Part

_FACES_A_LEAF = 8  # at most
_SLACK = 1e-9  # of the part's size, around every box: rounding never puts a face outside it


@dataclass(frozen=True, slots=True, eq=False)
class Hierarchy:
    """Boxes and faces; L leaves of m faces."""

    boxes_mm: FloatArray  # (2 L - 1, 6): middle x, y, half width in x, y, lowest z, highest z
    corners_mm: FloatArray  # (L, m, 3, 3)

    def __post_init__(self) -> None:
        for array in (self.boxes_mm, self.corners_mm):
            array.flags.writeable = False


def arrange(part: Part) -> Hierarchy:
    """Build the tree over all faces of a part."""
    corners_mm = part.vertices_mm[part.faces]
    corners_mm = corners_mm[_order(corners_mm.mean(axis=1))]
    return Hierarchy(_boxes_mm(corners_mm, _SLACK * part.size_mm), corners_mm)


def _order(middles_mm: FloatArray) -> NDArray[np.intp]:
    """Which faces each leaf holds, (L, m): every node is halved across its longest side."""
    count = len(middles_mm)
    levels = max(0, math.ceil(math.log2(count / _FACES_A_LEAF)))
    size = -(-count // 2**levels) * 2**levels
    order = np.resize(np.arange(count), (1, size))
    # Three rows of float32: only how well the tree is balanced depends on them.
    along = np.asarray(middles_mm[order].transpose(2, 0, 1), np.float32, order="C")
    for _ in range(levels):
        half = order.shape[1] // 2
        longest = np.ptp(along, axis=2).argmax(axis=0)
        longest_side = np.take_along_axis(along, longest[None, :, None], axis=0)[0]
        halved = np.argpartition(longest_side, half, axis=1)
        order = np.take_along_axis(order, halved, axis=1).reshape(-1, half)
        along = np.take_along_axis(along, halved[None], axis=2).reshape(3, -1, half)
    return order


def _boxes_mm(corners_mm: FloatArray, slack_mm: float) -> FloatArray:
    low, high = corners_mm.min(axis=(1, 2)), corners_mm.max(axis=(1, 2))
    lows, highs = [low], [high]
    while len(low) > 1:
        low = np.minimum(low[::2], low[1::2])
        high = np.maximum(high[::2], high[1::2])
        lows.insert(0, low)
        highs.insert(0, high)
    low, high = np.concatenate(lows) - slack_mm, np.concatenate(highs) + slack_mm
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    return np.column_stack([middle[:, :2], half[:, :2], low[:, 2], high[:, 2]])
