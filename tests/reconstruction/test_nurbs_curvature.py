"""Tangents and curvatures at scattered parameters, beside textbook twins and exact shapes."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import NdBSpline

from reconstruction.nurbs import (
    Surface,
    circle,
    clamped_uniform,
    points_and_tangents_at,
    surface_curvatures_at,
)
from tests.reconstruction.nurbs_cases import naive_slope
from tests.reconstruction.test_nurbs_surfaces import CASES, case, hemisphere


def naive_derivatives(surface: Surface, u: float, v: float) -> dict[tuple[int, int], np.ndarray]:
    """S and its derivatives to the second order: full homogeneous sums, then eq. 4.20, in turn."""
    (_, end_u), (_, end_v) = surface.domain
    count_u, count_v = surface.weights.shape
    net = np.concatenate([surface.control_points_mm, np.ones((count_u, count_v, 1))], axis=2)
    net = net * surface.weights[..., None]
    sums = {}
    for k, m in [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]:
        in_u, in_v = np.zeros(count_u), np.zeros(count_v)
        for i in range(len(surface.knots_u) - surface.degree_u - 1):
            in_u[i % count_u] += naive_slope(i, surface.degree_u, u, surface.knots_u, k, end=end_u)
        for j in range(len(surface.knots_v) - surface.degree_v - 1):
            in_v[j % count_v] += naive_slope(j, surface.degree_v, v, surface.knots_v, m, end=end_v)
        sums[k, m] = np.einsum("i,j,ijd->d", in_u, in_v, net)
    w = {key: each[3] for key, each in sums.items()}
    a = {key: each[:3] for key, each in sums.items()}
    s = {(0, 0): a[0, 0] / w[0, 0]}
    for key in ((1, 0), (0, 1)):
        s[key] = (a[key] - w[key] * s[0, 0]) / w[0, 0]
    s[2, 0] = (a[2, 0] - 2 * w[1, 0] * s[1, 0] - w[2, 0] * s[0, 0]) / w[0, 0]
    s[0, 2] = (a[0, 2] - 2 * w[0, 1] * s[0, 1] - w[0, 2] * s[0, 0]) / w[0, 0]
    s[1, 1] = (a[1, 1] - w[1, 0] * s[0, 1] - w[0, 1] * s[1, 0] - w[1, 1] * s[0, 0]) / w[0, 0]
    return s


def naive_curvatures(s: dict[tuple[int, int], np.ndarray]) -> np.ndarray:
    """Gaussian, mean, both principal ones: eigenvalues of I^-1 II, as textbooks have it."""
    normal = np.cross(s[1, 0], s[0, 1])
    normal /= np.linalg.norm(normal)
    first = np.array(
        [[s[1, 0] @ s[1, 0], s[1, 0] @ s[0, 1]], [s[1, 0] @ s[0, 1], s[0, 1] @ s[0, 1]]]
    )
    second = np.array([[s[2, 0] @ normal, s[1, 1] @ normal], [s[1, 1] @ normal, s[0, 2] @ normal]])
    values = np.sort(np.linalg.eigvals(np.linalg.solve(first, second)).real)[::-1]
    return np.array([np.linalg.det(second) / np.linalg.det(first), values.mean(), *values])


def places(surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    (u0, u1), (v0, v1) = surface.domain
    rng = np.random.default_rng(3)
    u = np.append(rng.uniform(u0, u1, count), [u0, u1, u0, u1])
    return u, np.append(rng.uniform(v0, v1, count), [v0, v0, v1, v1])


@CASES
def test_points_and_tangents_are_the_textbooks(degrees, periodic, rational):
    surface = case(degrees, periodic, rational)
    u, v = places(surface, 12)
    naive = [naive_derivatives(surface, *each) for each in zip(u, v, strict=True)]
    found = points_and_tangents_at(surface, u, v)
    for part, key in zip(found, [(0, 0), (1, 0), (0, 1)], strict=True):
        expected = np.array([each[key] for each in naive])
        np.testing.assert_allclose(part, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


@CASES
def test_curvatures_are_the_textbooks(degrees, periodic, rational):
    surface = case(degrees, periodic, rational)
    u, v = places(surface, 12)
    naive = np.array(
        [naive_curvatures(naive_derivatives(surface, *each)) for each in zip(u, v, strict=True)]
    )
    found = surface_curvatures_at(surface, u, v)
    ours = np.column_stack([found.gaussian_per_mm2, found.mean_per_mm, found.principal_per_mm])
    # The twin inverts the first form, which doubles the digits a skew net costs.
    scale = np.abs(naive).max(axis=0)
    np.testing.assert_allclose(ours, naive, rtol=1e-9, atol=1e-11 * scale.max())


def test_a_large_net_agrees_with_scipy_to_twelve_digits():
    rng = np.random.default_rng(0)
    counts = (120, 120)
    knots = [clamped_uniform(np.zeros((n, 2))).knots / (n - 3) for n in counts]
    net = rng.normal(size=(*counts, 3))
    surface = Surface(3, 3, *knots, net, np.ones(counts), periodic_u=False, periodic_v=False)
    u, v = rng.random((2, 20000))
    for part, orders in zip(
        points_and_tangents_at(surface, u, v), [(0, 0), (1, 0), (0, 1)], strict=True
    ):
        expected = NdBSpline(tuple(knots), net, 3)(np.column_stack([u, v]), nu=orders)
        # Derivatives are hundreds of mm: digits are counted from the largest of them.
        np.testing.assert_allclose(part, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def torus(major: float, minor: float) -> Surface:
    """Exact: a rational circle swept about z along another one."""
    ring = circle([0, 0], 1.0, np.eye(2))
    tube = circle([major, 0.0], minor, np.eye(2))
    net = np.empty((8, 8, 3))
    net[..., :2] = ring.control_points_mm[:, None] * tube.control_points_mm[None, :, :1]
    net[..., 2] = tube.control_points_mm[:, 1]
    weights = np.outer(ring.weights, tube.weights)
    return Surface(2, 2, ring.knots, tube.knots, net, weights, periodic_u=True, periodic_v=True)


def test_a_torus_has_its_known_curvatures_and_bends_away_from_its_outward_normal():
    u, v = np.random.default_rng(1).random((2, 500))
    x, y, z = points_and_tangents_at(torus(20.0, 6.0), u, v)[0].T
    across = (np.hypot(x, y) - 20.0) / 6.0  # cosine of the angle about the tube
    np.testing.assert_allclose(np.hypot(across, z / 6.0), 1.0, rtol=1e-13)
    found = surface_curvatures_at(torus(20.0, 6.0), u, v)
    about, along = across / (20.0 + 6.0 * across), 1.0 / 6.0
    np.testing.assert_allclose(found.gaussian_per_mm2, about * along, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.mean_per_mm, -(about + along) / 2, rtol=1e-13)
    np.testing.assert_allclose(found.principal_per_mm[:, 0], -about, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.principal_per_mm[:, 1], -along, rtol=1e-13)


def test_equal_principal_curvatures_are_as_exact_as_others_and_a_pole_has_none():
    u, v = [0.1, 0.4, 0.7, 0.3], [0.0, 0.3, 0.99, 1.0]
    found = surface_curvatures_at(hemisphere(), u, v)
    x, y, _ = points_and_tangents_at(hemisphere(), u, v)[0].T
    # Second derivatives about a ring of radius r are divided by r squared, with their rounding.
    bound = 16 * np.finfo(float).eps / np.hypot(x, y)[:3] ** 2
    off = np.abs(found.principal_per_mm[:3] + 1.0).max(axis=1)
    assert np.all(off < bound)
    assert np.all(np.abs(found.gaussian_per_mm2[:3] - 1.0) < 2 * bound)
    assert np.isnan(found.mean_per_mm[3])
    assert np.isnan(found.principal_per_mm[3]).all()


def test_small_features_of_a_large_surface_keep_their_own_curvature():
    side = np.array([0, 1e-6, 2e-6, 1e3])
    net = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros((4, 4))], axis=2)
    knots = np.repeat([0.0, 1.0], 4)
    surface = Surface(3, 3, knots, knots, net, np.ones((4, 4)), periodic_u=False, periodic_v=False)
    found = surface_curvatures_at(surface, [0.0], [0.0])
    assert found.gaussian_per_mm2[0] == 0.0


def test_no_place_has_no_curvatures():
    found = surface_curvatures_at(hemisphere(), [], [])
    assert found.gaussian_per_mm2.shape == (0,)
    assert found.principal_per_mm.shape == (0, 2)
