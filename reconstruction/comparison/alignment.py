"""The rigid motion that brings points closest to a mesh.

Iterated closest points on the signed point-to-triangle distance itself: its gradient is the
direction away from the nearest point, so Gauss-Newton on it (Chen and Medioni 1992,
doi:10.1016/0262-8856(92)90066-C, with tangent planes where the nearest point lies inside a face)
converges quadratically without noise. Far points lose their weight by Tukey's biweight.

A part that can slide along itself (a cylinder, a sphere) leaves directions without resistance.
They are left alone, not filled with noise, and the number that is held is reported.
"""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.comparison.deviation import Alignment
from reconstruction.comparison.nearest import FACE
from reconstruction.comparison.reference import Reference, measure
from reconstruction.errors import TooFewPoints

_MAX_POINTS = 50_000  # more do not move the result by a tenth of its own uncertainty
_START_POINTS = 2_000
_MAX_ITERATIONS = 100
_START_ITERATIONS = 8
_SETTLED = 1e-9  # step over size at which the motion has converged
# Resistance, relative to the stiffest direction, below which one is free: the facets of a cylinder
# of 200 sides resist its turning by about this much.
_LOOSE = 1e-4
_TUKEY = 4.685  # 95 % efficient on Gaussian noise
_BETTER = 0.5  # another start has to halve the median distance


def best_fit(points_mm: FloatArray, against: Reference, *, seed: int = 0) -> Alignment:
    """Find the rigid motion of (n, 3) points onto the mesh.

    It starts where the points are, and at the four ways to lay the principal axes of points and
    mesh onto each other; one of those wins only where it is much better.

    Raises
    ------
    TooFewPoints
        There are fewer than 6 points.
    """
    if len(points_mm) < 6:
        raise TooFewPoints(f"best fit: {len(points_mm)} points, a rigid motion needs 6")
    sample = _thinned(points_mm, _MAX_POINTS, seed)
    few = _thinned(sample, _START_POINTS, seed)
    starts = [np.eye(4), *_principal_starts(few, against)]
    tried = [_iterate(few, against, start, _START_ITERATIONS) for start in starts]
    offs = [_median_distance(few, against, result.transform) for result in tried]
    best = int(np.argmin(offs))
    if offs[best] > _BETTER * offs[0]:
        best = 0
    return _iterate(sample, against, tried[best].transform, _MAX_ITERATIONS)


def moved(points_mm: FloatArray, transform: FloatArray) -> FloatArray:
    """Apply a (4, 4) rigid motion to (n, 3) points."""
    return np.asarray(points_mm @ transform[:3, :3].T + transform[:3, 3])


def _thinned(points_mm: FloatArray, count: int, seed: int) -> FloatArray:
    if len(points_mm) <= count:
        return points_mm
    chosen = np.random.default_rng(seed).choice(len(points_mm), size=count, replace=False)
    return points_mm[chosen]


def _principal_starts(points_mm: FloatArray, against: Reference) -> list[FloatArray]:
    """Motions that lay the principal axes of the points onto those of the mesh's corners."""
    rows = against.triangles.rows
    corners = rows[:, :9].reshape(-1, 3, 3)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    centres = corners.mean(axis=1)
    goal_mm = np.average(centres, axis=0, weights=areas)
    goal_axes = np.linalg.eigh(np.cov(centres.T, aweights=areas))[1]
    axes = np.linalg.eigh(np.cov(points_mm.T))[1]
    middle_mm = points_mm.mean(axis=0)
    starts = []
    for flips in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        turned = goal_axes * np.array([*flips, 1.0])
        turned[:, 2] *= np.sign(np.linalg.det(turned @ axes.T))
        start = np.eye(4)
        start[:3, :3] = turned @ axes.T
        start[:3, 3] = against.triangles.origin_mm + goal_mm - start[:3, :3] @ middle_mm
        starts.append(start)
    return starts


def _median_distance(points_mm: FloatArray, against: Reference, transform: FloatArray) -> float:
    readings = measure(moved(points_mm, transform), against)
    return float(np.median(np.abs(readings.distances_mm)))


def _iterate(points_mm: FloatArray, against: Reference, start: FloatArray, most: int) -> Alignment:
    """Repeat steps until they vanish, or `most` were made."""
    transform, converged, iteration = start, False, 0
    centre_mm = points_mm.mean(axis=0)
    size_mm = float(np.sqrt(np.mean(np.sum((points_mm - centre_mm) ** 2, axis=1)))) or 1.0
    held, rms_mm = 0, math.nan
    while iteration < most and not converged:
        here = moved(points_mm, transform)
        pivot_mm = here.mean(axis=0)
        step, held, rms_mm = _step(here, pivot_mm, size_mm, against)
        transform = _rigid(step, pivot_mm, size_mm) @ transform
        converged = float(np.abs(step).max()) < _SETTLED
        iteration += 1
    turn = transform[:3, :3]
    # The antisymmetric part holds for small angles where the trace has lost its digits.
    sine = np.linalg.norm(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )
    return Alignment(
        transform=transform,
        rotation_rad=math.atan2(float(sine) / 2, (float(np.trace(turn)) - 1) / 2),
        translation_mm=float(np.linalg.norm(moved(centre_mm[None], transform)[0] - centre_mm)),
        iterations=iteration,
        converged=converged,
        held_freedoms=held,
        rms_mm=rms_mm,
        points=len(points_mm),
    )


def _step(
    here_mm: FloatArray, pivot_mm: FloatArray, size_mm: float, against: Reference
) -> tuple[FloatArray, int, float]:
    """Make one Gauss-Newton step: (6,) turn and shift over size, freedoms held, weighted rms."""
    readings = measure(here_mm, against)
    off = readings.distances_mm
    away = here_mm - readings.feet_mm
    directions = against.triangles.rows[readings.faces, 9:12].copy()
    clear = (readings.parts != FACE) & (np.abs(off) > 1e-9 * size_mm)
    directions[clear] = away[clear] / off[clear, None]
    arms = np.concatenate(
        [np.cross((here_mm - pivot_mm) / size_mm, directions), directions], axis=1
    )
    weights = _biweights(off, size_mm)
    normal = (arms * weights[:, None]).T @ arms
    stiffness, ways = np.linalg.eigh(normal)
    held = stiffness > _LOOSE * stiffness[-1]
    push = ways.T @ (arms.T @ (weights * off)) / size_mm
    amounts = np.divide(-push, stiffness, out=np.zeros(6), where=held)
    rms_mm = math.sqrt(float(np.sum(weights * off**2) / np.sum(weights)))
    return ways @ amounts, int(held.sum()), rms_mm


def _biweights(off_mm: FloatArray, size_mm: float) -> FloatArray:
    """Tukey's weights about 0, with the spread from the median; (n,) in [0, 1]."""
    spread_mm = 1.4826 * float(np.median(np.abs(off_mm)))
    reach_mm = max(_TUKEY * spread_mm, 1e-9 * size_mm)
    return np.asarray(np.clip(1 - (off_mm / reach_mm) ** 2, 0.0, None) ** 2)


def _rigid(step: FloatArray, pivot_mm: FloatArray, size_mm: float) -> FloatArray:
    """Turn about the pivot by the vector step[:3], shift by step[3:] sizes; (4, 4)."""
    angle = float(np.linalg.norm(step[:3]))
    x, y, z = step[:3] / angle if angle > 0 else step[:3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    motion = np.eye(4)
    motion[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    motion[:3, 3] = pivot_mm + size_mm * step[3:] - motion[:3, :3] @ pivot_mm
    return motion
