"""Which contours of neighbouring slices follow each other: branches, and where they meet.

slices -> loops -> events between neighbouring slices -> threads -> branches, joints
          `loops`  `overlaps`, `slabs`, `missing`        `threads`

The branches' closed surfaces, united and taken out in their order, are the part (`joining`). ::

    united       everything that is no hole, each closed by flat caps at its ends
    taken out    holes, closed in the same way
    order        from the outside in: after a hole comes what lies in it

A folded branch whose ends lie in one plane, a loop's and that of the hole in it, is closed by one
ring between them, not by two discs (`is_ring_ended`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import NotLoftable
from reconstruction.skinning.branch import Branch, Ending, Joint
from reconstruction.skinning.doubts import (
    Doubt,
    doubtful_shapes,
    index_of,
    off_the_line,
    unusable_loops,
)
from reconstruction.skinning.loops import AROUND, Loops, loops_of
from reconstruction.skinning.missing import bridged, is_missed, seen_once
from reconstruction.skinning.outlines import Outline
from reconstruction.skinning.slabs import Event, events_between
from reconstruction.skinning.threads import Chain, Slab, chains_of, tie_threads


@dataclass(frozen=True, slots=True, eq=False)
class Branching:
    """Branches from the outside in, their joints, and what is doubtful about slices."""

    branches: tuple[Branch, ...]
    joints: tuple[Joint, ...]
    doubts: tuple[Doubt, ...]  # by slice
    left_out: tuple[Outline, ...]  # contours in no branch; a doubt says why

    @property
    def suspects(self) -> tuple[int, ...]:
        """Indices of the slices that something is said about."""
        return tuple(sorted({each.slice_index for each in self.doubts}))

    @property
    def warnings(self) -> tuple[str, ...]:
        """A line each."""
        return tuple(str(each) for each in self.doubts)


def is_ring_ended(branch: Branch) -> bool:
    """Whether a folded branch ends in a loop and the hole in it, in one plane."""
    if branch.ends is None:
        return False
    first, last = branch.ends
    folded = branch.outlines[0].hole != branch.outlines[-1].hole
    return (
        folded
        and Ending.CLOSED not in (first.ending, last.ending)
        and (first.height_mm == last.height_mm)
    )


def find_branches(slices: Sequence[Sequence[Outline]], heights_mm: ArrayLike) -> Branching:
    """Follow closed outlines from slice to slice.

    Parameters
    ----------
    slices
        The outlines of each slice, from low to high; empty where nothing was found.
    heights_mm
        (s,) of the cutting planes, ascending.

    Raises
    ------
    NotLoftable
        Fewer than two slices with outlines, or none that follow each other.
    ValueError
        Heights that descend or do not belong to the slices; an open outline; planes that are not
        parallel.
    """
    stack_mm = _checked(slices, heights_mm)
    doubts: list[Doubt] = []
    given = loops_of(slices, stack_mm)
    loops = given.without(unusable_loops(given, doubts))
    doubts += doubtful_shapes(loops)
    slabs = _slabs(loops, stack_mm)
    alone = seen_once(loops, slabs, doubts)
    if alone.any():
        loops = loops.without(alone)
        slabs = _slabs(loops, stack_mm)
    _require(loops)
    doubts += _missed(loops, slabs)
    slabs = bridged(loops, slabs, stack_mm, doubts)
    threads = tie_threads(loops, slabs, stack_mm)
    chains = [_straightened(loops, each, doubts) for each in chains_of(threads, loops)]
    chains = _outside_in(loops, chains)
    used = {id(loops.outlines[each]) for chain in chains for each in chain.loops}
    return Branching(
        tuple(_branch(loops, chain) for chain in chains),
        _joints(loops, chains, threads.joint_heights_mm),
        tuple(sorted(doubts, key=lambda each: each.slice_index)),
        tuple(each for each in given.outlines if id(each) not in used),
    )


def _checked(slices: Sequence[Sequence[Outline]], heights_mm: ArrayLike) -> FloatArray:
    stack_mm = np.asarray(heights_mm, dtype=np.float64)
    if stack_mm.shape != (len(slices),):
        raise ValueError(f"heights_mm: {len(slices)} expected, got shape {stack_mm.shape}")
    if not np.isfinite(stack_mm).all() or (np.diff(stack_mm) < 0.0).any():
        raise ValueError("heights_mm: finite and ascending expected; sort the slices first")
    return stack_mm


def _slabs(loops: Loops, stack_mm: FloatArray) -> list[Slab]:
    """Events from slice to slice, over empty ones that were missed."""
    slabs: list[Slab] = []
    none = np.empty(0, dtype=np.int64)
    drifts = np.zeros((len(loops), 2))  # mm a mm of height
    full = [int(level) for level in np.unique(loops.levels)]
    for lower, upper in pairwise([-1, *full, len(stack_mm)]):
        below = loops.at(lower)
        if (
            lower >= 0
            and upper < len(stack_mm)
            and (upper == lower + 1 or is_missed(loops, lower, upper))
        ):
            events = _followed(loops, below, loops.at(upper), drifts)
            slabs.append(Slab(lower, upper, events))
            continue
        above = loops.at(upper)
        if 0 <= lower < len(stack_mm) - 1:
            slabs.append(Slab(lower, lower + 1, events_between(loops, below, none, drifts[below])))
        if 0 < upper < len(stack_mm):
            slabs.append(Slab(upper - 1, upper, events_between(loops, none, above, drifts[none])))
    return slabs


def _followed(
    loops: Loops, below: IntArray, above: IntArray, drifts: FloatArray
) -> tuple[Event, ...]:
    """Events, and the drift of what goes on noted."""
    rise = loops.heights_mm[above[0]] - loops.heights_mm[below[0]]
    events = events_between(loops, below, above, loops.centres_mm[below] + rise * drifts[below])
    for event in events:
        if len(event.below) == len(event.above) == 1:
            (p,), (q,) = event.below, event.above
            drifts[q] = (loops.centres_mm[q] - loops.centres_mm[p]) / rise
    return events


def _require(loops: Loops) -> None:
    slices = sorted({each.slice_index for each in loops.outlines})
    if len(slices) < 2:
        few = f"only slice {slices[0]} has" if slices else "no slice has"
        raise NotLoftable(
            f"{few} contours that another slice goes on with; a surface needs two slices",
            indices=tuple(slices),
        )


def _missed(loops: Loops, slabs: Sequence[Slab]) -> list[Doubt]:
    what = "no contour, though those below and above go on in each other; bridged"
    return [
        Doubt(index_of(loops, level), what)
        for slab in slabs
        for level in range(slab.lower + 1, slab.upper)
    ]


def _straightened(loops: Loops, chain: Chain, doubts: list[Doubt]) -> Chain:
    """Leave out what lies far off the line of its neighbours."""
    found = off_the_line(loops, chain.loops)
    doubts += [doubt for doubt, _, _ in found]
    gross = {number for _, number, left_out in found if left_out}
    return replace(chain, loops=[each for each in chain.loops if each not in gross])


def _outside_in(loops: Loops, chains: Sequence[Chain]) -> list[Chain]:
    """Order chains so that each comes after those whose contours its own lie in."""
    chain_of = {each: k for k, chain in enumerate(chains) for each in chain.loops}
    hosts: list[set[int]] = [set() for _ in chains]
    for each, k in chain_of.items():
        parent = int(loops.parents[each])
        if parent != AROUND and chain_of.get(parent, k) != k:
            hosts[k].add(chain_of[parent])
    order: list[int] = []
    while len(order) < len(chains):
        left = [k for k in range(len(chains)) if k not in order]
        free = [k for k in left if hosts[k] <= set(order)]
        # A ring of hosts cannot be in space; contours that touch may feign one.
        order += free or [min(left, key=lambda k: min(loops.depths[chains[k].loops]))]
    return [chains[k] for k in order]


def _branch(loops: Loops, chain: Chain) -> Branch:
    outlines = tuple(loops.outlines[each] for each in chain.loops)
    outermost = min(chain.loops, key=lambda each: int(loops.depths[each]))
    return Branch(outlines, chain.ends is None, chain.ends, loops.outlines[outermost].hole)


def _joints(
    loops: Loops, chains: Sequence[Chain], heights_mm: Sequence[float]
) -> tuple[Joint, ...]:
    sides: list[tuple[list[int], list[int]]] = [([], []) for _ in heights_mm]
    for number, chain in enumerate(chains):
        for end, each in zip(chain.ends or (), (chain.loops[0], chain.loops[-1]), strict=False):
            if end.joint is not None:
                above = bool(loops.heights_mm[each] > end.height_mm)
                if number not in sides[end.joint][above]:
                    sides[end.joint][above].append(number)
    return tuple(
        Joint(height, tuple(below), tuple(above))
        for height, (below, above) in zip(heights_mm, sides, strict=True)
    )
