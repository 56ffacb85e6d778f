"""Two views to one motion: searched, settled, judged; refused where it is not determined."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, frozen
from reconstruction.errors import NotRegistered
from reconstruction.registration.determinacy import freedoms
from reconstruction.registration.patches import Surveyed, View, survey
from reconstruction.registration.searching import angles_between, search
from reconstruction.registration.settling import Settled, settle

_MOST_SETTLED = 6  # ways that are settled to the end
_LEAST_OVERLAP = 0.15
_ON = 1.5  # radii from a site of the other view
_ALIKE = 1.5  # rms over the best, and
_ALIKE_OVERLAP = 0.9  # overlap over the best's: such a way fits alike
_SAME_RAD, _SAME_MM = math.radians(3.0), 0.5  # of the radius of patches
_POOR = 0.3  # radii of a patch: residuals so far are no fit


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """The motion that lays the second view on the first: x goes to turn x + shift."""

    transform: FloatArray  # (4, 4)
    middle_mm: FloatArray  # (3,) about which the turn's errors are told, in the first's frame
    covariance: FloatArray  # (6, 6) of a rotation vector (rad) about the middle, and a shift (mm)
    sites_mm: FloatArray  # (k, 3) where both views see the part, in the first's frame
    residuals_mm: FloatArray  # (k,) how far the second's surface lies over the first's
    counted: BoolArray  # (k,): not left out as a stray
    rms_mm: float  # of those that counted
    overlap: tuple[float, float]  # share of each view's surface that the other sees
    radius_mm: float  # of the patches

    def __post_init__(self) -> None:
        object.__setattr__(self, "transform", frozen(self.transform))
        object.__setattr__(self, "covariance", frozen(self.covariance))

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (6,): of the turn in rad about x, y, z, of the shift in mm."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def moved(self, points_mm: FloatArray) -> FloatArray:
        """Points (n, 3) of the second view in the first's frame."""
        return np.asarray(points_mm @ self.transform[:3, :3].T + self.transform[:3, 3])


def register_views(
    first: View,
    second: View,
    *,
    near: FloatArray | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Registration:
    """Find how the second view lies to the first.

    Parameters
    ----------
    near
        Roughly the turn (3, 3) of the second to the first; by default all are tried.
    progress
        Told what begins.

    Raises
    ------
    TooFewPoints
        A view's points are nowhere a surface.
    NotRegistered
        The views share too little; a motion is free; several ways fit alike; or it does not come
        to rest.
    """
    oriented = first.towards is not None and second.towards is not None
    progress("patches")
    fixed, moving = _surveyed(first, second)
    progress("search")
    ways = search(fixed.patches, moving.patches, fixed.radius_mm, oriented=oriented, near=near)
    progress("settle")
    settled: list[Settled] = []
    for way in ways[:_MOST_SETTLED]:
        found = settle(fixed, moving, way, oriented=oriented)
        if found is None or found.rms_mm > _POOR * fixed.radius_mm:
            continue
        settled.append(found)
        if freedoms(found):
            break  # as this one is free, so are the others
    if not settled:
        raise NotRegistered(
            "registration: no way was found to lay one view on the other; do both show the same"
            " part, and enough of it in common?"
        )
    judged = sorted(
        ((_overlap(fixed, moving, each), each) for each in settled),
        key=lambda one: one[1].rms_mm / min(one[0]) if min(one[0]) > 0.0 else math.inf,
    )
    overlap, best = judged[0]
    _must_be_held(best, overlap)
    _must_be_the_only_one(judged)
    return _told(best, overlap, fixed)


def _surveyed(first: View, second: View) -> tuple[Surveyed, Surveyed]:
    """Both with patches of one size: that of the view with the sparser points."""
    fixed, moving = survey(first), survey(second)
    radius_mm = max(fixed.radius_mm, moving.radius_mm)
    if fixed.radius_mm < radius_mm:
        fixed = survey(first, radius_mm)
    if moving.radius_mm < radius_mm:
        moving = survey(second, radius_mm)
    return fixed, moving


def _overlap(fixed: Surveyed, moving: Surveyed, found: Settled) -> tuple[float, float]:
    own = int((found.weights > 0.0).sum()) / len(fixed.patches.sites_mm)
    there = moving.patches.sites_mm @ found.turn.T + found.shift_mm
    away, nearest = fixed.site_tree.query(there)
    off = ((there - fixed.patches.sites_mm[nearest]) * fixed.patches.normals[nearest]).sum(axis=1)
    facing = ((moving.patches.normals @ found.turn.T) * fixed.patches.normals[nearest]).sum(axis=1)
    on = (away < _ON * fixed.radius_mm) & (np.abs(off) < 0.5 * fixed.radius_mm)
    return own, float((on & (np.abs(facing) > 0.5)).mean())


def _must_be_held(best: Settled, overlap: tuple[float, float]) -> None:
    if min(overlap) < _LEAST_OVERLAP:
        raise NotRegistered(
            f"registration: the views share {min(overlap):.0%} of what they see, and at least"
            f" {_LEAST_OVERLAP:.0%} are needed; turn the part over less, or scan it a third time"
        )
    if free := freedoms(best):
        motions = "; ".join(str(each) for each in free)
        raise NotRegistered(
            f"registration: not determined: {motions} changes nothing that the views see; scan the"
            " part with a feature that breaks this in both views (a flat, a hole, a dab of putty"
            " beside the axis)"
        )
    if not best.converged:
        raise NotRegistered(
            f"registration: does not come to rest (residuals {best.rms_mm:.3g} mm rms); scan more"
            " slices, or say roughly how the part was turned (near)"
        )


def _must_be_the_only_one(judged: list[tuple[tuple[float, float], Settled]]) -> None:
    overlap, best = judged[0]
    for other_overlap, other in judged[1:]:
        apart_rad = float(angles_between(other.turn[None], best.turn)[0])
        places = [each.turn @ best.middle_mm + each.shift_mm for each in (best, other)]
        apart_mm = float(np.linalg.norm(places[0] - places[1]))
        same = apart_rad < _SAME_RAD and apart_mm < _SAME_MM * best.size_mm
        alike = other.rms_mm < _ALIKE * best.rms_mm
        if not same and alike and min(other_overlap) > _ALIKE_OVERLAP * min(overlap):
            raise NotRegistered(
                f"registration: not determined: two ways fit alike, {best.rms_mm:.3g} and"
                f" {other.rms_mm:.3g} mm rms, {math.degrees(apart_rad):.3g} deg and"
                f" {apart_mm:.3g} mm apart; say roughly how the part was turned (near), or scan it"
                " with a feature that breaks the symmetry"
            )


def _told(best: Settled, overlap: tuple[float, float], fixed: Surveyed) -> Registration:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = best.turn, best.shift_mm
    units = np.diag([1.0 / best.size_mm] * 3 + [1.0] * 3)
    return Registration(
        transform,
        best.middle_mm,
        units @ np.linalg.inv(best.stiffness) @ units,
        best.sites.sites_mm,
        best.residuals_mm,
        best.weights > 0.0,
        best.rms_mm,
        overlap,
        fixed.radius_mm,
    )
