r"""Plane, cylinder, cone and sphere: how far places lie from them, and how that depends on them.

Each form counts distances outward, along its normal, and is moved by as many small numbers as it
has degrees of freedom, taken in its own frame: ::

          axis                            offset x, y   the origin moves along x or y of the frame
           |  tilt x                      tilt x, y     the axis leans towards x or y, in rad
           | /
           o--- x   <- origin
    |<-radius->|

Where it bends, a surface is described by two curvatures, positive where it bends away from its
normal: one around its axis, one along a meridian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.slices import Frame

_TINY = 1e-300
_BLUNT = 1e-6  # of the radius: nearer to the apex nobody asks for the curvature
AXIS = ("offset_x_mm", "offset_y_mm", "tilt_x_rad", "tilt_y_rad")


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Where places stand against a form."""

    distances_mm: FloatArray  # (m,), outward
    normals: FloatArray  # (m, 3), unit, outward
    around: FloatArray  # (m, 3), unit tangents around the axis
    curvatures: FloatArray  # (m, 2), around and along
    slopes: FloatArray  # (m, p): outward move of the form for each of its freedoms


class Form(Protocol):
    """A surface of few degrees of freedom."""

    @property
    def kind(self) -> str:
        """What it is called."""

    @property
    def names(self) -> tuple[str, ...]:
        """Its p degrees of freedom, with their units."""

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3)."""

    def moved(self, step: FloatArray) -> Form:
        """Return the form after a small move (p,)."""

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Where on the form the feet of places (m, 3) lie, (m, 2): around in rad or mm, along."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane through its frame's origin, the frame's normal outward."""

    frame: Frame

    @property
    def kind(self) -> str:
        """What it is called."""
        return "plane"

    @property
    def names(self) -> tuple[str, ...]:
        """Tilt of the normal towards x and y, and the shift along it."""
        return ("tilt_x_rad", "tilt_y_rad", "offset_mm")

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3)."""
        local = self.frame.to_plane(places_mm)
        count = len(local)
        slopes = np.column_stack([-local[:, 0], -local[:, 1], np.ones(count)])
        x, _, normal = self.frame.axes
        return Reading(
            local[:, 2], np.tile(normal, (count, 1)), np.tile(x, (count, 1)),
            np.zeros((count, 2)), slopes,
        )  # fmt: skip

    def moved(self, step: FloatArray) -> Plane:
        """Return the form after a small move (p,)."""
        leaning = leaned(self.frame, np.zeros(2), step[:2])
        origin = self.frame.origin_mm + step[2] * leaning.axes[2]
        return Plane(Frame(origin, leaning.axes))

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Coordinates in the plane, (m, 2) in mm."""
        return self.frame.to_plane(places_mm)[:, :2]


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """A circular cylinder about its frame's third axis."""

    frame: Frame
    radius_mm: float

    @property
    def kind(self) -> str:
        """What it is called."""
        return "cylinder"

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the axis, and the radius."""
        return (*AXIS, "radius_mm")

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3)."""
        height, radial, outward, around = polar(self.frame, places_mm)
        push = outward @ self.frame.axes[:2].T
        slopes = np.column_stack([push, height[:, None] * push, np.ones(len(push))])
        bends = np.column_stack([np.full(len(push), 1.0 / self.radius_mm), np.zeros(len(push))])
        return Reading(radial - self.radius_mm, outward, around, bends, slopes)

    def moved(self, step: FloatArray) -> Cylinder:
        """Return the form after a small move (p,)."""
        radius = max(self.radius_mm + float(step[4]), 0.1 * self.radius_mm)
        return Cylinder(leaned(self.frame, step[:2], step[2:4]), radius)

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Angle about the axis from x, in rad, and height along it, (m, 2)."""
        return turned(self.frame, places_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """A circular cone that opens along its frame's third axis."""

    frame: Frame
    radius_mm: float  # at the origin's height
    half_angle_rad: float  # positive

    @property
    def kind(self) -> str:
        """What it is called."""
        return "cone"

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the axis, the radius at the origin, and the half angle."""
        return (*AXIS, "radius_mm", "half_angle_rad")

    @property
    def apex_height_mm(self) -> float:
        """Of the apex along the axis, from the origin; negative."""
        return -self.radius_mm / math.tan(self.half_angle_rad)

    @property
    def apex_mm(self) -> FloatArray:
        """The apex, (3,)."""
        return np.asarray(self.frame.origin_mm + self.apex_height_mm * self.frame.axes[2])

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3); beyond the apex that nappe goes on."""
        height, radial, outward, around = polar(self.frame, places_mm)
        c, s = math.cos(self.half_angle_rad), math.sin(self.half_angle_rad)
        beyond = radial - self.radius_mm
        distances = beyond * c - height * s
        push = outward @ self.frame.axes[:2].T
        lever = (height * c + radial * s)[:, None] * push
        slopes = np.column_stack([c * push, lever, np.full(len(push), c), beyond * s + height * c])
        feet = np.maximum(radial - distances * c, _BLUNT * self.radius_mm)
        bends = np.column_stack([c / feet, np.zeros(len(push))])
        return Reading(distances, c * outward - s * self.frame.axes[2], around, bends, slopes)

    def moved(self, step: FloatArray) -> Cone:
        """Return the form after a small move (p,)."""
        frame = leaned(self.frame, step[:2], step[2:4])
        radius = max(self.radius_mm + float(step[4]), 0.1 * self.radius_mm)
        angle = self.half_angle_rad + float(step[5])
        if angle < 0.0:
            frame = Frame(frame.origin_mm, frame.axes * np.array([[1.0], [-1.0], [-1.0]]))
        return Cone(frame, radius, min(max(abs(angle), 1e-9), 0.5 * math.pi - 1e-6))

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Angle about the axis from x, in rad, and way along the ruling from the origin's height.

        That of the foot point: one that noise across the cone does not move.
        """
        local = self.frame.to_plane(places_mm)
        beyond = np.hypot(local[:, 0], local[:, 1]) - self.radius_mm
        c, s = math.cos(self.half_angle_rad), math.sin(self.half_angle_rad)
        angles = np.arctan2(local[:, 1], local[:, 0])
        return np.column_stack([angles, local[:, 2] * c + beyond * s])


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A sphere."""

    centre_mm: FloatArray  # (3,)
    radius_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_mm", frozen(self.centre_mm))

    @property
    def kind(self) -> str:
        """What it is called."""
        return "sphere"

    @property
    def names(self) -> tuple[str, ...]:
        """The centre in the part's frame, and the radius."""
        return ("centre_x_mm", "centre_y_mm", "centre_z_mm", "radius_mm")

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3)."""
        arms = places_mm - self.centre_mm
        lengths = np.maximum(np.sqrt((arms * arms).sum(axis=1)), _TINY)
        normals = arms / lengths[:, None]
        bends = np.full((len(arms), 2), 1.0 / self.radius_mm)
        slopes = np.column_stack([normals, np.ones(len(arms))])
        # Both curvatures are one: no direction stands out.
        return Reading(lengths - self.radius_mm, normals, np.zeros_like(arms), bends, slopes)

    def moved(self, step: FloatArray) -> Sphere:
        """Return the form after a small move (p,)."""
        radius = max(self.radius_mm + float(step[3]), 0.1 * self.radius_mm)
        return replace(self, centre_mm=self.centre_mm + step[:3], radius_mm=radius)

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Longitude in rad and sine of the latitude times the radius, in the part's frame."""
        normals = self.measure(places_mm).normals
        angles = np.arctan2(normals[:, 1], normals[:, 0])
        return np.column_stack([angles, self.radius_mm * normals[:, 2]])


