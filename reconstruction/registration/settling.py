r"""Patch against patch until nothing moves: point-to-plane on quadrics, with its covariance.

At a site c of the fixed view with normal n, d is how far over the fixed surface the moving one
lies, both as quadrics of raw points in the same patch. A small motion x = (omega, t) about the
middle g of the sites changes it by

    d(x) = d + [(c - g) x n / R,  n] x        R: rms distance of the sites from g, omega in mm at R

and the step is weighted least squares. Weights are one over the variances of both quadrics and of
what they cannot tell, which is found from the residuals; far ones lose theirs by Tukey's biweight:
sites that one view sees wrongly. The covariance is that of the weighted solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.registration.patches import Patches, Surveyed, fit_patches
from reconstruction.registration.searching import Laid, small_turns

_MOST_STEPS = 40
_CALM = 10  # steps after which only half of each is taken
_SETTLED = 0.03  # of the standard deviation: a point more in a patch moves it by about this much
_TUKEY = 4.685  # 95 % efficient on Gaussian noise
_AGREE = 0.8  # cosine between normals of one place
_MAD = 1.4826
# For Gaussian noise, with psi(x) = x w(x) of Tukey's weights: the mean of x psi is 0.7578, of w
# 0.9151, and the estimate's variance over that of plain least squares 1 / 0.95. So the inverse of
# the weighted stiffness, times sum(w r^2) / freedom / 0.787, is the covariance.
_OF_GAUSSIAN = 0.7578 * 0.95 / 0.9151
_FEWEST = 24  # sites, four a freedom


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Where it came to rest."""

    turn: FloatArray  # (3, 3): x of the moving view goes to turn x + shift
    shift_mm: FloatArray  # (3,)
    middle_mm: FloatArray  # (3,) g, in the fixed frame
    size_mm: float  # R
    stiffness: FloatArray  # (6, 6), of (omega R, t); its inverse is the covariance
    sites: Patches  # of the fixed view, that both see
    normal_noise: FloatArray  # (k, 3, 3), covariance of the unit normals there
    residuals_mm: FloatArray  # (k,)
    weights: FloatArray  # (k,), of the last solve; 0: left out
    converged: bool

    @property
    def rms_mm(self) -> float:
        """Of the residuals that counted."""
        kept = self.residuals_mm[self.weights > 0.0]
        return float(np.sqrt(np.mean(kept**2))) if len(kept) else math.inf


def settle(fixed: Surveyed, moving: Surveyed, start: Laid, *, oriented: bool) -> Settled | None:
    """Bring it to rest from a start nearby; None where the views share too little there."""
    turn, shift = start.turn, start.shift_mm
    found: Settled | None = None
    for step in range(_MOST_STEPS):
        seen = _seen(fixed, moving, turn, shift, oriented=oriented)
        if int(seen.shared.sum()) < _FEWEST:
            return None
        found, way = _solved(fixed.patches, seen, turn, shift)
        if float(way @ found.stiffness @ way) < _SETTLED**2 and step > 0:
            return found
        if step > _CALM:
            way = 0.5 * way
        turned = small_turns(way[None, :3] / found.size_mm)[0]
        turn = turned @ turn
        shift = turned @ (shift - found.middle_mm) + found.middle_mm + way[3:]
    assert found is not None
    return Settled(
        turn, shift, found.middle_mm, found.size_mm, found.stiffness, found.sites,
        found.normal_noise, found.residuals_mm, found.weights, converged=False,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    off_mm: FloatArray
    variances_mm2: FloatArray
    shared: BoolArray


def _seen(
    fixed: Surveyed, moving: Surveyed, turn: FloatArray, shift: FloatArray, *, oriented: bool
) -> _Seen:
    """The moving surface at the sites of the fixed one."""
    here = fixed.patches
    sites_mm, normals = (here.sites_mm - shift) @ turn, here.normals @ turn
    radius_mm = max(fixed.radius_mm, moving.radius_mm)
    there = fit_patches(moving.view.points_mm, moving.tree, sites_mm, normals, radius_mm)
    cosines = (there.normals * normals).sum(axis=1)
    agree = cosines > _AGREE
    if oriented:
        # The other side of a thin wall is no meeting: whose nearest site looks away is not seen.
        _, nearest = moving.site_tree.query(sites_mm)
        agree &= (moving.patches.normals[nearest] * normals).sum(axis=1) > 0.0
    return _Seen(
        there.heights_mm - here.heights_mm,
        there.variances_mm2 + here.variances_mm2,
        there.sound & agree,
    )


def _solved(
    here: Patches, seen: _Seen, turn: FloatArray, shift: FloatArray
) -> tuple[Settled, FloatArray]:
    shared = seen.shared
    sites, off, own = here.of(shared), seen.off_mm[shared], seen.variances_mm2[shared]
    middle = sites.sites_mm.mean(axis=0)
    arms = sites.sites_mm - middle
    size_mm = float(np.sqrt((arms**2).sum(axis=1).mean()))
    rows = np.concatenate([np.cross(arms, sites.normals) / size_mm, sites.normals], axis=1)
    way = np.zeros(6)
    weights = np.zeros(len(off))
    stiffness = np.eye(6)
    more = float(np.median(own))
    for _ in range(6):
        left = off + rows @ way
        more = _unexplained(left, own)
        spread = np.sqrt(own + more)
        share = left / (_TUKEY * spread)
        weights = np.where(np.abs(share) < 1.0, (1.0 - share**2) ** 2, 0.0) / spread**2
        stiffness = rows.T @ (weights[:, None] * rows)
        # What nothing holds stays where it is.
        way = -np.linalg.pinv(stiffness, rcond=1e-9, hermitian=True) @ (rows.T @ (weights * off))
    left = off + rows @ way
    kept = weights > 0.0
    # Unit weight from the residuals themselves: what the model of the noise leaves out is in it.
    freedom = max(1, int(kept.sum()) - 6)
    unit = float((weights[kept] * left[kept] ** 2).sum()) / freedom / _OF_GAUSSIAN
    noisier = 1.0 + more / float(np.median(own))
    settled = Settled(
        turn, shift, middle, size_mm, stiffness / unit, sites, noisier * sites.slopes, left,
        weights / unit, converged=True,
    )  # fmt: skip
    return settled, way


def _unexplained(left: FloatArray, own: FloatArray) -> float:
    """Variance beyond that of the quadrics which makes the middle half of the residuals usual."""
    low, high = 0.0, 100.0 * float(np.median(left**2)) + 1e-18
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _MAD * float(np.median(np.abs(left) / np.sqrt(own + middle))) > 1.0:
            low = middle
        else:
            high = middle
    return high
