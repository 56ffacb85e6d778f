"""A surface of revolution as a form: a profile in the half plane, turned about an axis.

The profile runs with the height, so that its left normal points away from the axis::

    radius
      |      __.--.
      |  _.-'  |   '-.
      |-'      o place
      +------------------ height along the axis
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, frozen
from reconstruction.fitting.bending import control_normals
from reconstruction.fitting.moments import cells_of_points
from reconstruction.fitting.smoothing import feet
from reconstruction.fitting.spline import evaluate, spans_of
from reconstruction.skinning.primitives import AXIS, Reading, leaned, polar, turned
from reconstruction.slices import Frame

_VERTICES_A_SPAN = 8
_TINY = 1e-300
_BLUNT = 1e-6  # of the largest radius: nearer to the axis nobody asks for the curvature


@dataclass(frozen=True, slots=True, eq=False)
class Revolution:
    """A profile turned about its frame's third axis."""

    frame: Frame
    control_mm: FloatArray  # (n, 2): height and radius, of a uniform cubic (`fitting.spline`)
    closed: bool  # the profile is a loop, as a torus has it

    def __post_init__(self) -> None:
        object.__setattr__(self, "control_mm", frozen(self.control_mm))

    @property
    def kind(self) -> str:
        """What it is called."""
        return "revolution"

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the axis, and the move of every control point along its normal."""
        return (*AXIS, *(f"profile_{j}_mm" for j in range(len(self.control_mm))))

    def measure(self, places_mm: FloatArray) -> Reading:
        """Distances and slopes at places (m, 3)."""
        t = self.parameters(places_mm)
        reading = self.measure_at(places_mm, t)
        profile = self.profile_slopes(t).toarray()
        return replace(reading, slopes=np.hstack([reading.slopes, profile]))

    def parameters(self, places_mm: FloatArray) -> FloatArray:
        """Where on the profile the foot points of places (m, 3) lie, (m,)."""
        half = np.column_stack(polar(self.frame, places_mm)[:2])
        return nearest(self.control_mm, half, closed=self.closed)

    def measure_at(self, places_mm: FloatArray, t: FloatArray) -> Reading:
        """Distances where the foot points (m,) are known, and the slopes of the axis alone."""
        heights, radii, outward, around = polar(self.frame, places_mm)
        points, first, second = evaluate(self.control_mm, t)
        speed = np.maximum(np.sqrt((first * first).sum(axis=1)), _TINY)
        rise, push = -first[:, 1] / speed, first[:, 0] / speed  # of the normal
        distances = (heights - points[:, 0]) * rise + (radii - points[:, 1]) * push
        least = _BLUNT * float(self.control_mm[:, 1].max())
        bend = (first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1]) / speed**3
        bends = np.column_stack([push / np.maximum(points[:, 1], least), bend])
        normals = push[:, None] * outward + rise[:, None] * self.frame.axes[2]
        beside = outward @ self.frame.axes[:2].T
        lever = (heights * push - radii * rise)[:, None] * beside
        slopes = np.hstack([push[:, None] * beside, lever])
        return Reading(distances, normals, around, bends, slopes)

    def profile_slopes(self, t: FloatArray) -> csr_array:
        """Outward move at parameters (m,) for the move of each control point, (m, n)."""
        count, spans = len(self.control_mm), spans_of(self.control_mm, closed=self.closed)
        span = np.clip(t.astype(np.int64), 0, spans - 1)
        f = t - span
        g = 1.0 - f
        basis = np.stack(
            [g**3, 3 * f**3 - 6 * f * f + 4, 3 * g**3 - 6 * g * g + 4, f**3], axis=1
        ) / 6.0  # fmt: skip
        at = (span[:, None] + np.arange(4)) % count
        turned_normals = control_normals(self.control_mm, closed=self.closed)[at]
        first = evaluate(self.control_mm, t)[1]
        speed = np.maximum(np.sqrt((first * first).sum(axis=1)), _TINY)
        normals = np.column_stack([-first[:, 1], first[:, 0]]) / speed[:, None]
        values = basis * np.einsum("mkd,md->mk", turned_normals, normals)
        starts = np.arange(0, 4 * len(t) + 1, 4)
        return csr_array((values.ravel(), at.ravel(), starts), shape=(len(t), count))

    def moved(self, step: FloatArray) -> Revolution:
        """Return the form after a small move (p,)."""
        normals = control_normals(self.control_mm, closed=self.closed)
        control = self.control_mm + step[4:, None] * normals
        return replace(self, frame=leaned(self.frame, step[:2], step[2:4]), control_mm=control)

    def chart(self, places_mm: FloatArray) -> FloatArray:
        """Angle about the axis from x, in rad, and the profile's parameter, (m, 2)."""
        return np.column_stack([turned(self.frame, places_mm)[:, 0], self.parameters(places_mm)])


def nearest(control_mm: FloatArray, half_mm: FloatArray, *, closed: bool) -> FloatArray:
    """Parameters (m,) of the profile nearest to places (m, 2) of the half plane."""
    spans = spans_of(control_mm, closed=closed)
    t = np.linspace(0.0, spans, _VERTICES_A_SPAN * spans, endpoint=not closed)
    near = cKDTree(evaluate(control_mm, t)[0]).query(half_mm)[1]
    return refined(control_mm, half_mm, t[near], closed=closed)


def refined(
    control_mm: FloatArray, half_mm: FloatArray, t: FloatArray, *, closed: bool
) -> FloatArray:
    """The same from rough parameters (m,)."""
    return feet(control_mm, cells_of_points(half_mm), t, closed=closed)[0]
