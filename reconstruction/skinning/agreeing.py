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

import numpy as np

from reconstruction.arrays import BoolArray
from reconstruction.skinning.doubts import Doubt, index_of
from reconstruction.skinning.loops import Loops
from reconstruction.skinning.slabs import Event, Slab, events_between

# A change and the change back cost 2 together. To pass over one contour costs less; to pass over
# one in each of two slices costs more: what two slices show is a feature of the part.
_PASSED_SLICE = 0.5
_LOST_CONTOUR = 1.0
_MOST_PASSED = 3  # slices in a row


def agreeing_slabs(loops: Loops, count: int, doubts: list[Doubt]) -> list[Slab]:
    """Choose among `count` slices; tell what happens between each chosen one and the next."""
    followed = _Followed(loops)
    chosen = _cheapest_way(loops, count, followed)
    slabs = []
    for lower, upper in pairwise(chosen):
        events: list[Event] = []
        for event in followed.between(lower, upper):
            way = followed.accord(event, lower, upper)
            stops = pairwise((*event.below, *way, *event.above))
            events += [Event((p,), (q,)) for p, q in stops] if way else [event]
        slabs.append(Slab(lower, upper, tuple(events)))
        doubts += _doubts(loops, slabs[-1])
    return slabs


def _cheapest_way(loops: Loops, count: int, followed: _Followed) -> list[int]:
    best, came_from = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
    best[0] = 0.0
    for upper in range(1, count):
        for lower in range(upper - 1, max(upper - _MOST_PASSED - 2, -1), -1):
            price = best[lower] + _PASSED_SLICE * (upper - lower - 1)
            if price >= best[upper]:  # so nothing is asked for where nothing changes
                continue
            price += _LOST_CONTOUR * followed.lost(lower, upper)
            price += sum(map(_changes, followed.between(lower, upper)))
            if price < best[upper] and followed.is_change_back(lower, upper):
                best[upper], came_from[upper] = price, lower
    chosen = [count - 1]
    while chosen[-1] > 0:
        chosen.append(int(came_from[chosen[-1]]))
    return chosen[::-1]


def _changes(event: Event) -> int:
    """How many elementary changes it is: beginning, closing, folding, merging, parting."""
    plain = len(event.below) == len(event.above) == 1
    return 0 if plain else max(abs(_euler(event)), 1)


def _euler(event: Event) -> int:
    """Euler number of a sphere with a hole for each rim."""
    return 2 - len(event.below) - len(event.above)


class _Followed:
    """What happens between any two slices, asked for once."""

    def __init__(self, loops: Loops) -> None:
        self._loops = loops
        self._drifts = np.zeros((len(loops), 2))  # mm a mm of height
        self._events: dict[tuple[int, int], tuple[Event, ...]] = {}
        self._partners: dict[tuple[int, int], dict[int, int]] = {}

    def between(self, lower: int, upper: int) -> tuple[Event, ...]:
        """Events; what would have ended before the next slice does not go on past empty ones."""
        events = self._seen(lower, upper)
        if upper == lower + 1:
            return events
        kept: list[Event] = []
        for event in events:
            if self._goes_on(event, lower, upper):
                kept.append(event)
            else:
                kept += [Event(event.below, ()), Event((), event.above)]
        return tuple(kept)

    def accord(self, event: Event, lower: int, upper: int) -> tuple[int, ...]:
        """Loops of the slices between that lie on the way of a contour that goes on."""
        if len(event.below) != 1 or len(event.above) != 1:
            return ()
        (here,), (goal,) = event.below, event.above
        way, level = [], lower
        for each in range(lower + 1, upper):
            found = self._partner(level, each).get(here)
            if found is not None and self._partner(each, upper).get(found) == goal:
                way.append(found)
                here, level = found, each
        return tuple(way)

    def lost(self, lower: int, upper: int) -> int:
        """How many contours between two slices are in accord with neither."""
        between = sum(len(self._loops.at(each)) for each in range(lower + 1, upper))
        events = self.between(lower, upper) if between else ()
        return between - sum(len(self.accord(each, lower, upper)) for each in events)

    def is_change_back(self, lower: int, upper: int) -> bool:
        """Whether the slices between add to the topology; a bump that merges is none the less."""
        if upper == lower + 1:
            return True
        single = [each for k in range(lower, upper) for each in self._seen(k, k + 1)]
        return sum(map(_euler, single)) != sum(map(_euler, self.between(lower, upper)))

    def _seen(self, lower: int, upper: int) -> tuple[Event, ...]:
        if (lower, upper) not in self._events:
            self._events[lower, upper] = self._follow(lower, upper)
        return self._events[lower, upper]

    def _follow(self, lower: int, upper: int) -> tuple[Event, ...]:
        loops = self._loops
        below, above = loops.at(lower), loops.at(upper)
        rise = loops.stack_mm[upper] - loops.stack_mm[lower]
        expected = loops.centres_mm[below] + rise * self._drifts[below]
        events = events_between(loops, below, above, expected)
        partners = {p: q for (p,), (q,) in map(_plain, events) if p >= 0}
        self._partners[lower, upper] = partners
        if upper == lower + 1:
            for p, q in partners.items():
                self._drifts[q] = (loops.centres_mm[q] - loops.centres_mm[p]) / rise
        return events

    def _partner(self, lower: int, upper: int) -> dict[int, int]:
        self._seen(lower, upper)
        return self._partners[lower, upper]

    def _goes_on(self, event: Event, lower: int, upper: int) -> bool:
        """Whether a contour that nothing between shows should have been there by its area."""
        if len(event.below) != 1 or len(event.above) != 1 or self.accord(event, lower, upper):
            return True
        (p,), (q,) = event.below, event.above
        before = [k for k, v in self._partner(lower - 1, lower).items() if v == p] if lower else []
        after = []
        if upper + 1 < len(self._loops.stack_mm) and q in self._partner(upper, upper + 1):
            after = [self._partner(upper, upper + 1)[q]]
        middle = 0.5 * float(self._loops.heights_mm[p] + self._loops.heights_mm[q])
        return all(
            self._area_left(here, behind, middle)
            for here, behinds in ((p, before), (q, after))
            for behind in behinds
        )

    def _area_left(self, here: int, behind: int, height_mm: float) -> bool:
        areas, heights = self._loops.areas_mm2, self._loops.heights_mm
        slope = (areas[here] - areas[behind]) / (heights[here] - heights[behind])
        return bool(areas[here] + slope * (height_mm - heights[here]) > 0.0)


def _plain(event: Event) -> tuple[tuple[int, ...], tuple[int, ...]]:
    if len(event.below) == len(event.above) == 1:
        return event.below, event.above
    return (-1,), (-1,)


def _doubts(loops: Loops, slab: Slab) -> list[Doubt]:
    """Say what was passed over."""
    used = {each for event in slab.events for each in event.below + event.above}
    found = []
    for level in range(slab.lower + 1, slab.upper):
        here = loops.at(level)
        lost = sum(int(each) not in used for each in here)
        what = "no contour, though those below and above go on in each other; bridged"
        if len(here):
            what = (
                f"{len(here)} contours do not follow on those below and above, which go on in"
                f" each other; {lost} of them left out"
            )
        found.append(Doubt(index_of(loops, level), what))
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
