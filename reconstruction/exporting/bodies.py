r"""Regions of space that surfaces enclose: what CAD is to see of a part, before any CAD library.

A body is one surface that runs around in u, and what closes it at its two v ends::

    CAPPED   ___        RING    _   _        a row that is one point, or a surface that is
            /   \              / \_/ \       periodic in v, too, needs nothing
            \___/              outside, over the rim, down the bore: one flat ring below

Bodies stand from the outside in, as branches do: each adds its region to what came before or, as a
hole, takes it out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import Along, Curve, Surface, clamped_along

if TYPE_CHECKING:
    from reconstruction.skinning.exact_skins import AnySkin


class Closing(Enum):
    """What closes a surface that is open in v."""

    CAPPED = "capped"  # a flat cap at each end that is no point
    RING = "ring"  # one flat ring between its two ends


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """One surface, closed at its ends."""

    surface: Surface  # periodic in u
    hole: bool = False  # it is taken out: material lies outside
    closing: Closing = Closing.CAPPED


def bodies_of(skins: Sequence[AnySkin]) -> tuple[Body, ...]:
    """The bodies of the skins of a scan, in their order."""
    from reconstruction.skinning.branching import is_ring_ended

    return tuple(
        Body(
            skin.surface,
            hole=skin.branch.hole,
            closing=Closing.RING if is_ring_ended(skin.branch) else Closing.CAPPED,
        )
        for skin in skins
    )


def borders_of(surface: Surface, *, within_mm: float) -> tuple[Curve | None, Curve | None]:
    """The curves on which a surface begins and ends in v; None for a point, or if it is closed."""
    if surface.periodic_v:
        return None, None
    surface = clamped_along(surface, Along.V)
    low, high = (
        Curve(
            surface.degree_u, surface.knots_u, surface.control_points_mm[:, row],
            surface.weights[:, row], surface.periodic_u,
        )
        for row in (0, -1)
    )  # fmt: skip
    return (
        None if _extent_mm(low) <= within_mm else low,
        None if _extent_mm(high) <= within_mm else high,
    )


def plane_of(border: Curve) -> tuple[FloatArray, FloatArray, float]:
    """Best plane of a curve's control points: a place (3,), a unit normal (3,), how far they lie.

    A curve lies within the hull of its control points, so no farther from the plane than they.
    """
    points = border.control_points_mm
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle)[2][-1]
    return middle, normal, float(np.abs((points - middle) @ normal).max())


def flat_caps(bodies: Sequence[Body], *, within_mm: float = 1e-4) -> tuple[Curve, ...]:
    """The borders of flat caps that no other body meets: for formats without Boolean operations.

    Left out are rings, borders farther from flat than `within_mm`, and caps whose plane and box
    another body's cap shares: there the part's face is some combination of the two.
    """
    ends = [
        (number, border)
        for number, body in enumerate(bodies)
        for border in borders_of(body.surface, within_mm=within_mm)
        if border is not None and border.periodic and plane_of(border)[2] <= within_mm
    ]
    return tuple(
        border
        for number, border in ends
        if bodies[number].closing is Closing.CAPPED
        and not any(_meet(border, other, within_mm) for another, other in ends if another != number)
    )


def _meet(first: Curve, second: Curve, within_mm: float) -> bool:
    place, normal, _ = plane_of(first)
    points, others = first.control_points_mm, second.control_points_mm
    apart = np.maximum(
        points.min(axis=0) - others.max(axis=0), others.min(axis=0) - points.max(axis=0)
    )
    level = np.abs((others - place) @ normal).max() <= within_mm
    return bool(level and apart.max() <= within_mm)


def _extent_mm(border: Curve) -> float:
    return float(np.ptp(border.control_points_mm, axis=0).max())
