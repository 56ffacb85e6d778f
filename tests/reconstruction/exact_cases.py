"""Parts whose exact form is known, scanned with noise and gathered in cells; and a free surface.

Nothing here comes from the code under test: points are drawn on formulas, cells are gathered by
numpy, and the free surface is a least-squares tensor spline of the deviations from the formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.outlines import Moments

Gap = tuple[float, float, float, float]  # from, to in rad; from, to in mm

STRIP = ((1.0, 1.0 + math.radians(36), -10.0, 110.0),)
PATCHES = tuple(
    (turn, turn + math.radians(36), low, low + 20.0)
    for turn, low in ((2.0, 5.0), (2.9, 40.0), (3.8, 75.0), (4.7, 20.0), (5.5, 60.0))
)


class Part(Protocol):
    """A surface in its own frame."""

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Points on the surface, (n, 3)."""

    def boxes(self, points: FloatArray) -> IntArray:
        """The cell every point belongs to."""

    def standing(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances (m,) of places near the surface, normals (m, 3), and a chart (m, 2)."""


@dataclass(frozen=True)
class Turned:
    """A wall about the z axis, its radius a function of angle and height; z from 0."""

    radius: Callable[[FloatArray, FloatArray], FloatArray]
    height: float = 100.0
    turn: float = math.tau
    gaps: tuple[Gap, ...] = ()
    slices: int = 25
    columns: int = 60
    by_area: bool = False  # points even over a cone's area, not over angle and height

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        share, angle = rng.random(count), self.turn * rng.random(count)
        z = self.height * (1.0 - np.sqrt(share)) if self.by_area else self.height * share
        missing = np.zeros(count, np.bool_)
        for start, end, low, high in self.gaps:
            missing |= (angle > start) & (angle < end) & (z > low) & (z < high)
        angle, z = angle[~missing], z[~missing]
        r = self.radius(angle, z)
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])

    def boxes(self, points: FloatArray) -> IntArray:
        level = np.floor(points[:, 2] / self.height * self.slices).astype(np.int64)
        angle = np.mod(np.arctan2(points[:, 1], points[:, 0]), math.tau)
        columns = np.full(len(points), float(self.columns))
        if self.by_area:  # towards an apex there is room for fewer
            columns *= np.clip(1.0 - (level + 0.5) / self.slices, 6.0 / self.columns, 1.0)
        return (level + 1000) * 10_000 + (angle / math.tau * np.floor(columns)).astype(np.int64)

    def standing(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, z = places.T
        angle, rho, step = np.arctan2(y, x), np.hypot(x, y), 1e-4
        along = (self.radius(angle, z + step) - self.radius(angle, z - step)) / (2 * step)
        around = (self.radius(angle + step, z) - self.radius(angle - step, z)) / (2 * step * rho)
        c, s = np.cos(angle), np.sin(angle)
        normals = np.column_stack([c + around * s, s - around * c, -along])
        lengths = np.linalg.norm(normals, axis=1)
        distances = (rho - self.radius(angle, z)) / lengths
        return distances, normals / lengths[:, None], np.column_stack([angle, z])


@dataclass(frozen=True)
class Ball:
    """An ellipsoid about the origin, cut in slices across z; a ball if its half axes are alike."""

    half_axes: tuple[float, float, float] = (30.0, 30.0, 30.0)
    low: float = -1.0  # as a share of the half axis
    slices: int = 30

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        z, angle = rng.uniform(self.low, 1.0, count), math.tau * rng.random(count)
        ring = np.sqrt(1.0 - z * z)
        return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z]) * self.half_axes

    def boxes(self, points: FloatArray) -> IntArray:
        share = (points[:, 2] / self.half_axes[2] + 1.0) / 2.0
        level = np.floor(share * self.slices).astype(np.int64)
        z = np.clip((level + 0.5) / self.slices * 2.0 - 1.0, -1.0, 1.0)
        columns = np.maximum(np.floor(90.0 * np.sqrt(1.0 - z * z)), 6.0)
        angle = np.mod(np.arctan2(points[:, 1], points[:, 0]), math.tau)
        return (level + 1000) * 10_000 + (angle / math.tau * columns).astype(np.int64)

    def standing(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        scaled = places / self.half_axes
        level = np.linalg.norm(scaled, axis=1)
        gradient = scaled / self.half_axes / level[:, None]
        lengths = np.linalg.norm(gradient, axis=1)
        chart = np.column_stack([np.arctan2(places[:, 1], places[:, 0]), scaled[:, 2] / level])
        return (level - 1.0) / lengths, gradient / lengths[:, None], chart


@dataclass(frozen=True)
class Board:
    """A rectangle across y, from -40 to 40 along x and 0 to 60 along z; bowed or not."""

    bow: float = 0.0

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        x, z = rng.uniform(-40.0, 40.0, count), rng.uniform(0.0, 60.0, count)
        return np.column_stack([x, self.bow * (x / 40.0) ** 2, z])

    def boxes(self, points: FloatArray) -> IntArray:
        x, z = np.floor(points[:, 0] / 2.0), np.floor(points[:, 2] / 3.0)
        return ((z + 1000) * 10_000 + x + 1000).astype(np.int64)

    def standing(self, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        x, y, z = places.T
        normals = np.column_stack([-self.bow * x / 800.0, np.ones(len(x)), np.zeros(len(x))])
        lengths = np.linalg.norm(normals, axis=1)
        distances = (y - self.bow * (x / 40.0) ** 2) / lengths
        return distances, normals / lengths[:, None], np.column_stack([x / 20.0, z])


@dataclass(frozen=True, eq=False)
class Scan:
    """A part, turned and moved, as cells."""

    part: Part
    moments: Moments
    noise_mm2: FloatArray  # (3, 3), covariance of a point's error
    turn: FloatArray  # (3, 3): part frame to scan
    shift_mm: FloatArray  # (3,)

    def local(self) -> FloatArray:
        """Means of the cells in the part's own frame."""
        return (self.moments.means_mm - self.shift_mm) @ self.turn

    def placed(self, places: FloatArray) -> FloatArray:
        """Places of the part's own frame in the scan's."""
        return np.asarray(places @ self.turn.T + self.shift_mm)

    def variances_mm2(self) -> FloatArray:
        """Of a point across the true surface, (m,)."""
        normals = self.part.standing(self.local())[1] @ self.turn.T
        return np.einsum("mi,ij,mj->m", normals, self.noise_mm2, normals)

    def free(self, *, around: int = 10, along: int = 6) -> tuple[float, float]:
        """Misfit and degrees of freedom of a surface that is free to deviate from the truth.

        A tensor spline of `around` x `along` control values, by least squares: no penalty.
        """
        distances, normals, chart = self.part.standing(self.local())
        variances = self.variances_mm2()
        root = np.sqrt(self.moments.counts / variances)
        rows = np.einsum("mi,mj->mij", _closed(chart[:, 0], around), _open(chart[:, 1], along))
        flat = rows.reshape(len(rows), -1)
        flat = flat[:, (flat > 1e-6).any(axis=0)] * root[:, None]
        square = flat.T @ flat
        square += 1e-9 * np.trace(square) / len(square) * np.eye(len(square))
        fitted = flat @ np.linalg.solve(square, flat.T @ (root * distances))
        turned = normals @ self.turn.T
        scatters = np.einsum("mi,mij,mj->m", turned, self.moments.covariances_mm2, turned)
        misfit = float(((root * distances - fitted) ** 2 + root**2 * scatters).sum())
        return misfit, float(flat.shape[1])


def _closed(angles: FloatArray, count: int) -> FloatArray:
    knots = np.arange(-3, count + 4) * math.tau / count
    rows = BSpline.design_matrix(np.mod(angles, math.tau), knots, 3).toarray()
    rows[:, :3] += rows[:, count:]
    return np.asarray(rows[:, :count])


def _open(values: FloatArray, count: int) -> FloatArray:
    low, high = values.min() - 1e-9, values.max() + 1e-9
    knots = np.concatenate([[low] * 3, np.linspace(low, high, count - 2), [high] * 3])
    return np.asarray(BSpline.design_matrix(values, knots, 3).toarray())


def scanned(
    part: Part,
    count: int,
    seed: int,
    *,
    sigma: float = 0.2,
    level_only: bool = False,
    turned: bool = True,
) -> Scan:
    """Draw points, add noise, gather them in cells; turn and move it all at random.

    Parameters
    ----------
    level_only
        The noise is in the cutting planes, as a profiler's is; heights are exact.
    """
    rng = np.random.default_rng(seed)
    points = part.drawn(rng, count)
    error = rng.normal(0.0, sigma, points.shape)
    noise = np.diag([sigma**2, sigma**2, 0.0 if level_only else sigma**2])
    points += error * [1.0, 1.0, 0.0 if level_only else 1.0]
    turn = rotation(rng) if turned else np.eye(3)
    shift = rng.normal(0.0, 50.0, 3) if turned else np.zeros(3)
    moments = gathered(points @ turn.T + shift, part.boxes(points))
    return Scan(part, moments, turn @ noise @ turn.T, turn, shift)


def gathered(points: FloatArray, boxes: IntArray) -> Moments:
    """Count, mean and covariance of the points of every box that holds any."""
    _, at, counts = np.unique(boxes, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(at, column) for column in points.T], axis=1) / counts[:, None]
    arms = points - means[at]
    spread = np.empty((len(counts), 3, 3))
    for i in range(3):
        for j in range(3):
            spread[:, i, j] = np.bincount(at, arms[:, i] * arms[:, j]) / counts
    return Moments(counts.astype(np.float64), means, spread)


def rotation(rng: np.random.Generator) -> FloatArray:
    """A random rotation."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.asarray(axes * np.sign(np.linalg.det(axes)))
