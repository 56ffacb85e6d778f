"""Curves: points and derivatives, against the recursion, geomdl, finite differences, the circle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.errors import TooFewPoints
from reconstruction.nurbs import (
    Curve,
    circle,
    clamped_uniform,
    curve_derivatives,
    evaluate_curve,
    periodic_uniform,
)
from tests.reconstruction.nurbs_cases import (
    curves,
    geomdl_curve,
    naive_curve,
    random_curve,
    spread,
)


@settings(max_examples=20, deadline=None)
@given(curves())
def test_points_are_the_papers_equation_one(curve):
    u = spread(curve, 9)
    naive = [naive_curve(curve, t) for t in u]
    np.testing.assert_allclose(evaluate_curve(curve, u), naive, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_points_and_derivatives_agree_with_geomdl(degree):
    curve = random_curve(np.random.default_rng(degree), degree + 6, degree)
    u = np.linspace(*curve.domain, 12)[:-1]  # geomdl takes derivatives at the end from outside
    peer = geomdl_curve(curve)
    expected = np.array([peer.derivatives(t, order=3) for t in u]).swapaxes(0, 1)
    ours = curve_derivatives(curve, u, 3)
    for order in range(4):
        scale = np.abs(expected[order]).max() + 1
        np.testing.assert_allclose(ours[order], expected[order], rtol=0, atol=1e-10 * scale)


@settings(max_examples=20, deadline=None)
@given(curves())
def test_derivatives_are_finite_differences(curve):
    start, end = curve.domain
    step = 1e-5
    u = np.linspace(start, end, 23)[1:-1]
    u = u[np.min(np.abs(u[:, None] - curve.knots), axis=1) > 3 * step]
    d = curve_derivatives(curve, u, 2)
    for order in (0, 1):
        ahead = curve_derivatives(curve, u + step, order)[order]
        behind = curve_derivatives(curve, u - step, order)[order]
        third = np.abs(curve_derivatives(curve, u, order + 3)[order + 3]).max(initial=0)
        bound = step**2 * (1 + 10 * third) + 1e-9 * (1 + np.abs(d[order]).max(initial=0))
        assert np.abs((ahead - behind) / (2 * step) - d[order + 1]).max(initial=0) < bound


@settings(max_examples=20, deadline=None)
@given(curves(), st.integers(0, 2**32 - 1))
def test_an_affine_map_of_the_control_points_is_one_of_the_curve(curve, seed):
    rng = np.random.default_rng(seed)
    dimension = curve.control_points_mm.shape[1]
    matrix, shift = rng.normal(size=(dimension, dimension)), rng.normal(size=dimension)
    moved = Curve(
        curve.degree,
        curve.knots,
        curve.control_points_mm @ matrix + shift,
        curve.weights,
        curve.periodic,
    )
    u = spread(curve)
    np.testing.assert_allclose(moved(u), curve(u) @ matrix + shift, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_a_clamped_curve_ends_exactly_on_its_control_points(degree):
    rng = np.random.default_rng(degree)
    for _ in range(20):
        plain = random_curve(rng, degree + 4, degree, rational=False)
        assert np.array_equal(plain(plain.domain), plain.control_points_mm[[0, -1]])
        rational = random_curve(rng, degree + 4, degree)  # (w x) / w may be one rounding off x
        ends = rational.control_points_mm[[0, -1]]
        assert np.all(np.abs(rational(rational.domain) - ends) <= np.spacing(np.abs(ends)))


@settings(max_examples=20, deadline=None)
@given(curves(periodic=True), st.integers(-5, 5))
def test_a_periodic_curve_is_the_same_one_period_on(curve, turns):
    start, end = curve.domain
    u = np.linspace(start, end, 17)
    np.testing.assert_allclose(curve(u + turns * (end - start)), curve(u), rtol=0, atol=1e-10)
    assert np.array_equal(curve(start), curve(end))


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_a_periodic_curve_is_smooth_at_its_seam(degree):
    curve = periodic_uniform(np.random.default_rng(1).normal(size=(9, 3)), degree)
    before = np.nextafter(curve.domain[1], 0)
    seam, other = curve_derivatives(curve, [0.0, before], degree).swapaxes(0, 1)
    for order in range(degree):
        np.testing.assert_allclose(seam[order], other[order], rtol=0, atol=1e-12)
    assert np.abs(seam[degree] - other[degree]).max() > 1e-3  # the first that may jump does


def test_a_scalar_parameter_gives_one_point_and_an_array_many():
    curve = clamped_uniform([[0, 0], [1, 1], [2, 0]], degree=2)
    assert curve(0.5).shape == (2,)
    assert curve([0.5]).shape == (1, 2)
    assert curve([]).shape == (0, 2)
    np.testing.assert_allclose(curve(0.5), [1, 0.5], rtol=1e-15)


def test_an_open_curve_refuses_parameters_outside():
    curve = clamped_uniform(np.eye(4), degree=3)
    with pytest.raises(ValueError, match=r"1\.5 lies outside the domain \[0, 1\]"):
        curve(1.5)


def test_the_circle_is_exact_everywhere_and_closed():
    axes = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0][:2]
    center = np.array([3.0, -2.0, 1.0])
    curve = circle(center, 50.0, axes)
    u = np.linspace(-1, 2, 3001)
    radii = np.linalg.norm(curve(u) - center, axis=1)
    assert np.abs(radii / 50.0 - 1).max() < 1e-13
    assert curve.closed
    np.testing.assert_allclose(curve(0.25), center + 50 * axes[1], rtol=1e-14)


def test_the_circles_derivatives_are_tangent_and_continuous_at_its_double_knots():
    curve = circle((0, 0), 1.0, np.eye(2))
    for knot in (0.0, 0.25, 0.5, 0.75):
        here, before = curve_derivatives(curve, [knot, knot - 1e-13], 1).swapaxes(0, 1)
        np.testing.assert_allclose(here, before, rtol=0, atol=1e-10)
    points, slopes = curve_derivatives(curve, np.linspace(0, 1, 100), 1)
    np.testing.assert_allclose(np.einsum("md,md->m", points, slopes), 0, atol=1e-12)
    assert np.all(points[:, 0] * slopes[:, 1] > points[:, 1] * slopes[:, 0])  # counter-clockwise


def test_constructors_say_when_points_are_too_few():
    with pytest.raises(TooFewPoints, match="needs 3"):
        periodic_uniform(np.zeros((2, 2)))
    with pytest.raises(TooFewPoints, match="needs 4"):
        clamped_uniform(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="positive radius"):
        circle((0, 0), 0.0, np.eye(2))


def test_values_refuse_knots_that_do_not_repeat_or_have_no_domain():
    points, weights = np.random.default_rng(0).normal(size=(5, 2)), np.ones(5)
    with pytest.raises(ValueError, match="must repeat"):
        Curve(2, np.arange(10.0) ** 2, points, weights, periodic=True)
    with pytest.raises(ValueError, match="no length"):
        Curve(2, np.zeros(8), points, weights, periodic=False)
    with pytest.raises(ValueError, match="must not decrease"):
        Curve(2, np.array([0, 0, 0, 2, np.nan, 3, 3, 3]), points, weights, periodic=False)
