"""How thick the cloud is and how sharply it bends, estimated from the points of one slice.

A point's neighbours are laid into the frame of their own principal axes and a parabola is fitted
to them. What is left over is the noise sigma; twice the parabola's leading coefficient is the
curvature. The window of neighbours must be much longer than the cloud is thick and much shorter
than the radius, so it grows until the second principal variance is below 5 % of the first
(measured in 50 mm circles: sigma 0.501 where 0.5 was put in; with the smallest window 0.288).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import TooFewPoints

_WINDOWS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
_FLAT = 0.05  # second over first principal variance of a window that sees a line, not a blob
_TREE_POINTS = 4096  # a random subset this large thins a slice without changing its thickness
_PROBES = 128
_SPACING_PROBES = 32  # for the spacing, which a subset would change, and which is measured on all


@dataclass(frozen=True, slots=True)
class Thickness:
    """What one slice's points say of themselves."""

    sigma_mm: float  # standard deviation of the points across the contour
    radius_mm: float  # median local radius of curvature; inf for straight runs
    spacing_mm: float  # median distance to the next point

    @property
    def width_mm(self) -> float:
        """The full width of the cloud, 4 sigma: 95 % of a Gaussian band."""
        return 4.0 * self.sigma_mm


def estimate_thickness(planar_mm: FloatArray, *, seed: int = 0) -> Thickness:
    """Estimate the thickness, the local radius and the spacing of a slice.

    Parameters
    ----------
    planar_mm : (n, 2)
        Points of one slice in its plane, in any order; n >= 8.
    seed : int
        Chooses the random subset of large slices and the probed points.

    Returns
    -------
    Thickness
        Medians over up to 128 probes; a slice with fewer points than a window uses what there is.

    Raises
    ------
    TooFewPoints
        Below 8 points: a parabola through fewer has no residual worth the name.
    """
    if len(planar_mm) < _WINDOWS[0]:
        raise TooFewPoints(f"{len(planar_mm)} points, the thickness of a slice needs {_WINDOWS[0]}")
    rng = np.random.default_rng(seed)
    points = planar_mm
    if len(points) > _TREE_POINTS:
        points = points[rng.choice(len(points), _TREE_POINTS, replace=False)]
    tree = cKDTree(points)
    probes = points[rng.choice(len(points), min(_PROBES, len(points)), replace=False)]
    most = max(_WINDOWS[0], len(points) // 3)
    windows = np.array([k for k in _WINDOWS if k <= most])
    _, neighbours = tree.query(probes, k=windows[-1])
    parabolas = _fit_growing(points[neighbours], windows)
    sigma, curvature = np.median(parabolas, axis=0)
    spacing = float(np.median(_nearest(planar_mm, probes[:_SPACING_PROBES])))
    return Thickness(
        sigma_mm=float(sigma),
        radius_mm=float(1.0 / curvature) if curvature > 0 else math.inf,
        spacing_mm=spacing if math.isfinite(spacing) else 0.0,
    )


@njit(cache=True)
def _nearest(points: FloatArray, probes: FloatArray) -> FloatArray:
    """Distance from each probe to the nearest other point (n, 2); a probe is one of the points."""
    found = np.full(len(probes), np.inf)
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        for q in range(len(probes)):
            square = (x - probes[q, 0]) ** 2 + (y - probes[q, 1]) ** 2
            # Zero is the probe itself, or its double: neither says how densely was sampled.
            if 0.0 < square < found[q]:
                found[q] = square
    return np.asarray(np.sqrt(found))


@njit(cache=True)
def _fit_growing(hoods: FloatArray, windows: IntArray) -> FloatArray:
    """Sigma and curvature (q, 2) of neighbourhoods (q, k, 2), nearest first, grown until flat.

    Sigma comes from the first flat window, where the parabola fits best; the curvature from the
    last one, since its error falls with the square of the window's length.
    """
    found = np.empty((len(hoods), 2))
    for q in range(len(hoods)):
        noted = False
        for window in windows:
            sigma, curvature, flatness = _fit_parabola(hoods[q, :window])
            flat = flatness < _FLAT
            if noted and not flat:
                break
            if flat and not noted:
                found[q, 0], noted = sigma, True
            found[q, 1] = curvature
        if not noted:
            found[q, 0] = sigma
    return found


@njit(cache=True)
def _fit_parabola(hood: FloatArray) -> tuple[float, float, float]:
    """Sigma, curvature and flatness of one window (k, 2)."""
    count = len(hood)
    mean_x, mean_y = hood[:, 0].mean(), hood[:, 1].mean()
    xx = xy = yy = 0.0
    for n in range(count):
        x, y = hood[n, 0] - mean_x, hood[n, 1] - mean_y
        xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
    tilt = 0.5 * math.atan2(2.0 * xy, xx - yy)
    cosine, sine = math.cos(tilt), math.sin(tilt)
    swing = math.hypot(0.5 * (xx - yy), xy)
    longer, shorter = (0.5 * (xx + yy) + swing) / count, (0.5 * (xx + yy) - swing) / count
    if longer <= 0.0:
        return 0.0, 0.0, 1.0
    # Scaled to unit variance, so that the sums of powers below stay near one.
    length = math.sqrt(longer)
    s3 = s4 = d0 = d1 = d2 = dd = 0.0
    for n in range(count):
        x, y = hood[n, 0] - mean_x, hood[n, 1] - mean_y
        s, d = (cosine * x + sine * y) / length, cosine * y - sine * x
        square = s * s
        s3, s4 = s3 + square * s, s4 + square * square
        d0, d1, d2, dd = d0 + d, d1 + d * s, d2 + d * square, dd + d * d
    # Means: <1> = 1, <s> = 0, <s2> = 1 by construction; orthogonal basis 1, s, s2 - <s3> s - 1.
    s3, s4, d0, d1, d2, dd = s3 / count, s4 / count, d0 / count, d1 / count, d2 / count, dd / count
    norm = s4 - s3 * s3 - 1.0
    bend = (d2 - s3 * d1 - d0) / norm if norm > 1e-9 else 0.0
    left = max(0.0, dd - d0 * d0 - d1 * d1 - bend * bend * norm) * count
    freedom = count - 3
    # The median of chi squared, not its mean, because the caller takes the median over probes.
    typical = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3
    return math.sqrt(left / typical), 2.0 * abs(bend) / longer, max(0.0, shorter) / longer
