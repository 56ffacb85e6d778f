"""The contours of a solid are closed: where points cannot tell, the closed reading is taken.

What a slice shows by itself leaves a wide gap ambiguous. Whoever knows that it was cut out of a
solid knows more: an open run is a loop of which the rest was not seen. It stays ambiguous, and its
gap a gap. That is so of the one run of a slice that is nearly a loop; a half may belong to another
half that was not seen, or not found.
"""

from __future__ import annotations

from dataclasses import replace

from reconstruction.fitting.chain import Chain
from reconstruction.fitting.nesting import find_depths, signed_area
from reconstruction.fitting.topology import Topology

_WIDEST = 0.25  # of the loop that a gap may be
_MOST = 0.8  # of what was found in the slice that the run is


def as_of_a_solid(topology: Topology) -> Topology:
    """Close the chain that is nearly all of a slice, if it may be closed; the numbers stay."""
    whole = sum(chain.length_mm for chain in topology.chains)
    read = [
        _closed(chain) if chain.length_mm > _MOST * whole else chain for chain in topology.chains
    ]
    if all(new is old for new, old in zip(read, topology.chains, strict=True)):
        return topology
    depths = find_depths([(chain.nodes_mm, chain.closed) for chain in read])
    chains = tuple(
        _turned(chain, clockwise=depth % 2 == 1) for chain, depth in zip(read, depths, strict=True)
    )
    return replace(topology, chains=chains, depths=tuple(depths))


def _closed(chain: Chain) -> Chain:
    """The closed reading of an open chain, if it has one and the gap is not too wide."""
    if chain.closed:
        return chain
    readings = chain.other_reading()
    if len(readings) != 1 or not readings[0].closed:
        return chain
    loop = readings[0]
    return loop if loop.length_mm - chain.length_mm <= _WIDEST * loop.length_mm else chain


def _turned(chain: Chain, *, clockwise: bool) -> Chain:
    if not chain.closed or (signed_area(chain.nodes_mm) < 0.0) == clockwise:
        return chain
    count = len(chain.nodes_mm)
    return replace(
        chain,
        nodes_mm=chain.nodes_mm[::-1],
        sigma_mm=chain.sigma_mm[::-1],
        gaps=tuple(sorted((count - 2 - gap) % count for gap in chain.gaps)),
    )
