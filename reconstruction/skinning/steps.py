"""Steps across strands: where, in most of them, one run ends and the next begins beside it.

The light meets the upper side and the lower, and not the wall between. A smooth surface through
both would swing on either side, so it is given an edge where the one side ends and another where
the other begins; the wall between is filled. ::

                   begins
      offset      ,------ run          edges: at `ends` and at `begins`, in every strand, as most
         run -----'                    of them have it
              ends
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, frozen

_FAR = 6.0  # standard deviations of a point, that a step is high
_STEEP = 2.0  # times as high as it is wide
_NEAR = 1.0 / 16.0  # of the middle line, that a step may lie off the one in the strand before
_FORGOTTEN = 8  # strands without it
_SHARE = 0.4  # of the strands must show a step
_STIFF = 10.0  # of the line along which a step runs: second differences beside squares
_LEAST_FACE = 1.0 / 40.0  # of the middle line, between two steps or beside a border


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step through all strands."""

    ends_mm: FloatArray  # (k,), along the middle line
    begins_mm: FloatArray  # (k,), no smaller
    shown: BoolArray  # (k,), whether the strand itself shows it

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends_mm", frozen(self.ends_mm))
        object.__setattr__(self, "begins_mm", frozen(self.begins_mm))
        object.__setattr__(self, "shown", frozen(self.shown, np.bool_))


@dataclass(frozen=True, slots=True)
class Jump:
    """A step as one strand shows it."""

    ends_mm: float
    begins_mm: float

    @property
    def at_mm(self) -> float:
        """The middle of it."""
        return 0.5 * (self.ends_mm + self.begins_mm)


@dataclass(slots=True)
class _Thread:
    strands: list[int] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)


Feet = tuple[FloatArray, FloatArray]  # of a run: along the middle line (n,), off it (n, 2)


def find_steps(
    strands: Sequence[Sequence[Feet]], borders: tuple[FloatArray, FloatArray], sigma_mm: float
) -> tuple[Step, ...]:
    """The steps that most strands show, in order along the middle line.

    Parameters
    ----------
    strands
        The runs of each, in order.
    borders
        (k,) each, where strands begin and end.
    """
    low, high = borders
    length = float(np.median(high - low))
    threads: list[_Thread] = []
    for k, runs in enumerate(strands):
        _follow(threads, k, _jumps(runs, sigma_mm), _NEAR * length)
    held = [each for each in threads if len(each.strands) >= _SHARE * len(strands)]
    found = sorted((_line(each, len(strands)) for each in held), key=lambda s: s.ends_mm.mean())
    return _apart(found, low, high, _LEAST_FACE * length)


def _jumps(runs: Sequence[Feet], sigma_mm: float) -> list[Jump]:
    found = []
    for (before, off), (after, other) in pairwise(runs):
        wide = float(after[0] - before[-1])
        high = float(np.linalg.norm(other[0] - off[-1]))
        if high > max(_FAR * sigma_mm, _STEEP * abs(wide)):
            ends, begins = sorted((float(before[-1]), float(after[0])))
            found.append(Jump(ends, begins))
    return found


def _follow(threads: list[_Thread], k: int, jumps: Sequence[Jump], reach_mm: float) -> None:
    """Add the jumps of strand k to the threads that they go on, each to the nearest."""
    for jump in jumps:
        near = [
            (abs(each.jumps[-1].at_mm - jump.at_mm), number)
            for number, each in enumerate(threads)
            if 0 < k - each.strands[-1] <= _FORGOTTEN
        ]
        away, number = min(near, default=(np.inf, -1))
        if away <= reach_mm:
            threads[number].strands.append(k)
            threads[number].jumps.append(jump)
        else:
            threads.append(_Thread([k], [jump]))


def _line(thread: _Thread, strands: int) -> Step:
    """A step through all strands: smooth through those that show it, straight on beyond."""
    shown = np.zeros(strands, np.bool_)
    shown[thread.strands] = True
    seconds = np.diff(np.eye(strands), 2, axis=0)
    normal = np.diag(shown.astype(np.float64)) + _STIFF * seconds.T @ seconds
    given = np.zeros((strands, 2))
    given[thread.strands] = [(jump.ends_mm, jump.begins_mm) for jump in thread.jumps]
    ends, begins = np.linalg.solve(normal, given).T
    return Step(np.minimum(ends, begins), np.maximum(ends, begins), shown)


def _apart(
    steps: Sequence[Step], low: FloatArray, high: FloatArray, least_mm: float
) -> tuple[Step, ...]:
    """Leave out steps that come too near to the one before, or to a border."""
    kept: list[Step] = []
    for step in steps:
        before = kept[-1].begins_mm if kept else low
        if (step.ends_mm - before).min() > least_mm and (high - step.begins_mm).min() > least_mm:
            kept.append(step)
    return tuple(kept)
