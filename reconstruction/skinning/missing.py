"""Contours that are missing in one slice, and contours that are in one slice only.

A contour that two slices show alike and the one between them does not was most likely missed
there. Unless its area, going on as it did before, would be gone by then: that is an end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.doubts import Doubt, index_of
from reconstruction.skinning.loops import Loops
from reconstruction.skinning.overlaps import measure_overlaps
from reconstruction.skinning.slabs import Event
from reconstruction.skinning.threads import Slab

_MOST_MISSING = 2  # empty slices in a row that may have been missed
_LIKE = 0.5  # common over united area of contours below and above


def is_missed(loops: Loops, lower: int, upper: int) -> bool:
    """Whether the empty slices between two slices, given by their places, were only missed."""
    if upper - lower - 1 > _MOST_MISSING:
        return False
    below, above = loops.at(lower), loops.at(upper)
    if not (measure_overlaps(loops, below, above).likeness >= _LIKE).any():
        return False
    middle = 0.5 * float(loops.heights_mm[below[0]] + loops.heights_mm[above[0]])
    return _goes_on(loops, below, loops.at(lower - 1), middle) and _goes_on(
        loops, above, loops.at(upper + 1), middle
    )


def bridged(
    loops: Loops, slabs: Sequence[Slab], stack_mm: FloatArray, doubts: list[Doubt]
) -> list[Slab]:
    """Join what closes below a slice with what begins above it, where the slice has missed it."""
    result = list(slabs)
    for k in range(len(slabs) - 1):
        lower, upper = result[k], result[k + 1]
        if lower.upper != upper.lower:
            continue
        for one in [each for each in lower.events if not each.above]:
            for other in [each for each in upper.events if not each.below]:
                pairs = _paired(loops, one, other, result, k, float(stack_mm[lower.upper]))
                if not pairs:
                    continue
                result[k] = lower = _less(lower, one)
                result[k + 1] = upper = _less(upper, other)
                result.append(Slab(lower.lower, upper.upper, pairs))
                size = 2.0 * float(loops.radii_mm[pairs[0].below[0]])
                what = f"a contour {size:.3g} mm across is missing that is below and above; bridged"
                doubts.append(Doubt(index_of(loops, lower.upper), what))
                break
    return result


def _paired(
    loops: Loops, one: Event, other: Event, slabs: Sequence[Slab], k: int, height_mm: float
) -> tuple[Event, ...]:
    """Each contour that vanishes with the one of its kind that appears; empty if they differ."""
    below = sorted(one.below, key=lambda each: loops.outlines[each].hole)
    above = sorted(other.above, key=lambda each: loops.outlines[each].hole)
    if len(below) != len(above):
        return ()
    for p, q in zip(below, above, strict=True):
        if loops.outlines[p].hole != loops.outlines[q].hole:
            return ()
        alike = measure_overlaps(loops, np.array([p]), np.array([q])).likeness[0, 0] >= _LIKE
        before = _before(slabs[k - 1].events, p) if k > 0 else ()
        after = _after(slabs[k + 2].events, q) if k + 2 < len(slabs) else ()
        if not (
            alike
            and _goes_on(loops, np.array([p]), np.array(before, dtype=np.int64), height_mm)
            and _goes_on(loops, np.array([q]), np.array(after, dtype=np.int64), height_mm)
        ):
            return ()
    return tuple(Event((p,), (q,)) for p, q in zip(below, above, strict=True))


def _before(events: Sequence[Event], number: int) -> tuple[int, ...]:
    return next((each.below for each in events if each.above == (number,)), ())


def _after(events: Sequence[Event], number: int) -> tuple[int, ...]:
    return next((each.above for each in events if each.below == (number,)), ())


def _less(slab: Slab, event: Event) -> Slab:
    return replace(slab, events=tuple(each for each in slab.events if each is not event))


def _goes_on(loops: Loops, here: IntArray, behind: IntArray, height_mm: float) -> bool:
    """Whether the area, changing as from `behind` to `here`, is still there at a height."""
    if not len(behind):
        return True
    signs = np.where(loops.holes, -1.0, 1.0) if len(here) > 1 else np.ones(len(loops))
    area, earlier = ((signs * loops.areas_mm2)[each].sum() for each in (here, behind))
    at, was = loops.heights_mm[here[0]], loops.heights_mm[behind[0]]
    return bool(area + (area - earlier) * (height_mm - at) / (at - was) > 0.0)


def seen_once(loops: Loops, slabs: Sequence[Slab], doubts: list[Doubt]) -> BoolArray:
    """Contours that hang together with none of another slice, (l,)."""
    alone = np.ones(len(loops), dtype=np.bool_)
    together: list[tuple[int, ...]] = []
    for slab in slabs:
        for event in slab.events:
            if event.below and event.above:
                alone[list(event.below + event.above)] = False
            else:
                together.append(event.below + event.above)
    for _ in range(2):  # a hole may hang on its loop at one end, and that on another slice
        for rims in together:
            alone[list(rims)] &= alone[list(rims)].all()
    for number in np.flatnonzero(alone):
        size = 2.0 * float(loops.radii_mm[number])
        what = f"a contour {size:.3g} mm across is in no other slice; left out"
        doubts.append(Doubt(loops.outlines[number].slice_index, what))
    return alone
