"""No verb of the algebra changes a shape; geomdl agrees on the control points."""

from __future__ import annotations

import numpy as np
import pytest
from geomdl import helpers, operations
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.nurbs import (
    Along,
    circle,
    clamped,
    clamped_along,
    curve_derivatives,
    elevate,
    elevate_along,
    evaluate_surface,
    insert_knot,
    insert_knot_along,
    opened,
    opened_along,
    periodic_uniform,
    refine,
    refine_along,
    reparametrise,
    reparametrise_along,
    reverse,
    reverse_along,
    split,
    split_along,
    swapped,
)
from tests.reconstruction.nurbs_cases import (
    curves,
    geomdl_curve,
    geomdl_surface,
    random_curve,
    random_surface,
    spread,
)

fractions = st.integers(0, 1009).map(lambda k: k / 1009)
BOTH = pytest.mark.parametrize("along", list(Along))


def assert_same(curve, other, u=None):
    u = spread(curve) if u is None else u
    scale = np.abs(curve.control_points_mm).max()
    np.testing.assert_allclose(other(u), curve(u), rtol=0, atol=1e-11 * scale)


def at(curve, fraction):
    start, end = curve.domain
    return min(end, start + fraction * (end - start))


def room(curve, u):
    return curve.degree - int(np.count_nonzero(curve.knots == u))


@settings(max_examples=40, deadline=None)
@given(curves(), fractions, st.integers(1, 5))
def test_inserting_a_knot_changes_nothing_but_the_knots(curve, fraction, times):
    u = at(curve, fraction)
    u = curve.domain[0] if curve.periodic and u == curve.domain[1] else u
    times = min(times, room(curve, u))
    if times > 0:
        finer = insert_knot(curve, u, times=times)
        assert len(finer.weights) == len(curve.weights) + times
        assert finer.domain == curve.domain
        assert_same(curve, finer)


@settings(max_examples=25, deadline=None)
@given(curves(), st.lists(fractions, max_size=12, unique=True))
def test_refining_changes_nothing_but_the_knots(curve, fractions):
    added = [u for u in (at(curve, f) for f in fractions) if u < curve.domain[1]]
    added = [u for u in added if room(curve, u) > 0]
    finer = refine(curve, added)
    assert len(finer.weights) == len(curve.weights) + len(added)
    assert_same(curve, finer)


@settings(max_examples=30, deadline=None)
@given(curves(), st.integers(1, 3))
def test_elevating_changes_nothing_but_degree_and_knots(curve, by):
    higher = elevate(curve, by=by)
    assert higher.degree == curve.degree + by
    assert higher.periodic is curve.periodic
    assert higher.domain == curve.domain
    assert_same(curve, higher)


@settings(max_examples=20, deadline=None)
@given(curves())
def test_clamping_changes_nothing_but_the_knots(curve):
    other = clamped(curve)
    assert not other.periodic
    assert other.domain == curve.domain
    assert np.all(other.knots[: curve.degree + 1] == curve.domain[0])
    assert np.all(other.knots[-curve.degree - 1 :] == curve.domain[1])
    assert_same(curve, other)


@settings(max_examples=20, deadline=None)
@given(curves(periodic=True), fractions)
def test_a_periodic_curve_opens_anywhere_and_keeps_its_parameters(curve, fraction):
    other = opened(curve, at(curve, fraction))
    assert_same(curve, other, np.linspace(*other.domain, 60))
    np.testing.assert_allclose(np.ptp(other.domain), np.ptp(curve.domain), rtol=1e-14)


@settings(max_examples=20, deadline=None)
@given(curves(periodic=False), st.floats(0.05, 0.95))
def test_the_two_parts_of_a_split_curve_are_the_curve(curve, fraction):
    u = at(curve, fraction)
    for part, domain in zip(
        split(curve, u), ((curve.domain[0], u), (u, curve.domain[1])), strict=True
    ):
        assert part.domain == domain
        assert_same(curve, part, np.linspace(*part.domain, 40))


def test_splitting_at_a_knot_of_full_multiplicity_takes_no_insertion():
    curve = insert_knot(random_curve(np.random.default_rng(0), 9, 3), 0.3, times=3)
    left, right = split(curve, 0.3)
    assert len(left.weights) + len(right.weights) == len(curve.weights) + 1
    assert np.array_equal(left.control_points_mm[-1], right.control_points_mm[0])


