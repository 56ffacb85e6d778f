"""A mesh near points moved onto them: at every vertex a quadratic surface through those around it.

How far around is decided vertex by vertex: the window grows as long as what it says agrees with
what all smaller ones said, within their own uncertainty (Lepski's rule; Goldenshluger, Nemirovski
1997). So a broad flank is smoothed widely, and an ear is not smoothed away. Windows of neighbours
are made alike, else the surface would show where they change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray

_WINDOWS = 8
_WIDER = 1.25
_FIRST = 1.5  # grains
_AGREES = 1.0  # standard deviations
_ALIKE = 6  # rounds in which windows of neighbours are made alike
_STRIDE = 0.5  # grains: farther, a window would hold another wall
_FEWEST = 12.0  # points in a window
_SAME_SIDE = 0.3  # cosine: points that look elsewhere are of another wall
_LEVEL = 0.05  # of the variance in the plane: what is left of it on a level wall


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points, what they look like and how certain they are; sorted into boxes."""

    points_mm: FloatArray  # (n, 3)
    outward: FloatArray  # (n, 3)
    counts: FloatArray  # (n,)
    variances_mm2: FloatArray  # (n,), along the outward direction, of one count
    starts: IntArray  # (boxes + 1,)
    low_mm: FloatArray  # (3,)
    box_mm: float
    shape: IntArray  # (3,)


def cloud_of(
    points_mm: FloatArray,
    outward: FloatArray,
    counts: FloatArray,
    *,
    sigma_mm: float,
    axis: FloatArray,
    box_mm: float,
) -> Cloud:
    """Sort points; their noise lies in the planes perpendicular to the axis (3,)."""
    low = points_mm.min(axis=0)
    shape = np.floor((points_mm.max(axis=0) - low) / box_mm).astype(np.int64) + 1
    at = np.floor((points_mm - low) / box_mm).astype(np.int64)
    key = (at[:, 0] * shape[1] + at[:, 1]) * shape[2] + at[:, 2]
    order = np.argsort(key, kind="stable")
    starts = np.searchsorted(key[order], np.arange(int(np.prod(shape)) + 1))
    variances = sigma_mm**2 * (1.0 - (outward @ axis) ** 2 + _LEVEL)
    return Cloud(
        points_mm[order], outward[order], counts[order], variances[order],
        starts.astype(np.int64), low, box_mm, shape,
    )  # fmt: skip


