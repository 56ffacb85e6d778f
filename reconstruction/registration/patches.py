r"""Where points are a surface: sites spread over it, and at each the quadric through raw points.

A site's patch is a cylinder about its normal; the surface in it, in the normal's frame,

    w = a + b u + c v + d u^2 + e u v + f v^2      least squares, those beyond 3 sigma left out once

so that its height a at the site is free of the bend that a plane would mistake for a shift. Sites
keep a distance that makes their patches nearly disjoint: what noise does to one it does not do to
the next, and the residuals of a registration by patches may be counted as independent.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.errors import TooFewPoints

_WANTED = 1200  # sites
_RADIUS = 0.75  # of the side of a site's cell
_APART = 1.6  # radii between two sites
_WIDER, _WIDENINGS = 1.3, 8  # where rows of points lie too far apart for patches
_ENOUGH_SITES = 0.5  # of all, with a sound patch
_FEWEST_SITES = 40
_FEWEST, _MOST = 12, 300  # points of a patch
_STRAY = 3.0  # standard deviations
_MOST_LEVERAGE = 12.0  # of the height at the middle; a patch all round has 3 to 5
_MAD = 1.4826


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Points of one scan of a part, in that scan's frame."""

    points_mm: FloatArray  # (n, 3)
    towards: FloatArray | None = None  # (n, 3), unit, to the sensor that saw them; None: unknown

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_mm", frozen(self.points_mm))


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Quadrics at sites; all arrays of m rows."""

    sites_mm: FloatArray  # (m, 3)
    normals: FloatArray  # (m, 3), outward where the view says so
    heights_mm: FloatArray  # of the surface over the site, along the normal that was given
    variances_mm2: FloatArray  # of the heights
    slopes: FloatArray  # (m, 3, 3), covariance of the unit normal
    sound: BoolArray

    def of(self, rows: BoolArray | IntArray) -> Patches:
        """Some of them."""
        return Patches(
            self.sites_mm[rows],
            self.normals[rows],
            self.heights_mm[rows],
            self.variances_mm2[rows],
            self.slopes[rows],
            self.sound[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Surveyed:
    """A view with its sites."""

    view: View
    tree: cKDTree  # of its points
    patches: Patches  # sound ones only; their sites lie on the surface
    site_tree: cKDTree
    radius_mm: float
    share_sound: float


def survey(view: View, radius_mm: float | None = None) -> Surveyed:
    """Spread sites over a view; with patches of a given radius, or one that suits its points.

    Raises
    ------
    TooFewPoints
        The points are nowhere dense enough to be a surface.
    """
    points_mm = view.points_mm
    if len(points_mm) < _FEWEST * _FEWEST_SITES:
        raise TooFewPoints(f"registration: a view of {len(points_mm)} points is too small")
    tree = cKDTree(points_mm)
    side_mm = _side(points_mm) if radius_mm is None else radius_mm / _RADIUS
    for _ in range(_WIDENINGS if radius_mm is None else 1):
        found = _surveyed(view, tree, side_mm)
        enough = len(found.patches.sites_mm) >= _FEWEST_SITES
        if enough and (found.share_sound >= _ENOUGH_SITES or radius_mm is not None):
            return found
        side_mm *= _WIDER
    raise TooFewPoints(
        "registration: its points are nowhere a surface, since rows of them lie too far apart;"
        " scan more slices"
    )


def fit_patches(
    points_mm: FloatArray, tree: cKDTree, sites_mm: FloatArray, normals: FloatArray, radius: float
) -> Patches:
    """Quadrics of points (n, 3) at sites (m, 3) in the frames of given normals (m, 3)."""
    count = len(sites_mm)
    heights, variances = np.zeros(count), np.full(count, np.inf)
    turned, slopes = normals.copy(), np.zeros((count, 3, 3))
    sound = np.zeros(count, np.bool_)
    for row, near in enumerate(_within(tree, sites_mm, math.sqrt(2.0) * radius)):
        if len(near) < _FEWEST:
            continue
        frame = _frame(normals[row])
        local = (points_mm[near] - sites_mm[row]) @ frame.T
        inside = np.hypot(local[:, 0], local[:, 1]) <= radius
        local = local[inside][_thinned(near[inside])]
        if (found := _quadric(local, radius)) is None:
            continue
        heights[row], variances[row], gradient, spread = found
        normal = frame[2] - gradient[0] * frame[0] - gradient[1] * frame[1]
        turned[row] = normal / np.linalg.norm(normal)
        slopes[row] = frame[:2].T @ spread @ frame[:2]
        sound[row] = True
    return Patches(sites_mm, turned, heights, variances, slopes, sound)


def _surveyed(view: View, tree: cKDTree, side_mm: float) -> Surveyed:
    radius_mm = _RADIUS * side_mm
    sites_mm = _spread(_cell_means(view.points_mm, side_mm), _APART * radius_mm)
    normals = _rough_normals(view, tree, sites_mm, radius_mm)
    first = fit_patches(view.points_mm, tree, sites_mm, normals, radius_mm)
    # Onto the surface, and in its own frame.
    on_mm = sites_mm + first.heights_mm[:, None] * normals
    again = fit_patches(
        view.points_mm, tree, on_mm[first.sound], first.normals[first.sound], radius_mm
    )
    patches = again.of(again.sound)
    share = len(patches.sites_mm) / max(1, len(sites_mm))
    return Surveyed(view, tree, patches, cKDTree(patches.sites_mm), radius_mm, share)


def _side(points_mm: FloatArray) -> float:
    """Side of cells of which about as many hold points as sites are wanted."""
    low, high = 1e-4, 1.0
    size_mm = float(np.linalg.norm(np.ptp(points_mm, axis=0)))
    for _ in range(20):
        middle = math.sqrt(low * high)
        if len(_cell_means(points_mm[:: max(1, len(points_mm) // 50_000)], middle * size_mm)) > (
            _WANTED
        ):
            low = middle
        else:
            high = middle
    return high * size_mm


def _cell_means(points_mm: FloatArray, side_mm: float) -> FloatArray:
    cells = np.floor((points_mm - points_mm.min(axis=0)) / side_mm).astype(np.int64)
    sizes = cells.max(axis=0) + 1
    number = (cells[:, 0] * sizes[1] + cells[:, 1]) * sizes[2] + cells[:, 2]
    _, where, counts = np.unique(number, return_inverse=True, return_counts=True)
    sums = [np.bincount(where, weights=points_mm[:, axis]) for axis in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]


def _spread(sites_mm: FloatArray, apart_mm: float) -> FloatArray:
    """Sites none of which is nearer to another; the first of each neighbourhood stays."""
    kept = np.ones(len(sites_mm), np.bool_)
    for row, near in enumerate(_within(cKDTree(sites_mm), sites_mm, apart_mm)):
        if kept[row]:
            kept[near[near > row]] = False
    return sites_mm[kept]


def _rough_normals(view: View, tree: cKDTree, sites_mm: FloatArray, radius_mm: float) -> FloatArray:
    """Least spread of the points about each site, towards the sensor where that is known."""
    normals = np.zeros_like(sites_mm)
    for row, near in enumerate(_within(tree, sites_mm, 1.2 * radius_mm)):
        if len(near) < _FEWEST:
            normals[row] = (0.0, 0.0, 1.0)
            continue
        arms = view.points_mm[near] - view.points_mm[near].mean(axis=0)
        normals[row] = np.linalg.eigh(arms.T @ arms)[1][:, 0]
        if view.towards is not None and view.towards[near].sum(axis=0) @ normals[row] < 0.0:
            normals[row] *= -1.0
    return normals


def _within(tree: cKDTree, sites_mm: FloatArray, radius_mm: float) -> Iterator[IntArray]:
    """Rows of the points within a ball about each site, in order."""
    for near in tree.query_ball_point(sites_mm, radius_mm, return_sorted=True):
        yield np.asarray(near, np.int64)


def _thinned(rows: IntArray) -> IntArray:
    """Which of some points to keep: the same whatever points come and go beside them."""
    if len(rows) <= _MOST:
        return np.arange(len(rows))
    # Knuth's multiplicative hash shuffles the rows; a stride would jump by one with each new point.
    return np.argpartition(rows * 2654435761 % 2**32, _MOST)[:_MOST]


def _frame(normal: FloatArray) -> FloatArray:
    """Right-handed rows u, v, normal."""
    least = np.eye(3)[int(np.abs(normal).argmin())]
    u = np.cross(normal, least)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(normal, u), normal])


def _quadric(
    local: FloatArray, radius: float
) -> tuple[float, float, FloatArray, FloatArray] | None:
    """Height, its variance, gradient (2,) and its covariance of points (k, 3); None: unsound."""
    for _ in range(2):
        if len(local) < _FEWEST:
            return None
        u, v = local[:, 0] / radius, local[:, 1] / radius
        rows = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        normal_matrix = rows.T @ rows
        try:
            inverse = np.linalg.inv(normal_matrix)
        except np.linalg.LinAlgError:
            return None
        at = inverse @ (rows.T @ local[:, 2])
        off = local[:, 2] - rows @ at
        limit = _STRAY * _MAD * float(np.median(np.abs(off))) + 1e-12
        if (np.abs(off) <= limit).all():
            break
        local = local[np.abs(off) <= limit]
    leverage = float(inverse[0, 0]) * len(off)
    if not 0.0 < leverage < _MOST_LEVERAGE:
        return None
    variance = float(off @ off) / max(1, len(off) - 6)
    spread = np.asarray(variance * inverse[1:3, 1:3] / radius**2)
    return float(at[0]), variance * float(inverse[0, 0]), at[1:3] / radius, spread
