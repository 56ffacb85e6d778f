"""Exact shapes become exact rational surfaces: on the form, ended where asked, turned outward."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.errors import Unfittable
from reconstruction.nurbs import Surface, points_and_normals
from reconstruction.skinning.exact_surfaces import surface_of
from reconstruction.skinning.primitives import Cone, Cylinder, Plane, Sphere, axes_about
from reconstruction.skinning.revolution import Revolution
from reconstruction.slices import Frame

UP = np.array([0.0, 0.0, 1.0])
START = np.array([1.0, 0.3, 0.0])
NOWHERE = np.zeros((1, 3))
ORIGIN = np.array([3.0, -2.0, 4.0])


def leaning(degrees: float) -> FloatArray:
    """A unit vector that leans from z towards y."""
    lean = math.radians(degrees)
    return np.array([0.0, math.sin(lean), math.cos(lean)])


def grid_of(surface: Surface) -> tuple[FloatArray, FloatArray]:
    """Points and normals (33, 17, 3) over the whole domain."""
    (u0, u1), (v0, v1) = surface.domain
    return points_and_normals(surface, np.linspace(u0, u1, 33), np.linspace(v0, v1, 17))


def off_axis(points: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Heights, radii and unit vectors away from an axis through ORIGIN."""
    arms = points - ORIGIN
    heights = arms @ axis
    away = arms - heights[..., None] * axis
    radii = np.linalg.norm(away, axis=-1)
    return heights, radii, away / np.maximum(radii, 1e-12)[..., None]


@pytest.mark.parametrize("lean", [0.0, 5.0, 40.0, 175.0])
@pytest.mark.parametrize("turn", [None, 2.0, 5.5], ids=["whole", "2 rad", "5.5 rad"])
def test_a_cylinder_between_two_planes_ends_in_them(lean: float, turn: float | None) -> None:
    axis = leaning(lean)
    form = Cylinder(Frame(ORIGIN, axes_about(axis, START)), 12.0)
    surface = surface_of(form, (-20.0, 25.0), START, along=UP, turn_rad=turn, places_mm=NOWHERE)
    points, normals = grid_of(surface)
    _, radii, away = off_axis(points, axis)
    np.testing.assert_allclose(radii, 12.0, atol=1e-12)
    np.testing.assert_allclose(points[:, 0, 2], -20.0, atol=1e-12)
    np.testing.assert_allclose(points[:, -1, 2], 25.0, atol=1e-12)
    np.testing.assert_allclose((normals * away).sum(axis=-1), 1.0, atol=1e-9)
    assert surface.periodic_u == (turn is None)
    assert surface.domain[1] == (-20.0, 25.0)


@pytest.mark.parametrize("lean", [0.0, 5.0, 40.0, 175.0])
@pytest.mark.parametrize("turn", [None, 2.0], ids=["whole", "2 rad"])
def test_a_cone_between_two_planes_ends_in_them(lean: float, turn: float | None) -> None:
    axis = leaning(lean)
    form = Cone(Frame(ORIGIN, axes_about(axis, START)), 30.0, 0.3)
    surface = surface_of(form, (-8.0, 9.0), START, along=UP, turn_rad=turn, places_mm=NOWHERE)
    points, normals = grid_of(surface)
    heights, radii, away = off_axis(points, axis)
    np.testing.assert_allclose(radii, 30.0 + math.tan(0.3) * heights, atol=1e-11)
    np.testing.assert_allclose(points[:, 0, 2], -8.0, atol=1e-12)
    np.testing.assert_allclose(points[:, -1, 2], 9.0, atol=1e-12)
    outward = math.cos(0.3) * away - math.sin(0.3) * axis
    np.testing.assert_allclose((normals * outward).sum(axis=-1), 1.0, atol=1e-9)


@pytest.mark.parametrize("opens", [1.0, -1.0], ids=["up", "down"])
def test_a_cone_asked_beyond_its_apex_ends_there_in_one_point(opens: float) -> None:
    axis = opens * leaning(10.0)
    form = Cone(Frame(ORIGIN, axes_about(axis, START)), 6.0, 0.5)
    apex = ORIGIN - 6.0 / math.tan(0.5) * axis
    surface = surface_of(form, (-60.0, 60.0), START, along=UP, places_mm=NOWHERE)
    row = surface.control_points_mm[:, 0 if opens > 0 else -1]
    np.testing.assert_allclose(row, np.tile(apex, (len(row), 1)), atol=1e-12)
    points, normals = grid_of(surface)
    ends = points[:, 0 if opens > 0 else -1]
    np.testing.assert_allclose(ends, np.tile(apex, (len(ends), 1)), atol=1e-12)
    assert np.isfinite(normals).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-9)