def moved(
    vertices_mm: FloatArray, faces: IntArray, cloud: Cloud, *, grain_mm: float, doubt_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Vertices (v, 3) on the points, and the standard deviation (v,) there; inf without points.

    Parameters
    ----------
    doubt_mm
        How far off the mesh may be: where points tell less than that, it stays.
    """
    normals = vertex_normals(vertices_mm, faces)
    windows = np.float64(_FIRST * grain_mm) * np.power(
        _WIDER, np.arange(_WINDOWS, dtype=np.float64)
    )
    each = np.empty((len(vertices_mm), 0))
    found = _estimated(vertices_mm, normals, *_columns(cloud), windows, each)
    own = _alike(windows[_agreeing(*found)], faces)
    away, sigma = _estimated(vertices_mm, normals, *_columns(cloud), windows[-1:], own[:, None])
    spread = np.minimum(sigma[:, 0], 1e6 * doubt_mm)
    step = np.where(np.isfinite(sigma[:, 0]), away[:, 0], 0.0)
    step *= doubt_mm**2 / (doubt_mm**2 + spread**2)
    step = np.clip(step, -_STRIDE * grain_mm, _STRIDE * grain_mm)
    return vertices_mm + step[:, None] * normals, sigma[:, 0]


def vertex_normals(vertices_mm: FloatArray, faces: IntArray) -> FloatArray:
    """Of a closed mesh, weighed by area, (v, 3)."""
    a, b, c = (vertices_mm[faces[:, k]] for k in range(3))
    normals = np.zeros_like(vertices_mm)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _columns(
    cloud: Cloud,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray, float, IntArray]:
    return (
        cloud.points_mm, cloud.outward, cloud.counts, cloud.variances_mm2,
        cloud.starts, cloud.low_mm, cloud.box_mm, cloud.shape,
    )  # fmt: skip


def _agreeing(away: FloatArray, sigma: FloatArray) -> IntArray:
    """The widest window that agrees with all narrower ones, (v,)."""
    low, high = np.full(len(away), -np.inf), np.full(len(away), np.inf)
    best, alive = np.zeros(len(away), dtype=np.int64), np.ones(len(away), dtype=np.bool_)
    for k in range(away.shape[1]):
        told: BoolArray = np.isfinite(sigma[:, k])
        reach = _AGREES * np.where(told, sigma[:, k], 0.0)
        lower, upper = np.maximum(low, away[:, k] - reach), np.minimum(high, away[:, k] + reach)
        good = alive & told & (lower <= upper)
        best[good], low[good], high[good] = k, lower[good], upper[good]
        alive &= ~told | good
    return best


def _alike(windows: FloatArray, faces: IntArray) -> FloatArray:
    """Windows (v,) that change slowly from vertex to vertex."""
    one, other = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    logs = np.log(windows)
    beside = np.maximum(np.bincount(one, minlength=len(logs)), 1)
    for _ in range(_ALIKE):
        logs = 0.5 * logs + 0.5 * np.bincount(one, logs[other], len(logs)) / beside
    return np.asarray(np.exp(logs))


@njit(cache=True, fastmath=True)
def _estimated(
    vertices: FloatArray,
    normals: FloatArray,
    points: FloatArray,
    outward: FloatArray,
    counts: FloatArray,
    variances: FloatArray,
    starts: IntArray,
    low: FloatArray,
    box: float,
    shape: IntArray,
    windows: FloatArray,
    own: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Distance to the points' surface along each normal, and its deviation, window by window.

    `own` (v, 1) has a window for every vertex, in place of all the others; (v, 0) has none.
    """
    count, many = len(vertices), len(windows)
    away, sigma = np.zeros((count, many)), np.full((count, many), np.inf)
    radii = windows.copy()
    normal, doubled = np.empty((many, 6, 6)), np.empty((many, 6, 6))
    right, held, q = np.empty((many, 6)), np.empty(many), np.empty(6)
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for v in range(count):
        if own.shape[1]:
            radii[0] = own[v, 0]
        n = normals[v]
        t = _across(n)
        b = np.array(
            [n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]]
        )
        reach = radii[many - 1]
        for d in range(3):
            first[d] = max(int(np.floor((vertices[v, d] - reach - low[d]) / box)), 0)
            last[d] = min(int(np.floor((vertices[v, d] + reach - low[d]) / box)), shape[d] - 1)
        normal[:], doubled[:], right[:], held[:] = 0.0, 0.0, 0.0, 0.0
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                row = (i * shape[1] + j) * shape[2]
                if last[2] < first[2]:
                    continue
                for p in range(starts[row + first[2]], starts[row + last[2] + 1]):
                    alike = outward[p, 0] * n[0] + outward[p, 1] * n[1] + outward[p, 2] * n[2]
                    if alike < _SAME_SIDE:
                        continue
                    x, y, z = (
                        points[p, 0] - vertices[v, 0],
                        points[p, 1] - vertices[v, 1],
                        points[p, 2] - vertices[v, 2],
                    )
                    square = x * x + y * y + z * z
                    if square >= reach * reach:
                        continue
                    e = x * t[0] + y * t[1] + z * t[2]
                    f = x * b[0] + y * b[1] + z * b[2]
                    height = x * n[0] + y * n[1] + z * n[2]
                    for r in range(many):
                        radius = radii[r]
                        if square >= radius * radius:
                            continue
                        share = 1.0 - square / (radius * radius)
                        weight = share * share * counts[p] / variances[p]
                        twice = weight * share * share
                        q[0], q[1], q[2] = 1.0, e / radius, f / radius
                        q[3], q[4], q[5] = q[1] * q[1], q[1] * q[2], q[2] * q[2]
                        held[r] += counts[p]
                        for c in range(6):
                            right[r, c] += weight * q[c] * height
                            for d in range(c + 1):
                                normal[r, c, d] += weight * q[c] * q[d]
                                doubled[r, c, d] += twice * q[c] * q[d]
        for r in range(many):
            if held[r] >= _FEWEST:
                away[v, r], sigma[v, r] = _level(normal[r], right[r], doubled[r])
    return away, sigma


@njit(cache=True)
def _across(n: FloatArray) -> FloatArray:
    """A unit vector perpendicular to one."""
    t = np.array([0.0, n[2], -n[1]]) if abs(n[0]) < 0.6 else np.array([-n[2], 0.0, n[0]])
    length = np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    for d in range(3):
        t[d] /= max(length, 1e-300)
    return t


@njit(cache=True)
def _level(normal: FloatArray, right: FloatArray, doubled: FloatArray) -> tuple[float, float]:
    """The constant of a quadratic from lower triangles (6, 6), and its deviation; inf if loose."""
    size = len(right)
    lower = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            total = normal[i, j] * (1.0 + 1e-9 if i == j else 1.0)
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = total / lower[j, j]
            elif total <= 1e-10 * normal[i, i] or total <= 0.0:
                return 0.0, np.inf
            else:
                lower[i, i] = np.sqrt(total)
    # The constant is row . right, with the first row of the inverse.
    row = np.zeros(size)
    for i in range(size):
        total = 1.0 if i == 0 else 0.0
        for k in range(i):
            total -= lower[i, k] * row[k]
        row[i] = total / lower[i, i]
    for i in range(size - 1, -1, -1):
        total = row[i]
        for k in range(i + 1, size):
            total -= lower[k, i] * row[k]
        row[i] = total / lower[i, i]
    value = variance = 0.0
    for i in range(size):
        value += row[i] * right[i]
        for j in range(size):
            variance += row[i] * row[j] * (doubled[i, j] if j <= i else doubled[j, i])
    return value, np.sqrt(max(variance, 0.0))
