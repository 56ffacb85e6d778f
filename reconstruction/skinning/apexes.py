"""Where surfaces run out in a point, and how far that may lie off.

A sharp tip is a place, and so is the pole of a sphere. The top of a free dome is none: its net may
end anywhere on it, and how far that lies off sideways means nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.nurbs import evaluate_surface_at
from reconstruction.skinning.ends import Apex
from reconstruction.skinning.exact_skins import AnySkin, ExactSkin
from reconstruction.skinning.net import basis_at
from reconstruction.skinning.primitives import Sphere
from reconstruction.skinning.skin import Skin
from reconstruction.skinning.variances import variances_across


@dataclass(frozen=True, slots=True, eq=False)
class Tip:
    """An end of a surface that is one point."""

    branch: int
    point_mm: FloatArray  # (3,)
    deviations_mm: FloatArray  # (3,), standard deviations along x, y and z
    sharp: bool  # a tip, not a dome

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", frozen(self.point_mm))
        object.__setattr__(self, "deviations_mm", frozen(self.deviations_mm))


def tips_of(skins: Sequence[AnySkin]) -> tuple[Tip, ...]:
    """Every place in which a surface runs out, branch by branch, the low end first."""
    return tuple(
        _tip(number, skin, brim, last=last)
        for number, skin in enumerate(skins)
        for last, brim in zip((False, True), skin.brims or (), strict=False)
        if isinstance(brim, Apex) and (brim.sharp or isinstance(skin, ExactSkin))
    )


def _tip(number: int, skin: AnySkin, brim: Apex, *, last: bool) -> Tip:
    (u, _), ends = skin.surface.domain
    at = np.array([u]), np.array([ends[last]])
    point = evaluate_surface_at(skin.surface, *at)[0]
    found = _exact(skin, point) if isinstance(skin, ExactSkin) else _free(skin, at)
    return Tip(number, point, found, brim.sharp)


def _exact(skin: ExactSkin, point: FloatArray) -> FloatArray:
    """Of a cone's apex, or of the pole of a sphere: its centre moves, and its radius."""
    shape, form = skin.shape, skin.shape.form
    if not isinstance(form, Sphere):
        return next(each for each in shape.quantities if each.name == "apex").deviations
    way = (point - form.centre_mm) / form.radius_mm
    slopes = np.column_stack([np.eye(3), way])
    return np.asarray(np.sqrt(np.einsum("ip,pq,iq->i", slopes, shape.covariance, slopes)))


def _free(skin: Skin, at: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Of an apex of a net, which moves freely: its variance along any direction."""
    net = skin.fit.net
    bases = (
        basis_at(np.repeat(at[0], 3), net.knots_u, 0, closed=net.closed_u),
        basis_at(np.repeat(at[1], 3), net.knots_v, 0, closed=net.closed_v),
    )
    return np.sqrt(variances_across(skin.fit.inverse, net, skin.fit.unknowns, bases, np.eye(3)))