def test_a_flat_leaning_cone_takes_more_arcs_rather_than_negative_weights() -> None:
    form = Cone(Frame(ORIGIN, axes_about(leaning(13.0), START)), 30.0, math.radians(75.0))
    surface = surface_of(form, (2.0, 9.0), START, along=UP, places_mm=NOWHERE)
    assert surface.weights.min() > 0.0
    assert len(surface.weights) > 8
    points, _ = grid_of(surface)
    heights, radii, _ = off_axis(points, leaning(13.0))
    np.testing.assert_allclose(radii, 30.0 + math.tan(math.radians(75.0)) * heights, atol=1e-9)
    np.testing.assert_allclose(points[:, 0, 2], 2.0, atol=1e-11)


@pytest.mark.parametrize(
    ("heights", "ends"),
    [((-99.0, 99.0), (-5.0, 13.0)), ((0.0, 99.0), (0.0, 13.0)), ((-1.5, 10.0), (-1.5, 10.0))],
    ids=["whole", "a pole", "a zone"],
)
def test_a_sphere_is_whole_or_between_two_latitudes(
    heights: tuple[float, float], ends: tuple[float, float]
) -> None:
    form = Sphere(ORIGIN, 9.0)
    surface = surface_of(form, heights, START, along=UP, places_mm=NOWHERE)
    points, normals = grid_of(surface)
    np.testing.assert_allclose(np.linalg.norm(points - ORIGIN, axis=-1), 9.0, atol=1e-12)
    np.testing.assert_allclose(points[:, 0, 2], ends[0], atol=1e-12)
    np.testing.assert_allclose(points[:, -1, 2], ends[1], atol=1e-12)
    np.testing.assert_allclose((normals * (points - ORIGIN)).sum(axis=-1), 9.0, atol=1e-6)
    if heights == (-99.0, 99.0):
        for row in (surface.control_points_mm[:, 0], surface.control_points_mm[:, -1]):
            np.testing.assert_allclose(row, row[:1].repeat(len(row), axis=0), atol=1e-12)


def parabola() -> Revolution:
    """Radii 20 + h**2 / 40 about a leaning axis: a cubic spline has it exactly (Marsden)."""
    h = np.linspace(-30.0, 40.0, 15)
    spacing = h[1] - h[0]
    control = np.column_stack([h, 20.0 + (h**2 - spacing**2 / 3.0) / 40.0])
    return Revolution(Frame(ORIGIN, axes_about(leaning(0.0), START)), control, closed=False)


@pytest.mark.parametrize("flip", [1.0, -1.0], ids=["upright", "head over"])
def test_a_profile_is_turned_exactly_and_trimmed_to_the_heights(flip: float) -> None:
    form = parabola()
    axes = form.frame.axes * np.array([[1.0], [flip], [flip]])
    form = Revolution(Frame(ORIGIN, axes), form.control_mm, closed=False)
    surface = surface_of(form, (-10.0, 20.0), START, along=UP, places_mm=NOWHERE)
    points, normals = grid_of(surface)
    heights, radii, away = off_axis(points, UP)
    np.testing.assert_allclose(radii, 20.0 + heights**2 / 40.0, atol=1e-9)
    np.testing.assert_allclose(points[:, 0, 2], -10.0, atol=1e-12)
    np.testing.assert_allclose(points[:, -1, 2], 20.0, atol=1e-12)
    assert ((normals * away).sum(axis=-1) > 0.5).all()
    assert surface.domain[1] == (-10.0, 20.0)


def test_a_profile_goes_on_straight_and_ends_on_the_axis() -> None:
    h = np.linspace(0.0, 30.0, 12)
    form = Revolution(
        Frame(ORIGIN, np.eye(3)), np.column_stack([h, 20.0 - 0.5 * h]), closed=False
    )  # a cone of slope 1/2 whose apex lies at 40
    surface = surface_of(form, (-5.0, 90.0), START, along=UP, places_mm=NOWHERE)
    points, _ = grid_of(surface)
    heights, radii, _ = off_axis(points, UP)
    np.testing.assert_allclose(radii, 20.0 - 0.5 * heights, atol=1e-9)
    np.testing.assert_allclose(points[:, 0, 2], -5.0, atol=1e-12)
    row = surface.control_points_mm[:, -1]
    np.testing.assert_allclose(row, np.tile(ORIGIN + 40.0 * UP, (len(row), 1)), atol=1e-9)
    assert np.ptp(row, axis=0).max() == 0.0


