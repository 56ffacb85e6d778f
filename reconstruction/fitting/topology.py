"""Which points belong together, and in which order: the points of a slice become chains.

::

    points -> places -> runs -> rows -> chains
              cells     linking thinning closing, nesting

No length is given by anybody: cells follow the thickness of the cloud (`places`), neighbours are
looked for as far as makes clean runs (`scale`), gaps are judged by the ends that face them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import IntArray, frozen
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.cells import Int32Array, bounds
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.closing import Joined, join
from reconstruction.fitting.crossing import Strand, uncross
from reconstruction.fitting.crowding import is_crowded
from reconstruction.fitting.gathering import gather, nearest_row
from reconstruction.fitting.nesting import find_depths, signed_area
from reconstruction.fitting.places import Places, look_at
from reconstruction.fitting.scale import Order, order
from reconstruction.fitting.thinning import Row, thin_again

_HEAP = 10  # points; fewer without an order are strays
_STOUT = 3.0  # full bands: a run no longer than this is a heap
_LARGEST_MM = 1e100  # coordinates beyond are no lengths; their squares must stay finite

STRAY = -1
UNORDERED = -2


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """Chains, what was set aside, and the scale of a slice."""

    chains: tuple[Chain, ...]  # outer loops counter-clockwise, holes clockwise
    depths: tuple[int, ...]  # how many loops each chain lies within; odd: a hole
    chain_of_point: Int32Array  # (n,): the number of its chain, STRAY or UNORDERED
    sigma_mm: float  # median standard deviation across the chains; 0 without any
    spacing_mm: float  # length of the chains over their number of points; inf without any

    def __post_init__(self) -> None:
        object.__setattr__(self, "chain_of_point", frozen(self.chain_of_point, np.int32))

    @property
    def strays(self) -> IntArray:
        """Indices of the points that were set aside."""
        return np.flatnonzero(self.chain_of_point == STRAY)

    @property
    def unordered(self) -> IntArray:
        """Indices of the points that hang together in heaps without an order."""
        return np.flatnonzero(self.chain_of_point == UNORDERED)

    @property
    def width_mm(self) -> float:
        """Thickness of the cloud, 4 sigma: 95 % of a Gaussian band."""
        return 4.0 * self.sigma_mm

    @property
    def band_mm(self) -> float:
        """Thickness of the cloud as the full width of a uniform band of the same variance."""
        return math.sqrt(12.0) * self.sigma_mm


def find_chains(points_mm: ArrayLike) -> Topology:
    """Order the points (n, 2) of a slice, n >= 4, given in any order.

    Raises
    ------
    TooFewPoints
        Fewer than 4 points, or points in fewer than 4 places.
    ValueError
        For another shape, or coordinates that are not finite lengths.
    """
    points = np.ascontiguousarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points must have shape (n, 2), got {points.shape}")
    if len(points) < 4:
        raise TooFewPoints(f"{len(points)} points; a curve needs 4")
    low, high = bounds(points)
    if not max(np.abs(low).max(), np.abs(high).max()) < _LARGEST_MM:
        raise ValueError("points must be finite lengths in mm: set NaN and infinity aside first")
    places = look_at(points, low, high)
    found = order(places)
    joined, chain_of_run = _joined(places, found)
    joined, chain_of_run = gather(joined, found, places, chain_of_run)
    # The last entry answers for what has no run.
    chain_of_place = np.append(chain_of_run, STRAY)[found.runs.run_of_place]
    strands = uncross(_strands(places, joined, chain_of_place))
    kept, chain_of_place = _kept(places, joined, strands, chain_of_place)
    return _concluded(places, kept, places.of_points(points, chain_of_place))


def _joined(places: Places, found: Order) -> tuple[list[Joined], IntArray]:
    """Rows joined to chains; the chain of each run, or STRAY or UNORDERED."""
    sampled = found.runs.run_of_place[places.place_of_sample]
    held = np.bincount(sampled[sampled >= 0], minlength=len(found.rows))
    chain_of_run = np.where(held >= _HEAP, UNORDERED, STRAY)
    numbers = [
        number for number, row in enumerate(found.rows)
        if row is not None and not is_crowded(row, places.sample)
    ]  # fmt: skip
    joined = join([row for number in numbers if (row := found.rows[number]) is not None])
    chain_of_run[numbers] = STRAY
    for chain, one in enumerate(joined):
        chain_of_run[[numbers[member] for member in one.members]] = chain
    return joined, chain_of_run


def _strands(places: Places, joined: list[Joined], chain_of_place: IntArray) -> list[Strand]:
    """Chains, thinned anew where they were put together."""
    sampled = chain_of_place[places.place_of_sample]
    found = []
    for number, one in enumerate(joined):
        row = one.row
        if one.put_together:
            row = thin_again(places.sample[sampled == number], row)
        found.append(Strand(row, number, one.ambiguous))
    return found


def _kept(
    places: Places, joined: list[Joined], strands: list[Strand], chain_of_place: IntArray
) -> tuple[list[Strand], IntArray]:
    """Strands that are no heaps; of each place the number of its strand among them."""
    found = chain_of_place.copy()
    kept: list[Strand] = []
    for number in range(len(joined)):
        mine = np.flatnonzero(chain_of_place == number)
        of_it = [strand for strand in strands if strand.chain == number]
        nearest = nearest_row(places.at[mine], [strand.row for strand in of_it])
        for position, strand in enumerate(of_it):
            heap = _is_heap(strand.row)
            found[mine[nearest == position]] = UNORDERED if heap else len(kept)
            kept += [] if heap else [strand]
    return kept, found


def _is_heap(row: Row) -> bool:
    """Whether a row is hardly longer than its points scatter across it."""
    band = math.sqrt(12.0) * float(np.median(row.sigma))
    return row.length < _STOUT * band


def _concluded(places: Places, kept: list[Strand], chain_of_point: Int32Array) -> Topology:
    depths = find_depths([(strand.row.nodes, strand.row.closed) for strand in kept])
    chains = tuple(
        _chain(places, strand, clockwise=depth % 2 == 1)
        for strand, depth in zip(kept, depths, strict=True)
    )
    held = int((chain_of_point >= 0).sum())
    sigma = np.concatenate([chain.sigma_mm for chain in chains]) if chains else np.zeros(1)
    length = sum(chain.length_mm for chain in chains)
    spacing = length / held if held else math.inf
    return Topology(chains, tuple(depths), chain_of_point, float(np.median(sigma)), spacing)


def _chain(places: Places, strand: Strand, *, clockwise: bool) -> Chain:
    row, gaps = strand.row, strand.row.gaps
    nodes, sigma = row.nodes * places.unit_mm + places.origin_mm, row.sigma * places.unit_mm
    if row.closed and (signed_area(row.nodes) < 0.0) != clockwise:
        nodes, sigma = nodes[::-1], sigma[::-1]
        gaps = tuple(sorted((len(nodes) - 2 - gap) % len(nodes) for gap in gaps))
    return Chain(nodes, sigma, row.closed, gaps, strand.ambiguous)
