"""A slice of a solid has closed contours, also where its points alone cannot tell."""

from __future__ import annotations

import math

import numpy as np

from reconstruction.fitting.chain import Chain
from reconstruction.fitting.nesting import signed_area
from reconstruction.fitting.solidity import as_of_a_solid
from reconstruction.fitting.topology import Topology


def arc(radius: float, degrees: float, *, ambiguous: bool = True) -> Chain:
    angle = np.linspace(0.0, -math.radians(degrees), 120)
    nodes = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Chain(nodes, np.full(120, 0.1), closed=False, ambiguous=ambiguous)


def found(*chains: Chain) -> Topology:
    return Topology(chains, (0,) * len(chains), np.zeros(4, np.int32), 0.1, 0.1)


def test_a_run_that_is_nearly_a_loop_is_closed_counter_clockwise_and_stays_in_doubt() -> None:
    (chain,) = as_of_a_solid(found(arc(50.0, 320.0))).chains
    assert chain.closed
    assert chain.ambiguous
    assert signed_area(chain.nodes_mm) > 0.0
    ways = np.linalg.norm(np.roll(chain.nodes_mm, -1, axis=0) - chain.nodes_mm, axis=1)
    assert chain.gaps == (int(np.argmax(ways)),)


def test_a_run_without_doubt_a_half_and_a_small_one_stay_open() -> None:
    for chains in (
        [arc(50.0, 320.0, ambiguous=False)],
        [arc(50.0, 200.0)],
        [arc(50.0, 200.0, ambiguous=False), arc(10.0, 320.0)],
    ):
        topology = found(*chains)
        assert as_of_a_solid(topology) is topology


def test_what_lies_in_a_loop_that_was_closed_becomes_a_hole() -> None:
    angle = np.linspace(0.0, math.tau, 60, endpoint=False)
    ring = 4.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = Chain(ring, np.full(60, 0.1), closed=True, gaps=(7,))
    read = as_of_a_solid(found(arc(50.0, 320.0), inner))
    assert read.depths == (0, 1)
    assert signed_area(read.chains[1].nodes_mm) < 0.0
    np.testing.assert_array_equal(read.chains[1].nodes_mm[::-1], ring)
    assert read.chains[1].gaps == (60 - 2 - 7,)
