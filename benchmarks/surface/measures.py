"""How far a result is from the truth; nothing here comes from a method under test.

Distances are from points, drawn uniformly by area on one surface, to the nearest **triangle** of
the other. Over both ways::

    chamfer   mean of the two mean distances
    H95       greater of the two 95 % quantiles
    H100      greater of the two greatest distances (of the drawn points)
    normals   mean of the two mean angles between the normal of the drawn point's triangle and that
              of the nearest triangle, without their sign

Closedness, Euler number and volume are trimesh's, of the vertices in use, those at one place
merged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from benchmarks.surface.cases import HEIGHT_MM, JUDGED_MM, RADIUS_MM, Gap, in_gaps
from reconstruction.comparison import measure, reference
from reconstruction.meshing import Mesh

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SAMPLES = 250_000
SIDE_SAMPLES, CELL_MM = 4_000_000, 0.5  # 32 in a cell of the cylinder's side: none is missed
REACH_MM = 10.0  # farther from the radius is no attempt at the side surface


@dataclass(frozen=True, slots=True)
class Shape:
    """What a mesh is, whatever it should be."""

    faces: int
    watertight: bool
    euler: int
    volume_mm3: float  # nan unless closed with all faces one way round


@dataclass(frozen=True, slots=True)
class Errors:
    """Against a closed truth; lengths in % of its diagonal."""

    chamfer: float
    h95: float
    h100: float
    normals_deg: float
    volume: float  # %, nan where the result has none
    apex: float  # %, from the true apex to the nearest place of the result; nan without one


@dataclass(frozen=True, slots=True)
class SideErrors:
    """Of the cylinder's side surface, radial, mm."""

    outside_rms_mm: float
    inside_rms_mm: float
    covered: float  # share of the gaps' area
    stray: float  # share of the area between the judged heights that is farther off than REACH_MM


def mesh_of(vertices_mm: Array, faces: Ints) -> trimesh.Trimesh:
    """The result with vertices at one place merged and unused ones dropped; faces stay."""
    mesh = trimesh.Trimesh(vertices_mm, faces, process=False)
    mesh.merge_vertices()
    mesh.remove_unreferenced_vertices()
    return mesh


def shape_of(mesh: trimesh.Trimesh) -> Shape:
    """Count and weigh a mesh."""
    closed = bool(mesh.is_watertight)
    sound = closed and bool(mesh.is_winding_consistent)
    return Shape(
        len(mesh.faces), closed, int(mesh.euler_number), float(mesh.volume) if sound else math.nan
    )


def errors_of(
    mesh: trimesh.Trimesh,
    truth: trimesh.Trimesh,
    *,
    seed: int,
    apex_mm: Array | None = None,
    samples: int = SAMPLES,
) -> Errors:
    """Measure a result against a closed mesh."""
    there, angle_there = _one_way(mesh, truth, samples, seed)
    back, angle_back = _one_way(truth, mesh, samples, seed + 1)
    diagonal = float(np.linalg.norm(truth.extents))
    share = 100.0 / diagonal
    apex = math.nan if apex_mm is None else float(distances(apex_mm[None], mesh)[0][0])
    return Errors(
        chamfer=share * float(there.mean() + back.mean()) / 2.0,
        h95=share * float(max(np.quantile(there, 0.95), np.quantile(back, 0.95))),
        h100=share * float(max(there.max(), back.max())),
        normals_deg=(angle_there + angle_back) / 2.0,
        volume=100.0 * abs(shape_of(mesh).volume_mm3 / float(truth.volume) - 1.0),
        apex=share * apex,
    )


def distances(points_mm: Array, mesh: trimesh.Trimesh) -> tuple[Array, Ints]:
    """Unsigned distance of points (n, 3) to the nearest triangle, and which one that is."""
    unmarked = np.zeros(len(mesh.vertices), dtype=np.bool_)
    found = measure(points_mm, reference(Mesh(mesh.vertices, mesh.faces, unmarked)))
    return np.abs(found.distances_mm), found.faces


def _one_way(
    drawn_on: trimesh.Trimesh, nearest_on: trimesh.Trimesh, samples: int, seed: int
) -> tuple[Array, float]:
    points, own = trimesh.sample.sample_surface(drawn_on, samples, seed=seed)
    away, faces = distances(np.asarray(points), nearest_on)
    cosines = np.abs(np.einsum("ij,ij->i", normals(drawn_on)[own], normals(nearest_on)[faces]))
    return away, math.degrees(float(np.arccos(np.clip(cosines, 0.0, 1.0)).mean()))