@settings(max_examples=20, deadline=None)
@given(curves())
def test_reversing_runs_backwards_and_twice_is_nothing(curve):
    start, end = curve.domain
    u = np.linspace(start, end, 40)
    backwards = reverse(curve)
    mirrored = np.clip(start + (end - u), start, end)
    np.testing.assert_allclose(backwards(mirrored), curve(u), rtol=0, atol=1e-10)
    assert backwards.domain == curve.domain
    np.testing.assert_allclose(
        reverse(backwards).control_points_mm, curve.control_points_mm, rtol=1e-15
    )


@settings(max_examples=20, deadline=None)
@given(curves(), st.floats(-100, 100), st.floats(0.1, 100))
def test_reparametrising_maps_the_domain_and_nothing_else(curve, start, length):
    other = reparametrise(curve, start, start + length)
    assert other.domain == (start, start + length)
    t = np.linspace(0.01, 0.99, 31)
    ours = other(start + t * length)
    theirs = curve(curve.domain[0] + t * np.ptp(curve.domain))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


@pytest.mark.parametrize("degree", [3, 4])
def test_algebra_leaves_a_periodic_curve_smooth_at_its_seam(degree):
    curve = periodic_uniform(np.random.default_rng(2).normal(size=(8, 2)), degree)
    before = np.nextafter(curve.domain[1], 0)
    for other in (elevate(curve), refine(curve, [0.5, 7.5, 7.75]), reverse(curve)):
        seam, end = curve_derivatives(other, [0.0, before], 2).swapaxes(0, 1)
        np.testing.assert_allclose(seam, end, rtol=0, atol=1e-10)


@pytest.mark.parametrize("verb", [elevate, clamped, lambda c: insert_knot(c, 0.4, times=2)])
def test_the_circle_stays_exact(verb):
    radii = np.linalg.norm(verb(circle((0, 0), 7.0, np.eye(2)))(np.linspace(0, 1, 500)), axis=1)
    assert np.abs(radii / 7.0 - 1).max() < 1e-13


def test_elevation_stays_accurate_on_very_uneven_knots():
    rng = np.random.default_rng(3)
    inner = np.cumsum(10.0 ** rng.uniform(-6, 0, 12))
    knots = np.concatenate([np.zeros(5), inner, np.full(5, inner[-1] + 1)])
    curve = random_curve(rng, 17, 4)
    curve = type(curve)(4, knots, curve.control_points_mm, curve.weights, periodic=False)
    assert_same(curve, elevate(curve, by=2))


def test_plain_shapes_stay_plain_and_keep_their_common_weight():
    curve = random_curve(np.random.default_rng(0), 9, 3, rational=False)
    heavy = type(curve)(3, curve.knots, curve.control_points_mm, 2 * curve.weights, periodic=False)
    assert np.all(elevate(curve).weights == 1)
    assert np.all(refine(heavy, [0.1, 0.2]).weights == 2)


@pytest.mark.parametrize("periodic", [True, False])
def test_a_knot_that_differs_by_rounding_alone_is_not_inserted_beside_its_twin(periodic):
    curve = random_curve(np.random.default_rng(0), 9, 3, periodic=periodic)
    knot = float(curve.knots[6])
    assert np.count_nonzero(curve.knots == knot) == 1
    finer = insert_knot(curve, np.nextafter(knot, 99))
    assert np.count_nonzero(finer.knots == knot) == 2
    assert_same(curve, finer)


