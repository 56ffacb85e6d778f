"""Curves made directly: from control points on uniform knots, and the exact circle."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.nurbs.values import Curve


def periodic_uniform(
    control_points_mm: ArrayLike, degree: int = 3, weights: ArrayLike | None = None
) -> Curve:
    """Return the closed curve of control points (n, d) on integer knots; its domain is [0, n].

    Raises
    ------
    TooFewPoints
        A closed curve of degree p needs p control points.
    """
    points = np.asarray(control_points_mm, dtype=np.float64)
    _require(len(points), degree, degree)
    knots = np.arange(-degree, len(points) + degree + 1, dtype=np.float64)
    return Curve(degree, knots, points, _weights(weights, len(points)), periodic=True)


def clamped_uniform(
    control_points_mm: ArrayLike, degree: int = 3, weights: ArrayLike | None = None
) -> Curve:
    """Return the curve of control points (n, d) that starts and ends on them; domain [0, n - p].

    Raises
    ------
    TooFewPoints
        A curve of degree p needs p + 1 control points.
    """
    points = np.asarray(control_points_mm, dtype=np.float64)
    _require(len(points), degree, degree + 1)
    spans = len(points) - degree
    knots = np.clip(np.arange(-degree, spans + degree + 1, dtype=np.float64), 0.0, spans)
    return Curve(degree, knots, points, _weights(weights, len(points)), periodic=False)


def circle(center_mm: ArrayLike, radius_mm: float, axes: ArrayLike) -> Curve:
    """Return the exact circle as a closed rational quadratic of eight control points.

    ::

        3 --- 2 --- 1       u = 0 at control point 0, on axes[0];
        |           |       u = 1/4 at 2, on axes[1]; and so on.
        4     o     0       corners weigh 1 / sqrt(2). The knots are double,
        |           |       so derivatives are continuous in the plane,
        5 --- 6 --- 7       though not in homogeneous space.

    Parameters
    ----------
    center_mm
        (d,), d = 2 or 3.
    axes
        Two orthonormal rows, (2, d); counter-clockwise is from the first to the second.

    References
    ----------
    The NURBS Book, section 7.5.
    """
    if not radius_mm > 0:
        raise ValueError(f"a circle needs a positive radius, not {radius_mm:g} mm")
    corners = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)]
    square = np.array(corners, dtype=np.float64) @ np.asarray(axes, dtype=np.float64)
    points = np.asarray(center_mm, dtype=np.float64) + radius_mm * square
    weights = np.where(np.arange(8) % 2 == 0, 1.0, math.sqrt(0.5))
    knots = np.array([-1, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]) / 4
    return Curve(2, knots, points, weights, periodic=True)


def _weights(weights: ArrayLike | None, count: int) -> FloatArray:
    if weights is None:
        return np.ones(count)
    return np.asarray(weights, dtype=np.float64)


def _require(count: int, degree: int, least: int) -> None:
    if count < least:
        raise TooFewPoints(f"{count} control points; this degree-{degree} curve needs {least}")
