"""The ends of a run do not turn back: the last nodes of one that do are left out.

At an end, and at the edge of a gap, points lie on one side of a node only. Where few of them
happen to be spread more across the band than along it, a row may end in a hook that lies on the
row itself; a corner, beyond which the band goes on, does not. ::

      __
     (__ ___________      the hook goes; its points stay the run's
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.nearness import nearest_way

_HOOK = 2.0  # reaches along the row, that a hook may be long, ...
_STEM = 4.0  # ... and as far on a row tells the direction of its end
_ON_ITSELF = 4.0  # standard deviations from the row further on: the hook is of the same band
_LEAST = 6  # nodes of a stretch; of fewer nobody knows the direction


def without_hooks(
    nodes: FloatArray,
    sigma: FloatArray,
    reach: FloatArray,
    gaps: tuple[int, ...],
    *,
    closed: bool,
) -> BoolArray:
    """Which of the nodes (m, 2) of a row are kept, (m,); a gap follows each of `gaps`.

    Points scatter by sigma (m,) across the row.
    """
    kept = np.ones(len(nodes), np.bool_)
    for stretch in _stretches(len(nodes), gaps, closed=closed):
        if len(stretch) >= _LEAST:
            for inward in (stretch, stretch[::-1]):
                hook = _hook(nodes[inward], sigma[inward], float(reach[inward[0]]))
                kept[inward[:hook]] = False
    return kept


def _stretches(count: int, gaps: tuple[int, ...], *, closed: bool) -> list[IntArray]:
    """Nodes in order from an end, or gap, to the next; none of a loop without a gap."""
    if closed and not gaps:
        return []
    every = np.arange(count)
    if closed:
        first = gaps[0] + 1
        every, gaps = np.roll(every, -first), tuple(gap - first for gap in gaps[1:])
    return list(np.split(every, [gap + 1 for gap in gaps]))


def _hook(nodes: FloatArray, sigma: FloatArray, reach: float) -> int:
    """How many nodes a row (m, 2) begins with, back over itself, before the outmost one."""
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(nodes, axis=0), axis=1).cumsum()])
    bend, stem = np.searchsorted(along, (_HOOK * reach, (_HOOK + _STEM) * reach), side="right")
    inward = nodes[min(stem, len(nodes)) - 1] - nodes[: max(bend, 1)].mean(axis=0)
    outmost = int(np.argmin(nodes[: max(min(bend, len(nodes) - 3), 1)] @ inward))
    if not outmost:
        return 0
    onward = nodes[outmost : max(stem, outmost + 2)]
    away = nearest_way(nodes[:1], onward[:-1].copy(), np.diff(onward, axis=0))[1]
    return outmost if away[0] <= _ON_ITSELF * sigma[outmost] else 0
