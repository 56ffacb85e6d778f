"""Loops that meet the hole in them beyond the last slice: two branches become one that turns over.

Where a scan ends on a part that narrows, as half-way up a ring that lies flat, nobody saw the wall
close; but the space between a loop and its hole tells. Over a rounded top its square falls linearly
with height. Where it runs out before the next slice would have been taken, the surface is taken to
turn over there; else it is closed by a level ring.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.outlines import Outline

_PLACES = 128
_SLACK = 1.15  # times the way to the next slice: heights and widths have noise
_LOOK = 3  # outlines that tell how the space narrows


def fold(branches: Sequence[Branch]) -> tuple[Branch, ...]:
    """Join each loop with the one hole in it, where both end unseen and are about to meet.

    A pair that meets at one end becomes a branch that goes up outside and comes down inside; one
    that meets at both is cyclic.
    """
    left = list(branches)
    found: list[Branch] = []
    while left:
        branch = left.pop(0)
        partner = None if branch.hole else _partner(branch, left)
        if partner is None:
            found.append(branch)
            continue
        folded = _folded(branch, partner)
        if folded is None:
            found.append(branch)
        else:
            left.remove(partner)
            found.append(folded)
    return tuple(found)


def _partner(outer: Branch, others: Sequence[Branch]) -> Branch | None:
    """The only hole that begins and ends in the same slices as a loop."""
    same = [
        other
        for other in others
        if other.hole
        and other.ends is not None
        and outer.ends is not None
        and not outer.cyclic
        and other.outlines[0].slice_index == outer.outlines[0].slice_index
        and other.outlines[-1].slice_index == outer.outlines[-1].slice_index
        and _inside(other.outlines[0], outer.outlines[0])
    ]
    return same[0] if len(same) == 1 else None


def _folded(outer: Branch, hole: Branch) -> Branch | None:
    assert outer.ends is not None, "an open branch has ends"
    assert hole.ends is not None, "an open branch has ends"
    low, high = (
        _unseen(outer.ends[side], hole.ends[side]) and _meet(outer, hole, last=bool(side))
        for side in (0, 1)
    )
    back = hole.outlines[::-1]
    if low and high:
        return replace(outer, outlines=(*outer.outlines, *back), cyclic=True, ends=None)
    if high:
        ends = (outer.ends[0], hole.ends[0])
        return replace(outer, outlines=(*outer.outlines, *back), ends=ends)
    if low:
        ends = (outer.ends[1], hole.ends[1])
        return replace(outer, outlines=(*outer.outlines[::-1], *hole.outlines), ends=ends)
    return None


def _unseen(one: End, other: End) -> bool:
    return one.ending is Ending.UNSEEN and other.ending is Ending.UNSEEN


def _meet(outer: Branch, hole: Branch, *, last: bool) -> bool:
    """Whether the space between runs out within a step beyond the last slice."""
    pairs = list(zip(outer.outlines, hole.outlines, strict=False))
    if len(outer.outlines) != len(hole.outlines):
        return False
    near = pairs[-_LOOK:][::-1] if last else pairs[:_LOOK]
    if len(near) < _LOOK:
        return False
    heights = np.array([loop.height_mm for loop, _ in near])
    squares = np.array([_space(*pair) ** 2 for pair in near])
    rises = np.abs(heights - heights[0])
    slope = (squares[1] - squares[0]) / rises[1]
    return bool(slope > 0.0 and squares[0] / slope < _SLACK * rises[1])


def _space(loop: Outline, hole: Outline) -> float:
    """Mean width of the space between: its area over the mean of both lengths."""
    (area, length), (hollow, around) = _measures(loop), _measures(hole)
    return 2.0 * (area - hollow) / (length + around)


def _measures(outline: Outline) -> tuple[float, float]:
    polygon = outline.polygon_mm(_PLACES)
    x, y = (polygon - polygon[0]).T
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    return area, float(np.linalg.norm(polygon - np.roll(polygon, 1, axis=0), axis=1).sum())


def _inside(hole: Outline, loop: Outline) -> bool:
    """Whether a hole's first place lies within a loop, by its winding about the place."""
    arms = _planar(loop) - _planar(hole)[0]
    turns = np.angle(np.exp(1j * np.diff(np.arctan2(arms[:, 1], arms[:, 0]))))
    return abs(float(turns.sum())) > math.pi


def _planar(outline: Outline) -> FloatArray:
    return outline.frame.to_part(outline.polygon_mm(_PLACES)) @ outline.frame.axes[:2].T
