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

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolArray
from reconstruction.errors import NotLoftable
from reconstruction.skinning.agreeing import agreeing_slabs, seen_once
from reconstruction.skinning.branch import Branch, Ending, Joint
from reconstruction.skinning.doubt import Doubt
from reconstruction.skinning.doubts import (
    crossings,
    doubtful_shapes,
    off_the_line,
    scattered,
    unusable_loops,
)
from reconstruction.skinning.loops import AROUND, Loops, loops_of
from reconstruction.skinning.outlines import Outline
from reconstruction.skinning.shoulders import part_at_shoulders
from reconstruction.skinning.slabs import Event, Slab
from reconstruction.skinning.stack import stack_up
from reconstruction.skinning.threads import Chain, chains_of, part_deep_folds, tie_threads


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


def find_branches(
    slices: Sequence[Sequence[Outline]],
    heights_mm: ArrayLike,
    *,
    indices: Sequence[int] | None = None,
    unresolved: Sequence[bool] | None = None,
) -> Branching:
    """Follow closed outlines from slice to slice.

    Parameters
    ----------
    slices
        The outlines of each slice, from low to high; empty where nothing was found.
    heights_mm
        (s,) of the cutting planes, ascending.
    indices
        (s,) of the slices, to name them by; unset: those of their outlines, and an empty slice
        counts on from the one below.
    unresolved
        (s,), whether points of a slice hang together in no closed outline, but in open runs or
        heaps: what is missing there is not known to end.

    Raises
    ------
    NotLoftable
        Fewer than two slices with outlines, or none that follow each other.
    ValueError
        Heights that descend or do not belong to the slices; an open outline; planes that are not
        parallel.
    """
    doubts: list[Doubt] = []
    given = loops_of(stack_up(slices, heights_mm, indices, unresolved, doubts))
    loops = given.without(unusable_loops(given, doubts))
    crossing = crossings(loops)
    doubts += doubtful_shapes(loops, crossing)
    doubtful = crossing.any(axis=1) | scattered(loops)
    slabs = agreeing_slabs(loops, doubtful, doubts)
    slabs = _without(slabs, seen_once(loops, slabs, doubts))
    _require(loops, slabs)
    threads = tie_threads(loops, slabs)
    part_at_shoulders(threads, loops)
    part_deep_folds(threads, loops)
    chains = [
        _straightened(loops, each, crossing[:, 0], doubts) for each in chains_of(threads, loops)
    ]
    chains = _outside_in(loops, chains)
    used = {id(loops.outlines[each]) for chain in chains for each in chain.loops}
    return Branching(
        tuple(_branch(loops, chain) for chain in chains),
        _joints(loops, chains, threads.joint_heights_mm),
        tuple(sorted(doubts, key=lambda each: each.slice_index)),
        tuple(each for each in given.outlines if id(each) not in used),
    )


def _without(slabs: Sequence[Slab], dropped: BoolArray) -> list[Slab]:
    """Leave out the events of loops that nothing else hangs on."""
    return [
        replace(slab, events=tuple(each for each in slab.events if not _about(each, dropped)))
        for slab in slabs
    ]


def _about(event: Event, dropped: BoolArray) -> bool:
    return bool(dropped[list(event.below + event.above)].any())


def _require(loops: Loops, slabs: Sequence[Slab]) -> None:
    if any(slab.events for slab in slabs):
        return
    indices = tuple(sorted({each.slice_index for each in loops.outlines}))
    if len(indices) < 2:
        found = f"only slice {indices[0]} has contours" if indices else "no slice has contours"
    else:
        found = f"no contour of {len(indices)} slices goes on in another one"
    raise NotLoftable(f"{found}; a surface needs two slices that overlap", indices=indices)


def _straightened(loops: Loops, chain: Chain, crossing: BoolArray, doubts: list[Doubt]) -> Chain:
    """Leave out what lies far off the line of its neighbours, and what crosses itself.

    Where half of a branch crosses itself, nothing better is there to take its place.
    """
    found = off_the_line(loops, chain.loops)
    doubts += [doubt for doubt, _, _ in found]
    dropped = {number for _, number, gross in found if gross}
    tangled = {each for each in chain.loops if crossing[each]}
    if 2 * len(tangled) < len(chain.loops):
        dropped |= tangled
    return replace(chain, loops=[each for each in chain.loops if each not in dropped])


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
    pitch_mm = float(np.median(np.diff(loops.stack.heights_mm)))
    hole = loops.outlines[outermost].hole
    return Branch(outlines, chain.ends is None, chain.ends, hole, pitch_mm)


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
