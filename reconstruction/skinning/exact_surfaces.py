"""From a form to an exact rational surface: u around the axis, v along it.

::

    cylinder, cone   rulings v from one end curve to the other; the ends are cut by planes across
                     the slicing axis, so an end of a leaning form is an ellipse, still exact: the
                     cut of a ruling is linear (cylinder) or a quotient of linear functions (cone)
                     of the point on the circle, which is what weights are for
    sphere           an arc of latitude, turned; poles are degenerate rows
    revolution       the profile's cubic, turned
    plane            four corners

A height is a point's scalar product with the slicing axis. Surfaces run counter-clockwise about it
in u, from the start direction, and up in v: their normals point away from the form's axis.

References
----------
The NURBS Book, sections 7.5 (circles), 8.3 (general cylinders), 8.5 (surfaces of revolution).
"""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import Unfittable
from reconstruction.fitting.spline import nurbs_of
from reconstruction.nurbs import Curve, Surface, circle, reparametrise
from reconstruction.skinning.primitives import Cone, Cylinder, Form, Plane, Sphere, axes_about
from reconstruction.skinning.profiles import profile_between
from reconstruction.skinning.revolution import Revolution

_UPRIGHT = 0.05  # cosine of the lean from which planes across no longer cut a form round
_PIECES = (4, 8, 16, 32)  # arcs of a full turn; with more, the control polygon is tighter

Heights = tuple[float, float]


def surface_of(
    form: Form,
    heights_mm: Heights,
    start: FloatArray,
    *,
    along: FloatArray | None = None,
    turn_rad: float | None = None,
    places_mm: FloatArray,
) -> Surface:
    """The exact surface of a form between two heights.

    Parameters
    ----------
    heights_mm
        Low and high. A cone ends at its apex, a sphere at its poles, a profile at the axis, even
        where more is asked for; a loop (torus) is whole. A profile that ends before goes on
        straight. A leaning surface of revolution ends in circles about its own axis whose centres
        lie at the heights: only where it does not lean are they in the planes.
    start
        (3,), where u begins, seen from the axis; of a plane, the way u runs.
    along
        (3,), the slicing axis; by default the form's own, of a sphere z.
    turn_rad
        Of an open patch: how far u goes round, counter-clockwise; by default all round, closed.
    places_mm
        (m, 3), what a plane must reach across.

    Raises
    ------
    ValueError
        Heights that do not increase, a start direction along the axis, a turn not in (0, 2 pi].
    Unfittable
        The form leans so far that planes across the slicing axis do not cut it round, or lies
        outside the heights.
    """
    low, high = heights_mm
    if not low < high:
        raise ValueError(f"heights {low:g} and {high:g} mm do not increase")
    if turn_rad is not None and not 0.0 < turn_rad <= math.tau:
        raise ValueError(f"a turn of {turn_rad:g} rad is not in (0, 2 pi]")
    up = _unit(_own_axis(form) if along is None else np.asarray(along, dtype=np.float64))
    if isinstance(form, Plane):
        return _plane(form, heights_mm, start, up, places_mm)
    if isinstance(form, Sphere):
        return _sphere(form, heights_mm, _axes(up, start), _ring(turn_rad, 4))
    assert isinstance(form, Cylinder | Cone | Revolution)
    axis = form.frame.axes[2]
    if abs(float(axis @ up)) < _UPRIGHT:
        lean = math.degrees(math.acos(min(abs(float(axis @ up)), 1.0)))
        raise Unfittable(f"{form.kind}: its axis leans {lean:.0f} deg from the slicing axis")
    axes = _axes(axis if float(axis @ up) > 0.0 else -axis, start)
    if isinstance(form, Cylinder):
        return _cylinder(form, heights_mm, axes, up, _ring(turn_rad, 4))
    if isinstance(form, Cone):
        return _cone(form, heights_mm, axes, up, turn_rad)
    return _revolution(form, heights_mm, axes, up, _ring(turn_rad, 4))


def _own_axis(form: Form) -> FloatArray:
    if isinstance(form, Plane):
        return np.asarray(form.frame.axes[1])
    if isinstance(form, Cylinder | Cone | Revolution):
        return np.asarray(form.frame.axes[2])
    return np.array([0.0, 0.0, 1.0])


def _unit(direction: FloatArray) -> FloatArray:
    return np.asarray(direction / math.sqrt(float(direction @ direction)))


def _axes(axis: FloatArray, start: FloatArray) -> FloatArray:
    """Rows x, y, axis; x towards the start direction."""
    across = start - (start @ axis) * axis
    if not float(across @ across) > 1e-12 * float(start @ start):
        raise ValueError("the start direction runs along the axis: take one that points away")
    return axes_about(axis, start)


def _ring(turn_rad: float | None, pieces: int) -> Curve:
    """The unit circle, closed, or its arc from x on over a turn; at least `pieces` a full turn."""
    closed = turn_rad is None
    turn = math.tau if turn_rad is None else turn_rad
    count = pieces if closed else max(math.ceil(pieces * turn / math.tau - 1e-9), 1)
    half = turn / (2 * count)
    at = np.arange(2 * count + (not closed))
    weights = np.where(at % 2 == 1, math.cos(half), 1.0)
    points = np.column_stack([np.cos(half * at), np.sin(half * at)]) / weights[:, None]
    if not closed:
        inner = np.repeat(np.arange(1, count) / count, 2)
        knots = np.concatenate([np.zeros(3), inner, np.ones(3)])
        return Curve(2, knots, points, weights, periodic=False)
    if count == 4:
        return circle(np.zeros(2), 1.0, np.eye(2))
    knots = (np.arange(2 * count + 5) + 1) // 2 - 1
    return Curve(2, knots / count, points, weights, periodic=True)


