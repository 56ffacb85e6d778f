"""Raw points to arc cells: what of a slice is kept when its points are dropped.

A cell holds the points nearest to one vertex of a fine polyline along the curve: their number, mean
and covariance, the two points that lie farthest to either side, and their true heights (a slice is
never flattened: a sloping wall shows in the covariance of place and height). A fit from cells much
shorter than its knot spans is the fit from the points, to second order (`sweep`); cells can be
re-parametrised and re-knotted with whatever curve comes later.

    .  . :. :.  . :      points, one pass, any order
    |----|----|----|     one cell for each vertex, borders half-way
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray, frozen

_LONGEST_HOP = 40.0  # vertices
_RECORD = 8  # count, x, y, xx, xy, yy, least and greatest distance: one line of the cache


@dataclass(frozen=True, slots=True, eq=False)
class ArcCells:
    """Points gathered along a curve, in its order; or single points, each a cell of one."""

    counts: FloatArray  # (m,), positive
    means_mm: FloatArray  # (m, 2)
    covariances_mm2: FloatArray  # (m, 3): xx, xy, yy
    extremes_mm: FloatArray  # (m, 2, 2): the points farthest to the right and to the left
    heights_mm: FloatArray  # (m,), mean; empty without heights
    height_covariances_mm2: FloatArray  # (m, 3): zx, zy, zz; empty without heights

    def __post_init__(self) -> None:
        for name in self.__slots__:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def total(self) -> int:
        """How many points the cells hold."""
        return round(float(self.counts.sum()))

    def only(self, rows: IntArray) -> ArcCells:
        """Return the cells of these rows, in their order."""
        return ArcCells(*(getattr(self, name)[rows] if len(getattr(self, name)) else
                          getattr(self, name) for name in self.__slots__))  # fmt: skip


def cells_of_points(points_mm: FloatArray, heights_mm: FloatArray | None = None) -> ArcCells:
    """Make every point a cell of its own."""
    count = len(points_mm)
    heights = np.empty(0) if heights_mm is None else heights_mm
    spread = np.empty((0, 3)) if heights_mm is None else np.zeros((count, 3))
    extremes = np.repeat(points_mm[:, None, :], 2, axis=1)
    return ArcCells(np.ones(count), points_mm, np.zeros((count, 3)), extremes, heights, spread)


def gather(
    points_mm: FloatArray,
    vertices_mm: FloatArray,
    normals: FloatArray,
    reach_mm: FloatArray,
    *,
    closed: bool,
    heights_mm: FloatArray | None = None,
) -> tuple[ArcCells, IntArray, int]:
    """Gather points (n, 2) at the vertices (v, 2) of a polyline, in one pass.

    Returns
    -------
    cells, the vertex of each cell, and how many points lay farther than `reach_mm` (v,) from the
    nearest vertex's tangent and were left out.
    """
    grid = _lay_grid(points_mm, vertices_mm, reach_mm, closed=closed)
    heights = np.empty(0) if heights_mm is None else heights_mm
    records, upward, extremes, far = _accumulate(
        points_mm, heights, _hops(vertices_mm, normals), np.column_stack([normals, reach_mm]),
        grid.low_mm, grid.edge_mm, grid.starts, closed=closed,
    )  # fmt: skip
    at = np.flatnonzero(records[:, 0] > 0)
    outermost = points_mm[extremes[at]]
    return _cells(records[at], upward[at], outermost, vertices_mm[at]), at, far


def nearest_vertices(
    points_mm: FloatArray, vertices_mm: FloatArray, reach_mm: FloatArray
) -> IntArray:
    """Return the nearest vertex of every point, -1 where none is within reach; (n, 2) -> (n,)."""
    distances, nearest = cKDTree(vertices_mm).query(points_mm)
    found = np.asarray(nearest, dtype=np.int64)
    return np.where(np.asarray(distances) <= reach_mm[found], found, -1)


def _hops(vertices: FloatArray, normals: FloatArray) -> FloatArray:
    """A vertex in a row, and its tangent over the step to the next: places to vertices ahead."""
    steps = np.linalg.norm(np.diff(vertices, axis=0, append=vertices[:1]), axis=1)
    steps[-1] = steps[-2]  # an open line does not close
    tangents = np.column_stack([normals[:, 1], -normals[:, 0]])
    return np.column_stack([vertices, tangents / np.maximum(steps, 1e-300)[:, None]])


def _cells(
    records: FloatArray, upward: FloatArray, outermost: FloatArray, origins: FloatArray
) -> ArcCells:
    """Sums about each cell's vertex to means and covariances."""
    counts = records[:, 0]
    x, y, *squares = (records[:, 1:6] / counts[:, None]).T
    plane = np.column_stack(squares) - np.column_stack([x * x, x * y, y * y])
    means = np.column_stack([x, y]) + origins
    if not upward.shape[1]:
        return ArcCells(counts, means, plane, outermost, np.empty(0), np.empty((0, 3)))
    z, *products = (upward / counts[:, None]).T
    slopes = np.column_stack(products) - np.column_stack([z * x, z * y, z * z])
    return ArcCells(counts, means, plane, outermost, z, slopes)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    low_mm: FloatArray  # (2,)
    edge_mm: float
    # The vertex nearest to a box, and one of another stretch that may be nearer; -1 for none.
    starts: NDArray[np.int32]  # (nx, ny, 2)


