"""Shoulders: where contours that follow each other change at once, between two slices.

One smooth surface through both would swing on either side of the step. So branches end there in a
plane midway, as where contours split, and the part between them is level. ::

    slice 4      |   |
    slice 3      |   |      steps up here are small ...
    joint     +--+   +--+   ... the step over this joint is far beyond its neighbours' ...
    slice 2   |         |   ... and beyond the noise
    slice 1   |         |
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from reconstruction.distances import polygon_distances
from reconstruction.skinning.loops import Loops
from reconstruction.skinning.threads import DOWN, UP, Side, Threads, chains_of

_ABRUPT = 4.0  # times what a wall as steep as beside it would step
_CLEAR = 6.0  # standard deviations of a point
_LEVEL = 1e-300
_NEARLY_ALL = 0.9  # of a contour: beside a shoulder so much of it is calm ...
_MOST = 0.75  # ... and at one so much of it steps; features of one side are no shoulders
_APART = 4  # slices, on average: where every other one steps, a slope was recorded in terraces


def part_at_shoulders(threads: Threads, loops: Loops) -> None:
    """End branches in a level joint where their contours step abruptly."""
    for chain in chains_of(threads, loops):
        for one, other in _shoulders(loops, chain.loops):
            height_mm = 0.5 * float(loops.heights_mm[one] + loops.heights_mm[other])
            threads.cut(_side(loops, one, other), threads.new_joint(height_mm))


def _side(loops: Loops, one: int, other: int) -> Side:
    """The side at which a contour is left for the next one."""
    return one, UP if loops.heights_mm[other] > loops.heights_mm[one] else DOWN


def _shoulders(loops: Loops, chain: Sequence[int]) -> list[tuple[int, int]]:
    """Contours that follow each other, but not smoothly."""
    rises = np.abs(np.diff(loops.heights_mm[list(chain)]))
    least, most = np.array([_steps(loops, a, b) for a, b in pairwise(chain)]).reshape(-1, 2).T
    slopes = most / np.maximum(rises, _LEVEL)
    sigmas = [loops.outlines[each].fitted.sigma_mm for each in chain]
    clear = [_CLEAR * max(pair) for pair in pairwise(sigmas)]
    found = [
        (chain[k], chain[k + 1])
        for k in range(1, len(rises) - 1)
        # A fold rises by nothing: what lies beyond it is another wall.
        if rises[k - 1 : k + 2].all()
        and least[k] > max(_ABRUPT * rises[k] * max(slopes[[k - 1, k + 1]]), clear[k])
    ]
    return found if _APART * len(found) <= len(chain) else []


def _steps(loops: Loops, one: int, other: int) -> tuple[float, float]:
    """How far two contours are apart, seen along the axis: most of them, and nearly all."""
    corners = loops.corners_mm[one], loops.corners_mm[other]
    ways = [np.abs(polygon_distances(a, b)) for a, b in (corners, corners[::-1])]
    least = min(float(np.quantile(way, 1.0 - _MOST)) for way in ways)
    return least, max(float(np.quantile(way, _NEARLY_ALL)) for way in ways)
