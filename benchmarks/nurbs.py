"""A million evaluations of an 80 x 100 bicubic surface, on one core, beside scipy.

Run: ``python benchmarks/nurbs.py [--repeats N]``. Targets: grid with normals 60 ms, scattered with
normals 120 ms. scipy evaluates no rational surfaces and no normals: its row with normals is the
points, two derivatives and numpy's cross product. Ratios travel between machines; times do not.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, NdBSpline

from reconstruction.nurbs import (
    Surface,
    clamped_uniform,
    evaluate_surface,
    evaluate_surface_at,
    points_and_normals,
    points_and_normals_at,
)

Array = NDArray[np.float64]
SIDE = 1000


def surface_of(rng: np.random.Generator) -> Surface:
    """Return a bicubic sheet of 80 x 100 control points."""
    counts = (80, 100)
    knots = [clamped_uniform(np.zeros((n, 2))).knots / (n - 3) for n in counts]
    net = rng.normal(size=(*counts, 3))
    return Surface(3, 3, *knots, net, np.ones(counts), periodic_u=False, periodic_v=False)


def scipy_grid(surface: Surface, u: Array, v: Array, orders: tuple[int, int]) -> Array:
    """Evaluate scipy's spline in v, and its values as coefficients of a spline in u."""
    net = surface.control_points_mm.swapaxes(0, 1)
    rows = BSpline(surface.knots_v, net, 3)(v, nu=orders[1]).swapaxes(0, 1)
    return BSpline(surface.knots_u, rows, 3)(u, nu=orders[0])


def scipy_scattered(surface: Surface, pairs: Array, orders: tuple[int, int]) -> Array:
    """Evaluate scipy's tensor spline at scattered parameters."""
    knots = (surface.knots_u, surface.knots_v)
    return NdBSpline(knots, surface.control_points_mm, 3)(pairs, nu=orders)


def with_normals(evaluate: Callable[[tuple[int, int]], Array]) -> tuple[Array, Array]:
    """Return points and unit normals from a function that gives derivatives by their orders."""
    points = evaluate((0, 0))
    normals = np.cross(evaluate((1, 0)), evaluate((0, 1)))
    return points, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Time a function after one run that compiles and warms up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    rng = np.random.default_rng(0)
    surface = surface_of(rng)
    u = v = np.linspace(0, 1, SIDE)
    pairs = rng.random((SIDE * SIDE, 2))
    su, sv = np.ascontiguousarray(pairs.T)
    table = [
        ("grid, points", lambda: evaluate_surface(surface, u, v),
         lambda: scipy_grid(surface, u, v, (0, 0))),
        ("grid, points and normals", lambda: points_and_normals(surface, u, v),
         lambda: with_normals(lambda orders: scipy_grid(surface, u, v, orders))),
        ("scattered, points", lambda: evaluate_surface_at(surface, su, sv),
         lambda: scipy_scattered(surface, pairs, (0, 0))),
        ("scattered, points and normals", lambda: points_and_normals_at(surface, su, sv),
         lambda: with_normals(lambda orders: scipy_scattered(surface, pairs, orders))),
    ]  # fmt: skip
    print(f"{SIDE * SIDE} evaluations, 80 x 100 bicubic; medians of {repeats}")
    print(f"{'':32}{'loftscan ms':>12}{'scipy ms':>12}{'scipy / us':>12}")
    for name, ours, theirs in table:
        mine, peer = median_ms(ours, repeats), median_ms(theirs, max(2, repeats // 3))
        print(f"{name:32}{mine:12.1f}{peer:12.1f}{peer / mine:12.1f}")


if __name__ == "__main__":
    main()
