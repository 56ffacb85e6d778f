"""What becomes of contours between two neighbouring slices.

Regions of material, and regions of void, are linked from slice to slice where they overlap, or are
near and alike. Linked regions are one body, or one void, of the slab between the slices; a contour
parts a body from a void, and all contours of the slab that part the same two are the rims of one
piece of surface::

    rims below | above
      1        |   1     it goes on
      1        |   0     it closes                  (and upside down: it begins)
      2        |   0     a loop and the hole in it vanish together
      more               contours split or merge

So a hole that opens over void comes out of the outer contour (a handle lying flat), one that opens
over material does not (the inside of a cup): nothing else tells them apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.loops import AROUND, Loops
from reconstruction.skinning.overlaps import Overlaps, measure_overlaps

_STRONG = 0.5  # of the smaller region
_WEAK = 0.2  # enough for a region that has no better partner
_ALIKE = 0.3  # common over united area; enough where neither has another partner
_STRETCH = 2.5  # ratio of areas that may still be one part, drifting


@dataclass(frozen=True, slots=True)
class Event:
    """Contours, by number, that one piece of surface between two slices ends in."""

    below: tuple[int, ...]
    above: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Slab:
    """What happens between two slices, given by their places in the stack."""

    lower: int
    upper: int  # more than lower + 1 where slices were passed over
    events: tuple[Event, ...]


def events_between(
    loops: Loops, lower: IntArray, upper: IntArray, expected_mm: FloatArray
) -> tuple[Event, ...]:
    """Tell what becomes of loops (a,) of one slice and (b,) of the next, by their numbers.

    Parameters
    ----------
    expected_mm
        (a, 2), where the centre of each lower loop has drifted by the height of the upper slice.
    """
    overlaps = measure_overlaps(loops, lower, upper)
    if len(lower) == len(upper) == 1 and overlaps.direct[0, 0] >= _STRONG:
        return (Event((int(lower[0]),), (int(upper[0]),)),)
    linked = _linked(overlaps, _Slab(loops, lower, upper), expected_mm)
    return _gathered(loops, lower, upper, _number_bodies(linked))


class _Slab:
    """Numbers of the slab's loops counted from 0 in each slice; AROUND stays -1."""

    def __init__(self, loops: Loops, lower: IntArray, upper: IntArray) -> None:
        self.same = loops.holes[lower][:, None] == loops.holes[upper][None, :]
        self.parents = tuple(_local_parents(loops, each) for each in (lower, upper))
        self.depths = loops.depths[lower][:, None] + loops.depths[upper][None, :]
        self.radii = loops.radii_mm[lower], loops.radii_mm[upper]
        self.centres = loops.centres_mm[upper]


def _local_parents(loops: Loops, numbers: IntArray) -> IntArray:
    parents = loops.parents[numbers]
    return np.where(parents == AROUND, AROUND, parents - (numbers[0] if len(numbers) else 0))


def _linked(overlaps: Overlaps, slab: _Slab, expected: FloatArray) -> BoolArray:
    """Which regions are one body or one void, (a + 1, b + 1); the surroundings last."""
    share = overlaps.direct.copy()
    share[:-1, :-1] = np.maximum(share[:-1, :-1], _through_holes(overlaps.agreement, slab))
    linked = share >= _STRONG
    for p, q in _descending(share[:-1, :-1], _WEAK):
        if not (linked[p].any() and linked[:, q].any()):
            linked[p, q] = True
    for p, q in _descending(overlaps.likeness, _ALIKE):
        _link_lonely(linked, p, q, slab)
    for p, q in _descending(_nearness(slab, expected), 0.0):
        _link_lonely(linked, p, q, slab)
    return linked


def _through_holes(agreement: FloatArray, slab: _Slab) -> FloatArray:
    """The agreement of loops, but none where an outer loop around one of them claims the other.

    Else a ring that begins in the bore of a tube would agree with the tube.
    """
    claimed = np.zeros_like(agreement)
    for p, q in _ascending(slab.depths):
        around = any(claimed[p, each] >= _STRONG for each in _ancestors(slab.parents[1], q))
        around |= any(claimed[each, q] >= _STRONG for each in _ancestors(slab.parents[0], p))
        claimed[p, q] = 0.0 if around else agreement[p, q]
    return claimed


def _ascending(depths: IntArray) -> Iterator[tuple[int, int]]:
    for at in np.argsort(depths, axis=None, kind="stable"):
        yield divmod(int(at), depths.shape[1])


def _descending(scores: FloatArray, least: float) -> Iterator[tuple[int, int]]:
    """Pairs from the best down to `least`, which is not enough."""
    for at in np.argsort(-scores, axis=None, kind="stable"):
        p, q = divmod(int(at), scores.shape[1])
        if not scores[p, q] > least:
            return
        yield p, q


def _ancestors(parents: IntArray, each: int) -> Iterator[int]:
    while (each := int(parents[each])) != AROUND:
        yield each


def _link_lonely(linked: BoolArray, p: int, q: int, slab: _Slab) -> None:
    """Link two that have no partner, if what they lie in is linked."""
    lonely = not (linked[p].any() or linked[:, q].any())
    if lonely and slab.same[p, q] and linked[slab.parents[0][p], slab.parents[1][q]]:
        linked[p, q] = True


def _nearness(slab: _Slab, expected: FloatArray) -> FloatArray:
    """Positive where two loops would nearly touch and are of like size: 1 at the same place."""
    reach = slab.radii[0][:, None] + slab.radii[1][None, :]
    away = np.linalg.norm(expected[:, None] - slab.centres[None], axis=2)
    stretch = (slab.radii[0][:, None] / np.maximum(slab.radii[1][None, :], 1e-300)) ** 2
    alike = (stretch < _STRETCH) & (stretch > 1.0 / _STRETCH)
    return np.where(alike & slab.same, 1.0 - away / np.maximum(reach, 1e-300), 0.0)


def _gathered(
    loops: Loops, lower: IntArray, upper: IntArray, bodies: tuple[IntArray, IntArray]
) -> tuple[Event, ...]:
    """Contours by the body and the void that they part."""
    rims: dict[tuple[int, int], tuple[list[int], list[int]]] = {}
    for side, (numbers, body) in enumerate(zip((lower, upper), bodies, strict=True)):
        parents = _local_parents(loops, numbers)
        for each, number in enumerate(numbers):
            inner, outer = int(body[each]), int(body[parents[each]])
            parted = (outer, inner) if loops.holes[number] else (inner, outer)
            rims.setdefault(parted, ([], []))[side].append(int(number))
    return tuple(Event(tuple(below), tuple(above)) for below, above in rims.values())


@njit(cache=True)
def _number_bodies(linked: BoolArray) -> tuple[IntArray, IntArray]:
    """Number the connected regions: of the lower slice (a + 1,), and of the upper (b + 1,)."""
    a, b = linked.shape
    body = np.arange(a + b)
    changed = True
    while changed:
        changed = False
        for p in range(a):
            for q in range(b):
                if linked[p, q] and body[p] != body[a + q]:
                    body[p] = body[a + q] = min(body[p], body[a + q])
                    changed = True
    return body[:a], body[a:]
