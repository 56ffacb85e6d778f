"""The judge of chains knows right from wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.topology import Topology
from tests.reconstruction.topology_cases import Scene, arc, ellipse, scene
from tests.reconstruction.topology_judge import Answer, judge

GAP = scene(ellipse(50, 50), np.random.default_rng(0), per_mm=10.0, band_mm=1.0, gap_degrees=40.0)
ARC = scene(arc(50.0, 320.0), np.random.default_rng(0), per_mm=10.0, band_mm=1.0)


def found(made: Scene, *chains: Chain, held: int = 0) -> Topology:
    """What a program would have found that says all points are of one chain."""
    of_point = np.where(made.outline_of_point >= 0, held, -1)
    return Topology(tuple(chains), (0,) * len(chains), of_point.astype(np.int32), 0.3, 0.1)


def nodes_of(made: Scene) -> FloatArray:
    """The seen part of the only outline, from one side of its gap to the other, a node a mm."""
    (outline,), (seen,) = made.outlines, made.seen
    after = int(np.flatnonzero(~seen & np.roll(seen, -1))[0]) + 1 if not seen.all() else 0
    turned, visible = np.roll(outline.points_mm, -after, axis=0), np.roll(seen, -after)
    return turned[visible][::20]


def chain(nodes: FloatArray, *, closed: bool = True, ambiguous: bool = False) -> Chain:
    gaps = (len(nodes) - 1,) if closed else ()
    return Chain(nodes, np.full(len(nodes), 0.3), closed, gaps, ambiguous)


def test_the_true_outline_is_right_either_way_round() -> None:
    nodes = nodes_of(GAP)
    for way in (nodes, nodes[::-1]):
        verdict = judge(found(GAP, chain(way)), GAP)
        assert verdict.answer is Answer.RIGHT
        assert not verdict.doubted
    assert judge(found(GAP, chain(nodes, ambiguous=True)), GAP).doubted


def test_a_loop_that_is_said_to_be_open_is_wrong_or_unsure() -> None:
    nodes = nodes_of(GAP)
    assert judge(found(GAP, chain(nodes, closed=False)), GAP).answer is Answer.WRONG
    doubt = chain(nodes, closed=False, ambiguous=True)
    assert judge(found(GAP, doubt), GAP).answer is Answer.AMBIGUOUS


def test_a_run_that_is_said_to_be_a_loop_is_wrong_or_unsure() -> None:
    nodes = ARC.outlines[0].points_mm[::20]
    assert judge(found(ARC, chain(nodes, closed=False)), ARC).answer is Answer.RIGHT
    assert judge(found(ARC, chain(nodes)), ARC).answer is Answer.WRONG
    assert judge(found(ARC, chain(nodes, ambiguous=True)), ARC).answer is Answer.AMBIGUOUS


def test_pieces_are_wrong_unless_they_are_all_in_doubt() -> None:
    nodes = nodes_of(GAP)
    sure = [chain(part, closed=False) for part in (nodes[:100], nodes[100:])]
    assert judge(found(GAP, *sure), GAP).answer is Answer.WRONG
    unsure = [replace(part, ambiguous=True) for part in sure]
    assert judge(found(GAP, *unsure), GAP).answer is Answer.AMBIGUOUS


def test_what_runs_elsewhere_or_back_or_leaves_out_or_hides_a_gap_is_wrong() -> None:
    nodes = nodes_of(GAP)
    swapped = nodes.copy()
    swapped[50:60] = swapped[50:60][::-1]  # to and fro within 9 mm, more than the band
    bulging = nodes.copy()
    bulging[80] *= 1.04
    shortened = np.delete(nodes, slice(100, 115), axis=0)
    silent = replace(chain(nodes), gaps=())
    words = {
        "back": chain(swapped),
        "off": chain(bulging),
        "leaves out": replace(chain(shortened), gaps=(99, len(shortened) - 1)),
        "not said": silent,
    }
    for word, each in words.items():
        verdict = judge(found(GAP, each), GAP)
        assert verdict.answer is Answer.WRONG
        assert word in verdict.why or (word == "not said" and "off" in verdict.why)


def test_twice_around_is_wrong() -> None:
    whole = scene(ellipse(50, 50), np.random.default_rng(0), per_mm=10.0, band_mm=1.0)
    angle = np.linspace(0.0, 2.0 * math.tau, 700, endpoint=False)
    nodes = 50.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    twice = Chain(nodes, np.full(700, 0.3), closed=True)
    assert "passes" in judge(found(whole, twice), whole).why


def test_a_chain_that_lost_its_points_or_is_missing_is_wrong() -> None:
    nodes = nodes_of(GAP)
    assert "lost" in judge(found(GAP, chain(nodes), held=-1), GAP).why
    assert "no chain" in judge(found(GAP), GAP).why
