"""A million evaluations of bicubic surfaces, on one core, beside scipy.

Run: ``python benchmarks/nurbs.py [--repeats N]``. Process time. Targets: on 80 x 100 control
points, grid with normals 60 ms, scattered with normals 120 ms; on 120 x 120, scattered points with
both first derivatives or normals 120 ms. scipy evaluates no rational surfaces, no normals and no
curvatures: its rows are the points, the derivatives and numpy on them. Ratios travel between
machines; times do not.
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
    points_and_tangents_at,
    surface_curvatures_at,
)

Array = NDArray[np.float64]
SIDE = 1000


def surface_of(rng: np.random.Generator, counts: tuple[int, int]) -> Surface:
    """Return a bicubic sheet of so many control points."""
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


def with_curvatures(evaluate: Callable[[tuple[int, int]], Array]) -> tuple[Array, Array]:
    """Return Gaussian and mean curvature from a function that gives derivatives by their orders."""
    su, sv = evaluate((1, 0)), evaluate((0, 1))
    normals = np.cross(su, sv)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    e, f, g = ((a * b).sum(axis=-1) for a, b in ((su, su), (su, sv), (sv, sv)))
    second = [(evaluate(orders) * normals).sum(axis=-1) for orders in ((2, 0), (1, 1), (0, 2))]
    area = e * g - f * f
    gaussian = (second[0] * second[2] - second[1] ** 2) / area
    return gaussian, (e * second[2] - 2 * f * second[1] + g * second[0]) / (2 * area)


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Time a function after one run that compiles and warms up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    rng = np.random.default_rng(0)
    surface, large = surface_of(rng, (80, 100)), surface_of(rng, (120, 120))
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
        ("120 x 120: points and normals", lambda: points_and_normals_at(large, su, sv),
         lambda: with_normals(lambda orders: scipy_scattered(large, pairs, orders))),
        ("120 x 120: first derivatives", lambda: points_and_tangents_at(large, su, sv),
         lambda: [scipy_scattered(large, pairs, each) for each in ((0, 0), (1, 0), (0, 1))]),
        ("120 x 120: curvatures", lambda: surface_curvatures_at(large, su, sv),
         lambda: with_curvatures(lambda orders: scipy_scattered(large, pairs, orders))),
    ]  # fmt: skip
    print(f"{SIDE * SIDE} evaluations, 80 x 100 bicubic unless said; medians of {repeats}")
    print(f"{'':32}{'loftscan ms':>12}{'scipy ms':>12}{'scipy / us':>12}")
    for name, ours, theirs in table:
        mine, peer = median_ms(ours, repeats), median_ms(theirs, max(2, repeats // 3))
        print(f"{name:32}{mine:12.1f}{peer:12.1f}{peer / mine:12.1f}")


if __name__ == "__main__":
    main()
