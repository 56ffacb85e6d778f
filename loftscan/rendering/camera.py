"""Where a picture is taken from.

The depth that the z-buffer holds is the *nearness* of a point, in mm, larger towards the eye::

    eye o -------------------- D -------------------- centre of the box
                    <------ t ------|                 t: how far before the centre, in mm

    nearness  n = t / (1 - t / D)        orthographic (D = infinity):  n = t
    enlargement   1 + n / D              of what lies t before the centre

n is an affine function of the screen coordinates on every plane, in both projections, so it may be
interpolated straight across a triangle, and planes stay planes for the ambient occlusion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, frozen

Axis = Literal["x", "y", "z"]
_AXES: tuple[Axis, ...] = ("x", "y", "z")
_EYE_DISTANCE_RADII = 6.0  # of a portrait lens: depth is felt, nothing is distorted


class Lens(Enum):
    """How depth changes size."""

    ORTHOGRAPHIC = "orthographic"
    PORTRAIT = "portrait"  # a mild perspective


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera settled on a picture of one size: from part coordinates to pixels."""

    rotation: FloatArray  # (3, 3), rows right, up, towards the eye
    centre_mm: FloatArray  # (3,)
    inverse_distance: float  # 1/D in 1/mm, 0 for orthographic
    scale_px_mm: float
    shift_px: tuple[float, float]

    def project(self, points_mm: FloatArray) -> FloatArray:
        """Part coordinates (n, 3) to x (right), y (down) in pixels and nearness in mm, (n, 3).

        What lies behind the eye comes out as NaN.
        """
        projected = _projected(
            points_mm, self.rotation, self.centre_mm, self.inverse_distance,
            self.scale_px_mm, self.shift_px,
        )  # fmt: skip
        return np.asarray(projected)


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Looks at the middle of a box; the whole box is in the picture at `zoom` 1.

    The azimuth turns counter-clockwise about the `up` axis, from the next axis in the cycle
    x, y, z: with `up="z"`, azimuth 0 looks from +x, a quarter turn from +y.
    """

    bounds_mm: FloatArray  # (2, 3), lowest and highest corner
    azimuth_rad: float = math.radians(-60)
    elevation_rad: float = math.radians(22)
    up: Axis = "z"
    lens: Lens = Lens.PORTRAIT
    zoom: float = 1.0

    def __post_init__(self) -> None:
        bounds = frozen(self.bounds_mm)
        if bounds.shape != (2, 3) or not np.all(np.isfinite(bounds)):
            raise ValueError(f"camera: bounds must be finite and of shape (2, 3), got {bounds!r}")
        if self.up not in _AXES or not self.zoom > 0:
            raise ValueError(f"camera: up={self.up!r} must be x, y or z, zoom={self.zoom} positive")
        object.__setattr__(self, "bounds_mm", bounds)

    @property
    def radius_mm(self) -> float:
        """Half the diagonal of the box; 1 mm where the box is a single point."""
        return float(np.linalg.norm(np.diff(self.bounds_mm, axis=0))) / 2 or 1.0

    @property
    def up_index(self) -> int:
        """0, 1 or 2 for x, y, z."""
        return _AXES.index(self.up)

    def view(self, size_px: tuple[int, int]) -> View:
        """Settle on a picture of (width, height) pixels: centre the box and fit it in."""
        near = self.lens is Lens.PORTRAIT
        view = View(
            rotation=self._rotation(),
            centre_mm=self.bounds_mm.mean(axis=0),
            inverse_distance=1 / (_EYE_DISTANCE_RADII * self.radius_mm) if near else 0.0,
            scale_px_mm=1.0,
            shift_px=(0.0, 0.0),
        )
        return _fitted(view, self._corners_mm(), np.asarray(size_px, float), zoom=self.zoom)

    def _rotation(self) -> FloatArray:
        first, second, up = (np.eye(3)[(self.up_index + turn) % 3] for turn in (1, 2, 3))
        ahead = math.cos(self.azimuth_rad) * first + math.sin(self.azimuth_rad) * second
        right = math.cos(self.azimuth_rad) * second - math.sin(self.azimuth_rad) * first
        towards = math.cos(self.elevation_rad) * ahead + math.sin(self.elevation_rad) * up
        return np.stack([right, np.cross(towards, right), towards])

    def _corners_mm(self) -> FloatArray:
        choices = np.indices((2, 2, 2)).reshape(3, 8).T
        return np.asarray(self.bounds_mm[choices, np.arange(3)])


def camera_around(
    *points_mm: FloatArray,
    azimuth_rad: float = math.radians(-60),
    elevation_rad: float = math.radians(22),
    up: Axis = "z",
    lens: Lens = Lens.PORTRAIT,
    zoom: float = 1.0,
) -> Camera:
    """Return a camera on the box of all finite points of the arrays (n, 3); a unit box if none."""
    corners = [_box(points) for points in points_mm if np.isfinite(points).all(axis=1).any()]
    bounds = np.concatenate([*corners]) if corners else np.array([[-0.5] * 3, [0.5] * 3])
    bounds = np.stack([bounds.min(axis=0), bounds.max(axis=0)])
    return Camera(bounds, azimuth_rad, elevation_rad, up, lens, zoom)


@njit(cache=True)
def _projected(
    points_mm: FloatArray,
    rotation: FloatArray,
    centre_mm: FloatArray,
    inverse_distance: float,
    scale_px_mm: float,
    shift_px: tuple[float, float],
) -> FloatArray:
    screen = np.empty(points_mm.shape)
    for point in range(points_mm.shape[0]):
        x, y, z = (
            points_mm[point, 0] - centre_mm[0],
            points_mm[point, 1] - centre_mm[1],
            points_mm[point, 2] - centre_mm[2],
        )
        before = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
        remaining = 1.0 - before * inverse_distance
        enlargement = 1.0 / remaining if remaining > 0.0 else np.nan
        right = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
        up = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
        screen[point, 0] = right * enlargement * scale_px_mm + shift_px[0]
        screen[point, 1] = shift_px[1] - up * enlargement * scale_px_mm
        screen[point, 2] = before * enlargement
    return screen


def _box(points_mm: FloatArray) -> FloatArray:
    finite = points_mm[np.isfinite(points_mm).all(axis=1)]
    return np.stack([finite.min(axis=0), finite.max(axis=0)])


def _fitted(view: View, corners_mm: FloatArray, size_px: FloatArray, *, zoom: float) -> View:
    margin = 0.07
    seen = view.project(corners_mm)[:, :2]
    low, high = seen.min(axis=0), seen.max(axis=0)
    extent = np.maximum(high - low, 1e-3 * max((high - low).max(), 1e-9))
    scale = float(((1 - 2 * margin) * size_px / extent).min()) * zoom
    if not np.any(high > low):
        scale = float(size_px.min()) / 2  # a box without size: 1 mm is half the picture
    shift = size_px / 2 - scale * (low + high) / 2
    return View(
        view.rotation,
        view.centre_mm,
        view.inverse_distance,
        scale,
        (float(shift[0]), float(shift[1])),
    )
