"""Which slices to believe where neighbours contradict each other.

A contour that is missing in one slice, two that have run together in one, a slice that was pushed
aside: each looks like a part that changes its topology and at once changes it back. Passing over a
slice has a price, and so has every change; the cheapest way from the lowest slice to the highest
is taken (a shortest path). What a slice that was passed over shows in accord with the slices below
and above is used all the same. ::

    slice 7   o   o      changes: 1 + 1, dearer than      o   o
    slice 6     o        passing over slice 6             |   |
    slice 5   o   o                                       o   o
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np

from reconstruction.arrays import BoolArray
from reconstruction.skinning.doubt import Doubt
from reconstruction.skinning.following import Followed
from reconstruction.skinning.loops import Loops
from reconstruction.skinning.slabs import Event, Slab

# A change and the change back cost 2 together. To pass over one contour costs less; to pass over
# one in each of two slices costs more: what two slices show is a feature of the part.
_PASSED_SLICE = 0.5
_UNRESOLVED_SLICE = 0.1  # what is missing there is not known to end
_LOST_CONTOUR = 1.0  # nothing, if it was doubtful anyway
_MOST_PASSED = 3  # slices in a row
_MOST_UNRESOLVED = 12


def agreeing_slabs(loops: Loops, doubtful: BoolArray, doubts: list[Doubt]) -> list[Slab]:
    """Choose among the slices; tell what happens between each chosen one and the next.

    `doubtful` (l,) contours weigh nothing; at the ends of the stack, slices are passed over only
    if they have no others.
    """
    followed, count = Followed(loops), len(loops.stack)
    if count < 2:
        return []
    chosen = cheapest_way(_Prices(loops, followed, doubtful), count)
    slabs = []
    for lower, upper in pairwise(chosen):
        events: list[Event] = []
        for event in followed.between(lower, upper):
            way = followed.accord(event, lower, upper)
            stops = pairwise((*event.below, *way, *event.above))
            events += [Event((p,), (q,)) for p, q in stops] if way else [event]
        slabs.append(Slab(lower, upper, tuple(events)))
    doubts += _passed_over(loops, slabs, count)
    return slabs


class _Prices:
    """What ways through the stack cost."""

    def __init__(self, loops: Loops, followed: Followed, doubtful: BoolArray) -> None:
        self._loops, self._followed = loops, followed
        self._weights = np.where(doubtful, 0.0, _LOST_CONTOUR)

    def passing(self, lower: int, upper: int) -> float:
        """Of the slices between, without their contours."""
        unresolved = int(self._loops.stack.unresolved[lower + 1 : upper].sum())
        others = upper - lower - 1 - unresolved
        if others > _MOST_PASSED or unresolved > _MOST_UNRESOLVED:
            return np.inf
        return _PASSED_SLICE * others + _UNRESOLVED_SLICE * unresolved

    def going(self, lower: int, upper: int) -> float:
        """Of the contours between that are in accord with neither slice, and of all changes.

        Slices are not passed over for a bump: what begins and then merges is no change back.
        """
        events = self._followed.between(lower, upper)
        price = float(sum(map(_changes, events)))
        if upper == lower + 1:
            return price
        single = [each for k in range(lower, upper) for each in self._followed.seen(k, k + 1)]
        if sum(map(_balance, single)) == sum(map(_balance, events)):
            return np.inf
        between = range(lower + 1, upper)
        price += sum(float(self._weights[self._loops.at(level)].sum()) for level in between)
        return price - sum(
            float(self._weights[list(self._followed.accord(each, lower, upper))].sum())
            for each in events
        )

    def leaving_out(self, levels: range) -> float:
        """Of slices at an end of the stack."""
        if len(levels) > _MOST_PASSED:
            return np.inf
        numbers = [self._loops.at(level) for level in levels]
        if any(not len(each) or self._weights[each].any() for each in numbers):
            return np.inf
        return _PASSED_SLICE * len(levels)


class Prices(Protocol):
    """What ways through a stack cost."""

    def passing(self, lower: int, upper: int) -> float:
        """Of the slices between two, in any case; infinite if they are too many."""

    def going(self, lower: int, upper: int) -> float:
        """Of the way from one slice to another, besides; asked for only where it may pay."""

    def leaving_out(self, levels: range) -> float:
        """Of slices at an end of the stack."""


def cheapest_way(prices: Prices, count: int) -> list[int]:
    """Choose the slices of the cheapest way through `count` of them; 2 or more of each."""
    begun = np.array([prices.leaving_out(range(level)) for level in range(count)])
    come = np.full(count, np.inf)  # from below
    came_from = np.full(count, -1)
    for upper in range(1, count):
        for lower in range(upper - 1, -1, -1):
            passing = prices.passing(lower, upper)
            if passing == np.inf:
                break
            price = min(begun[lower], come[lower]) + passing
            if price >= come[upper]:  # so nothing is asked for where nothing changes
                continue
            price += prices.going(lower, upper)
            if price < come[upper]:
                come[upper], came_from[upper] = price, lower
    ends = [come[last] + prices.leaving_out(range(last + 1, count)) for last in range(count)]
    chosen = [int(np.argmin(ends))]
    while len(chosen) == 1 or come[chosen[-1]] < begun[chosen[-1]]:
        chosen.append(int(came_from[chosen[-1]]))
    return chosen[::-1]


def _changes(event: Event) -> int:
    """How many elementary changes it is: beginning, closing, folding, merging, parting."""
    return abs(_balance(event))


def _balance(event: Event) -> int:
    """1 for what begins or ends, a fold as well; -1 for each merging or parting."""
    rims = len(event.below) + len(event.above)
    return 1 if rims == 2 and not (event.below and event.above) else 2 - rims


def _passed_over(loops: Loops, slabs: Sequence[Slab], count: int) -> list[Doubt]:
    """Say which slices were passed over, and what of theirs is used."""
    used = {each for slab in slabs for event in slab.events for each in event.below + event.above}
    chosen = {level for slab in slabs for level in (slab.lower, slab.upper)}
    found = []
    for level in sorted(set(range(count)) - chosen):
        here = loops.at(level)
        lost = sum(int(each) not in used for each in here)
        what = "no contour, though those below and above go on in each other; bridged"
        if lost:
            what = f"{lost} of {len(here)} contours contradict the slices below and above; left out"
        elif len(here):
            what = "a contour that the slices below and above show is missing; bridged"
        found.append(Doubt(int(loops.stack.indices[level]), what))
    return found


def seen_once(loops: Loops, slabs: Sequence[Slab], doubts: list[Doubt]) -> BoolArray:
    """Contours that hang together with none of another slice, (l,)."""
    alone = np.zeros(len(loops), dtype=np.bool_)
    for slab in slabs:
        for event in slab.events:
            alone[list(event.below + event.above)] = True
    together: list[list[int]] = []
    for slab in slabs:
        for event in slab.events:
            rims = list(event.below + event.above)
            if event.below and event.above:
                alone[rims] = False
            else:
                together.append(rims)
    for _ in range(2):  # a hole may hang on its loop at one end, and that on another slice
        for rims in together:
            alone[rims] &= alone[rims].all()
    for number in np.flatnonzero(alone):
        what = f"a contour {loops.across(int(number))} is in no other slice; left out"
        doubts.append(Doubt(loops.outlines[number].slice_index, what))
    return alone
