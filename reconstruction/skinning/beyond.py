"""How far a branch goes on in slices where it is too small for a contour.

Towards a tip the noise closes a contour: its points are one heap, or a run. That the part goes on
there is seen all the same, and where it ends is the first slice that holds nothing of it. ::

    .           nothing: the branch ends below, by its own slope
    ::          a heap
    (::)        a heap
    (  )        the last contour
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.ends import Apex, brim_or_apex
from reconstruction.skinning.outlines import Outline

_FEWEST = 8  # points
_NOISE = 3.0  # standard deviations around what a contour encloses
_PLACES = 128


def seen_beyond(branch: Branch, stack: Sequence[SliceOutlines]) -> Branch:
    """Let the closed ends of a branch lie where slices, low to high, hold nothing of it.

    Only where its outlines, as they shrink, run out in a point on the way there: a ridge, or two
    walls too near to be told apart, is a heap as well, and says nothing of where it ends.
    """
    if branch.ends is None or branch.hole or len(branch.outlines) < 2:
        return branch
    outlines, ends = branch.outlines, list(branch.ends)
    for last, (edge, inner) in enumerate(((0, 1), (-1, -2))):
        farther = _end(ends[last], outlines[edge], outlines[inner], stack)
        if isinstance(brim_or_apex(outlines, farther, last=bool(last)), Apex):
            ends[last] = farther
    return replace(branch, ends=(ends[0], ends[1]))


def _end(end: End, edge: Outline, inner: Outline, stack: Sequence[SliceOutlines]) -> End:
    if end.ending is not Ending.CLOSED:
        return end
    way = math.copysign(1.0, end.height_mm - edge.height_mm)
    beyond = [each for each in stack if (each.height_mm - edge.height_mm) * way > 0.0]
    beyond = beyond if way > 0.0 else beyond[::-1]
    for piece in beyond:
        if not _holds(piece, edge, inner):
            return replace(end, height_mm=piece.height_mm)
        last = piece.height_mm
    if not beyond:
        return end
    step = abs(last - (beyond[-2].height_mm if len(beyond) > 1 else edge.height_mm))
    return replace(end, height_mm=last + way * step)


def _holds(piece: SliceOutlines, edge: Outline, inner: Outline) -> bool:
    """Whether points of a slice lie where a branch would go on, and in no contour there."""
    middle, radius = _circle(edge)
    before, _ = _circle(inner)
    rise = edge.height_mm - inner.height_mm
    drift = (middle - before) / rise * (piece.height_mm - edge.height_mm) if rise else 0.0
    centre, reach = middle + drift, radius + _NOISE * edge.fitted.sigma_mm
    for other in piece.outlines:
        place, own = _circle(other)
        if np.linalg.norm(place - centre) < reach + own:
            return False
    flat = piece.grains.points_mm @ edge.frame.axes[:2].T
    near = np.linalg.norm(flat - centre, axis=1) < reach
    return float(piece.grains.counts[near].sum()) >= _FEWEST


def _circle(outline: Outline) -> tuple[FloatArray, float]:
    """Middle (2,) in the plane through the part's origin, and radius around it."""
    places = outline.frame.to_part(outline.polygon_mm(_PLACES)) @ outline.frame.axes[:2].T
    middle = places.mean(axis=0)
    return middle, float(np.linalg.norm(places - middle, axis=1).max())
