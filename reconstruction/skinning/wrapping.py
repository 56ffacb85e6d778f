"""One closed mesh around all points of all slices, whatever their contours were taken for.

Used where branches do not follow the points: contours that run into each other, walls seen from one
side only, features that come and go within a slice or two.

points -> inside and outside (`field`) -> level surface -> laid through the points (`draping`)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import manifold3d
import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import Unfittable
from reconstruction.manifolds import manifold_of, mesh_of
from reconstruction.meshing import Mesh
from reconstruction.skinning.draping import Cloud, draped
from reconstruction.skinning.field import Field, Guess, field_of
from reconstruction.skinning.handles import without_weak_handles

_EDGE = 1.2  # grid steps: of the mesh
_MOST_VERTICES = 100_000  # to lay through points: the time for it grows faster than they do
_LEAST_PART = 0.01  # of the volume: a smaller one is a heap of stray points
_SPACING = 1.2  # times the mean distance of points on the surface is a grain, ...
_NOISE = 2.2  # ... or so many standard deviations, or the distance of slices
_UNSEEN = 2.5  # grains: farther from all points a vertex stands on none
_SAMPLES, _FEWER = 300_000, 50_000
_APART = 0.75  # grains
_FAR = 4.0  # standard deviations
_WEAK = 0.15  # of the step from outside to inside: a handle that hangs on less is noise
_LEFT = 0.01  # of the points: more aside, and the guess of what is inside may be wrong


@dataclass(frozen=True, slots=True, eq=False)
class Swarm:
    """All points of a stack, as far as noise lets them be told apart."""

    points_mm: FloatArray  # (n, 3)
    counts: FloatArray  # (n,)
    levels: IntArray  # (n,), each one's slice, from low to high
    sigma_mm: float  # in the cutting planes
    pitch_mm: float  # of the slices
    axis: FloatArray  # (3,), perpendicular to them


def wrapped(swarm: Swarm) -> Mesh | None:
    """Wrap a mesh around points; None if they enclose nothing.

    Inside and outside are guessed one way, and another way as well if that leaves points aside.
    """
    best, least = None, math.inf
    for guess in Guess:
        made = _wrapped(swarm, guess)
        if made is None:
            continue
        left = share_far(made, swarm)
        if left < least:
            best, least = made, left
        if left <= _LEFT:
            break
    return best


def _wrapped(swarm: Swarm, guess: Guess) -> Mesh | None:
    points, counts = swarm.points_mm, swarm.counts
    grain = grain_mm(swarm)
    try:
        field = field_of(points, counts, grain, guess)
    except Unfittable:
        return None
    mesh = _bounded_mesh(field)
    if mesh is None:
        return None
    if _rings(mesh):
        simpler = _bounded_mesh(replace(field, values=without_weak_handles(field.values, _WEAK)))
        mesh = simpler if simpler is not None and _rings(simpler) < _rings(mesh) else mesh
    cloud = Cloud(points, field.outward, counts, swarm.sigma_mm, swarm.axis)
    vertices = draped(mesh.vertices_mm, mesh.faces, cloud, grain_mm=grain)
    mesh = _between_planes(Mesh(vertices, mesh.faces, mesh.synthetic), swarm)
    away, _ = cKDTree(points).query(mesh.vertices_mm)
    return Mesh(mesh.vertices_mm, mesh.faces, np.asarray(away > _UNSEEN * grain))


def _rings(mesh: Mesh) -> int:
    """Handles of all bodies together."""
    body = manifold_of(mesh)
    return sum(each.genus() for each in body.decompose())


def _bounded_mesh(field: Field) -> Mesh | None:
    mesh = _level_mesh(field, _EDGE)
    if mesh is None or len(mesh.vertices_mm) <= _MOST_VERTICES:
        return mesh
    return _level_mesh(field, _EDGE * math.sqrt(len(mesh.vertices_mm) / _MOST_VERTICES))


def _between_planes(mesh: Mesh, swarm: Swarm) -> Mesh:
    """Cut off what lies more than half a slice's distance beyond the outermost slices.

    No slice has seen it; over a flat end, which slices never sample, the field bulges.
    """
    heights = swarm.points_mm @ swarm.axis
    body = manifold_of(mesh)
    low, high = float(heights.min()), float(heights.max())
    margin = 0.5 * swarm.pitch_mm
    body = body.trim_by_plane(swarm.axis.tolist(), low - margin)
    body = body.trim_by_plane((-swarm.axis).tolist(), -(high + margin))
    return mesh if body.is_empty() else mesh_of(body)


def share_far(mesh: Mesh, swarm: Swarm) -> float:
    """The share of points that lie farther from a mesh than their noise explains.

    A slice counts no more than the one beside it that is farther off: if it is alone with what it
    says, it is itself in doubt, and named elsewhere.
    """
    places, spacing = _sampled(mesh)
    away, _ = cKDTree(places).query(swarm.points_mm)
    far = away > math.hypot(_FAR * swarm.sigma_mm, 2.0 * spacing)
    points = np.bincount(swarm.levels, swarm.counts)
    shares = np.bincount(swarm.levels, swarm.counts * far) / np.maximum(points, 1.0)
    beside = np.concatenate([[0.0], shares, [0.0]])
    told = np.minimum(shares, np.maximum(beside[:-2], beside[2:]))
    return float(told @ points / points.sum())


def share_apart(one: Mesh, other: Mesh, swarm: Swarm) -> float:
    """The share of the area on which two meshes differ by more than the points leave open."""
    (here, spacing), (there, wider) = _sampled(one), _sampled(other)
    reach = max(_FAR * swarm.sigma_mm, _APART * grain_mm(swarm), 2.0 * spacing, 2.0 * wider)
    ways = ((here, there), (there, here))
    shares = [float(np.mean(cKDTree(b).query(a[:_FEWER])[0] > reach)) for a, b in ways]
    return max(shares)


def _sampled(mesh: Mesh) -> tuple[FloatArray, float]:
    """Places (n, 3) evenly by area on a mesh, in any order, and how far they are apart."""
    rng = np.random.default_rng(0)
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    face = rng.choice(len(areas), _SAMPLES, p=areas / areas.sum())
    s, t = np.sqrt(rng.random(_SAMPLES)), rng.random(_SAMPLES)
    places = (1 - s)[:, None] * a[face] + (s * (1 - t))[:, None] * b[face]
    places += (s * t)[:, None] * c[face]
    return places, math.sqrt(float(areas.sum()) / _SAMPLES)


def grain_mm(swarm: Swarm) -> float:
    """What is smaller than that, points do not tell."""
    points = swarm.points_mm
    # Of points on a surface, the tenth nearest lies at sqrt(10 / (pi density)).
    some = points[:: max(len(points) // 5000, 1)]
    tenth = np.asarray(cKDTree(points).query(some, k=[11])[0])
    spacing = float(np.median(tenth)) * math.sqrt(math.pi / 10.0)
    return max(swarm.pitch_mm, _SPACING * spacing, _NOISE * swarm.sigma_mm)


def _level_mesh(field: Field, edge_steps: float) -> Mesh | None:
    """The zero of a field as a manifold mesh, without the heaps of stray points."""
    values, low, step = np.ascontiguousarray(field.values), field.low_mm, field.step_mm
    x, y, z = low.tolist()
    high = low + step * (np.array(values.shape) - 1)

    def inside(a: float, b: float, c: float) -> float:
        return float(_between(values, (a - x) / step, (b - y) / step, (c - z) / step))

    body = manifold3d.Manifold.level_set(inside, [x, y, z, *high.tolist()], edge_steps * step)
    whole = body.volume()
    parts = [each for each in body.decompose() if abs(each.volume()) > _LEAST_PART * whole]
    if not parts or not whole > 0.0:
        return None
    return mesh_of(manifold3d.Manifold.compose(parts))


@njit(cache=True)
def _between(values: FloatArray, x: float, y: float, z: float) -> float:
    """A value between nodes, linearly; outside of the grid the nearest."""
    x = min(max(x, 0.0), values.shape[0] - 1.001)
    y = min(max(y, 0.0), values.shape[1] - 1.001)
    z = min(max(z, 0.0), values.shape[2] - 1.001)
    i, j, k = int(x), int(y), int(z)
    a, b, c = x - i, y - j, z - k
    total = 0.0
    for p in range(2):
        for q in range(2):
            for r in range(2):
                share = (a if p else 1 - a) * (b if q else 1 - b) * (c if r else 1 - c)
                total += share * values[i + p, j + q, k + r]
    return total
