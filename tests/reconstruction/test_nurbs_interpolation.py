"""Curves through points and surfaces through sections."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.nurbs import (
    Curve,
    chord_parameters,
    circle,
    curve_derivatives,
    evaluate_surface,
    interpolate_open,
    interpolate_periodic,
    loft_sections,
    surface_derivatives,
)

seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 40), st.integers(1, 5), st.sampled_from([2, 3]))
def test_a_closed_curve_meets_its_points_at_the_integers(seed, count, degree, dimension):
    count = max(count, degree)
    points = np.random.default_rng(seed).normal(0, 10, (count, dimension))
    curve = interpolate_periodic(points, degree=degree)
    assert curve.periodic
    assert len(curve.weights) == count
    np.testing.assert_allclose(curve(np.arange(count)), points, rtol=0, atol=1e-9)


def test_a_closed_cubic_solves_the_one_four_one_system():
    points = np.random.default_rng(0).normal(size=(7, 2))
    c = interpolate_periodic(points).control_points_mm
    filtered = (c + 4 * np.roll(c, -1, axis=0) + np.roll(c, -2, axis=0)) / 6
    np.testing.assert_allclose(filtered, points, rtol=0, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(5, 40), st.integers(1, 5))
def test_a_closed_curve_meets_its_points_at_given_parameters(seed, count, degree):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    parameters = 3 + np.concatenate([[0.0], rng.uniform(0.5, 1.5, count).cumsum()])
    curve = interpolate_periodic(points, degree=degree, parameters=parameters)
    np.testing.assert_allclose(curve(parameters[:-1]), points, rtol=0, atol=1e-9)
    np.testing.assert_allclose(curve(parameters[-1]), points[0], rtol=0, atol=1e-9)
    if degree % 2:
        assert curve.domain == (parameters[0], parameters[-1])


def test_a_closed_cubic_is_scipys_periodic_spline():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(12, 2))
    parameters = np.concatenate([[0.0], rng.uniform(0.2, 2, 12).cumsum()])
    peer = make_interp_spline(parameters, np.vstack([points, points[:1]]), k=3, bc_type="periodic")
    u = np.linspace(0, parameters[-1], 200)
    curve = interpolate_periodic(points, parameters=parameters)
    np.testing.assert_allclose(curve(u), peer(u), rtol=0, atol=1e-12)
    second = curve_derivatives(curve, [0.0, np.nextafter(parameters[-1], 0)], 2)[2]
    np.testing.assert_allclose(second[0], second[1], rtol=0, atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 5), st.integers(1, 30))
def test_an_open_curve_meets_its_points_at_chord_length(seed, degree, more):
    points = np.cumsum(np.random.default_rng(seed).uniform(0.2, 2, (degree + more, 3)), axis=0)
    curve = interpolate_open(points, degree=degree)
    assert curve.domain == (0.0, 1.0)
    np.testing.assert_allclose(curve(chord_parameters(points)), points, rtol=0, atol=1e-9)


def test_an_open_curve_meets_its_points_at_given_parameters():
    rng = np.random.default_rng(2)
    points, parameters = rng.normal(size=(9, 2)), rng.uniform(0.1, 3, 9).cumsum()
    curve = interpolate_open(points, parameters=parameters)
    np.testing.assert_allclose(curve(parameters), points, rtol=0, atol=1e-12)
    assert curve.domain == (parameters[0], parameters[-1])


def test_interpolation_refuses_too_few_points_and_parameters_that_stand_still():
    with pytest.raises(TooFewPoints, match=r"2 points; a closed degree-3 curve needs 3"):
        interpolate_periodic(np.zeros((2, 2)))
    with pytest.raises(TooFewPoints, match=r"3 points; a degree-3 curve needs 4"):
        interpolate_open(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="points 1 and 2 are equal"):
        interpolate_open(np.array([[0, 0], [1, 0], [1, 0], [2, 0]], dtype=float))
    with pytest.raises(ValueError, match="6 increasing parameters"):
        interpolate_periodic(np.eye(5), parameters=[0, 1, 1, 2, 3, 4])


def sections(count, weights=None):
    """Closed cubic sections that grow, shift and twist, at uneven heights."""
    rng = np.random.default_rng(count)
    heights = rng.uniform(0.5, 3, count).cumsum()
    nets = rng.normal(0, 5, (count, 9, 3))
    nets[..., 2] = heights[:, None]
    knots = np.arange(-3, 13, dtype=float)
    return nets, heights, knots


@pytest.mark.parametrize("count", [2, 3, 4, 5, 12])
@pytest.mark.parametrize("weighted", ["plain", "common", "each its own"])
def test_a_lofted_surface_contains_its_sections(count, weighted):
    nets, heights, knots = sections(count)
    rng = np.random.default_rng(1)
    weights = {
        "plain": None,
        "common": rng.uniform(0.5, 2, 9),
        "each its own": rng.uniform(1.0, 1.2, (count, 9)),
    }[weighted]
    surface = loft_sections(
        nets, degree_u=3, knots_u=knots, periodic_u=True, parameters=heights, weights=weights
    )
    assert surface.degree_v == min(3, count - 1)
    assert surface.domain == ((0, 9), (heights[0], heights[-1]))
    u = np.linspace(0, 9, 50)
    each = np.ones((count, 9)) if weights is None else np.broadcast_to(weights, (count, 9))
    for row in range(count):
        section = Curve(3, knots, nets[row], each[row], periodic=True)
        ours = evaluate_surface(surface, u, heights[row])[:, 0]
        np.testing.assert_allclose(ours, section(u), rtol=0, atol=1e-9)


def test_the_v_parameter_of_a_loft_is_the_height_itself():
    nets, heights, knots = sections(8)
    surface = loft_sections(nets, degree_u=3, knots_u=knots, periodic_u=True, parameters=heights)
    v = np.linspace(heights[0], heights[-1], 30)
    points = evaluate_surface(surface, np.linspace(0, 9, 30), v)
    np.testing.assert_allclose(points[..., 2], np.tile(v, (30, 1)), rtol=1e-13)


def test_a_loft_of_circles_is_a_cylinder():
    rings = [circle((0, 0, z), 5.0, np.eye(3)[:2]) for z in (0.0, 1.0, 4.0, 9.0)]
    surface = loft_sections(
        np.stack([ring.control_points_mm for ring in rings]),
        degree_u=2,
        knots_u=rings[0].knots,
        periodic_u=True,
        parameters=[0.0, 1.0, 4.0, 9.0],
        weights=rings[0].weights,
    )
    points = evaluate_surface(surface, np.linspace(0, 1, 60), np.linspace(0, 9, 40))
    radii = np.linalg.norm(points[..., :2], axis=2)
    assert np.abs(radii / 5 - 1).max() < 1e-13


def test_a_cubic_loft_is_twice_continuous_across_its_sections():
    nets, heights, knots = sections(9)
    surface = loft_sections(nets, degree_u=3, knots_u=knots, periodic_u=True, parameters=heights)
    inner = surface.knots_v[4:-4]
    above = surface_derivatives(surface, np.full(len(inner), 1.3), inner, 2)
    below = surface_derivatives(surface, np.full(len(inner), 1.3), np.nextafter(inner, 0), 2)
    np.testing.assert_allclose(above, below, rtol=0, atol=1e-8)


def test_what_cannot_be_lofted_is_named():
    nets, heights, knots = sections(5)
    common = {"degree_u": 3, "knots_u": knots, "periodic_u": True}
    with pytest.raises(NotLoftable, match="sections 1 and 2") as caught:
        loft_sections(nets, parameters=heights[[0, 2, 1, 3, 4]], **common)
    assert caught.value.indices == (1, 2)
    with pytest.raises(NotLoftable, match="1 section"):
        loft_sections(nets[:1], parameters=heights[:1], **common)
    with pytest.raises(ValueError, match="5 sections need 5 parameters"):
        loft_sections(nets, parameters=heights[:4], **common)
    wild = np.ones((5, 9))
    wild[2] = 1e-3
    wild[3] = 100.0
    with pytest.raises(NotLoftable, match="weights fall to"):
        loft_sections(nets, parameters=heights, weights=wild, **common)
