"""Where to begin: forms near few cells, found without a first guess.

A surface of revolution has x**2 + y**2 = a x + b y + f(h) along its axis, with f constant for a
cylinder, quadratic for a cone, and near a polynomial for others: linear in all unknowns but the
axis's direction. So directions all over the half sphere are tried at once, and the best looked at
more closely (for the cylinder: Eberly, *Least Squares Fitting of Data by Linear or Quadratic
Structures*, section 7).
"""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.primitives import Cone, Cylinder, Plane, Sphere, axes_about
from reconstruction.slices import Frame

_DIRECTIONS = 160  # over the half sphere: about 11 degrees apart
_ZOOMS = 4
_RING = 12  # directions about the best one, each zoom
_NEAR = 0.2  # rad, of the first ring
_TINY = 1e-300


def plane_near(places_mm: FloatArray, weights: FloatArray) -> Plane:
    """The plane of least squares through places (m, 3)."""
    middle, arms = _centred(places_mm, weights)
    axes = np.linalg.eigh((arms * weights[:, None]).T @ arms)[1]
    return Plane(Frame(middle, axes_about(axes[:, 0], axes[:, 2])))


def sphere_near(places_mm: FloatArray, weights: FloatArray) -> Sphere:
    """Kasa's sphere."""
    middle, arms = _centred(places_mm, weights)
    rows = np.column_stack([2 * arms, np.ones(len(arms))])
    root = np.sqrt(weights)
    squares = (arms**2).sum(axis=1)
    found = np.linalg.lstsq(rows * root[:, None], squares * root, rcond=None)[0]
    square = float(found[3] + found[:3] @ found[:3])
    return Sphere(middle + found[:3], math.sqrt(max(square, _TINY)))


def axis_near(places_mm: FloatArray, weights: FloatArray, *, degree: int) -> Frame:
    """The axis about which places (m, 3) are most nearly a surface of revolution.

    Parameters
    ----------
    degree
        Of the polynomial in height that the squared radius is taken for.

    Returns
    -------
    Frame whose origin is on the axis, abreast of the middle of the places, its third axis pointing
    up, that is, along the coordinate it is nearest to.
    """
    middle, arms = _centred(places_mm, weights)
    size = max(math.sqrt(float((arms**2).sum(axis=1).mean())), _TINY)
    arms = arms / size
    frames = _frames(_half_sphere(_DIRECTIONS))
    costs, centres = _costs(frames, arms, weights, degree)
    best = int(np.argmin(costs))
    least, frame, centre = float(costs[best]), frames[best], centres[best]
    for zoom in range(_ZOOMS):
        frames = _frames(_ring_about(frame, _NEAR / 3**zoom))
        costs, centres = _costs(frames, arms, weights, degree)
        best = int(np.argmin(costs))
        if costs[best] < least:
            least, frame, centre = float(costs[best]), frames[best], centres[best]
    origin = middle + size * (centre @ frame[:2])
    upward = float(frame[2][np.argmax(np.abs(frame[2]))]) > 0.0
    return Frame(origin, frame if upward else frame * np.array([[1.0], [-1.0], [-1.0]]))


def cylinder_near(frame: Frame, places_mm: FloatArray, weights: FloatArray) -> Cylinder:
    """A cylinder about an axis through places (m, 3)."""
    _, radii = _heights_and_radii(frame, places_mm)
    return Cylinder(frame, max(float(np.average(radii, weights=weights)), _TINY))


def cone_near(frame: Frame, places_mm: FloatArray, weights: FloatArray) -> Cone:
    """A cone about an axis through places (m, 3), opening along it or, turned round, against it."""
    heights, radii = _heights_and_radii(frame, places_mm)
    middle, level = np.average(heights, weights=weights), np.average(radii, weights=weights)
    rise = weights @ ((heights - middle) * (radii - level))
    slope = float(rise / max(float(weights @ (heights - middle) ** 2), _TINY))
    radius = max(float(level - slope * middle), 0.1 * float(level))
    axes = frame.axes if slope >= 0.0 else frame.axes * np.array([[1.0], [-1.0], [-1.0]])
    angle = min(max(abs(math.atan(slope)), 1e-3), 0.5 * math.pi - 1e-3)
    return Cone(Frame(frame.origin_mm, axes), radius, angle)


def _centred(places: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    middle = np.average(places, axis=0, weights=weights)
    return middle, places - middle


def _heights_and_radii(frame: Frame, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    local = frame.to_plane(places)
    return local[:, 2], np.hypot(local[:, 0], local[:, 1])


def _half_sphere(count: int) -> FloatArray:
    """Directions (count, 3) evenly over the upper half sphere, on a spiral."""
    z = (np.arange(count) + 0.5) / count
    turn = np.arange(count) * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), z])


def _ring_about(frame: FloatArray, angle: float) -> FloatArray:
    """Directions at an angle from the third row of a frame, and at half of it."""
    turn = math.tau * np.arange(_RING) / _RING
    tilt = angle * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(frame[2] + np.concatenate([tilt, 0.5 * tilt]) @ frame[:2])


def _frames(directions: FloatArray) -> FloatArray:
    """Right-handed frames (d, 3, 3) whose third rows are directions (d, 3)."""
    axes = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    least = np.eye(3)[np.argmin(np.abs(axes), axis=1)]
    x = np.cross(least, axes)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(axes, x), axes], axis=1)


def _costs(
    frames: FloatArray, arms: FloatArray, weights: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Mean squared distance (d,) of places about each axis, and where the axis passes, (d, 2)."""
    x, y, heights = np.moveaxis(np.einsum("dij,mj->dim", frames, arms), 1, 0)
    heights = heights / np.maximum(np.abs(heights).max(axis=1, keepdims=True), _TINY)
    powers = np.polynomial.chebyshev.chebvander(heights, degree)
    rows = np.concatenate([x[:, :, None], y[:, :, None], powers], axis=2)  # (d, m, 3 + degree)
    squares = x * x + y * y
    held = rows * weights[:, None]
    matrix = rows.swapaxes(1, 2) @ held
    right = (squares[:, None, :] @ held)[:, 0, :]
    size = np.sqrt(np.einsum("dii->di", matrix))
    matrix /= size[:, :, None] * size[:, None, :]
    matrix += 1e-10 * np.eye(matrix.shape[1])
    found = np.linalg.solve(matrix, (right / size)[:, :, None])[:, :, 0] / size
    misses = squares - (rows @ found[:, :, None])[:, :, 0]
    centres = 0.5 * found[:, :2]
    apart = (x - centres[:, :1]) ** 2 + (y - centres[:, 1:]) ** 2
    # A miss of the squared radius is twice the radius times the distance.
    return (weights * misses**2 / (4.0 * apart + 1e-12)).sum(axis=1) / weights.sum(), centres
