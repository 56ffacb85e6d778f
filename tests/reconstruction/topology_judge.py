"""A judge of chains who knows the outlines that the points were taken of.

A chain is right if it is the only one of its outline, is said to be closed where the outline is,
and runs along it once: every place of it that is no gap lies within a band of the outline, it
never turns back, it passes all that was seen, and it says where nothing was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.topology import Topology
from tests.reconstruction.topology_cases import STEP_MM, Outline, Scene

_SAMPLED_MM = 0.2  # along a chain
_SAG = 0.15  # share of its length that a way from node to node may cut a bend
_HELD = 0.97  # share of an outline's points that its chain must hold


class Answer(Enum):
    """How a topology stands to the truth."""

    RIGHT = "right"
    AMBIGUOUS = "ambiguous"  # says that it cannot tell, and nothing that is wrong
    WRONG = "wrong"


@dataclass(frozen=True, slots=True)
class Verdict:
    """An answer, whether any chain was said to be ambiguous, and what is wrong."""

    answer: Answer
    doubted: bool
    why: str = ""


def judge(found: Topology, scene: Scene) -> Verdict:
    """Judge what was found in the points of a scene."""
    doubted = any(chain.ambiguous for chain in found.chains)
    answers = [Answer.RIGHT]
    if not found.chains:
        return Verdict(Answer.WRONG, doubted, f"no chain of {len(scene.outlines)}")
    owner = [_owner(chain, scene.outlines) for chain in found.chains]
    for number, outline in enumerate(scene.outlines):
        chains = [chain for chain, of in zip(found.chains, owner, strict=True) if of == number]
        if not chains:
            return Verdict(Answer.WRONG, doubted, f"no chain of outline {number}")
        for chain in chains:
            why = _strays_from(chain, outline, scene, whole=len(chains) == 1)
            if why:
                return Verdict(Answer.WRONG, doubted, why)
        if len(chains) > 1 and not all(chain.ambiguous for chain in chains):
            return Verdict(Answer.WRONG, doubted, f"{len(chains)} chains of outline {number}")
        if len(chains) > 1:
            answers.append(Answer.AMBIGUOUS)
        elif chains[0].closed != outline.closed:
            if not chains[0].ambiguous:
                kind = "closed" if chains[0].closed else "open"
                return Verdict(Answer.WRONG, doubted, f"{kind} without a doubt")
            answers.append(Answer.AMBIGUOUS)
    lost = _lost(found, scene)
    if lost > 1.0 - _HELD:
        return Verdict(Answer.WRONG, doubted, f"{lost:.1%} of the points are lost")
    return Verdict(max(answers, key=list(Answer).index), doubted)


def _lost(found: Topology, scene: Scene) -> float:
    """Share of an outline's points that are in no chain, at most."""
    held = found.chain_of_point >= 0
    return max(
        1.0 - float(held[scene.outline_of_point == number].mean())
        for number in range(len(scene.outlines))
    )


def _owner(chain: Chain, outlines: Sequence[Outline]) -> int:
    """The outline that a chain lies nearest to."""
    return int(np.argmin([np.median(o.tree.query(chain.nodes_mm)[0]) for o in outlines]))


def _strays_from(chain: Chain, outline: Outline, scene: Scene, *, whole: bool) -> str:
    """What is wrong with a chain as the order of an outline's points; empty if nothing is."""
    nodes, gaps, closed = chain.nodes_mm, set(chain.gaps), chain.closed
    if closed and not outline.closed:  # a loop in doubt: read as the open run it may be
        nodes, gaps, closed = _opened(nodes, gaps)
    places, in_gap, way = _sampled(nodes, gaps, closed=closed)
    away, nearest = (np.asarray(v) for v in outline.tree.query(places))
    band = scene.band_mm
    off = np.where(in_gap, 0.0, away - _SAG * way)
    if off.max() > band:
        return f"a place lies {off.max():.2f} mm off"
    steps = _steps(nearest[~in_gap], outline, around=closed)
    back = _back(steps)
    if back > band:
        return f"it runs back by {back:.2f} mm"
    if (
        outline.closed
        and closed
        and abs(steps.sum() - outline.length_mm) > 0.01 * outline.length_mm
    ):
        return f"it passes {steps.sum():.1f} of {outline.length_mm:.1f} mm"
    missed = _longest(outline, scene.seen_of(outline), nearest[~in_gap], closed=outline.closed)
    if whole and missed > scene.blur_mm:
        return f"it leaves out {missed:.1f} mm"
    unsaid = _longest_unsaid(places, in_gap, nearest, scene.seen_of(outline))
    if unsaid > scene.blur_mm:
        return f"a gap of {unsaid:.1f} mm is not said"
    return ""


