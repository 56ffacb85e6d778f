"""A cloud to draw: a twisted vase as a noisy, gappy turntable scan, from a formula and a seed."""

from __future__ import annotations

import math

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray

SEED = 20
HEIGHT_MM = 90.0
_ROWS = 91
_STEPS = 720
_NOISE_MM = 0.15
_LOBES = 5
_TWIST_RAD = 1.1
_STRAYS = 60


def vase_radius_mm(angle_rad: FloatArray, height_mm: FloatArray) -> FloatArray:
    """Radius of the vase: a belly and a neck, five soft lobes that turn with the height."""
    t = np.asarray(height_mm) / HEIGHT_MM
    body = 26.0 + 9.0 * np.sin(math.pi * (1.35 * t + 0.1)) + 4.0 * np.maximum(t - 0.75, 0.0) * 8.0
    lobes = 1.0 + 0.07 * np.cos(_LOBES * (angle_rad - _TWIST_RAD * t)) * np.sin(math.pi * t) ** 0.5
    return np.asarray(body * lobes)


def make_cloud(seed: int = SEED) -> FloatArray:
    """Scan the vase row by row, (n, 3) in mm, axis z: noise, two shadows, drop-outs, strays."""
    rng = np.random.default_rng(seed)
    rows = np.linspace(0.0, HEIGHT_MM, _ROWS)
    angles = np.arange(_STEPS) * (2.0 * math.pi / _STEPS)
    angle, height = np.meshgrid(angles, rows)
    angle, height = angle.ravel(), height.ravel()
    seen = ~_shadowed(angle, height) & (rng.random(len(angle)) > 0.1)
    angle, height = angle[seen], height[seen]
    # A profiler measures along its line of sight: the noise is radial, 0.15 mm.
    radius = vase_radius_mm(angle, height) + rng.normal(0.0, _NOISE_MM, len(angle))
    part = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    strays = rng.uniform([-80.0, -80.0, 0.0], [80.0, 80.0, HEIGHT_MM], (_STRAYS, 3))
    return np.concatenate([part, strays[np.hypot(strays[:, 0], strays[:, 1]) > 50.0]])


def _shadowed(angle: FloatArray, height: FloatArray) -> BoolArray:
    """Two places that the camera never saw: a strip of 20 degrees and a patch of 30."""
    strip = (np.abs(angle - 1.0) < math.radians(10)) & (height > 30.0) & (height < 75.0)
    patch = (np.abs(angle - 3.6) < math.radians(15)) & (height > 12.0) & (height < 26.0)
    return np.asarray(strip | patch)
