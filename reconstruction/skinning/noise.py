"""The scatter of a scan's points: of one size in the cutting planes, of another across them.

A profiler errs in the plane of its light; the height of a slice is known from the axes. So on a
wall that leans, less of the error points across the wall, and a level surface is hit exactly
however noisy the points are within their plane. Both sizes are told by the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray, frozen

_LEAST_FREEDOM = 0.1  # of the points, that degrees of freedom leave over
_LEAST_RISE = 3e-3  # of the variance in the plane: nothing is exact
_SCORINGS = 8
_WEAK = 20.0  # points' worth of belief that both are alike


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Variances of a point's error."""

    level_mm2: float  # in any direction of the cutting plane
    rise_mm2: float  # along the stacking axis
    axis: FloatArray  # (3,), unit
    inflation: float = 1.0  # how much less independent the points are than they look

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", frozen(self.axis))

    @property
    def covariance_mm2(self) -> FloatArray:
        """Of a point's error, (3, 3)."""
        rise = np.outer(self.axis, self.axis)
        return np.asarray(self.level_mm2 * (np.eye(3) - rise) + self.rise_mm2 * rise)

    def across(self, normals: FloatArray) -> FloatArray:
        """Variance along normals (m, 3), (m,)."""
        steep = (normals @ self.axis) ** 2
        return np.asarray(self.level_mm2 * (1.0 - steep) + self.rise_mm2 * steep)

    def looked_at_again(
        self, normals: FloatArray, squares_mm2: FloatArray, held: FloatArray, edf: float
    ) -> Noise:
        """Both variances by likelihood from squared residuals (m,) of cells of `held` points.

        The squares of a fit with `edf` degrees of freedom are too small by that share.
        """
        points = float(held.sum())
        freedom = max(points - edf, _LEAST_FREEDOM * points, 1.0)
        squares = squares_mm2 * (points / freedom)
        steep = (normals @ self.axis) ** 2
        parts = np.stack([1.0 - steep, steep], axis=1)
        sizes = np.array([self.level_mm2, self.rise_mm2])
        for _ in range(_SCORINGS):
            model = np.maximum(parts @ sizes, 1e-300)
            weights = held / model**2
            normal = parts.T @ (weights[:, None] * parts)
            right = parts.T @ (weights * squares)
            mean = float((held * squares).sum()) / max(float(held.sum()), 1e-300)
            alike = _WEAK / mean**2
            normal[[0, 1], [0, 1]] += alike
            normal[[0, 1], [1, 0]] -= alike
            sizes = np.linalg.solve(normal, right)
            sizes[0] = max(sizes[0], 1e-3 * mean, 1e-300)
            # The axes know a height at least as well as the sensor knows a place in its light.
            if sizes[1] > sizes[0]:
                sizes[:] = mean
            sizes[1] = max(sizes[1], _LEAST_RISE * sizes[0])
        return replace(self, level_mm2=float(sizes[0]), rise_mm2=float(sizes[1]))
