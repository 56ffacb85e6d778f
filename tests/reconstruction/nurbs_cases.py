"""Naive twins of the NURBS kernels, hypothesis strategies, and the bridge to geomdl.

The twins are the paper's eqs. 1-3 word for word: recursive, one basis function at a time.
"""

from __future__ import annotations

import numpy as np
from geomdl import NURBS
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import Curve, Surface


def naive_basis(i: int, p: int, t: float, knots: FloatArray, *, end: float) -> float:
    """Eqs. 2 and 3 (Cox, de Boor); half-open spans, the domain's end in the span before it."""
    if p == 0:
        last = knots[i] < end <= knots[i + 1] and t == end
        inside = knots[i] <= t < knots[i + 1] and t != end
        return 1.0 if inside or last else 0.0
    total = 0.0
    if knots[i + p] > knots[i]:
        factor = (t - knots[i]) / (knots[i + p] - knots[i])
        total += factor * naive_basis(i, p - 1, t, knots, end=end)
    if knots[i + p + 1] > knots[i + 1]:
        factor = (knots[i + p + 1] - t) / (knots[i + p + 1] - knots[i + 1])
        total += factor * naive_basis(i + 1, p - 1, t, knots, end=end)
    return total


def naive_slope(i: int, p: int, t: float, knots: FloatArray, order: int, *, end: float) -> float:
    """The order-th derivative by the recursion on the degree (The NURBS Book, eq. 2.9)."""
    if order == 0:
        return naive_basis(i, p, t, knots, end=end)
    if p == 0:
        return 0.0
    total = 0.0
    for j, sign in ((i, 1.0), (i + 1, -1.0)):
        if knots[j + p] > knots[j]:
            slope = naive_slope(j, p - 1, t, knots, order - 1, end=end)
            total += sign * p * slope / (knots[j + p] - knots[j])
    return total


def naive_curve(curve: Curve, t: float) -> FloatArray:
    """Eq. 1 in one parameter, over all control points of the wrapped net."""
    p, end = curve.degree, curve.domain[1]
    above, below = np.zeros(curve.control_points_mm.shape[1]), 0.0
    count = len(curve.weights)
    for i in range(len(curve.knots) - p - 1):
        term = curve.weights[i % count] * naive_basis(i, p, t, curve.knots, end=end)
        above += term * curve.control_points_mm[i % count]
        below += term
    return above / below


def naive_surface(surface: Surface, u: float, v: float) -> FloatArray:
    """Eq. 1."""
    (_, end_u), (_, end_v) = surface.domain
    p, q = surface.degree_u, surface.degree_v
    count_u, count_v = surface.weights.shape
    above, below = np.zeros(3), 0.0
    for i in range(len(surface.knots_u) - p - 1):
        for j in range(len(surface.knots_v) - q - 1):
            term = naive_basis(i, p, u, surface.knots_u, end=end_u)
            term *= naive_basis(j, q, v, surface.knots_v, end=end_v)
            term *= surface.weights[i % count_u, j % count_v]
            above += term * surface.control_points_mm[i % count_u, j % count_v]
            below += term
    return above / below


def random_knots(
    rng: np.random.Generator, count: int, degree: int, *, periodic: bool, clamped: bool = True
) -> FloatArray:
    """Uneven knots, some of them repeated; steps between 0.2 and 2."""
    if periodic:
        steps = _steps(rng, count, degree)
        once = np.concatenate([[0.0], steps.cumsum()])
        turns, place = np.divmod(np.arange(-degree, count + degree + 1), count)
        return once[place] + turns * once[-1]
    inner = _steps(rng, count - degree, degree).cumsum() - 1.0
    if clamped:
        ends = np.ones(degree + 1)
        return np.concatenate([-1.0 * ends, inner[:-1], inner[-1] * ends])
    before, after = rng.uniform(0.2, 2.0, (2, degree))
    middle = np.concatenate([[-1.0], inner])
    return np.concatenate([-1.0 - before.cumsum()[::-1], middle, inner[-1] + after.cumsum()])


def _steps(rng: np.random.Generator, count: int, degree: int) -> FloatArray:
    """Knot steps; now and then one is zero, so that knots stand at most p times."""
    steps = rng.uniform(0.2, 2.0, count)
    if degree > 1:
        steps[1:-1:4] = 0.0
    return steps


def random_curve(
    rng: np.random.Generator,
    count: int,
    degree: int,
    *,
    periodic: bool = False,
    clamped: bool = True,
    rational: bool = True,
    dimension: int = 3,
) -> Curve:
    knots = random_knots(rng, count, degree, periodic=periodic, clamped=clamped)
    weights = rng.uniform(0.3, 3.0, count) if rational else np.ones(count)
    return Curve(degree, knots, rng.normal(0.0, 10.0, (count, dimension)), weights, periodic)


def random_surface(
    rng: np.random.Generator,
    counts: tuple[int, int],
    degrees: tuple[int, int],
    *,
    periodic: tuple[bool, bool] = (False, False),
    rational: bool = True,
) -> Surface:
    return Surface(
        *degrees,
        random_knots(rng, counts[0], degrees[0], periodic=periodic[0]),
        random_knots(rng, counts[1], degrees[1], periodic=periodic[1]),
        rng.normal(0.0, 10.0, (*counts, 3)),
        rng.uniform(0.3, 3.0, counts) if rational else np.ones(counts),
        *periodic,
    )


@st.composite
def curves(draw: st.DrawFn, *, periodic: bool | None = None) -> Curve:
    """Open (clamped or not) and periodic curves of degree 1 to 5, rational or not, in 2D or 3D."""
    closed = draw(st.booleans()) if periodic is None else periodic
    degree = draw(st.integers(1, 5))
    count = draw(st.integers(max(2, degree) if closed else degree + 1, degree + 9))
    return random_curve(
        np.random.default_rng(draw(st.integers(0, 2**32 - 1))),
        count,
        degree,
        periodic=closed,
        clamped=draw(st.booleans()),
        rational=draw(st.booleans()),
        dimension=draw(st.sampled_from([2, 3])),
    )


def spread(curve: Curve, count: int = 60) -> FloatArray:
    """Parameters over the whole domain, its ends and all its knots among them."""
    start, end = curve.domain
    inner = curve.knots[(curve.knots >= start) & (curve.knots <= end)]
    return np.sort(np.concatenate([np.linspace(start, end, count), inner]))


def geomdl_curve(curve: Curve) -> NURBS.Curve:
    peer = NURBS.Curve(normalize_kv=False)
    peer.degree = curve.degree
    peer.ctrlpts = curve.control_points_mm.tolist()
    peer.weights = curve.weights.tolist()
    peer.knotvector = curve.knots.tolist()
    return peer


def geomdl_surface(surface: Surface) -> NURBS.Surface:
    peer = NURBS.Surface(normalize_kv=False)
    peer.degree_u, peer.degree_v = surface.degree_u, surface.degree_v
    weighted = surface.control_points_mm * surface.weights[..., None]
    net = np.concatenate([weighted, surface.weights[..., None]], axis=2)
    peer.ctrlpts2d = net.tolist()
    peer.knotvector_u, peer.knotvector_v = surface.knots_u.tolist(), surface.knots_v.tolist()
    return peer
