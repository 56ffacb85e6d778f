"""Surfaces: grids and scattered points, derivatives, normals, poles."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.nurbs import (
    Surface,
    evaluate_surface,
    evaluate_surface_at,
    points_and_normals,
    points_and_normals_at,
    surface_derivatives,
    surface_derivatives_on_grid,
    surface_normals,
    surface_normals_at,
)
from tests.reconstruction.nurbs_cases import geomdl_surface, naive_surface, random_surface

CASES = pytest.mark.parametrize(
    ("degrees", "periodic", "rational"),
    [
        ((3, 3), (False, False), True),
        ((3, 3), (True, False), False),
        ((3, 3), (True, True), True),
        ((2, 4), (False, True), True),
        ((1, 2), (False, False), False),
        ((5, 1), (True, False), True),
    ],
)


def case(degrees, periodic, rational):
    rng = np.random.default_rng(degrees[0] * 10 + degrees[1])
    return random_surface(rng, (8, 7), degrees, periodic=periodic, rational=rational)


def grid_of(surface, count):
    (u0, u1), (v0, v1) = surface.domain
    u = np.sort(np.concatenate([np.linspace(u0, u1, count), np.clip(surface.knots_u, u0, u1)]))
    v = np.sort(np.concatenate([np.linspace(v0, v1, count), np.clip(surface.knots_v, v0, v1)]))
    return u, v


def pairs_of(u, v):
    grid = np.meshgrid(u, v, indexing="ij")
    return grid[0].ravel(), grid[1].ravel()


@CASES
def test_grids_and_scattered_points_are_the_papers_equation_one(degrees, periodic, rational):
    surface = case(degrees, periodic, rational)
    u, v = np.linspace(*surface.domain[0], 5), np.linspace(*surface.domain[1], 5)
    naive = np.array([[naive_surface(surface, s, t) for t in v] for s in u])
    np.testing.assert_allclose(evaluate_surface(surface, u, v), naive, rtol=0, atol=1e-12)
    scattered = evaluate_surface_at(surface, *pairs_of(u, v))
    np.testing.assert_allclose(scattered, naive.reshape(-1, 3), rtol=0, atol=1e-12)


@CASES
def test_every_way_to_evaluate_gives_the_same(degrees, periodic, rational):
    surface = case(degrees, periodic, rational)
    u, v = grid_of(surface, 12)
    points, du, dv = surface_derivatives_on_grid(surface, u, v)
    careful = surface_derivatives(surface, *pairs_of(u, v))
    scale = np.abs(careful).max(axis=(2, 3))
    for ours, (k, m) in ((points, (0, 0)), (du, (1, 0)), (dv, (0, 1))):
        theirs = careful[k, m].reshape(points.shape)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * scale[k, m])
    normals = np.cross(careful[1, 0], careful[0, 1])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for pair in (
        points_and_normals(surface, u, v),
        points_and_normals_at(surface, *pairs_of(u, v)),
    ):
        np.testing.assert_allclose(pair[0].reshape(-1, 3), careful[0, 0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(pair[1].reshape(-1, 3), normals, rtol=0, atol=1e-9)


def test_second_derivatives_agree_with_geomdl():
    surface = random_surface(np.random.default_rng(8), (7, 6), (3, 2))
    peer = geomdl_surface(surface)
    u, v = np.linspace(-0.9, 1.1, 5), np.linspace(-0.8, 0.9, 5)
    ours = surface_derivatives(surface, u, v, 2)
    for row in range(5):
        theirs = np.array(peer.derivatives(u[row], v[row], order=2))
        for k, m in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)):
            np.testing.assert_allclose(ours[k, m, row], theirs[k, m], rtol=1e-9, atol=1e-8)


def test_all_mixed_derivatives_are_finite_differences_of_lower_ones():
    surface = random_surface(np.random.default_rng(9), (8, 8), (4, 4), periodic=(True, True))
    step = 1e-5
    u, v = np.array([0.41, 2.3, 3.1]), np.array([0.33, 1.9, 3.0])
    d = surface_derivatives(surface, u, v, 2)
    for k, m in np.ndindex(3, 3):
        if k > 0:
            ahead = surface_derivatives(surface, u + step, v, 2)[k - 1, m]
            behind = surface_derivatives(surface, u - step, v, 2)[k - 1, m]
        elif m > 0:
            ahead = surface_derivatives(surface, u, v + step, 2)[k, m - 1]
            behind = surface_derivatives(surface, u, v - step, 2)[k, m - 1]
        else:
            continue
        scale = np.abs(d[k, m]).max()
        np.testing.assert_allclose((ahead - behind) / (2 * step), d[k, m], atol=1e-5 * scale)


def test_corners_of_a_clamped_surface_are_exact_on_grids_and_scattered():
    surface = random_surface(np.random.default_rng(1), (49, 53), (3, 3), rational=False)
    (u0, u1), (v0, v1) = surface.domain
    net = surface.control_points_mm
    corners = np.array([[net[0, 0], net[0, -1]], [net[-1, 0], net[-1, -1]]])
    assert np.array_equal(evaluate_surface(surface, [u0, u1], [v0, v1]), corners)
    scattered = evaluate_surface_at(surface, [u0, u0, u1, u1], [v0, v1, v0, v1])
    assert np.array_equal(scattered, corners.reshape(-1, 3))
    assert np.array_equal(surface([u0, u1], [v0, v1]), corners)


def test_a_periodic_surface_takes_any_parameter_and_an_open_one_refuses():
    surface = random_surface(np.random.default_rng(2), (8, 7), (3, 3), periodic=(True, False))
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.array([0.1, 2.0]), np.array([v0, v1])
    np.testing.assert_allclose(
        evaluate_surface(surface, u + 3 * (u1 - u0), v), evaluate_surface(surface, u, v), atol=1e-10
    )
    with pytest.raises(ValueError, match="outside the domain"):
        evaluate_surface(surface, u, v + 1)
    with pytest.raises(ValueError, match="come in pairs: 2 u, 1 v"):
        evaluate_surface_at(surface, u, 0.0)


def hemisphere() -> Surface:
    """Half a unit sphere, z >= 0: quarter circle turned round; its last row is the pole."""
    s = np.sqrt(0.5)
    ring = np.array([(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)], float)
    net = np.zeros((8, 3, 3))
    net[:, 0, :2] = net[:, 1, :2] = ring
    net[:, 1:, 2] = 1.0
    weights = np.tile([1.0, s], 4)[:, None] * np.array([1.0, s, 1.0])
    knots_u = np.array([-1, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]) / 4
    return Surface(
        2, 2, knots_u, np.repeat([0.0, 1.0], 3), net, weights, periodic_u=True, periodic_v=False
    )


@pytest.mark.parametrize("parameters", [[0.0, 0.3, 1.0], [1.0], [1 - 1e-7, 1 - 1e-9, 1 - 1e-12]])
def test_normals_of_a_sphere_are_its_radii_also_at_and_near_the_pole(parameters):
    surface = hemisphere()
    u = np.linspace(0, 1, 13)
    points, normals = points_and_normals(surface, u, parameters)
    np.testing.assert_allclose(np.linalg.norm(points, axis=2), 1.0, rtol=1e-14)
    np.testing.assert_allclose(normals, points, rtol=0, atol=1e-6)
    scattered = surface_normals_at(surface, *pairs_of(u, parameters))
    np.testing.assert_allclose(scattered, points.reshape(-1, 3), rtol=0, atol=1e-6)


def test_a_pole_at_the_start_of_v_keeps_the_sense_of_the_normal():
    upright = hemisphere()
    turned = Surface(
        2, 2, upright.knots_u, upright.knots_v, upright.control_points_mm[:, ::-1],
        upright.weights[:, ::-1], periodic_u=True, periodic_v=False,
    )  # fmt: skip
    normals = surface_normals(turned, [0.0, 0.4], [0.0, 0.5])
    np.testing.assert_allclose(normals[:, 0], [[0, 0, -1], [0, 0, -1]], atol=1e-12)
    assert np.all(normals[:, 1, 2] < 0)


def test_a_surface_collapsed_to_a_line_has_no_normals_and_says_so_with_zeros():
    net = np.zeros((4, 4, 3))
    net[..., 0] = np.arange(4.0)
    knots = np.repeat([0.0, 1.0], 4)
    line = Surface(3, 3, knots, knots, net, np.ones((4, 4)), periodic_u=False, periodic_v=False)
    assert not surface_normals(line, [0.0, 0.5], [0.2, 1.0]).any()


def test_small_features_of_a_large_surface_keep_their_own_normals():
    plane = np.stack(np.meshgrid([0, 1e-6, 2e-6, 1e3], [0, 1e-6, 2e-6, 1e3], indexing="ij"), axis=2)
    net = np.concatenate([plane, np.zeros((4, 4, 1))], axis=2)
    knots = np.array([0, 0, 1, 2, 3, 3], dtype=float)
    sheet = Surface(1, 1, knots, knots, net, np.ones((4, 4)), periodic_u=False, periodic_v=False)
    np.testing.assert_array_equal(
        surface_normals_at(sheet, [0.5, 1.5, 2.5], [0.5, 0.5, 0.5]), np.tile([0.0, 0, 1], (3, 1))
    )