def _lay_grid(
    points: FloatArray, vertices: FloatArray, reach: FloatArray, *, closed: bool
) -> _Grid:
    steps = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
    step, margin = float(steps.max(initial=0.0)), float(reach.max())
    low, high = vertices.min(axis=0) - margin, vertices.max(axis=0) + margin
    sides = high - low
    edge = max(step, margin / 3, math.sqrt(float(sides[0] * sides[1]) / 60_000), 1e-300)
    shape = np.floor(sides / edge).astype(np.int64) + 1
    return _Grid(low, edge, _stamp(vertices, reach, low, edge, shape, step, closed=closed))


@njit(cache=True, nogil=True, error_model="numpy")
def _stamp(
    vertices: FloatArray,
    reach: FloatArray,
    low: FloatArray,
    edge: float,
    shape: IntArray,
    step: float,
    *,
    closed: bool,
) -> NDArray[np.int32]:
    """Enter vertices in the boxes they may be nearest in; a few an edge will do, to start from."""
    count = len(vertices)
    stride = max(int(edge / max(step, 1e-300)), 1)
    slack = 1.5 * edge + stride * step
    starts = np.full((shape[0], shape[1], 2), -1, np.int32)
    best = np.full((shape[0], shape[1]), np.inf)
    other = np.full((shape[0], shape[1]), np.inf)
    for again in range(2):
        for v in range(0, count, stride):
            radius = reach[v] + slack
            i0 = max(int((vertices[v, 0] - radius - low[0]) / edge), 0)
            i1 = min(int((vertices[v, 0] + radius - low[0]) / edge), shape[0] - 1)
            j0 = max(int((vertices[v, 1] - radius - low[1]) / edge), 0)
            j1 = min(int((vertices[v, 1] + radius - low[1]) / edge), shape[1] - 1)
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    dx = low[0] + (i + 0.5) * edge - vertices[v, 0]
                    dy = low[1] + (j + 0.5) * edge - vertices[v, 1]
                    away = math.sqrt(dx * dx + dy * dy)
                    if not again:
                        if away < best[i, j]:
                            best[i, j], starts[i, j, 0] = away, v
                        continue
                    # Half a diagonal either way, for the point's place in its box.
                    if away > best[i, j] + slack or away >= other[i, j]:
                        continue
                    apart = abs(v - starts[i, j, 0])
                    if closed:
                        apart = min(apart, count - apart)
                    if apart * step > best[i, j] + 2.0 * edge:
                        other[i, j], starts[i, j, 1] = away, v
    return starts


@njit(cache=True, nogil=True, inline="always")
def _square(vertices: FloatArray, v: int, x: float, y: float) -> float:
    dx, dy = x - vertices[v, 0], y - vertices[v, 1]
    return float(dx * dx + dy * dy)


@njit(cache=True, nogil=True, inline="always")
def _hop(
    hops: FloatArray,
    v: int,
    x: float,
    y: float,
    closed: bool,  # noqa: FBT001
) -> int:
    """Jump to the vertex abreast, as far as the tangent tells."""
    count = len(hops)
    ahead = (x - hops[v, 0]) * hops[v, 2] + (y - hops[v, 1]) * hops[v, 3]
    w = v + int(min(max(ahead, -_LONGEST_HOP), _LONGEST_HOP) + (count + 0.5)) - count
    if closed:
        return w - count if w >= count else (w + count if w < 0 else w)
    return min(max(w, 0), count - 1)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _accumulate(
    points: FloatArray,
    heights: FloatArray,
    hops: FloatArray,
    bounds: FloatArray,
    low: FloatArray,
    edge: float,
    starts: NDArray[np.int32],
    *,
    closed: bool,
) -> tuple[FloatArray, FloatArray, IntArray, int]:
    """Sum up by vertex: from the box's own, two hops lead to the one abreast of the point.

    It need not be the very nearest, for the sums are exact wherever a point is filed; a search for
    the nearest would take twice the time. `bounds` has normals and reaches.
    """
    far = 0
    count = len(hops)
    records = np.zeros((count, _RECORD))
    upward = np.zeros((count, 4 if len(heights) else 0))
    extremes = np.zeros((count, 2), np.int64)
    inverse = 1.0 / edge
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        fx, fy = (x - low[0]) * inverse, (y - low[1]) * inverse
        if not (0.0 <= fx < starts.shape[0] and 0.0 <= fy < starts.shape[1]):
            far += 1
            continue
        first, second = starts[int(fx), int(fy), 0], starts[int(fx), int(fy), 1]
        if first < 0:
            far += 1
            continue
        v = _hop(hops, _hop(hops, first, x, y, closed), x, y, closed)
        if second >= 0:
            w = _hop(hops, _hop(hops, second, x, y, closed), x, y, closed)
            v = w if _square(hops, w, x, y) < _square(hops, v, x, y) else v
        x, y = x - hops[v, 0], y - hops[v, 1]
        across = x * bounds[v, 0] + y * bounds[v, 1]
        if not math.fabs(across) <= bounds[v, 2]:
            far += 1
            continue
        record = records[v]
        if record[0] == 0.0 or across < record[6]:
            record[6], extremes[v, 0] = across, n
        if record[0] == 0.0 or across > record[7]:
            record[7], extremes[v, 1] = across, n
        record[0] += 1.0
        record[1] += x
        record[2] += y
        record[3] += x * x
        record[4] += x * y
        record[5] += y * y
        if len(heights) > 0:
            z = heights[n]
            upward[v, 0] += z
            upward[v, 1] += z * x
            upward[v, 2] += z * y
            upward[v, 3] += z * z
    return records, upward, extremes, far