def test_a_loop_turned_is_a_torus_closed_in_both_directions() -> None:
    turn = -math.tau * np.arange(24) / 24
    control = np.column_stack([5.0 * np.cos(turn), 20.0 + 5.0 * np.sin(turn)])
    form = Revolution(Frame(ORIGIN, np.eye(3)), control, closed=True)
    surface = surface_of(form, (-1.0, 1.0), START, along=UP, places_mm=NOWHERE)
    assert surface.periodic_u
    assert surface.periodic_v
    points, normals = grid_of(surface)
    heights, radii, away = off_axis(points, UP)
    tube = np.hypot(heights, radii - 20.0)
    np.testing.assert_allclose(tube, 5.0, atol=0.1)  # a spline of 24 spans through 24 corners
    outward = heights[..., None] * UP + (radii - 20.0)[..., None] * away
    assert ((normals * outward).sum(axis=-1) > 4.8).all()


def test_a_plane_reaches_across_its_places_between_the_heights() -> None:
    axes = axes_about(np.array([0.0, 1.0, 0.2]), np.eye(3)[0])
    form = Plane(Frame(ORIGIN, axes))
    places = ORIGIN + np.array([[-7.0, 3.0], [11.0, -2.0]]) @ axes[:2]
    surface = surface_of(form, (0.0, 30.0), np.eye(3)[0], along=UP, places_mm=places)
    points, _ = grid_of(surface)
    np.testing.assert_allclose((points - ORIGIN) @ axes[2], 0.0, atol=1e-12)
    np.testing.assert_allclose(points[:, 0, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(points[:, -1, 2], 30.0, atol=1e-12)
    level = np.cross(UP, axes[2]) / np.linalg.norm(np.cross(UP, axes[2]))
    reach = np.sort(np.abs((places - ORIGIN) @ level))
    assert np.sort(np.abs((points - ORIGIN) @ level).max(axis=1))[-1] == pytest.approx(reach[-1])


def test_u_begins_at_the_start_direction_and_runs_counter_clockwise() -> None:
    form = Cylinder(Frame(ORIGIN, axes_about(-UP, START)), 12.0)
    surface = surface_of(form, (0.0, 10.0), START, along=UP, places_mm=NOWHERE)
    first, quarter = surface(np.array([0.0, 0.25]), np.array([5.0]))[:, 0]
    direction = START / np.linalg.norm(START)
    np.testing.assert_allclose((first - ORIGIN)[:2], 12.0 * direction[:2], atol=1e-12)
    np.testing.assert_allclose(
        (quarter - ORIGIN)[:2], 12.0 * np.array([-direction[1], direction[0]]), atol=1e-12
    )


def test_what_cannot_be_asked_is_said_in_one_line() -> None:
    form = Cylinder(Frame(ORIGIN, axes_about(UP, START)), 12.0)
    with pytest.raises(ValueError, match="heights 3 and 3 mm do not increase"):
        surface_of(form, (3.0, 3.0), START, places_mm=NOWHERE)
    with pytest.raises(ValueError, match="start direction"):
        surface_of(form, (0.0, 3.0), UP, places_mm=NOWHERE)
    with pytest.raises(ValueError, match="turn of 7 rad"):
        surface_of(form, (0.0, 3.0), START, turn_rad=7.0, places_mm=NOWHERE)
    with pytest.raises(Unfittable, match="leans 90 deg"):
        surface_of(form, (0.0, 3.0), UP, along=np.eye(3)[0], places_mm=NOWHERE)
    with pytest.raises(Unfittable, match="outside the heights"):
        surface_of(Sphere(ORIGIN, 2.0), (50.0, 60.0), START, along=UP, places_mm=NOWHERE)
    with pytest.raises(Unfittable, match="no part of its profile"):
        surface_of(parabola(), (-900.0, -800.0), START, along=UP, places_mm=NOWHERE)
    cone = Cone(Frame(ORIGIN, axes_about(leaning(30.0), START)), 30.0, math.radians(75.0))
    with pytest.raises(Unfittable, match="ellipses"):
        surface_of(cone, (2.0, 9.0), START, along=UP, places_mm=NOWHERE)
