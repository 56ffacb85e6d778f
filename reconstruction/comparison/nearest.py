"""The nearest point of a triangle mesh, exactly, for many points.

Per triangle the point is first tried against the plane, then against those edges outside of which
it lies: on a convex shape the nearest point lies on one of them. That stays accurate on needles
where the barycentric formulas of the textbooks (Ericson 2005, ClosestPtPointTriangle) lose digits
as the fourth power of the length.

Points are visited along a Morton curve, and the triangle found for one is the first guess for the
next; the answer does not depend on it, the speed does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.comparison.bounding import STACK_SIZE, BoxTree, box_tree

# Which part of a triangle is nearest. Edge k runs from corner k to corner k + 1.
VERTEX, EDGE, FACE = 0, 3, 6  # codes 0 1 2: corner, 3 4 5: edge, 6: inside

_CORNER_A, _CORNER_B, _CORNER_C = slice(0, 3), slice(3, 6), slice(6, 9)
_NORMAL = slice(9, 12)


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """For each point the nearest point of the mesh."""

    points_mm: FloatArray  # (n, 3)
    triangles: IntArray  # (n,)
    parts: IntArray  # (n,), corner 0-2, edge 3-5, or 6 for the inside


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Triangles ready for queries, about `origin_mm` so that far-off parts lose no digits."""

    origin_mm: FloatArray  # (3,)
    rows: FloatArray  # (m, 12): corners a, b, c and the unit normal (0 when flat)
    items: FloatArray  # (items, 12), the same rows in leaf order
    tree: BoxTree


def prepare(corners_mm: FloatArray) -> Triangles:
    """Build what `nearest` needs from triangles of shape (m, 3, 3)."""
    origin = (corners_mm.min(axis=(0, 1)) + corners_mm.max(axis=(0, 1))) / 2
    shifted = corners_mm - origin
    rows = np.concatenate([shifted.reshape(-1, 9), unit_normals(shifted)], axis=1)
    tree = box_tree(shifted)
    return Triangles(origin, rows, rows[tree.triangle_of_item], tree)


def unit_normals(corners_mm: FloatArray) -> FloatArray:
    """Outward unit normals, (m, 3, 3) -> (m, 3); 0 for a triangle without area.

    They are taken from the two shorter edges: the longest of a needle only adds rounding.
    """
    edges = np.roll(corners_mm, -1, axis=1) - corners_mm
    longest = np.einsum("ijk,ijk->ij", edges, edges).argmax(axis=1)
    rows = np.arange(len(edges))
    normals = np.cross(edges[rows, (longest + 1) % 3], edges[rows, (longest + 2) % 3])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0))


def nearest(points_mm: FloatArray, triangles: Triangles) -> Nearest:
    """Find the nearest mesh point of each of (n, 3) points."""
    shifted = points_mm - triangles.origin_mm
    feet = np.empty_like(shifted)
    found, parts = np.empty((2, len(shifted)), dtype=np.int64)
    tree = triangles.tree
    _query(
        shifted, _morton_order(shifted), triangles.items, triangles.rows, tree.triangle_of_item,
        tree.boxes, tree.children, tree.counts, feet, found, parts,
    )  # fmt: skip
    return Nearest(feet + triangles.origin_mm, found, parts)


def _morton_order(points_mm: FloatArray) -> IntArray:
    """Order along a Morton curve of 1024 cells an axis, so that neighbours follow each other."""
    if len(points_mm) == 0:
        return np.empty(0, dtype=np.int64)
    low = points_mm.min(axis=0)
    width = float((points_mm.max(axis=0) - low).max())
    if width <= 0.0:
        return np.arange(len(points_mm))
    return np.argsort(_morton_codes(points_mm, low, 1023.0 / width))


@njit(cache=True)
def _morton_codes(points_mm: FloatArray, low: FloatArray, scale: float) -> IntArray:
    """Interleave the bits of the three cell numbers."""
    codes = np.empty(len(points_mm), dtype=np.int64)
    for i in range(len(points_mm)):
        code = 0
        for axis in range(3):
            x = int((points_mm[i, axis] - low[axis]) * scale)
            x = (x | (x << 16)) & 0x30000FF
            x = (x | (x << 8)) & 0x300F00F
            x = (x | (x << 4)) & 0x30C30C3
            x = (x | (x << 2)) & 0x9249249
            code |= x << axis
        codes[i] = code
    return codes


