"""Foot points on a surface, and what cells of points tell about it there.

A cell stands for its points to second order. With the second fundamental form II (positive where
the surface bends towards its normal), the points' covariance T and that of their noise N, both in
the tangent plane, the mean of the cell lies off the surface by 1/2 tr(II (T - N)) along the normal:
an arc's centroid lies inside it, and noise moves points to the outside of a bend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, frozen
from reconstruction.nurbs import evaluate_surface
from reconstruction.skinning.net import Net, derivatives_at
from reconstruction.skinning.outlines import Moments

_BEFORE = 1e-6  # a crease
_BESIDE = 0.25  # spans beside a wall
_AT_ONCE = 16_384  # cells: derivatives of all would take more memory than the cells themselves
_A_SPAN = 3  # places of the net a span, to look for the nearest


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """Where cells stand on a surface, and how far off."""

    u: FloatArray  # (m,)
    v: FloatArray  # (m,)
    normals: FloatArray  # (m, 3)
    distances_mm: FloatArray  # (m,), of the points' mean from the surface, along the normal
    scatters_mm2: FloatArray  # (m,), variance of the points along the normal about that

    def __post_init__(self) -> None:
        for name in self.__slots__:
            object.__setattr__(self, name, frozen(getattr(self, name)))


def find_feet(
    net: Net,
    moments: Moments,
    u: FloatArray,
    v: FloatArray,
    noise_mm2: FloatArray,
    *,
    rounds: int,
) -> Feet:
    """Refine rough foot points (m,), (m,) by Newton's method and measure from there.

    Parameters
    ----------
    noise_mm2
        (3, 3), covariance of a point's error.
    """
    parts = [
        _feet(net, moments, u, v, slice(start, start + _AT_ONCE), noise_mm2, rounds=rounds)
        for start in range(0, max(len(u), 1), _AT_ONCE)
    ]
    return Feet(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _feet(
    net: Net,
    moments: Moments,
    every_u: FloatArray,
    every_v: FloatArray,
    part: slice,
    noise_mm2: FloatArray,
    *,
    rounds: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """What `Feet` holds, of some of the cells."""
    u, v, means = every_u[part], every_v[part], moments.means_mm[part]
    end_u, end_v = net.spans
    low, high = _faces(net, u)
    for _ in range(rounds):
        derivatives = derivatives_at(net, u, v)
        u, v = _stepped(
            derivatives, means, u, v, low, high, end_u, end_v,
            closed_u=net.closed_u, closed_v=net.closed_v,
        )  # fmt: skip
    derivatives = derivatives_at(net, u, v)
    return u, v, *_measured(derivatives, means, moments.covariances_mm2[part], noise_mm2)


def _faces(net: Net, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds in u (m,) of the face that each foot (m,) stands on; it does not step over a crease.

    The face that holds the seam goes on beyond it.
    """
    creases, end_u = net.creases.astype(np.float64), net.spans[0]
    if not len(creases):
        return np.full(len(u), -np.inf), np.full(len(u), np.inf)
    ends = (creases[-1] - end_u, creases[0] + end_u) if net.closed_u else (-np.inf, np.inf)
    around = np.concatenate([ends[:1], creases, ends[1:]])
    face = np.searchsorted(creases, u, "right")
    return around[face], around[face + 1] - _BEFORE


