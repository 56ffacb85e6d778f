"""What the topology hands to the fit: the points of one run, thinned and in order.

A chain says which points belong together and in which order, never where the curve is: that is
for the fit of the raw points to find. ::

    closed   o--o--o--o--(gap)--o--o--back to the first
    open     o--o--o--(gap)--o--o
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """One loop or open run."""

    nodes_mm: FloatArray  # (m, 2), in order, roughly on the curve; m >= 2, closed: m >= 3
    sigma_mm: FloatArray  # (m,), standard deviation of the points across the run there
    closed: bool
    gaps: tuple[int, ...] = ()  # i: no point supports the way from node i to the next one
    ambiguous: bool = False  # the points cannot tell whether it is closed; `closed` is the likelier

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes_mm", frozen(self.nodes_mm))
        object.__setattr__(self, "sigma_mm", frozen(self.sigma_mm))
        count = len(self.nodes_mm)
        if self.nodes_mm.shape != (count, 2) or self.sigma_mm.shape != (count,):
            raise ValueError(
                f"chain: nodes {self.nodes_mm.shape} and sigmas {self.sigma_mm.shape};"
                " (m, 2) and (m,) expected"
            )
        if count < (3 if self.closed else 2):
            raise ValueError(f"chain: {count} nodes are too few")
        ways = count if self.closed else count - 1
        if not all(0 <= gap < ways for gap in self.gaps):
            raise ValueError(f"chain: gaps {self.gaps} in a chain of {ways} ways")

    @property
    def length_mm(self) -> float:
        """Along the nodes, the way back of a closed chain included."""
        ends = np.vstack([self.nodes_mm, self.nodes_mm[:1]]) if self.closed else self.nodes_mm
        return float(np.linalg.norm(np.diff(ends, axis=0), axis=1).sum())