def polar(
    frame: Frame, places_mm: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Heights (m,), radii (m,), unit vectors away from the axis and around it, (m, 3) each."""
    axis = frame.axes[2]
    arms = places_mm - frame.origin_mm
    heights = arms @ axis
    arms -= heights[:, None] * axis
    radii = np.maximum(np.sqrt((arms * arms).sum(axis=1)), _TINY)
    outward = arms / radii[:, None]
    a, b, c = axis
    x, y, z = outward.T
    around = np.column_stack([b * z - c * y, c * x - a * z, a * y - b * x])
    return heights, radii, outward, around


def turned(frame: Frame, places_mm: FloatArray) -> FloatArray:
    """Angle about the third axis from the first, in rad, and height along it, (m, 2)."""
    local = frame.to_plane(places_mm)
    return np.column_stack([np.arctan2(local[:, 1], local[:, 0]), local[:, 2]])


def leaned(frame: Frame, offset_mm: FloatArray, tilt_rad: FloatArray) -> Frame:
    """Return a frame moved along its x and y, its third axis leaning towards them."""
    axis = frame.axes[2] + tilt_rad @ frame.axes[:2]
    return Frame(frame.origin_mm + offset_mm @ frame.axes[:2], axes_about(axis, frame.axes[0]))


def axes_about(axis: FloatArray, x: FloatArray) -> FloatArray:
    """Right-handed rows x, y, axis, (3, 3); x as near to the given one as may be.

    Not finite where the axis has run away: whoever fits it finds out.
    """
    if not (np.isfinite(axis).all() and np.isfinite(x).all()):
        return np.full((3, 3), np.nan)
    axis = axis / math.sqrt(float(axis @ axis))
    across = x - (x @ axis) * axis
    if not float(across @ across) > 1e-12 * float(x @ x):
        return axes_about(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across = across / math.sqrt(float(across @ across))
    return np.stack([across, np.cross(axis, across), axis])
