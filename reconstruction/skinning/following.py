"""What happens between any two slices, asked for once, with what was learnt on the way.

A contour drifts: where it will be in the next slice is foretold from the one before. One that the
slices between do not show goes on past them only if its area, changing as it did, would not have
gone by then.
"""

from __future__ import annotations

import numpy as np

from reconstruction.skinning.loops import Loops
from reconstruction.skinning.overlaps import likeness_to
from reconstruction.skinning.slabs import Event, events_between


class Followed:
    """The events between slices of a stack, by their places."""

    def __init__(self, loops: Loops) -> None:
        self._loops = loops
        self._drifts = np.zeros((len(loops), 2))  # mm a mm of height
        self._events: dict[tuple[int, int], tuple[Event, ...]] = {}
        self._partners: dict[tuple[int, int], dict[int, int]] = {}

    def between(self, lower: int, upper: int) -> tuple[Event, ...]:
        """Events; what would have ended before the next slice does not go on past empty ones."""
        events = self.seen(lower, upper)
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
        """Loops of the slices between that lie on the way of a contour that goes on.

        One that lies rather where a hole is, below and above, is a hole that has lost its outline.
        """
        if len(event.below) != 1 or len(event.above) != 1:
            return ()
        (here,), (goal,) = event.below, event.above
        way, level = [], lower
        for each in range(lower + 1, upper):
            found = self._partner(level, each).get(here)
            if found is None or self._partner(each, upper).get(found) != goal:
                continue
            if self._is_another(found, here, level) and self._is_another(found, goal, upper):
                continue
            way.append(found)
            here, level = found, each
        return tuple(way)

    def _is_another(self, number: int, partner: int, level: int) -> bool:
        """Whether a loop looks less like its partner than like one of the other kind there."""
        numbers = self._loops.at(level)
        others = numbers[self._loops.holes[numbers] != self._loops.holes[partner]]
        if not len(others):
            return False
        alike = likeness_to(self._loops, number, np.append(partner, others))
        return bool(alike[1:].max() > alike[0])

    def seen(self, lower: int, upper: int) -> tuple[Event, ...]:
        """Events, without a look at what lies between."""
        if (lower, upper) not in self._events:
            self._events[lower, upper] = self._follow(lower, upper)
        return self._events[lower, upper]

    def _follow(self, lower: int, upper: int) -> tuple[Event, ...]:
        loops = self._loops
        below, above = loops.at(lower), loops.at(upper)
        rise = loops.stack.heights_mm[upper] - loops.stack.heights_mm[lower]
        expected = loops.centres_mm[below] + rise * self._drifts[below]
        events = events_between(loops, below, above, expected)
        partners = {p: q for (p,), (q,) in map(_plain, events) if p >= 0}
        self._partners[lower, upper] = partners
        if upper == lower + 1:
            for p, q in partners.items():
                self._drifts[q] = (loops.centres_mm[q] - loops.centres_mm[p]) / rise
        return events

    def _partner(self, lower: int, upper: int) -> dict[int, int]:
        self.seen(lower, upper)
        return self._partners[lower, upper]

    def _goes_on(self, event: Event, lower: int, upper: int) -> bool:
        """Whether a contour should be there by its area, in slices between that do not show it."""
        if len(event.below) != 1 or len(event.above) != 1:
            return True
        (p,), (q,) = event.below, event.above
        before, after = self._before(p, lower), self._after(q, upper)
        stops = [*before, p, *self.accord(event, lower, upper), q, *after]
        missed = np.flatnonzero(np.diff(self._loops.levels[stops]) > 1)
        return all(self._is_bridged(stops, int(each)) for each in missed)

    def _before(self, number: int, level: int) -> list[int]:
        pairs = self._partner(level - 1, level).items() if level else ()
        return [p for p, q in pairs if q == number]

    def _after(self, number: int, level: int) -> list[int]:
        if level + 1 == len(self._loops.stack.heights_mm):
            return []
        return [q for p, q in self._partner(level, level + 1).items() if p == number]

    def _is_bridged(self, stops: list[int], at: int) -> bool:
        """Whether there are points on the way to the next stop, or else no side would vanish."""
        p, q = stops[at], stops[at + 1]
        between = slice(self._loops.levels[p] + 1, self._loops.levels[q])
        if self._loops.stack.unresolved[between].all():
            return True
        middle = 0.5 * float(self._loops.heights_mm[p] + self._loops.heights_mm[q])
        from_below = at == 0 or self._area_left(p, stops[at - 1], middle)
        return from_below and (at + 2 == len(stops) or self._area_left(q, stops[at + 2], middle))

    def _area_left(self, here: int, behind: int, height_mm: float) -> bool:
        areas, heights = self._loops.areas_mm2, self._loops.heights_mm
        slope = (areas[here] - areas[behind]) / (heights[here] - heights[behind])
        return bool(areas[here] + slope * (height_mm - heights[here]) > 0.0)


def _plain(event: Event) -> tuple[tuple[int, ...], tuple[int, ...]]:
    if len(event.below) == len(event.above) == 1:
        return event.below, event.above
    return (-1,), (-1,)