def test_refusals_say_what_does_not_fit():
    curve = random_curve(np.random.default_rng(0), 9, 3)
    closed = random_curve(np.random.default_rng(0), 9, 3, periodic=True)
    with pytest.raises(ValueError, match="do not fit degree 3"):
        insert_knot(curve, 0.0, times=4)
    with pytest.raises(ValueError, match="do not fit degree 3"):
        insert_knot(curve, -1.0)
    with pytest.raises(ValueError, match="outside the domain"):
        insert_knot(curve, -1.1)
    with pytest.raises(ValueError, match="not inside the domain"):
        split(curve, -1.0)
    with pytest.raises(ValueError, match="open it first"):
        split(closed, 1.0)
    with pytest.raises(ValueError, match="only a periodic"):
        opened(curve, 0.0)
    with pytest.raises(ValueError, match="not lowered"):
        elevate(curve, by=-1)
    with pytest.raises(ValueError, match="must increase"):
        reparametrise(curve, 1.0, 1.0)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_control_points_agree_with_geomdl_after_insertion(degree):
    curve = random_curve(np.random.default_rng(degree), degree + 6, degree)
    u = float(np.mean(curve.domain)) + 0.01
    peer = operations.insert_knot(geomdl_curve(curve), [u], [2])
    ours = insert_knot(curve, u, times=2)
    np.testing.assert_allclose(ours.knots, peer.knotvector, rtol=1e-15)
    np.testing.assert_allclose(ours.control_points_mm, peer.ctrlpts, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(ours.weights, peer.weights, rtol=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_control_points_agree_with_geomdl_after_elevation_of_a_bezier(degree):
    curve = random_curve(np.random.default_rng(degree), degree + 1, degree)
    weighted = np.column_stack(
        [curve.control_points_mm * curve.weights[:, None], curve.weights]
    ).tolist()
    peer = np.array(helpers.degree_elevation(degree, weighted, num=2))
    ours = elevate(curve, by=2)
    np.testing.assert_allclose(ours.weights, peer[:, 3], rtol=1e-12)
    np.testing.assert_allclose(
        ours.control_points_mm, peer[:, :3] / peer[:, 3:], rtol=1e-10, atol=1e-10
    )


def test_both_parts_agree_with_geomdl_after_a_split():
    curve = random_curve(np.random.default_rng(7), 9, 3)
    for ours, peer in zip(
        split(curve, 0.7), operations.split_curve(geomdl_curve(curve), 0.7), strict=True
    ):
        np.testing.assert_allclose(ours.control_points_mm, peer.ctrlpts, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(ours.weights, peer.weights, rtol=1e-12)


@BOTH
def test_surface_control_points_agree_with_geomdl_after_insertion_and_split(along):
    surface = random_surface(np.random.default_rng(4), (7, 8), (3, 2))
    u = float(np.mean(surface.domain[0 if along is Along.U else 1]))
    where = [u, None] if along is Along.U else [None, u]
    peer = operations.insert_knot(geomdl_surface(surface), where, [1 if w else 0 for w in where])
    ours = insert_knot_along(surface, along, u)
    shape = (*ours.weights.shape, 3)
    np.testing.assert_allclose(
        ours.control_points_mm, np.reshape(peer.ctrlpts, shape), rtol=1e-10, atol=1e-10
    )
    divide = operations.split_surface_u if along is Along.U else operations.split_surface_v
    for part, other in zip(
        split_along(surface, along, u), divide(geomdl_surface(surface), u), strict=True
    ):
        shape = (*part.weights.shape, 3)
        np.testing.assert_allclose(
            part.control_points_mm, np.reshape(other.ctrlpts, shape), rtol=1e-10, atol=1e-10
        )


@BOTH
@pytest.mark.parametrize("rational", [True, False])
@pytest.mark.parametrize("periodic", [(False, False), (True, False), (True, True)])
def test_no_verb_changes_a_surface(along, rational, periodic):
    rng = np.random.default_rng(11)
    surface = random_surface(rng, (7, 8), (3, 2), periodic=periodic, rational=rational)
    (u0, u1), (v0, v1) = surface.domain
    start, end = (u0, u1) if along is Along.U else (v0, v1)
    inner = start + (end - start) * np.array([0.21, 0.63])
    u, v = np.linspace(u0, u1, 15), np.linspace(v0, v1, 17)
    expected = evaluate_surface(surface, u, v)
    for other in (
        insert_knot_along(surface, along, inner[0]),
        refine_along(surface, along, inner),
        elevate_along(surface, along),
        clamped_along(surface, along),
        swapped(swapped(surface)),
    ):
        np.testing.assert_allclose(evaluate_surface(other, u, v), expected, rtol=0, atol=1e-9)
        assert other.domain == surface.domain


@BOTH
def test_surfaces_turn_round_move_their_domain_and_open(along):
    surface = random_surface(np.random.default_rng(12), (7, 8), (3, 2), periodic=(True, True))
    axis = 0 if along is Along.U else 1
    grid = [np.linspace(*surface.domain[0], 9), np.linspace(*surface.domain[1], 9)]
    expected = evaluate_surface(surface, *grid)
    backwards = evaluate_surface(reverse_along(surface, along), *grid)
    np.testing.assert_allclose(np.flip(backwards, axis), expected, rtol=0, atol=1e-10)
    moved = reparametrise_along(surface, along, 0.0, 1.0)
    assert moved.domain[axis] == (0.0, 1.0)
    cut = opened_along(surface, along, float(grid[axis][3]))
    assert (cut.periodic_u, cut.periodic_v) == (along is not Along.U, along is not Along.V)
    grid[axis] = np.linspace(*cut.domain[axis], 9)
    np.testing.assert_allclose(
        evaluate_surface(cut, *grid), evaluate_surface(surface, *grid), rtol=0, atol=1e-10
    )
