"""How far a surface is from triangles on it, measured at places on their edges and inside them.

Each place is a parameter between those of the corners; the surface's point there is held against
the triangles that meet there, not against the point of the triangle with the same parameter: how
the parameter runs within the surface is no error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.nurbs.layout import Sheet
from reconstruction.nurbs.surface_evaluation import evaluate_surface_at

_EDGE_PLACES = np.array([[1.0, 1.0], [3.0, 1.0], [1.0, 3.0]])
_FACE_PLACES = np.array(
    [[1.0, 1, 1], [4.0, 1, 1], [1.0, 4, 1], [1.0, 1, 4], *permutations((3.0, 2.0, 1.0))]
)


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """The points of a layout: on seams they stand twice, at poles many times."""

    parameters: FloatArray  # (n, 2)
    points_mm: FloatArray  # (n, 3)
    same: IntArray  # (n,), the first of the points at one place
    loose: BoolArray  # (n, 2), whether u or v says nothing: at a pole
    held: IntArray  # (n,), a bit for every border that was given its points and has this one


def chordal_error(sheet: Sheet, made: Placed, faces: IntArray) -> float:
    """Greatest distance of the surface from its triangles, mm.

    Over an edge that is the distance to the nearer of its two triangles; where the surface ends or
    may have an edge itself, to the triangles' edge. Borders that were given their points, and the
    triangles that stand on them, are left out.
    """
    corners = made.points_mm[faces]
    tails, heads, ones, others = _edges(made.same, faces)
    ends = np.stack([tails, heads], axis=1)
    given = (made.held[tails] & made.held[heads]) != 0
    touched = np.zeros(len(faces), dtype=np.bool_)
    touched[ones[given]] = touched[others[given]] = True
    sharp = _on_sharp_lines(sheet, made.parameters[ends]) | (ones == others)
    apart, free = ~(touched[ones] | touched[others]), np.flatnonzero(~touched)
    lines, ridges = np.flatnonzero(apart & sharp), np.flatnonzero(apart & ~sharp)
    worst = 0.0
    for shares in _EDGE_PLACES:
        over = _places(sheet, made, ends[lines], shares)
        worst = max(worst, _farthest_from_segments(over, made.points_mm[ends[lines]]))
        over = _places(sheet, made, ends[ridges], shares)
        worst = max(worst, _farthest_from_pairs(over, corners, ones[ridges], others[ridges]))
    for shares in _FACE_PLACES:
        over = _places(sheet, made, faces[free], shares)
        worst = max(worst, _farthest_from_pairs(over, corners, free, free))
    return worst


def _edges(same: IntArray, faces: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Both ends of every edge, and the two faces at it; one face twice where there is one."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    one, other = same[tails], same[heads]
    keys = np.minimum(one, other) * len(same) + np.maximum(one, other)
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    stops = np.append(starts[1:], len(order)) - 1
    first, last = order[starts], order[stops]
    return tails[first], heads[first], first // 3, last // 3


def _on_sharp_lines(sheet: Sheet, ends: FloatArray) -> BoolArray:
    """Which edges (m, 2, 2) lie on lines across which the surface may have an edge."""
    flat = sheet.flat
    found = np.zeros(len(ends), dtype=np.bool_)
    for k, sharp in enumerate((flat.breaks_u[flat.sharp_u], flat.breaks_v[flat.sharp_v])):
        found |= (ends[:, 0, k] == ends[:, 1, k]) & np.isin(ends[:, 0, k], sharp)
    return found


def _places(sheet: Sheet, made: Placed, corners: IntArray, shares: FloatArray) -> FloatArray:
    """Points (m, 3) of the surface between groups (m, k); a u or v that says nothing is ignored."""
    says = ~made.loose[corners]
    says |= ~says.any(axis=1, keepdims=True)
    weights = np.where(says, shares[:, None], 0.0)
    at = (weights * made.parameters[corners]).sum(axis=1) / weights.sum(axis=1)
    return evaluate_surface_at(sheet.surface, at[:, 0], at[:, 1])


@njit(cache=True)
def _farthest_from_segments(places: FloatArray, ends: FloatArray) -> float:
    """Greatest distance of a place (m, 3) from its segment (m, 2, 3)."""
    worst = 0.0
    for n in range(len(places)):
        worst = max(worst, _square_from_segment(places[n], ends[n, 0], ends[n, 1]))
    return math.sqrt(worst)


@njit(cache=True)
def _farthest_from_pairs(
    places: FloatArray, corners: FloatArray, ones: IntArray, others: IntArray
) -> float:
    """Greatest distance of a place (m, 3) from the nearer of its two triangles."""
    worst = 0.0
    for n in range(len(places)):
        square = _square_from_triangle(places[n], corners[ones[n]])
        if others[n] != ones[n] and square > worst:
            square = min(square, _square_from_triangle(places[n], corners[others[n]]))
        worst = max(worst, square)
    return math.sqrt(worst)


@njit(cache=True)
def _square_from_segment(p: FloatArray, a: FloatArray, b: FloatArray) -> float:
    along = square = 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        square += (b[k] - a[k]) ** 2
    share = min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0
    away = 0.0
    for k in range(3):
        away += (p[k] - a[k] - share * (b[k] - a[k])) ** 2
    return away


@njit(cache=True)
def _square_from_triangle(p: FloatArray, corners: FloatArray) -> float:
    """Squared distance of a point from a triangle: from its plane, or from its nearest edge."""
    a, b, c = corners[0], corners[1], corners[2]
    nx = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    ny = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    nz = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    square = nx * nx + ny * ny + nz * nz
    inside = square > 0.0
    for k in range(3):
        s, t = corners[k], corners[(k + 1) % 3]
        ex, ey, ez = t[0] - s[0], t[1] - s[1], t[2] - s[2]
        wx, wy, wz = p[0] - s[0], p[1] - s[1], p[2] - s[2]
        side = (ey * wz - ez * wy) * nx + (ez * wx - ex * wz) * ny + (ex * wy - ey * wx) * nz
        inside = inside and side >= 0.0
    if inside:
        height = (p[0] - a[0]) * nx + (p[1] - a[1]) * ny + (p[2] - a[2]) * nz
        return float(height * height / square)
    nearest: float = min(
        _square_from_segment(p, a, b), _square_from_segment(p, b, c), _square_from_segment(p, c, a)
    )
    return nearest
