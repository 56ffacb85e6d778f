"""Published point sets, beside what their authors' own programs make of them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import resolve_section
from section_tables.outlines import (
    CURVES,
    Array,
    Outline,
    polar_outline,
    read_outline,
    rms_mm,
    the_loop,
)
from section_tables.rivals import paper_mm

# Run by us, one seed each, the authors' (docs/sections/figures.md): StretchDenoise (Ohrhallinger,
# Wimmer 2018, arXiv:1808.07778) and FitConnect (Ohrhallinger, Wimmer 2018).
CIRCLES = (("0.10", 0.006, 0.008, 0.011, 0.020), ("0.50", 0.026, 0.042, 0.073, 0.053))
BUNNIES = (("0.4", 4.5, 5.68), ("0.2", 3.0, 3.53))
_BETWEEN = 20  # samples between two points


def peers_table(_shapes: dict[str, Outline], _seeds: int | None) -> Iterator[str]:
    """Our curve, with our own order, beside StretchDenoise, FitConnect and the paper's method."""
    if not CURVES.is_dir():
        yield "Peers: no data; set LOFTSCAN_DATA"
        return
    yield "Peers' points: rms to the truth, our own order; bounds in brackets"
    yield (f"{'':14}{'recognised':>15}{'exact=never':>15}{'StretchDenoise':>16}{'FitConnect':>12}"
           f"{'paper':>8}")  # fmt: skip
    unit = polar_outline(lambda turn: np.ones(len(turn)))
    for extent, exact_bound, free_bound, stretched, connected in CIRCLES:
        points = np.loadtxt(CURVES / f"circle_n{extent}.txt")
        exact, free = (_loop_of(points, exact) for exact in (Exact.AUTO, Exact.NEVER))
        yield (
            f"circle {extent:7}{rms_mm(exact, unit):8.4f} ({exact_bound:.3f})"
            f"{rms_mm(free, unit):7.4f} ({free_bound:.3f}){stretched:16.3f}{connected:12.3f}"
            f"{paper_mm(points, unit):8.3f}"
        )
    yield (f"{'':14}{'between points':>15}{'in file order':>15}{'StretchDenoise':>16}"
           f"{'arc-uniform':>12}{'paper':>8}")  # fmt: skip
    truth = Outline(read_outline(CURVES / "bunny.npz"))
    for spacing, bound, stretched in BUNNIES:
        points = np.loadtxt(CURVES / f"bunny_eps{spacing}.txt")
        curve = _loop_of(points, Exact.AUTO)
        yield (
            f"bunny {spacing:8}{between_mm(curve, points, truth):9.3f} ({bound:.1f})"
            f"{between_mm(curve, points, truth, sort=False):15.3f}{stretched:16.2f}"
            f"{rms_mm(curve, truth):12.3f}{paper_mm(points, truth):8.3f}"
        )
    yield "between points: equal samples of our curve between points that are neighbours on it, as"
    yield "  StretchDenoise has equal samples on every edge of its polyline; in file order: between"
    yield "  those that are neighbours on the true outline"


def _loop_of(points: Array, exact: Exact) -> FittedCurve:
    curve = the_loop(resolve_section(points, exact=exact))
    if curve is None:
        raise SystemExit(f"no single loop in {len(points)} points: the order is wrong")
    return curve


def between_mm(curve: FittedCurve, points: Array, truth: Outline, *, sort: bool = True) -> float:
    """Rms of equally many samples of the curve between neighbouring input points."""
    grid = np.arange(20_000) / 20_000
    feet = grid[cKDTree(curve(grid)).query(points)[1]]
    feet = np.sort(feet) if sort else feet
    steps = np.mod(np.roll(feet, -1) - feet + 0.5, 1.0) - 0.5
    ahead = np.arange(_BETWEEN) / _BETWEEN
    places = curve(np.mod(feet[:, None] + steps[:, None] * ahead, 1.0).ravel())
    return float(np.sqrt(np.mean(truth.distances_mm(places) ** 2)))
