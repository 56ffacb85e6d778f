"""An exact surface that explains the cells of a branch, with what is known of its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.nurbs import Surface
from reconstruction.skinning.exact_surfaces import surface_of
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.primitives import Cone, Cylinder, Form, Plane, Sphere
from reconstruction.skinning.revolution import Revolution


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A figure of a shape, with its uncertainty."""

    name: str
    unit: str  # "mm", "rad", or "1" for a direction
    values: FloatArray  # (k,)
    covariance: FloatArray  # (k, k), in the part's frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "covariance", frozen(self.covariance))

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations, (k,)."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A recognised plane, cylinder, cone, sphere or surface of revolution."""

    form: Form
    covariance: FloatArray  # (p, p), of the form's freedoms `form.names`, in the form's frame
    freedom: float  # how many degrees of freedom the cells fill
    moments: Moments
    distances_mm: FloatArray  # (m,), mean distance of each cell's points, outward
    scatters_mm2: FloatArray  # (m,), their variance across

    def __post_init__(self) -> None:
        for name in ("covariance", "distances_mm", "scatters_mm2"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def kind(self) -> str:
        """One of "plane", "cylinder", "cone", "sphere", "revolution"."""
        return self.form.kind

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations of the form's freedoms, (p,)."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What a drawing would say: axis, radius, half angle, apex, centre, normal."""
        return quantities_of(self.form, self.covariance)

    def deviation_mm(self, points_mm: FloatArray) -> FloatArray:
        """Standard deviation of the surface across itself near points (m, 3), (m,)."""
        slopes = self.form.measure(np.asarray(points_mm, dtype=np.float64)).slopes
        variances = np.einsum("mi,ij,mj->m", slopes, self.covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    def surface(
        self,
        low_mm: float,
        high_mm: float,
        start_direction: FloatArray,
        *,
        along: FloatArray | None = None,
        turn_rad: float | None = None,
    ) -> Surface:
        """The exact rational surface between two heights; see `exact_surfaces.surface_of`."""
        return surface_of(
            self.form, (low_mm, high_mm), np.asarray(start_direction, dtype=np.float64),
            along=along, turn_rad=turn_rad, places_mm=self.moments.means_mm,
        )  # fmt: skip


def quantities_of(form: Form, covariance: FloatArray) -> tuple[Quantity, ...]:
    """Figures of a form whose freedoms have the covariance (p, p)."""
    if isinstance(form, Sphere):
        return (
            Quantity("centre", "mm", form.centre_mm, covariance[:3, :3]),
            _scalar("radius", "mm", form.radius_mm, covariance[3, 3]),
        )
    if isinstance(form, Plane):
        x, y, normal = form.frame.axes
        lean = np.stack([x, y]).T
        shift = covariance[2, 2] * np.outer(normal, normal)
        return (
            Quantity("point", "mm", form.frame.origin_mm, shift),
            Quantity("normal", "1", normal, lean @ covariance[:2, :2] @ lean.T),
        )
    assert isinstance(form, Cylinder | Cone | Revolution)
    beside = form.frame.axes[:2].T
    axis = (
        Quantity("axis point", "mm", form.frame.origin_mm, beside @ covariance[:2, :2] @ beside.T),
        Quantity(
            "axis direction", "1", form.frame.axes[2], beside @ covariance[2:4, 2:4] @ beside.T
        ),
    )
    if isinstance(form, Cylinder):
        return (*axis, _scalar("radius", "mm", form.radius_mm, covariance[4, 4]))
    if isinstance(form, Cone):
        slopes = _apex_slopes(form)
        return (
            *axis,
            _scalar("half angle", "rad", form.half_angle_rad, covariance[5, 5]),
            Quantity("apex", "mm", form.apex_mm, slopes @ covariance @ slopes.T),
        )
    return axis


def _scalar(name: str, unit: str, value: float, variance: float) -> Quantity:
    return Quantity(name, unit, np.array([value]), np.array([[variance]]))


def _apex_slopes(cone: Cone) -> FloatArray:
    """How the apex moves with the cone's freedoms, (3, 6)."""
    x, y, axis = cone.frame.axes
    height, tangent = cone.apex_height_mm, math.tan(cone.half_angle_rad)
    widening = cone.radius_mm / math.sin(cone.half_angle_rad) ** 2
    return np.stack([x, y, height * x, height * y, -axis / tangent, widening * axis], axis=1)