def _plane(
    plane: Plane, heights: Heights, start: FloatArray, up: FloatArray, places: FloatArray
) -> Surface:
    normal = plane.frame.axes[2]
    rise = up - (up @ normal) * normal
    if not float(np.linalg.norm(rise)) > _UPRIGHT:
        raise Unfittable("plane: it lies across the slicing axis, heights do not bound it")
    rise = rise / np.linalg.norm(rise)
    level = np.cross(rise, normal)
    level = level if float(level @ start) >= 0.0 else -level
    reach = (places - plane.frame.origin_mm) @ level
    corners = np.empty((2, 2, 3))
    for i, across in enumerate((float(reach.min()), float(reach.max()))):
        for j, height in enumerate(heights):
            climb = (height - float(plane.frame.origin_mm @ up)) / float(rise @ up)
            corners[i, j] = plane.frame.origin_mm + across * level + climb * rise
    return _ruled(corners, np.ones(2), 1, np.array([0.0, 0.0, 1.0, 1.0]), heights, periodic=False)


def _ruled(
    rows: FloatArray, weights: FloatArray, degree: int, knots: FloatArray, heights: Heights,
    *, periodic: bool,
) -> Surface:  # fmt: skip
    """The surface of straight lines in v between two rows of control points (n, 2, 3)."""
    low, high = heights
    return Surface(
        degree, 1, knots, np.array([low, low, high, high]), rows,
        np.repeat(weights[:, None], 2, axis=1), periodic_u=periodic, periodic_v=False,
    )  # fmt: skip


def _cylinder(
    cylinder: Cylinder, heights: Heights, axes: FloatArray, up: FloatArray, ring: Curve
) -> Surface:
    axis = axes[2]
    points = cylinder.frame.origin_mm + cylinder.radius_mm * ring.control_points_mm @ axes[:2]
    climbs = (np.array(heights) - (points @ up)[:, None]) / float(axis @ up)
    rows = points[:, None, :] + climbs[:, :, None] * axis
    return _ruled(rows, ring.weights, 2, ring.knots, heights, periodic=ring.periodic)


def _cone(
    cone: Cone, heights: Heights, axes: FloatArray, up: FloatArray, turn: float | None
) -> Surface:
    opens = 1.0 if float(cone.frame.axes[2] @ up) > 0.0 else -1.0
    apex, tip = cone.apex_mm, float(cone.apex_mm @ up)
    low, high = heights
    low, high = (max(low, tip), high) if opens > 0.0 else (low, min(high, tip))
    if not low < high:
        raise Unfittable(f"cone: its apex at {tip:g} mm leaves nothing between the heights")
    c, s = math.cos(cone.half_angle_rad), math.sin(cone.half_angle_rad)
    for pieces in _PIECES:
        ring = _ring(turn, pieces)
        ways = c * opens * axes[2] + s * ring.control_points_mm @ axes[:2]
        climbs = opens * (ways @ up)
        if climbs.min() > 1e-3 * c:
            break
    else:
        raise Unfittable("cone: planes across the slicing axis do not cut it in ellipses")
    # On a ruling a height is reached at (height - tip) / climb: the climb goes into the weight.
    shares = opens * (np.array([low, high]) - tip)
    rows = apex + shares[:, None] * (ways / climbs[:, None])[:, None, :]
    return _ruled(rows, ring.weights * climbs, 2, ring.knots, (low, high), periodic=ring.periodic)


def _sphere(sphere: Sphere, heights: Heights, axes: FloatArray, ring: Curve) -> Surface:
    radius, middle = sphere.radius_mm, float(sphere.centre_mm @ axes[2])
    low, high = (min(max((h - middle) / radius, -1.0), 1.0) for h in heights)
    if not low < high:
        raise Unfittable("sphere: it lies outside the heights")
    south, north = math.asin(low), math.asin(high)
    arc = _ring(north - south, 4)
    c, s = math.cos(south), math.sin(south)
    profile = radius * arc.control_points_mm @ np.array([[s, c], [c, -s]])  # height, radius
    for end, latitude in ((0, low), (-1, high)):
        profile[end] = radius * latitude, radius * math.sqrt(1.0 - latitude * latitude)
    ends = middle + radius * low, middle + radius * high
    knots = ends[0] + (ends[1] - ends[0]) * arc.knots
    curve = Curve(2, knots, profile, arc.weights, periodic=False)
    return _turned(curve, sphere.centre_mm, axes, ring)


def _turned(profile: Curve, origin: FloatArray, axes: FloatArray, ring: Curve) -> Surface:
    """A profile of heights and radii, turned."""
    heights, radii = profile.control_points_mm.T
    arms = ring.control_points_mm @ axes[:2]
    net = origin + heights[None, :, None] * axes[2] + radii[None, :, None] * arms[:, None, :]
    return Surface(
        2, profile.degree, ring.knots, profile.knots, net,
        ring.weights[:, None] * profile.weights[None, :], ring.periodic, profile.periodic,
    )  # fmt: skip


def _revolution(
    form: Revolution, heights: Heights, axes: FloatArray, up: FloatArray, ring: Curve
) -> Surface:
    control, axis, origin = form.control_mm, axes[2], form.frame.origin_mm
    if float(axis @ form.frame.axes[2]) < 0.0:
        control = control[::-1] * np.array([-1.0, 1.0])
    if form.closed:
        return _turned(nurbs_of(control, closed=True), origin, axes, ring)
    low, high = ((height - float(origin @ up)) / float(axis @ up) for height in heights)
    profile = profile_between(control, low, high)
    ends = (float(origin @ up) + float(axis @ up) * profile.control_points_mm[[0, -1], 0]).tolist()
    if ends[0] < ends[1]:
        profile = reparametrise(profile, *ends)
    return _turned(profile, origin, axes, ring)
