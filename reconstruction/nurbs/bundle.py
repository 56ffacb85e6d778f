"""Many B-splines on one knot vector: the form in which knots are inserted, split and elevated.

A curve is a bundle of one homogeneous point per control point; a surface, seen along u or along v,
is a bundle whose rows are whole rows of its net. So the algebra (`knot_algebra`, `elevation`) is
written once, for arrays (n, k). A shape whose weights are all equal travels without its weights:
they cannot change, and no rounding may make it rational.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.nurbs.basis import domain_of
from reconstruction.nurbs.evaluation import homogeneous
from reconstruction.nurbs.values import Curve, Surface


class Along(Enum):
    """The parameter direction of a surface in which something is done."""

    U = "u"
    V = "v"


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """B-splines with common knots; periodic ones are stored as in `reconstruction.nurbs.values`."""

    degree: int
    knots: FloatArray  # (n + p + 1,) open, (n + 2p + 1,) periodic
    coefficients: FloatArray  # (n, k)
    periodic: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", frozen(self.knots))
        object.__setattr__(self, "coefficients", frozen(self.coefficients))

    @property
    def domain(self) -> tuple[float, float]:
        """The parameter interval on which the bundle is defined."""
        return domain_of(self.degree, self.knots)


Change = Callable[[Bundle], Bundle]


def changed_curve(curve: Curve, change: Change) -> Curve:
    """Apply a change of the knots to a curve."""
    coefficients = _lifted(curve.control_points_mm, curve.weights)
    bundle = change(Bundle(curve.degree, curve.knots, coefficients, curve.periodic))
    width = curve.control_points_mm.shape[1]
    points, weights = _dropped(bundle.coefficients, width, float(curve.weights[0]))
    return Curve(bundle.degree, bundle.knots, points, weights, bundle.periodic)


def changed_surface(surface: Surface, along: Along, change: Change) -> Surface:
    """Apply a change of the knots of one direction to a surface."""
    net = _lifted(surface.control_points_mm, surface.weights)
    if along is Along.U:
        bundle = change(_rows(net, surface.degree_u, surface.knots_u, surface.periodic_u))
        net = bundle.coefficients.reshape(-1, *net.shape[1:])
        points, weights = _dropped(net, 3, float(surface.weights[0, 0]))
        return Surface(
            bundle.degree, surface.degree_v, bundle.knots, surface.knots_v,
            points, weights, bundle.periodic, surface.periodic_v,
        )  # fmt: skip
    return swapped(changed_surface(swapped(surface), Along.U, change))


def swapped(surface: Surface) -> Surface:
    """Exchange u and v; the normals turn round."""
    return Surface(
        surface.degree_v, surface.degree_u, surface.knots_v, surface.knots_u,
        surface.control_points_mm.swapaxes(0, 1), surface.weights.T,
        surface.periodic_v, surface.periodic_u,
    )  # fmt: skip


def _rows(net: FloatArray, degree: int, knots: FloatArray, periodic: bool) -> Bundle:  # noqa: FBT001
    return Bundle(degree, knots, net.reshape(len(net), -1), periodic)


def _lifted(points: FloatArray, weights: FloatArray) -> FloatArray:
    if np.all(weights == weights.flat[0]):
        return points
    return homogeneous(points, weights)


def _dropped(net: FloatArray, width: int, weight: float) -> tuple[FloatArray, FloatArray]:
    if net.shape[-1] == width:
        return net, np.full(net.shape[:-1], weight)
    return net[..., :-1] / net[..., -1:], net[..., -1]