def _opened(nodes: FloatArray, gaps: set[int]) -> tuple[FloatArray, set[int], bool]:
    """A closed chain cut at its longest way."""
    ways = np.linalg.norm(np.roll(nodes, -1, axis=0) - nodes, axis=1)
    cut = int(np.argmax(ways))
    turned = {(gap - cut - 1) % len(nodes) for gap in gaps}
    return np.roll(nodes, -cut - 1, axis=0), turned - {len(nodes) - 1}, False


def _sampled(
    nodes: FloatArray, gaps: set[int], *, closed: bool
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Places along a chain, which of them lie within its gaps, and how long their ways are."""
    ring = np.vstack([nodes, nodes[:1]]) if closed else nodes
    lengths = np.linalg.norm(np.diff(ring, axis=0), axis=1)
    counts = np.maximum(np.ceil(lengths / _SAMPLED_MM).astype(np.int64), 1)
    way = np.repeat(np.arange(len(lengths)), counts)
    share = (np.arange(len(way)) - np.repeat(counts.cumsum() - counts, counts)) / counts[way]
    places = ring[way] + share[:, None] * (ring[way + 1] - ring[way])
    # A gap begins at a node, which itself is none.
    in_gap = np.isin(way, sorted(gaps)) & (share > 0.0)
    long = np.where(share > 0.0, lengths[way], 0.0)
    if not closed:
        places, in_gap = np.vstack([places, ring[-1:]]), np.append(in_gap, [False])
        long = np.append(long, 0.0)
    return places, in_gap, long


def _steps(nearest: IntArray, outline: Outline, *, around: bool) -> FloatArray:
    """Steps along an outline from foot to foot, counted positive the way most of them go."""
    feet = np.append(nearest, nearest[0]) if around else nearest
    steps = np.diff(feet).astype(np.float64)
    if outline.closed:
        half = len(outline.points_mm) / 2
        steps = np.mod(steps + half, 2 * half) - half
    return STEP_MM * steps * (np.sign(np.median(np.sign(steps[steps != 0]))) or 1.0)


def _back(steps: FloatArray) -> float:
    """The longest way back, over as many steps as it takes."""
    reached = np.concatenate([[0.0], steps.cumsum()])
    return float((np.maximum.accumulate(reached) - reached).max())


def _longest(outline: Outline, seen: BoolArray, feet: IntArray, *, closed: bool) -> float:
    """The longest stretch of the seen outline that no foot lies on."""
    count = len(seen)
    stops = np.unique(np.concatenate([feet, np.flatnonzero(~seen)]))
    if not closed:
        stops = np.concatenate([[-1], stops, [count]])
        return STEP_MM * float(np.diff(stops).max() - 1)
    return STEP_MM * float(np.diff(np.append(stops, stops[0] + count)).max() - 1)


def _longest_unsaid(
    places: FloatArray, in_gap: BoolArray, nearest: IntArray, seen: BoolArray
) -> float:
    """The longest stretch that a chain passes over unseen outline without saying so."""
    silent = ~in_gap & ~seen[nearest]
    ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
    longest = length = 0.0
    for hidden, way in zip(silent[:-1] & silent[1:], ways, strict=True):
        length = length + float(way) if hidden else 0.0
        longest = max(longest, length)
    return longest
