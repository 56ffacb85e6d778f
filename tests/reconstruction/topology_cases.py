"""Outlines, clouds of noisy points around them, and a judge of chains that knows the outline."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.chain import Chain

STEP_MM = 0.05  # between the points of an outline


def evenly(points: FloatArray, *, closed: bool) -> FloatArray:
    """The polyline at equal arc lengths of about a step."""
    ring = np.vstack([points, points[:1]]) if closed else points
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(ring, axis=0), axis=1).cumsum()])
    wanted = np.linspace(0.0, along[-1], int(along[-1] / STEP_MM), endpoint=not closed)
    return np.stack([np.interp(wanted, along, column) for column in ring.T], axis=1)


def ellipse(x_mm: float, y_mm: float, centre: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    angle = np.linspace(0.0, math.tau, 4000, endpoint=False)
    return evenly(
        np.stack([x_mm * np.cos(angle), y_mm * np.sin(angle)], axis=1) + centre, closed=True
    )


def superformula() -> FloatArray:
    """Five lobes, exponents 3, 6, 6, mean radius 50 mm."""
    angle = np.linspace(0.0, math.tau, 8000, endpoint=False)
    powers = np.abs(np.cos(5 * angle / 4)) ** 6 + np.abs(np.sin(5 * angle / 4)) ** 6
    radius = powers ** (-1 / 3)
    radius *= 50.0 / radius.mean()
    return evenly(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


def arc(radius_mm: float, degrees: float) -> FloatArray:
    angle = np.linspace(0.0, math.radians(degrees), 4000)
    return evenly(radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=False)


def letter_s(radius_mm: float) -> FloatArray:
    """Two bows of three quarters of a circle."""
    angle = np.linspace(0.0, 1.5 * math.pi, 2000)
    bow = radius_mm * np.stack([np.cos(angle), 1.0 + np.sin(angle)], axis=1)
    return evenly(np.vstack([bow, -bow[-2::-1]]), closed=False)


def overlapping(pitch_mm: float) -> FloatArray:
    """A spiral of a little more than a turn: its ends run past each other, a pitch apart."""
    angle = np.linspace(0.0, 1.06 * math.tau, 6000)
    radius = 40.0 + pitch_mm * angle / math.tau
    return evenly(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=False)


def corner() -> FloatArray:
    return evenly(np.array([[60.0, 0.0], [0.0, 0.0], [0.0, 45.0]]), closed=False)


def cloud(
    outline: FloatArray,
    rng: np.random.Generator,
    *,
    per_mm: float,
    band_mm: float,
    closed: bool = True,
    gap_degrees: float = 0.0,
) -> FloatArray:
    """Points at random places of an outline, noise uniform across it over the full band."""
    steps = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    if not closed:
        steps = np.gradient(outline, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    normals = np.stack([-steps[:, 1], steps[:, 0]], axis=1)
    chosen = rng.integers(0, len(outline), round(per_mm * STEP_MM * len(outline)))
    across = rng.uniform(-band_mm / 2, band_mm / 2, (len(chosen), 1))
    points = outline[chosen] + across * normals[chosen]
    start = rng.uniform(0.0, math.tau)
    angle = np.mod(np.arctan2(points[:, 1], points[:, 0]) - start, math.tau)
    return rng.permutation(points[angle >= math.radians(gap_degrees)])


def with_outliers(points: FloatArray, rng: np.random.Generator, share: float) -> FloatArray:
    """Some points more, uniform over twice the bounding box."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = (high - low) / 2
    more = rng.uniform(low - margin, high + margin, (round(share * len(points)), 2))
    return rng.permutation(np.vstack([points, more]))


def fault(
    chain: Chain, outline: FloatArray, *, band_mm: float, closed: bool = True, gap_mm: float = 0.0
) -> str:
    """What is wrong with a chain as the order of an outline's points; empty if nothing is.

    Its nodes must lie within a band of the outline, run along it one way only, to within a band,
    and pass all of it but for the gap.
    """
    nodes = chain.nodes_mm
    if chain.closed and not closed:  # a loop in doubt: read as the open run it may be
        ring = np.linalg.norm(np.diff(nodes, axis=0, append=nodes[:1]), axis=1)
        nodes = np.roll(nodes, -int(np.argmax(ring)) - 1, axis=0)
    away, nearest = cKDTree(outline).query(nodes)
    if away.max() > band_mm:
        return f"a node lies {away.max():.2f} mm off"
    length = STEP_MM * len(outline)
    steps = STEP_MM * np.diff(nearest.astype(np.float64))
    if closed:
        ring = np.append(nearest, nearest[0]) if chain.closed else nearest
        steps = STEP_MM * np.diff(ring.astype(np.float64))
        steps = np.mod(steps + length / 2, length) - length / 2
    steps *= np.sign(steps.sum())
    if steps.min() < -band_mm:
        return f"it runs back by {-steps.min():.2f} mm"
    if closed and chain.closed and abs(steps.sum() - length) > 0.01 * length:
        return f"it passes {steps.sum():.1f} of {length:.1f} mm"
    slack = 6.0 * band_mm + 3.0
    if not chain.closed and steps.sum() < length - gap_mm - slack:
        return f"it passes {steps.sum():.1f} of {length:.1f} mm"
    if steps.max() > gap_mm + slack:
        return f"it leaves out {steps.max():.1f} mm"
    return ""


def signed_area(nodes: FloatArray) -> float:
    """Positive for a counter-clockwise loop."""
    x, y = nodes.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2
