"""Signed distances of points to the faces of artefacts, and how they change with everything.

Each function gives the distance (n,), the unit normal at each point (n, 3), which is the distance's
gradient, and its derivatives by the shape's own parameters (n, k). Pure; lengths are mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from acquisition.arrays import FloatArray

Distances = tuple[FloatArray, FloatArray, FloatArray]
_TINY = 1e-12


class Form(Enum):
    """What a face is."""

    SPHERE = "sphere"  # own: x, y, z, radius
    PLANE = "plane"  # own: two tilts, distance from the origin
    CYLINDER = "cylinder"  # own: two shifts, two tilts of the axis, radius
    FRUSTUM = "frustum"  # own: a turn (3) and a shift (3)


_OWN = {Form.SPHERE: 4, Form.PLANE: 3, Form.CYLINDER: 5, Form.FRUSTUM: 6}


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A form and what its parameters count from.

    ``frame`` (3, 3) has rows e1, e2, w: a plane's normal is w + a e1 + b e2, made a unit vector,
    and so is a cylinder's axis, through ``base_mm`` + u e1 + v e2. A frustum's ``frame`` turns its
    own coordinates into the part's; ``faces`` (m, 4) are its outward normals and distances, and
    `face` says on which of them each point lies.
    """

    form: Form
    frame: FloatArray
    base_mm: FloatArray
    faces: FloatArray | None = None

    @property
    def size(self) -> int:
        """How many parameters of its own."""
        return _OWN[self.form]


def distances(shape: Shape, own: FloatArray, points_mm: FloatArray) -> Distances:
    """Distances of points (n, 3) to a shape with the parameters `own`."""
    if shape.form is Form.SPHERE:
        return _to_sphere(own, points_mm)
    if shape.form is Form.PLANE:
        return _to_plane(shape, own, points_mm)
    if shape.form is Form.CYLINDER:
        return _to_cylinder(shape, own, points_mm)
    return _to_frustum(shape, own, points_mm)


def _to_sphere(own: FloatArray, points_mm: FloatArray) -> Distances:
    ray = points_mm - own[:3]
    length = np.maximum(np.linalg.norm(ray, axis=1), _TINY)
    normal = ray / length[:, None]
    return length - own[3], normal, np.column_stack([-normal, np.full(len(ray), -1.0)])


def _to_plane(shape: Shape, own: FloatArray, points_mm: FloatArray) -> Distances:
    normal, tilts = tilted(shape.frame, own[:2])
    by_tilt = points_mm @ tilts.T
    flat = np.broadcast_to(normal, points_mm.shape)
    by_own = np.column_stack([by_tilt, np.full(len(points_mm), -1.0)])
    return points_mm @ normal - own[2], np.asarray(flat), by_own


def _to_cylinder(shape: Shape, own: FloatArray, points_mm: FloatArray) -> Distances:
    axis, tilts = tilted(shape.frame, own[2:4])
    through_mm = shape.base_mm + own[:2] @ shape.frame[:2]
    ray = points_mm - through_mm
    along = ray @ axis
    away = ray - along[:, None] * axis
    length = np.maximum(np.linalg.norm(away, axis=1), _TINY)
    normal = away / length[:, None]
    by_shift = -normal @ shape.frame[:2].T
    by_tilt = -along[:, None] * (normal @ tilts.T)
    by_own = np.column_stack([by_shift, by_tilt, np.full(len(ray), -1.0)])
    return length - own[4], normal, by_own


def _to_frustum(shape: Shape, own: FloatArray, points_mm: FloatArray) -> Distances:
    """Each point belongs to the face that it lies farthest outside of: a frustum is convex."""
    if shape.faces is None:
        raise ValueError("frustum: no faces")
    turned = rotation(own[:3]) @ shape.frame
    ray = points_mm - own[3:] - shape.base_mm
    normals = shape.faces[:, :3] @ turned.T
    outside = ray @ normals.T - shape.faces[:, 3]
    face = outside.argmax(axis=1)
    normal = normals[face]
    by_turn = np.cross(normal, ray) @ left_jacobian(own[:3])
    by_own = np.column_stack([by_turn, -normal])
    return outside[np.arange(len(ray)), face], normal, by_own


def tilted(frame: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vector w + a e1 + b e2 (3,), and its derivatives by a and b (2, 3)."""
    leaning = frame[2] + tilt @ frame[:2]
    length = float(np.linalg.norm(leaning))
    unit = leaning / length
    return unit, (frame[:2] - np.outer(frame[:2] @ unit, unit)) / length


def rotation(turn_rad: FloatArray) -> FloatArray:
    """Rotation by a vector (3,), by Rodrigues."""
    angle, cross = float(np.linalg.norm(turn_rad)), _cross(turn_rad)
    if angle < _TINY:
        return np.asarray(np.eye(3) + cross)
    square = (1.0 - np.cos(angle)) / angle**2
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + square * (cross @ cross))


def left_jacobian(turn_rad: FloatArray) -> FloatArray:
    """By which a small change of `turn_rad` turns what `rotation` gave, (3, 3)."""
    angle, cross = float(np.linalg.norm(turn_rad)), _cross(turn_rad)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + cross / 2.0)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def frame_around(direction: FloatArray) -> FloatArray:
    """A right-handed frame (3, 3) whose last row is the direction."""
    w = direction / np.linalg.norm(direction)
    aside = np.eye(3)[int(np.abs(w).argmin())]
    e1 = np.cross(aside, w)
    e1 /= np.linalg.norm(e1)
    return np.stack([e1, np.cross(w, e1), w])


def _cross(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
