"""One slice's points to its curves: every chain is fitted to its own points.

points -> Topology -> points grouped by chain -> a curve each -> SectionFit
          strays, heaps ------------------------------------------^

The points are copied at most once, and not at all where one chain holds them all: a slice may
have half a million.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.errors import ReconstructionError, TooFewPoints, Unfittable
from reconstruction.fitting.cells import Int32Array, bounds
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section_fit import fit_chain
from reconstruction.fitting.solidity import as_of_a_solid
from reconstruction.fitting.topology import UNORDERED, Topology, find_chains

_LEAST = 4  # points
_LARGEST_MM = 1e30  # the powers of lengths must stay finite ...
_SMALLEST_MM = 1e-30  # ... and above nothing
_FAR = 1e5  # times the size of a slice


@dataclass(frozen=True, slots=True, eq=False)
class SectionFit:
    """The curves of a slice, and what became of the points that are in none."""

    curves: tuple[FittedCurve, ...]  # loops by area, then open runs by length, largest first
    chains: tuple[Chain, ...]  # the order each curve was fitted in
    depths: tuple[int, ...]  # how many loops each curve lies within; odd: a hole, clockwise
    strays: IntArray  # indices of points that were set aside
    unordered: IntArray  # indices of points that hang together without a curve
    failures: tuple[str, ...]  # why chains gave no curve; their points are among the unordered
    sigma_mm: float  # standard deviation of the points across their curves; 0 without any
    spacing_mm: float  # length of the chains over their number of points; inf without any

    def __post_init__(self) -> None:
        object.__setattr__(self, "strays", frozen(self.strays, np.int64))
        object.__setattr__(self, "unordered", frozen(self.unordered, np.int64))

    @property
    def width_mm(self) -> float:
        """Thickness of the cloud, 4 sigma: 95 % of a Gaussian band."""
        return 4.0 * self.sigma_mm

    @property
    def band_mm(self) -> float:
        """Thickness of the cloud as the full width of a uniform band of the same variance."""
        return math.sqrt(12.0) * self.sigma_mm


def fit_section(points_mm: ArrayLike, *, exact: Exact = Exact.AUTO) -> list[FittedCurve]:
    """Fit the curves of one slice to its points (n, 2), given in any order.

    Returns
    -------
    Loops first, counter-clockwise and holes clockwise, then open runs; the largest of each first.

    Raises
    ------
    TooFewPoints
        Fewer than 4 points, or points in fewer than 4 places.
    Unfittable
        Coordinates that are no finite lengths, or points that no curve could be found in.
    ValueError
        For another shape, or values that are not real numbers.
    """
    found = resolve_section(points_mm, exact=exact)
    require_curves(found, np.shape(points_mm)[0])
    return list(found.curves)


def require_curves(found: SectionFit, count: int) -> None:
    """Raise Unfittable where nothing was found in `count` points."""
    if not found.curves:
        why = "; ".join(found.failures) or "they have no order"
        raise Unfittable(
            f"no curve in {count} points: {len(found.unordered)} unordered,"
            f" {len(found.strays)} stray ({why}); is this one slice?"
        )


def resolve_section(
    points_mm: ArrayLike,
    *,
    exact: Exact = Exact.AUTO,
    heights_mm: ArrayLike | None = None,
    solid: bool = False,
) -> SectionFit:
    """Do what `fit_section` does, and say what became of every point; no curve is no error.

    Parameters
    ----------
    heights_mm
        (n,), true heights of the points above the cutting plane; kept as moments of the cells.
    solid
        The slice is known to be one of a solid: what may be closed or open is closed.
    """
    points, away_mm = _checked(points_mm)
    heights = None if heights_mm is None else _checked_heights(heights_mm, len(points))
    if away_mm is None:
        return _resolved(points, exact, heights, solid=solid)
    return _moved(_resolved(points - away_mm, exact, heights, solid=solid), away_mm)


def _resolved(
    points: FloatArray, exact: Exact, heights: FloatArray | None, *, solid: bool
) -> SectionFit:
    topology = as_of_a_solid(find_chains(points)) if solid else find_chains(points)
    groups = _grouped(points, topology, heights)
    failures: list[str] = []
    fitted: dict[int, FittedCurve] = {}
    for number in _by_size(topology.chains):
        curve = _fitted(*groups[number], topology.chains[number], exact, failures)
        if curve is not None:
            fitted[number] = curve
    return SectionFit(
        curves=tuple(fitted.values()),
        chains=tuple(topology.chains[number] for number in fitted),
        depths=tuple(topology.depths[number] for number in fitted),
        strays=topology.strays,
        unordered=_without_curve(topology, fitted),
        failures=tuple(failures),
        sigma_mm=_sigma_mm(fitted.values(), otherwise=topology.sigma_mm),
        spacing_mm=topology.spacing_mm,
    )


def _sigma_mm(curves: Iterable[FittedCurve], *, otherwise: float) -> float:
    """Pooled standard deviation across the curves, by their points."""
    pairs = [(curve.points_used, curve.sigma_mm**2) for curve in curves]
    held = sum(points for points, _ in pairs)
    return math.sqrt(sum(n * square for n, square in pairs) / held) if held else otherwise


def _without_curve(topology: Topology, fitted: Collection[int]) -> IntArray:
    """Indices of the points in heaps, and in chains without a curve."""
    failed = [number for number in range(len(topology.chains)) if number not in fitted]
    if not failed:
        return topology.unordered
    return np.flatnonzero(np.isin(topology.chain_of_point, [UNORDERED, *failed]))


def _moved(found: SectionFit, by_mm: FloatArray) -> SectionFit:
    """The same somewhere else."""
    chains = [replace(chain, nodes_mm=chain.nodes_mm + by_mm) for chain in found.chains]
    curves = []
    for each in found.curves:
        curve = replace(each.curve, control_points_mm=each.curve.control_points_mm + by_mm)
        means, extremes = each.cells.means_mm + by_mm, each.cells.extremes_mm + by_mm
        cells = replace(each.cells, means_mm=means, extremes_mm=extremes)
        curves.append(replace(each, curve=curve, cells=cells))
    return replace(found, curves=tuple(curves), chains=tuple(chains))


def _checked(points_mm: ArrayLike) -> tuple[FloatArray, FloatArray | None]:
    """Points as (n, 2) finite floats, shared where they are that already; where they lie, if far.

    So far from the origin that the squares of coordinates would not know the slice any more.
    """
    if np.ma.is_masked(points_mm):
        raise ValueError("points_mm: some are masked; pass only the rows that are not")
    given = np.asarray(points_mm)
    if given.ndim != 2 or given.shape[1] != 2:
        raise ValueError(f"points_mm: shape (n, 2) expected, got {given.shape}")
    if given.dtype.kind not in "iuf":
        raise ValueError(f"points_mm: real numbers expected, got {given.dtype}")
    if len(given) < _LEAST:
        raise TooFewPoints(f"{len(given)} points; a curve needs {_LEAST}")
    with np.errstate(over="ignore", invalid="ignore"):
        points = np.ascontiguousarray(given, dtype=np.float64)
    low, high = bounds(points)
    if not max(-float(low.min()), float(high.max())) < _LARGEST_MM:
        lost = int((~(np.abs(points) < _LARGEST_MM)).any(axis=1).sum())
        raise Unfittable(
            f"{lost} of {len(points)} points are no finite lengths in mm: set them aside first"
        )
    size = float((high - low).max())
    if not size > _SMALLEST_MM:
        raise TooFewPoints(f"all {len(points)} points lie in one place; a curve needs {_LEAST}")
    far = max(-float(low.min()), float(high.max())) > _FAR * size
    return points, low if far else None


def _checked_heights(heights_mm: ArrayLike, count: int) -> FloatArray:
    """Heights as (n,) finite floats."""
    heights = np.ascontiguousarray(heights_mm, dtype=np.float64)
    if heights.shape != (count,):
        raise ValueError(f"heights_mm: shape ({count},) expected, got {heights.shape}")
    if not np.isfinite(heights).all():
        raise Unfittable(f"a height of {count} points is not finite: set its point aside first")
    return heights


def _grouped(
    points: FloatArray, topology: Topology, heights: FloatArray | None
) -> list[tuple[FloatArray, FloatArray | None]]:
    """The points of each chain, and their heights."""
    of, chains = topology.chain_of_point, len(topology.chains)
    counts = _count(of, chains)
    if chains == 1 and counts[0] == len(points):
        return [(points, heights)]
    borders = np.concatenate([[0], counts.cumsum()])
    grouped = _group(points, of, borders[:-1].copy(), int(borders[-1]))
    if heights is None:
        return [(grouped[a:b], None) for a, b in pairwise(borders)]
    raised = _group(heights[:, None], of, borders[:-1].copy(), int(borders[-1])).ravel()
    return [(grouped[a:b], raised[a:b]) for a, b in pairwise(borders)]


def _by_size(chains: tuple[Chain, ...]) -> list[int]:
    """Loops by area, then open runs by length, the largest first."""

    def size(number: int) -> tuple[bool, float]:
        chain = chains[number]
        return not chain.closed, -(_area_mm2(chain) if chain.closed else chain.length_mm)

    return sorted(range(len(chains)), key=size)


def _area_mm2(chain: Chain) -> float:
    x, y = (chain.nodes_mm - chain.nodes_mm[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _fitted(
    points: FloatArray,
    heights: FloatArray | None,
    chain: Chain,
    exact: Exact,
    failures: list[str],
) -> FittedCurve | None:
    """The curve of a chain; where it has none, why goes to `failures`: the others are kept."""
    try:
        with np.errstate(all="ignore"):  # what is not finite is refused below
            curve = fit_chain(points, chain, exact=exact, heights_mm=heights)
    except (ReconstructionError, ValueError, ArithmeticError) as why:
        failures.append(str(why))
        return None
    if not np.isfinite(curve.curve.control_points_mm).all():
        failures.append(f"the fit of {len(points)} points did not settle")
        return None
    return curve


@njit(cache=True, nogil=True)
def _count(chain_of_point: Int32Array, chains: int) -> IntArray:
    counts = np.zeros(chains, np.int64)
    for n in range(len(chain_of_point)):
        if chain_of_point[n] >= 0:
            counts[chain_of_point[n]] += 1
    return counts


@njit(cache=True, nogil=True)
def _group(
    rows: FloatArray, chain_of_point: Int32Array, places: IntArray, count: int
) -> FloatArray:
    """Rows by chain, in their order; `places` are where each chain begins, and are used up."""
    width = rows.shape[1]
    grouped = np.empty((count, width))
    for n in range(len(rows)):
        chain = chain_of_point[n]
        if chain >= 0:
            for column in range(width):
                grouped[places[chain], column] = rows[n, column]
            places[chain] += 1
    return grouped
