"""What the topology hands to the fit: the points of one run, thinned and in order.

A chain says which points belong together and in which order, never where the curve is: that is
for the fit of the raw points to find. ::

    closed   o--o--o--o--(gap)--o--o--back to the first
    open     o--o--o--(gap)--o--o
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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

    def other_reading(self) -> tuple[Chain, ...]:
        """What else the points of an ambiguous chain may be; of another, nothing.

        A closed chain opened at its widest gap; an open one parted at its widest gap, or closed
        where its ends lie nearer to each other than that.
        """
        if not self.ambiguous:
            return ()
        ways = np.linalg.norm(np.roll(self.nodes_mm, -1, axis=0) - self.nodes_mm, axis=1)
        wide = np.isin(np.arange(len(ways)), self.gaps)
        if self.closed:
            return (self._from(int(np.argmax(np.where(wide.any(), ways * wide, ways)))),)
        cut = int(np.argmax(ways * wide))
        if wide.any() and ways[cut] >= ways[-1] and 1 <= cut < len(ways) - 2:
            return self._part(0, cut + 1), self._part(cut + 1, len(ways))
        if len(ways) < 3:
            return ()
        return (replace(self, closed=True, gaps=(*self.gaps, len(ways) - 1)),)

    def _from(self, cut: int) -> Chain:
        """A closed chain opened after a node."""
        count = len(self.nodes_mm)
        turned = np.roll(np.arange(count), -cut - 1)
        gaps = tuple(sorted((gap - cut - 1) % count for gap in self.gaps if gap != cut))
        return replace(
            self, nodes_mm=self.nodes_mm[turned], sigma_mm=self.sigma_mm[turned], closed=False,
            gaps=gaps,
        )  # fmt: skip

    def _part(self, start: int, stop: int) -> Chain:
        """Some nodes of an open chain."""
        gaps = tuple(gap - start for gap in self.gaps if start <= gap < stop - 1)
        return replace(
            self, nodes_mm=self.nodes_mm[start:stop], sigma_mm=self.sigma_mm[start:stop], gaps=gaps
        )
