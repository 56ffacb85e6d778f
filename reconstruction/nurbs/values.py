"""A NURBS curve and a NURBS surface as plain values.

The homogeneous form is never stored: control points are Euclidean, weights stand beside them.

A **clamped or unclamped open** direction of degree p with n control points has n + p + 1 knots and
the domain ``[knots[p], knots[n]]``.

A **periodic** direction stores each of its n control points once and n + 2p + 1 knots, which repeat
with the period T = knots[n + p] - knots[p]::

    knots[i + n] == knots[i] + T
    domain       == [knots[p], knots[n + p]]

so that appending the first p control points at the end (`wrapped`) gives an ordinary B-spline on
the same knots. Everything here that takes "full" control points means that wrapped form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import FloatArray, frozen
from reconstruction.nurbs.basis import domain_of
from reconstruction.nurbs.evaluation import evaluate_curve
from reconstruction.nurbs.surface_evaluation import evaluate_surface


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A rational B-spline curve in 2 or 3 dimensions (the paper's eqs. 1-3 in one parameter)."""

    degree: int
    knots: FloatArray  # (n + p + 1,) open, (n + 2p + 1,) periodic
    control_points_mm: FloatArray  # (n, d)
    weights: FloatArray  # (n,), positive
    periodic: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", frozen(self.knots))
        object.__setattr__(self, "control_points_mm", frozen(self.control_points_mm))
        object.__setattr__(self, "weights", frozen(self.weights))
        count = len(self.control_points_mm)
        _check_direction("curve", self.degree, self.knots, count, periodic=self.periodic)
        if self.weights.shape != (count,) or not np.all(self.weights > 0):
            raise ValueError(f"curve: {count} control points need {count} positive weights")

    @property
    def domain(self) -> tuple[float, float]:
        """The parameter interval on which the curve is defined."""
        return domain_of(self.degree, self.knots)

    def __call__(self, u: ArrayLike) -> FloatArray:
        """Points (m, d) in mm at parameters (m,), or one point (d,) at a scalar parameter."""
        points = evaluate_curve(self, u)
        return points[0] if np.ndim(u) == 0 else points

    @property
    def closed(self) -> bool:
        """Whether the curve runs back into its start with full smoothness."""
        return self.periodic


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A rational tensor-product B-spline surface (the paper's eq. 1).

    u runs around a section, v from section to section.
    """

    degree_u: int
    degree_v: int
    knots_u: FloatArray
    knots_v: FloatArray
    control_points_mm: FloatArray  # (nu, nv, 3)
    weights: FloatArray  # (nu, nv), positive
    periodic_u: bool
    periodic_v: bool

    def __post_init__(self) -> None:
        for name in ("knots_u", "knots_v", "control_points_mm", "weights"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        count_u, count_v = self.control_points_mm.shape[:2]
        _check_direction(
            "surface u", self.degree_u, self.knots_u, count_u, periodic=self.periodic_u
        )
        _check_direction(
            "surface v", self.degree_v, self.knots_v, count_v, periodic=self.periodic_v
        )
        if self.weights.shape != (count_u, count_v) or not np.all(self.weights > 0):
            raise ValueError(
                f"surface: weights must be positive and of shape ({count_u}, {count_v})"
            )

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The parameter intervals ((u0, u1), (v0, v1))."""
        return domain_of(self.degree_u, self.knots_u), domain_of(self.degree_v, self.knots_v)

    def __call__(self, u: ArrayLike, v: ArrayLike) -> FloatArray:
        """Points (mu, mv, 3) in mm of the grid u (mu,) x v (mv,)."""
        return evaluate_surface(self, u, v)


def _check_direction(
    name: str, degree: int, knots: FloatArray, count: int, *, periodic: bool
) -> None:
    expected = count + (2 * degree if periodic else degree) + 1
    if degree < 1 or count < degree + (0 if periodic else 1):
        raise ValueError(f"{name}: {count} control points are too few for degree {degree}")
    if knots.shape != (expected,):
        raise ValueError(f"{name}: {expected} knots expected, got {knots.shape}")
    if not np.all(np.diff(knots) >= 0):
        raise ValueError(f"{name}: knots must not decrease")
    start, end = domain_of(degree, knots)
    if not start < end:
        raise ValueError(f"{name}: the domain [{start:g}, {end:g}] has no length")
    if periodic and not np.allclose(knots[count:] - knots[:-count], end - start, rtol=1e-9, atol=0):
        raise ValueError(f"{name}: periodic knots must repeat after {count} with {end - start:g}")