@njit(cache=True, nogil=True)
def _query(
    points: FloatArray, visits: IntArray, items: FloatArray, rows: FloatArray, owners: IntArray,
    boxes: FloatArray, children: IntArray, counts: IntArray,
    feet: FloatArray, found: IntArray, parts: IntArray,
) -> None:  # fmt: skip
    """Walk the tree once for every point."""
    stack = np.empty(STACK_SIZE, dtype=np.int64)
    bounds = np.empty(STACK_SIZE)
    guess = 0
    for i in visits:
        p = (points[i, 0], points[i, 1], points[i, 2])
        guess = _descend(p, guess, items, boxes, children, counts, stack, bounds)
        found[i] = owners[guess]
        parts[i] = _foot(p, rows[owners[guess]], feet[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _descend(
    p: tuple[float, float, float], guess: int, items: FloatArray, boxes: FloatArray,
    children: IntArray, counts: IntArray, stack: IntArray, bounds: FloatArray,
) -> int:  # fmt: skip
    """Find the item nearest to p."""
    best, best_squared = guess, _squared_distance(p, items, guess, np.inf)
    stack[0], bounds[0] = 0, 0.0
    waiting = 1
    while waiting > 0:
        waiting -= 1
        if bounds[waiting] >= best_squared:
            continue
        node = stack[waiting]
        near_squared = _box_squared(p, boxes, node, 0)
        far_squared = _box_squared(p, boxes, node, 1)
        near = 0
        if far_squared < near_squared:
            near, near_squared, far_squared = 1, far_squared, near_squared
        for turn in range(2):  # the far one first, so that the near one is on top
            side = 1 - near if turn == 0 else near
            squared = far_squared if turn == 0 else near_squared
            if squared >= best_squared:
                continue
            child = children[node, side]
            if child >= 0:
                stack[waiting], bounds[waiting] = child, squared
                waiting += 1
                continue
            start, stop = -(child + 1), counts[node, side] - (child + 1)
            best, best_squared = _try_leaf(p, items, start, stop, best, best_squared)
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _try_leaf(
    p: tuple[float, float, float],
    items: FloatArray,
    start: int,
    stop: int,
    best: int,
    best_squared: float,
) -> tuple[int, float]:
    """Keep the nearest of the best so far and the items of a leaf."""
    for item in range(start, stop):
        tried = _squared_distance(p, items, item, best_squared)
        if tried < best_squared:
            best, best_squared = item, tried
    return best, best_squared


@njit(cache=True, nogil=True, error_model="numpy")
def _box_squared(p: tuple[float, float, float], boxes: FloatArray, node: int, side: int) -> float:
    """Squared distance of p to a box, 0 inside."""
    x = max(max(boxes[node, side, 0] - p[0], p[0] - boxes[node, side, 3]), 0.0)
    y = max(max(boxes[node, side, 1] - p[1], p[1] - boxes[node, side, 4]), 0.0)
    z = max(max(boxes[node, side, 2] - p[2], p[2] - boxes[node, side, 5]), 0.0)
    return float(x * x + y * y + z * z)


@njit(cache=True, nogil=True, error_model="numpy")
def _squared_distance(
    p: tuple[float, float, float], items: FloatArray, item: int, limit: float
) -> float:
    """Squared distance of p to a triangle, or something above `limit`."""
    wx, wy, wz = p[0] - items[item, 0], p[1] - items[item, 1], p[2] - items[item, 2]
    nx, ny, nz = items[item, 9], items[item, 10], items[item, 11]
    height = wx * nx + wy * ny + wz * nz
    squared = height * height
    if squared >= limit:
        return np.inf
    inside = nx != 0.0 or ny != 0.0 or nz != 0.0
    flat = not inside
    best = np.inf
    for k in range(3):
        a, b = 3 * k, 3 * ((k + 1) % 3)
        ex = items[item, b] - items[item, a]
        ey = items[item, b + 1] - items[item, a + 1]
        ez = items[item, b + 2] - items[item, a + 2]
        wx, wy, wz = p[0] - items[item, a], p[1] - items[item, a + 1], p[2] - items[item, a + 2]
        cx, cy, cz = ey * wz - ez * wy, ez * wx - ex * wz, ex * wy - ey * wx
        if flat or cx * nx + cy * ny + cz * nz < 0.0:
            inside = False
            along = wx * ex + wy * ey + wz * ez
            length = ex * ex + ey * ey + ez * ez
            t = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
            x, y, z = wx - t * ex, wy - t * ey, wz - t * ez
            best = min(best, x * x + y * y + z * z)
    return squared if inside else best


@njit(cache=True, nogil=True, error_model="numpy")
def _foot(p: tuple[float, float, float], row: FloatArray, foot: FloatArray) -> int:
    """Write the nearest point of the triangle to p, return its part."""
    a, normal = row[_CORNER_A], row[_NORMAL]
    flat = normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0
    best, part = np.inf, FACE
    for k in range(3):
        b, e = row[3 * k : 3 * k + 3], 3 * ((k + 1) % 3)
        ex, ey, ez = row[e] - b[0], row[e + 1] - b[1], row[e + 2] - b[2]
        wx, wy, wz = p[0] - b[0], p[1] - b[1], p[2] - b[2]
        cx, cy, cz = ey * wz - ez * wy, ez * wx - ex * wz, ex * wy - ey * wx
        if not flat and cx * normal[0] + cy * normal[1] + cz * normal[2] >= 0.0:
            continue
        length = ex * ex + ey * ey + ez * ez
        t = (wx * ex + wy * ey + wz * ez) / length if length > 0.0 else 0.0
        on = VERTEX + k if t <= 0.0 else (VERTEX + (k + 1) % 3 if t >= 1.0 else EDGE + k)
        t = min(max(t, 0.0), 1.0)
        x, y, z = wx - t * ex, wy - t * ey, wz - t * ez
        squared = x * x + y * y + z * z
        if squared < best:
            best, part = squared, on
            foot[0], foot[1], foot[2] = p[0] - x, p[1] - y, p[2] - z
    if part == FACE:
        height = 0.0
        for j in range(3):
            height += (p[j] - a[j]) * normal[j]
        for j in range(3):
            foot[j] = p[j] - height * normal[j]
    return part