def normals(mesh: trimesh.Trimesh) -> Array:
    """Unit normal of every face (m, 3), zero for one without area; trimesh leaves those out."""
    a, b, c = (np.asarray(mesh.vertices)[mesh.faces[:, k]] for k in range(3))
    crossed = np.cross(b - a, c - a)
    return crossed / np.maximum(np.linalg.norm(crossed, axis=1, keepdims=True), 1e-300)


def side_errors_of(mesh: trimesh.Trimesh, gaps: tuple[Gap, ...], *, seed: int) -> SideErrors:
    """Measure a result against the side of the cylinder between the judged heights."""
    points = _drawn_between(mesh, *JUDGED_MM, seed)
    radii, angles = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    off, inside = radii - RADIUS_MM, in_gaps(gaps, angles, points[:, 2])
    near = np.abs(off) < REACH_MM
    return SideErrors(
        _rms(off[near & ~inside]),
        _rms(off[near & inside]),
        _covered(angles[near], points[near, 2], gaps),
        float(np.mean(~near)),
    )


def _drawn_between(mesh: trimesh.Trimesh, low: float, high: float, seed: int) -> Array:
    """Points uniform by area on the part of a mesh between two heights."""
    height = np.asarray(mesh.vertices)[mesh.faces][:, :, 2]
    part = (height.max(axis=1) >= low) & (height.min(axis=1) <= high)
    some = trimesh.Trimesh(mesh.vertices, mesh.faces[part], process=False)
    points = np.asarray(trimesh.sample.sample_surface(some, SIDE_SAMPLES, seed=seed)[0])
    return points[(points[:, 2] >= low) & (points[:, 2] <= high)]


def _covered(angle_rad: Array, height_mm: Array, gaps: tuple[Gap, ...]) -> float:
    """Share of the cells with their centre in a gap that hold a point."""
    around = round(math.tau * RADIUS_MM / CELL_MM)
    up = round(HEIGHT_MM / CELL_MM)
    column = np.floor(np.mod(angle_rad / math.tau, 1.0) * around).astype(np.int64) % around
    row = np.clip(height_mm / CELL_MM, 0, up - 1).astype(np.int64)
    filled = np.zeros((around, up), dtype=np.bool_)
    filled[column, row] = True
    turn = (np.arange(around) + 0.5) / around * math.tau
    level = (np.arange(up) + 0.5) * CELL_MM
    inside = in_gaps(gaps, np.repeat(turn, up), np.tile(level, around)).reshape(around, up)
    inside &= (level > JUDGED_MM[0]) & (level < JUDGED_MM[1])
    return float(filled[inside].mean())


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def folded_share(patch: dict[str, Array], *, grid: int = 1000) -> float:
    """Share of a grid on which the Jacobian of (u, v) -> (angle about z, height) has lost its sign.

    A surface about the z axis that is star-shaped in every slice has none. The ends of v, where a
    row of the net may be one point, are left out. Evaluated by scipy, from the control points.
    """
    (u, v), points, du, dv = _frames(patch, grid)
    x, y = points[..., 0], points[..., 1]
    angle_u = x * du[..., 1] - y * du[..., 0]  # times the squared radius, which is positive
    angle_v = x * dv[..., 1] - y * dv[..., 0]
    jacobian = angle_u * dv[..., 2] - angle_v * du[..., 2]
    del u, v
    return float(np.mean(np.sign(jacobian) != np.sign(np.median(jacobian))))


def _frames(patch: dict[str, Array], grid: int) -> tuple[tuple[Array, Array], Array, Array, Array]:
    """Points and first derivatives on a grid over the inside of the domain."""
    p, q = int(patch["degree_u"]), int(patch["degree_v"])
    knots_u, knots_v = patch["knots_u"], patch["knots_v"]
    weights = patch["weights"][..., None]
    net = np.concatenate([patch["control_points_mm"] * weights, weights], axis=2)
    if patch["periodic_u"]:
        net = np.concatenate([net, net[:p]], axis=0)
    if patch["periodic_v"]:
        net = np.concatenate([net, net[:, :q]], axis=1)
    u = _within(knots_u[p], knots_u[len(net)], grid)
    v = _within(knots_v[q], knots_v[net.shape[1]], grid)

    def summed(order_u: int, order_v: int) -> Array:
        along = BSpline(knots_u, net, p)(u, nu=order_u)
        return BSpline(knots_v, along.swapaxes(0, 1), q)(v, nu=order_v).swapaxes(0, 1)

    value, in_u, in_v = summed(0, 0), summed(1, 0), summed(0, 1)
    points = value[..., :3] / value[..., 3:]
    du = (in_u[..., :3] - in_u[..., 3:] * points) / value[..., 3:]
    dv = (in_v[..., :3] - in_v[..., 3:] * points) / value[..., 3:]
    return (u, v), points, du, dv


def _within(start: float, end: float, count: int) -> Array:
    return start + (end - start) * (np.arange(count) + 0.5) / count
