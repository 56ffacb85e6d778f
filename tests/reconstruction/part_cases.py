"""Parts whose truth is a formula, scanned with seeded noise and gaps."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.slices import Frame, Slice
from reconstruction.survey import Pass


def band(
    rng: np.random.Generator,
    *,
    radius_mm: float = 50.0,
    width_mm: float = 2.0,
    points_a_mm: float = 40.0,
    centre_mm: tuple[float, float] = (0.0, 0.0),
) -> FloatArray:
    """The paper's own case: a circle as a band of uniform width, unordered, (n, 2)."""
    count = round(2.0 * math.pi * radius_mm * points_a_mm)
    angle = rng.uniform(0.0, 2.0 * math.pi, count)
    radius = radius_mm + rng.uniform(-width_mm / 2.0, width_mm / 2.0, count)
    outline = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(outline + centre_mm)


def turned_part(
    rng: np.random.Generator,
    radius_mm: Callable[[FloatArray], FloatArray],
    *,
    rows: int,
    row_mm: float,
    points_a_row: int,
    noise_mm: float,
    hidden: Callable[[FloatArray, FloatArray], BoolArray] | None = None,
) -> FloatArray:
    """A body of revolution about z, scanned row by row; `hidden(angle, height)` was never seen."""
    height = np.repeat(np.arange(rows) * row_mm, points_a_row)
    # A turntable's equal steps, each row begun somewhere else and the steps a little uneven.
    steps = np.tile(np.arange(points_a_row), rows) + rng.uniform(0.0, 0.5, rows * points_a_row)
    begun = np.repeat(rng.uniform(0.0, points_a_row, rows), points_a_row)
    angle = (steps + begun) % points_a_row * (2.0 * math.pi / points_a_row) - math.pi
    if hidden is not None:
        seen = ~hidden(angle, height)
        height, angle = height[seen], angle[seen]
    # A profiler measures along its line of sight: the noise is radial.
    radius = radius_mm(height) + rng.normal(0.0, noise_mm, len(height))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def star(rng: np.random.Generator, corners: int) -> FloatArray:
    """A simple polygon (corners, 2), counter-clockwise, with deep dents."""
    # No wedge of half a turn or more, even of three: the pole stays inside.
    steps = np.arange(corners) + rng.uniform(0.0, 0.45, corners)
    angle = rng.uniform(0.0, 2.0 * math.pi) + steps * (2.0 * math.pi / corners)
    radius = rng.uniform(2.0, 20.0, corners)
    return np.asarray(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def ring(
    radius_mm: float, count: int, height_mm: float = 0.0, phase_rad: float = 0.0
) -> FloatArray:
    """Regular points on a circle about z, counter-clockwise, (count, 3)."""
    angle = phase_rad + np.arange(count) * (2.0 * math.pi / count)
    x, y = radius_mm * np.cos(angle), radius_mm * np.sin(angle)
    return np.column_stack([x, y, np.full(count, height_mm)])


def flat_slice(planar_mm: FloatArray, *, index: int = 0, height_mm: float = 0.0) -> Slice:
    """A slice perpendicular to z from points (n, 2)."""
    points = np.column_stack([planar_mm, np.full(len(planar_mm), height_mm)])
    return Slice(index, points, Frame(np.array([0.0, 0.0, height_mm]), np.eye(3)))


def chunks_of(points: FloatArray, size: int = 1 << 20) -> Pass:
    """A pass over an array, `size` points at a time."""
    return lambda: (points[start : start + size] for start in range(0, len(points), size))