def nearby(net: Net, cells: Moments, reach_mm: float) -> tuple[Moments, FloatArray, FloatArray]:
    """Cells within reach of a net, and rough foot points."""
    end_u, end_v = net.spans
    u = np.linspace(0.0, end_u, _A_SPAN * int(end_u), endpoint=not net.closed_u)
    v = np.linspace(0.0, end_v, _A_SPAN * int(end_v), endpoint=not net.closed_v)
    grid = evaluate_surface(net.surface(), u, v)
    _, found = cKDTree(grid.reshape(-1, 3)).query(cells.means_mm)
    at_u, at_v = u[found // len(v)], v[found % len(v)]
    feet = find_feet(net, cells, at_u, at_v, np.zeros((3, 3)), rounds=4)
    # Away from a border of the surface the arm is the normal's; over one it is longer.
    arms = cells.means_mm - derivatives_at(net, feet.u, feet.v)[:, 0]
    near = np.linalg.norm(arms, axis=1) <= reach_mm
    kept = Moments(cells.counts[near], cells.means_mm[near], cells.covariances_mm2[near])
    return kept, feet.u[near], feet.v[near]


def off_the_walls(net: Net, cells: Moments, u: FloatArray, v: FloatArray) -> FloatArray:
    """Rough foot points u (m,) with those on a step's wall, which nobody has seen, beside it.

    Of an open net; its creases are the edges of such walls, two and two.
    """
    if not len(net.walls):
        return u
    moved = np.array(u)
    for low, high in net.creases.reshape(-1, 2).astype(np.float64):
        on = np.flatnonzero((u > low - _BEFORE) & (u < high))
        away = [
            np.linalg.norm(
                cells.means_mm[on] - derivatives_at(net, np.full(len(on), edge), v[on])[:, 0],
                axis=1,
            )
            for edge in (low, high)
        ]
        moved[on] = np.where(away[0] < away[1], low - _BESIDE, high + _BESIDE)
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def _stepped(
    derivatives: FloatArray, means: FloatArray, u: FloatArray, v: FloatArray, low: FloatArray,
    high: FloatArray, end_u: float, end_v: float, *, closed_u: bool, closed_v: bool,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """One damped Newton step for every foot point, a knot at most."""
    new_u, new_v = u.copy(), v.copy()
    for m in range(len(u)):
        guu = guv = gvv = ru = rv = huu = huv = hvv = 0.0
        for d in range(3):
            arm = means[m, d] - derivatives[m, 0, d]
            du, dv = derivatives[m, 1, d], derivatives[m, 2, d]
            guu += du * du
            guv += du * dv
            gvv += dv * dv
            ru += arm * du
            rv += arm * dv
            huu += arm * derivatives[m, 3, d]
            huv += arm * derivatives[m, 4, d]
            hvv += arm * derivatives[m, 5, d]
        # Newton's matrix while it is safely positive, Gauss's otherwise.
        a, b, c = guu - huu, guv - huv, gvv - hvv
        if not (a > 0.25 * guu and c > 0.25 * gvv and a * c - b * b > 0.1 * (guu * gvv)):
            a, b, c = guu, guv, gvv
        determinant = a * c - b * b
        if not determinant > 1e-9 * a * c:
            step_u = ru / a if a > 0.0 else 0.0
            step_v = rv / c if c > 0.0 else 0.0
        else:
            step_u, step_v = (c * ru - b * rv) / determinant, (a * rv - b * ru) / determinant
        at_u = min(max(u[m] + min(max(step_u, -1.0), 1.0), low[m]), high[m])
        new_u[m] = _inside(at_u, end_u, closed_u)
        new_v[m] = _inside(v[m] + min(max(step_v, -1.0), 1.0), end_v, closed_v)
    return new_u, new_v


@njit(cache=True, nogil=True, inline="always")
def _inside(t: float, end: float, closed: bool) -> float:  # noqa: FBT001 (a kernel)
    if not closed:
        return min(max(t, 0.0), end)
    t = t + end if t < 0.0 else t
    return t - end if t >= end else t


@njit(cache=True, nogil=True, error_model="numpy")
def _measured(
    derivatives: FloatArray, means: FloatArray, covariances: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    count = len(means)
    normals, distances, scatters = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for m in range(count):
        du, dv = derivatives[m, 1], derivatives[m, 2]
        nx = du[1] * dv[2] - du[2] * dv[1]
        ny = du[2] * dv[0] - du[0] * dv[2]
        nz = du[0] * dv[1] - du[1] * dv[0]
        area = np.sqrt(nx * nx + ny * ny + nz * nz)
        if not area > 1e-300:
            continue
        n = (nx / area, ny / area, nz / area)
        normals[m] = n
        guu = guv = gvv = luu = luv = lvv = distance = across = 0.0
        cuu = cuv = cvv = 0.0
        for d in range(3):
            distance += (means[m, d] - derivatives[m, 0, d]) * n[d]
            guu += du[d] * du[d]
            guv += du[d] * dv[d]
            gvv += dv[d] * dv[d]
            luu += derivatives[m, 3, d] * n[d]
            luv += derivatives[m, 4, d] * n[d]
            lvv += derivatives[m, 5, d] * n[d]
            for e in range(3):
                across += n[d] * covariances[m, d, e] * n[e]
                c = covariances[m, d, e] - noise[d, e]
                cuu += du[d] * c * du[e]
                cuv += du[d] * c * dv[e]
                cvv += dv[d] * c * dv[e]
        determinant = area * area
        # Contravariant: the shape operator applied to the tangential covariance.
        iuu, iuv, ivv = gvv / determinant, -guv / determinant, guu / determinant
        tuu = iuu * (iuu * cuu + iuv * cuv) + iuv * (iuu * cuv + iuv * cvv)
        tuv = iuu * (iuv * cuu + ivv * cuv) + iuv * (iuv * cuv + ivv * cvv)
        tvv = iuv * (iuv * cuu + ivv * cuv) + ivv * (iuv * cuv + ivv * cvv)
        bent = luu * tuu + 2 * luv * tuv + lvv * tvv
        distances[m] = distance - 0.5 * bent
        scatters[m] = max(across, 0.0)
    return normals, distances, scatters
