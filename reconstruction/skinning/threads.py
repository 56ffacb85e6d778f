"""From events between slices to threads of contours: branches in the making.

Every contour has two sides, down and up; what happens there joins it to a side of another one or
ends it. A thread is followed from end to end, or round. ::

    up    +--<--+      a fold: side up of the loop to side up of the hole in it
          |     |
         out    in
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from reconstruction.skinning.branch import End, Ending
from reconstruction.skinning.loops import Loops
from reconstruction.skinning.slabs import Event, Slab

DOWN, UP = 0, 1
Side = tuple[int, int]  # number of a loop, DOWN or UP


@dataclass(slots=True)
class Threads:
    """Which side of which contour follows on which; each side is in one of the two."""

    follows: dict[Side, Side] = field(default_factory=dict)
    ends: dict[Side, End] = field(default_factory=dict)
    joint_heights_mm: list[float] = field(default_factory=list)

    def tie(self, one: Side, other: Side) -> None:
        """Let two sides follow on each other."""
        self.follows[one], self.follows[other] = other, one

    def cut(self, side: Side, end: End) -> None:
        """End both sides that follow on each other here."""
        other = self.follows.pop(side)
        del self.follows[other]
        self.ends[side] = self.ends[other] = end

    def new_joint(self, height_mm: float) -> End:
        """An end in a joint of its own."""
        self.joint_heights_mm.append(height_mm)
        return End(Ending.JOINED, height_mm, len(self.joint_heights_mm) - 1)

    def onward(self, side: Side) -> list[Side]:
        """The sides at which a walk leaves contours, `side` first; to an end, or back to it."""
        walk = [side]
        while (entered := self.follows.get(walk[-1])) is not None:
            leaving = (entered[0], 1 - entered[1])
            if leaving == side:
                break
            walk.append(leaving)
        return walk

    def is_fold(self, side: Side) -> bool:
        """Whether a contour is followed by another one of its own slice here."""
        return side in self.follows and self.follows[side][1] == side[1]


@dataclass(frozen=True, slots=True)
class Chain:
    """Contours that follow each other, by number."""

    loops: list[int]
    ends: tuple[End, End] | None  # None: it runs round


def tie_threads(loops: Loops, slabs: Sequence[Slab]) -> Threads:
    """Join the sides of the contours that events are about; the stack's ends are unseen."""
    threads = Threads()
    for slab in slabs:
        for event in slab.events:
            _enter(threads, event, slab, loops)
    for number in {number for number, _ in (*threads.follows, *threads.ends)}:
        for side in ((number, DOWN), (number, UP)):
            if side not in threads.follows and side not in threads.ends:
                threads.ends[side] = End(Ending.UNSEEN, float(loops.heights_mm[number]))
    return threads


def _enter(threads: Threads, event: Event, slab: Slab, loops: Loops) -> None:
    sides = [(each, UP) for each in event.below] + [(each, DOWN) for each in event.above]
    if len(sides) == 1:
        beyond = slab.lower + 1 if event.below else slab.upper - 1
        threads.ends[sides[0]] = End(Ending.CLOSED, float(loops.stack.heights_mm[beyond]))
    elif len(sides) == 2 and _is_plain(event, loops):
        threads.tie(*sides)
    else:
        height_mm = 0.5 * float(
            loops.stack.heights_mm[slab.lower] + loops.stack.heights_mm[slab.upper]
        )
        threads.ends.update(dict.fromkeys(sides, threads.new_joint(height_mm)))


def _is_plain(event: Event, loops: Loops) -> bool:
    """Whether one of two contours goes on in the other, or they are a loop and the hole in it."""
    one, other = (loops.outlines[each].hole for each in event.below + event.above)
    return (one == other) if len(event.below) == 1 else (one != other)


def part_deep_folds(threads: Threads, loops: Loops) -> None:
    """End the inner arm of a fold where the outer one ends.

    ::

        +--+    +--+      The inside of a cup goes on where its outside meets the handle: of the
        |  |    |  |      two arms of the rim, the inner is ended in the plane of that joint, too.
        +--+----+--+ joint    Else the rim, closed by caps of its own, would not be a solid.
        |  |____|  |
        |__________|
    """
    pending = [side for side in threads.follows if threads.is_fold(side)]
    while pending:
        one = pending.pop()
        if not threads.is_fold(one):
            continue
        other = threads.follows[one]
        outer, inner = sorted((one, other), key=lambda side: int(loops.depths[side[0]]))
        last = threads.onward((outer[0], 1 - outer[1]))[-1]
        if last in threads.follows or _has_fold(threads, (outer[0], 1 - outer[1])):
            continue
        end = threads.ends[last]
        height_mm = end.height_mm
        if end.ending is Ending.CLOSED:
            height_mm = 0.5 * (height_mm + float(loops.heights_mm[last[0]]))
        passed = _passing(threads, (inner[0], 1 - inner[1]), height_mm, loops)
        if passed is None:
            continue
        if end.joint is None:
            threads.ends[last] = end = threads.new_joint(height_mm)
        threads.cut(passed, end)
        pending = [side for side in threads.follows if threads.is_fold(side)]


def _has_fold(threads: Threads, side: Side) -> bool:
    return any(threads.is_fold(each) for each in threads.onward(side))


def _passing(threads: Threads, start: Side, height_mm: float, loops: Loops) -> Side | None:
    """The side at which the arm from `start` on passes a height, short of its next fold."""
    for side in threads.onward(start):
        if side not in threads.follows or threads.is_fold(side):
            return None
        here = loops.heights_mm[side[0]]
        there = loops.heights_mm[threads.follows[side][0]]
        if min(here, there) < height_mm < max(here, there):
            return side
    return None


def chains_of(threads: Threads, loops: Loops) -> list[Chain]:
    """Follow every thread once: upward, or from its outer end where it folds."""
    chains: list[Chain] = []
    seen = np.zeros(len(loops), dtype=np.bool_)
    outer_first = np.lexsort((np.arange(len(loops)), loops.depths)).tolist()
    ends = [side for each in outer_first for side in ((each, DOWN), (each, UP))]
    begins = [side for side in ends if side in threads.ends]
    for begin in [*begins, *((each, DOWN) for each in outer_first)]:
        if seen[begin[0]] or begin not in threads.follows | threads.ends:
            continue
        walk = threads.onward((begin[0], 1 - begin[1]))
        numbers = [each for each, _ in walk]
        seen[numbers] = True
        if begin in threads.follows:
            chains.append(Chain(numbers, None))
        elif walk[-1][1] == DOWN == 1 - begin[1]:  # down all the way
            chains.append(Chain(numbers[::-1], (threads.ends[walk[-1]], threads.ends[begin])))
        else:
            chains.append(Chain(numbers, (threads.ends[begin], threads.ends[walk[-1]])))
    return chains
