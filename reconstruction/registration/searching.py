"""Every way to lay one view on another, roughly: a grid of turns, each walked downhill.

Turns are spread evenly by super-Fibonacci spirals (Alexa 2022, doi:10.1109/CVPR52688.2022.00811).
Each begins with the middles of both views on one another and takes a few steps of iterated closest
points to planes (Chen and Medioni 1992), all turns at once; of each, the farthest third of the
points is left out, because there is much that only one view sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.registration.patches import Patches

_TURNS, _FEW_SITES, _FEW_STEPS = 3000, 120, 8
_BEST, _MORE_SITES, _MORE_STEPS = 60, 600, 25
_KEPT_SHARE = 2.0 / 3.0
_AGREE = 0.5  # cosine between normals of one place
_DAMPING = 1e-3  # of the stiffest motion: what slides freely stays
_ALIKE_RAD, _ALIKE_MM = math.radians(12.0), 2.0  # of the radius of patches
_NEAR_RAD = math.radians(40.0)
_HOPEFUL = 0.75  # of the best score


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A way to lay the second view on the first: x of the second goes to turn x + shift."""

    turn: FloatArray  # (3, 3)
    shift_mm: FloatArray  # (3,)
    score: float  # share of the second's sites that lie on the first, 0 to 1


def search(
    fixed: Patches,
    moving: Patches,
    radius_mm: float,
    *,
    oriented: bool,
    near: FloatArray | None = None,
) -> list[Laid]:
    """The distinct ways that fit, best first.

    Parameters
    ----------
    oriented
        Normals point outward in both; else their sign says nothing.
    near
        A turn (3, 3): only those within 40 degrees of it are tried.
    """
    turns = spread_turns(_TURNS)
    if near is not None:
        turns = np.concatenate([near[None], turns[angles_between(turns, near) < _NEAR_RAD]])
    look = _Look(fixed, cKDTree(fixed.sites_mm), radius_mm, oriented=oriented)
    few = _every(moving, _FEW_SITES)
    middle = moving.sites_mm.mean(axis=0)
    shifts = fixed.sites_mm.mean(axis=0) - turns @ middle
    turns, shifts, scores = look.walk(few, turns, shifts, _FEW_STEPS)
    # One of each kind: a symmetric part has ways of which one would crowd out the others.
    best = _distinct(turns, turns @ middle + shifts, scores, radius_mm)[:_BEST]
    more = _every(moving, _MORE_SITES)
    turns, shifts, scores = look.walk(more, turns[best], shifts[best], _MORE_STEPS)
    rows = _distinct(turns, turns @ middle + shifts, scores, radius_mm)
    hopeful = [row for row in rows if scores[row] >= _HOPEFUL * scores[rows[0]]]
    return [Laid(turns[row], shifts[row], float(scores[row])) for row in hopeful]


def spread_turns(count: int) -> FloatArray:
    """Rotations, evenly spread, (count, 3, 3)."""
    s = np.arange(count) + 0.5
    low, high = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = math.tau * s / math.sqrt(2.0), math.tau * s / 1.533751168755204288118041
    x, y, z, w = low * np.sin(alpha), low * np.cos(alpha), high * np.sin(beta), high * np.cos(beta)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def angles_between(turns: FloatArray, other: FloatArray) -> FloatArray:
    """Angles in rad of the turns that lead from one to the others, (k, 3, 3) -> (k,)."""
    traces = np.einsum("kij,ij->k", turns, other)
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))


def small_turns(ways: FloatArray) -> FloatArray:
    """Rotations (k, 3, 3) by rotation vectors (k, 3), after Rodrigues."""
    angles = np.linalg.norm(ways, axis=1)
    x, y, z = (ways / np.maximum(angles, 1e-300)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))


class _Look:
    """Looks for the nearest sites of the fixed view, for many turns at once."""

    def __init__(self, fixed: Patches, tree: cKDTree, radius_mm: float, *, oriented: bool) -> None:
        self._fixed, self._tree, self._radius_mm = fixed, tree, radius_mm
        self._oriented = oriented

    def walk(
        self, moving: Patches, turns: FloatArray, shifts: FloatArray, steps: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Walk downhill from each of k ways; the ways and their scores."""
        for _ in range(steps):
            places, away, off, normals, agree = self._seen(moving, turns, shifts)
            kept = round(_KEPT_SHARE * (away.shape[1] - 1))
            limits = np.partition(np.where(agree, away, np.inf), kept, axis=1)[:, kept]
            limits = np.where(np.isfinite(limits), limits, np.median(away, axis=1))
            weights = (agree & (away <= limits[:, None])).astype(np.float64)
            middles = places.mean(axis=1)
            arms = places - middles[:, None]
            size_mm = np.sqrt((arms**2).sum(axis=2).mean(axis=1))
            rows = np.concatenate(
                [np.cross(arms, normals) / size_mm[:, None, None], normals], axis=2
            )
            stiff = np.einsum("kn,kni,knj->kij", weights, rows, rows)
            stiff += _DAMPING * np.trace(stiff, axis1=1, axis2=2)[:, None, None] * np.eye(6)
            stiff += 1e-9 * np.eye(6)
            pull = np.einsum("kn,kni,kn->ki", weights, rows, off)
            step = -np.linalg.solve(stiff, pull[:, :, None])[:, :, 0]
            turned = small_turns(step[:, :3] / size_mm[:, None])
            shifts = np.einsum("kij,kj->ki", turned, shifts - middles) + middles + step[:, 3:]
            turns = turned @ turns
        _, away, off, _, agree = self._seen(moving, turns, shifts)
        fits = np.maximum(0.0, 1.0 - (off / self._radius_mm) ** 2)
        on = agree & (away < 2.5 * self._radius_mm)
        return turns, shifts, np.asarray((fits * on).mean(axis=1))

    def _seen(
        self, moving: Patches, turns: FloatArray, shifts: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, np.ndarray]:
        places = np.einsum("kij,nj->kni", turns, moving.sites_mm) + shifts[:, None]
        away, nearest = self._tree.query(places.reshape(-1, 3), workers=1)
        found = np.asarray(nearest).reshape(places.shape[:2])
        normals = self._fixed.normals[found]
        off = ((places - self._fixed.sites_mm[found]) * normals).sum(axis=2)
        facing = np.einsum("kij,nj->kni", turns, moving.normals)
        cosines = (facing * normals).sum(axis=2)
        agree = (cosines if self._oriented else np.abs(cosines)) > _AGREE
        return places, np.asarray(away).reshape(places.shape[:2]), off, normals, agree


def _every(patches: Patches, count: int) -> Patches:
    """About so many of them, spread over all."""
    rng = np.random.default_rng(0)
    rows: IntArray = np.sort(rng.permutation(len(patches.sites_mm))[:count])
    return patches.of(rows)


def _distinct(
    turns: FloatArray, places: FloatArray, scores: FloatArray, radius_mm: float
) -> list[int]:
    """Rows of ways none of which is like one before it, best first; places: of the middle."""
    left = np.argsort(-scores)
    found: list[int] = []
    while len(left):
        row = left[0]
        found.append(int(row))
        alike = angles_between(turns[left], turns[row]) < _ALIKE_RAD
        alike &= np.linalg.norm(places[left] - places[row], axis=1) < _ALIKE_MM * radius_mm
        left = left[~alike]
    return found
