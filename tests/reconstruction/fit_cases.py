"""Outlines with noise, and chains made the crude way: the true order cut into even pieces."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.chain import Chain

Outline = Callable[[FloatArray], FloatArray]  # shares of the length (m,) -> places (m, 2)


def along(dense: FloatArray) -> Outline:
    """Parametrise a dense polyline by its length."""
    steps = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    shares = np.concatenate([[0.0], steps.cumsum()]) / steps.sum()
    return lambda share: np.column_stack([np.interp(share, shares, axis) for axis in dense.T])


def circle(radius: float = 50.0) -> Outline:
    return lambda share: (
        radius * np.column_stack([np.cos(2 * np.pi * share), np.sin(2 * np.pi * share)])
    )


def ellipse() -> Outline:
    turn = np.linspace(0, 2 * np.pi, 20001)
    return along(np.column_stack([60 * np.cos(turn), 30 * np.sin(turn)]))


def superformula() -> Outline:
    """Five lobes, exponents 3, 6, 6, mean radius 50 (Gielis 2003)."""
    turn = np.linspace(0, 2 * np.pi, 20001)
    radius = (np.cos(1.25 * turn) ** 6 + np.sin(1.25 * turn) ** 6) ** (-1 / 3)
    radius *= 50 / radius[:-1].mean()
    return along(radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


def wave() -> Outline:
    """An open S of 100 mm."""
    x = np.linspace(0, 100, 20001)
    return along(np.column_stack([x, 15 * np.sin(2 * np.pi * x / 100)]))


def noisy(
    outline: Outline, count: int, sigma: float, seed: int, *, gap: tuple[float, float] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Points at random places of the outline with isotropic noise, in order; and their shares."""
    rng = np.random.default_rng(seed)
    share = np.sort(rng.random(count))
    points = outline(share) + rng.normal(0.0, sigma, (count, 2))
    if gap is None:
        return points, share
    kept = (share < gap[0]) | (share > gap[1])
    return points[kept], share[kept]


def chain_of(
    points: FloatArray, share: FloatArray, sigma: float, *, pieces: int = 100, closed: bool = True
) -> Chain:
    """Mean places of even pieces; an empty piece is a gap."""
    at = np.minimum((share * pieces).astype(np.int64), pieces - 1)
    filled = np.unique(at)
    nodes = np.array([points[at == piece].mean(axis=0) for piece in filled])
    steps = np.diff(filled, append=filled[0] + pieces)
    ways = steps if closed else steps[:-1]
    gaps = tuple(int(i) for i in np.flatnonzero(ways > 1))
    return Chain(nodes, np.full(len(nodes), sigma), closed, gaps)


def shuffled(points: FloatArray, seed: int = 0) -> FloatArray:
    return np.random.default_rng(seed).permutation(points)


def rms_to(places: FloatArray, outline: Outline) -> float:
    """Root mean square distance of places to a closed outline, by its dense polyline."""
    return float(np.sqrt(np.mean(distances_to(places, outline) ** 2)))


def distances_to(places: FloatArray, outline: Outline) -> FloatArray:
    corners = outline(np.linspace(0, 1, 8001))
    nearest = cKDTree(corners).query(places)[1]
    here = np.clip(nearest, 1, len(corners) - 2)
    tangents = corners[here + 1] - corners[here - 1]
    arms = places - corners[here]
    across = tangents[:, 0] * arms[:, 1] - tangents[:, 1] * arms[:, 0]
    return np.asarray(np.abs(across) / np.linalg.norm(tangents, axis=1))
