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
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints

_WINDOWS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
_FLAT = 0.05  # second over first principal variance of a window that sees a line, not a blob
_TREE_POINTS = 8192  # a random subset this large thins a slice without changing its thickness
_PROBES = 192


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
        Medians over up to 192 probes; a slice with fewer points than a window uses what there is.

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
    # Shuffled, so that equal points do not unbalance the tree.
    tree = cKDTree(points)
    probes = points[rng.choice(len(points), min(_PROBES, len(points)), replace=False)]
    windows = [k for k in _WINDOWS if k <= max(_WINDOWS[0], len(points) // 3)]
    distances, neighbours = tree.query(probes, k=windows[-1])
    parabolas = _fit_growing(points[neighbours], windows)
    sigma, curvature = np.median(parabolas, axis=0)
    return Thickness(
        sigma_mm=float(sigma),
        radius_mm=float(1.0 / curvature) if curvature > 0 else math.inf,
        spacing_mm=float(np.median(distances[:, 1])),
    )


def _fit_growing(hoods_mm: FloatArray, windows: list[int]) -> FloatArray:
    """Sigma and curvature (q, 2) of neighbourhoods (q, k, 2) that grow until they are flat.

    Sigma comes from the first flat window, where the parabola fits best; the curvature from the
    last one, since its error falls with the square of the window's length.
    """
    best = np.full((len(hoods_mm), 2), np.nan)
    growing = np.arange(len(hoods_mm))
    for window in windows:
        sigma, curvature, flatness = _fit_parabolas(hoods_mm[growing, :window])
        fresh = np.isnan(best[growing, 0])
        flat = flatness < _FLAT
        takes = flat | fresh
        best[growing[takes], 1] = curvature[takes]
        noted = fresh & (flat | (window == windows[-1]))
        best[growing[noted], 0] = sigma[noted]
        growing = growing[flat | np.isnan(best[growing, 0])]
        if len(growing) == 0:
            break
    return best


def _fit_parabolas(hoods_mm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    centred = hoods_mm - hoods_mm.mean(axis=1, keepdims=True)
    covariance = np.einsum("qki,qkj->qij", centred, centred) / hoods_mm.shape[1]
    variances, axes = np.linalg.eigh(covariance)
    along = np.einsum("qki,qi->qk", centred, axes[:, :, 1])
    across = np.einsum("qki,qi->qk", centred, axes[:, :, 0])
    # Scaled to unit length so that the normal equations stay well conditioned.
    length = np.sqrt(np.maximum(variances[:, 1], np.finfo(float).tiny))
    s = along / length[:, None]
    design = np.stack([np.ones_like(s), s, s * s], axis=2)
    normal = np.einsum("qki,qkj->qij", design, design)
    right = np.einsum("qki,qk->qi", design, across)
    ridge = 1e-9 * np.eye(3)
    coefficients = np.linalg.solve(normal + ridge, right[..., None])[..., 0]
    residual = across - np.einsum("qki,qi->qk", design, coefficients)
    freedom = hoods_mm.shape[1] - 3
    # The median of chi squared, not its mean, because the caller takes the median over probes.
    typical = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3
    sigma = np.sqrt((residual**2).sum(axis=1) / typical)
    curvature = 2.0 * np.abs(coefficients[:, 2]) / length**2
    flatness = variances[:, 0] / np.maximum(variances[:, 1], np.finfo(float).tiny)
    return sigma, curvature, flatness
