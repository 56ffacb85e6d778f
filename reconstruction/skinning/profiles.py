"""The part of a fitted profile that lies between two heights, down to the axis at most."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from reconstruction.arrays import FloatArray
from reconstruction.errors import Unfittable
from reconstruction.fitting.spline import nurbs_of
from reconstruction.nurbs import Curve, split

_SAMPLES = 16  # of a span, to find where it passes a height
_SAME = 1e-9  # of the profile's size


def profile_between(control_mm: FloatArray, low_mm: float, high_mm: float) -> Curve:
    """Cut an open profile to the stretch from its first to its last place between two heights.

    Where it ends before them, but heads for them, it goes on straight, as far again as it is long
    at most; where it meets the axis it ends, on the axis exactly.

    Parameters
    ----------
    control_mm
        (n, 2), heights and radii, see `fitting.spline`.

    Raises
    ------
    Unfittable
        No part of it lies there.
    """
    control = _extended(control_mm, low_mm)
    control = _extended(control[::-1], high_mm)[::-1]
    curve = nurbs_of(control, closed=False)
    t = np.linspace(*curve.domain, _SAMPLES * (len(control) - 3) + 1)

    def inside(places: FloatArray) -> FloatArray:
        height, radius = places.T
        return np.asarray(np.minimum(np.minimum(height - low_mm, high_mm - height), radius))

    depths = inside(curve(t))
    held = np.flatnonzero(depths > 0.0)
    if not len(held):
        raise Unfittable(f"revolution: no part of its profile lies at {low_mm:g} .. {high_mm:g} mm")

    def depth(at: float) -> float:
        return float(inside(curve(np.array([at])))[0])

    first, last = int(held[0]), int(held[-1])
    if last < len(t) - 1:
        curve = split(curve, float(brentq(depth, t[last], t[last + 1], xtol=1e-14)))[0]
    if first > 0:
        curve = split(curve, float(brentq(depth, t[first - 1], t[first], xtol=1e-14)))[1]
    return _ended(curve, low_mm, high_mm)


def _extended(control: FloatArray, height_mm: float) -> FloatArray:
    """Let a profile go on straight before its start, until it has passed a height or the axis.

    Control points in a row on a line make a straight piece; the joint stays as smooth as it was.
    """
    edge, other = (control[0] + 4 * control[1] + control[2]) / 6, control[-1]
    side = 1.0 if height_mm > edge[0] else -1.0
    way = control[0] - control[1]
    lacks = abs(height_mm - edge[0]) > _SAME * float(np.ptp(control, axis=0).max())
    nearer = side * (edge[0] - other[0]) > 0.0  # than the other end: that one may get there
    heads = side * way[0] > 0.0 or way[1] < 0.0
    if not (lacks and nearer and heads and edge[1] > 0.0):
        return control
    most = len(control)  # as far again as it is long: beyond, nothing is known of it
    added = control[0] + np.arange(1, most + 1)[:, None] * way
    passed = np.flatnonzero((side * (added[:, 0] - height_mm) > 0.0) | (added[:, 1] < 0.0))
    count = min(int(passed[0]) + 2, most) if len(passed) else most
    return np.vstack([added[:count][::-1], control])


def _ended(curve: Curve, low_mm: float, high_mm: float) -> Curve:
    """Make exact what was found to rounding: the heights, and the axis."""
    points = np.array(curve.control_points_mm)
    least = _SAME * float(np.ptp(points, axis=0).max())
    for at in (0, -1):
        for height in (low_mm, high_mm):
            if abs(points[at, 0] - height) < least:
                points[at, 0] = height
        if abs(points[at, 1]) < least:
            points[at, 1] = 0.0
    return Curve(3, curve.knots, points, curve.weights, periodic=False)
