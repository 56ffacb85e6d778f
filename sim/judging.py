"""How far a finished mesh lies from the part that was truly scanned, told by the simulator.

The program under test does not grade itself: distances are worked out here, on the true part's own
triangles, with nothing of the program's. ::

    python -m sim.judging --part vase RESULT/mesh.stl

Rings never see the ends of a part, so that what closes a mesh there is no measurement: faces that
lie flat in the lowest or the highest plane of the mesh are left out, and counted.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sim.arrays import FaceArray, FloatArray
from sim.parts import find_part

_FLAT = 1e-6  # of the mesh's height: so near to an end plane is in it
_LONGEST_EDGE = 0.02  # of the size: larger triangles are cut, so that few are ever candidates
_AT_ONCE = 4096  # points whose candidate triangles are in memory together


@dataclass(frozen=True, slots=True)
class Judgement:
    """Distances in mm between the result's walls and the truth."""

    points: int  # sampled on the result, evenly by area
    rms_mm: float  # of the result's points from the truth
    mean_mm: float  # signed, positive: the result lies outside
    percentile_95_mm: float
    max_mm: float
    back_points: int  # sampled on the truth between the result's end planes
    back_rms_mm: float  # of the truth's points from the result
    back_max_mm: float
    capped_area_share: float  # of the result's area that closes its ends, and is left out


class Surface:
    """Triangles that can be asked for their distance from points."""

    def __init__(self, vertices_mm: FloatArray, faces: FaceArray) -> None:
        solid = faces[_areas(vertices_mm[faces]) > 0.0]
        edge_mm = float(np.linalg.norm(np.ptp(vertices_mm, axis=0))) * _LONGEST_EDGE
        self.corners_mm: FloatArray = _cut(np.asarray(vertices_mm[solid], np.float64), edge_mm)
        self._middle_mm = self.corners_mm.mean(axis=1)
        # A triangle is within this of its middle: what is farther than the best by more than it
        # cannot be the nearest.
        reach_mm = np.linalg.norm(self.corners_mm - self._middle_mm[:, None], axis=2)
        self._reach_mm = float(reach_mm.max())
        self._tree = cKDTree(self._middle_mm)

    def sample(self, count: int, seed: int) -> FloatArray:
        """Draw points evenly by area, (count, 3)."""
        rng = np.random.default_rng(seed)
        areas = _areas(self.corners_mm)
        chosen = self.corners_mm[rng.choice(len(areas), count, p=areas / areas.sum())]
        a, b = rng.random((2, count, 1))
        over = a + b > 1.0
        a, b = np.where(over, 1.0 - a, a), np.where(over, 1.0 - b, b)
        first = chosen[:, 0]
        return np.asarray(first + a * (chosen[:, 1] - first) + b * (chosen[:, 2] - first))

    def signed_distances_mm(self, points_mm: FloatArray) -> FloatArray:
        """Distance of each point (n, 3) from the nearest triangle, positive outside: (n,)."""
        starts = range(0, len(points_mm), _AT_ONCE)
        parts = [self._signed(points_mm[start : start + _AT_ONCE]) for start in starts]
        return np.concatenate([np.empty(0), *parts])

    def _signed(self, points_mm: FloatArray) -> FloatArray:
        nearest_mm, _ = self._tree.query(points_mm)
        found = self._tree.query_ball_point(points_mm, nearest_mm + self._reach_mm + 1e-9)
        counts = np.array([len(each) for each in list(found)])
        triangle = np.concatenate(found).astype(np.intp)
        point = np.repeat(np.arange(len(points_mm)), counts)
        away = points_mm[point] - _nearest_on(self.corners_mm[triangle], points_mm[point])
        squared = np.einsum("ij,ij->i", away, away)
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        least = np.minimum.reduceat(squared, starts)
        outward = _nearest_side(self.corners_mm[triangle], away, squared, least[point])
        side = np.sign(np.add.reduceat(outward, starts))
        return np.asarray(np.sqrt(least) * np.where(side < 0.0, -1.0, 1.0))


def _cut(corners_mm: FloatArray, edge_mm: float) -> FloatArray:
    """Halve triangles (n, 3, 3) at their longest edge until none is longer: (m, 3, 3).

    Only what is too long is cut, so that the long thin triangles of a wall become few.
    """
    short: list[FloatArray] = []
    while len(corners_mm):
        edges = np.linalg.norm(np.roll(corners_mm, -1, axis=1) - corners_mm, axis=2)
        short.append(corners_mm[edges.max(axis=1) <= edge_mm])
        long_mm = corners_mm[edges.max(axis=1) > edge_mm]
        begins = edges.argmax(axis=1)[edges.max(axis=1) > edge_mm]
        turned = (begins[:, None] + np.arange(3)) % 3
        a, b, apex = np.take_along_axis(long_mm, turned[:, :, None], axis=1).swapaxes(0, 1)
        middle = (a + b) / 2.0
        halves = np.stack([a, middle, apex], axis=1), np.stack([middle, b, apex], axis=1)
        corners_mm = np.concatenate(halves)
    return np.concatenate([np.empty((0, 3, 3)), *short])


def judge(truth: Surface, result: trimesh.Trimesh, *, samples: int, seed: int = 0) -> Judgement:
    """Compare a result's walls with the truth, both ways."""
    vertices_mm = np.asarray(result.vertices, np.float64)
    faces = np.asarray(result.faces, np.int32)
    walls, share = _walls(vertices_mm, faces)
    made = Surface(vertices_mm, faces[walls])
    off_mm = truth.signed_distances_mm(made.sample(samples, seed))
    low_mm, high_mm = vertices_mm[:, 2].min(), vertices_mm[:, 2].max()
    there = truth.sample(samples, seed + 1)
    there = there[(there[:, 2] > low_mm) & (there[:, 2] < high_mm)]
    back_mm = np.abs(made.signed_distances_mm(there))
    return Judgement(
        points=samples,
        rms_mm=_rms(off_mm),
        mean_mm=float(off_mm.mean()),
        percentile_95_mm=float(np.percentile(np.abs(off_mm), 95)),
        max_mm=float(np.abs(off_mm).max()),
        back_points=len(back_mm),
        back_rms_mm=_rms(back_mm),
        back_max_mm=float(back_mm.max(initial=0.0)),
        capped_area_share=share,
    )


def _walls(vertices_mm: FloatArray, faces: FaceArray) -> tuple[NDArray[np.bool_], float]:
    """Which faces do not lie in an end plane, and the share of the area of those that do."""
    z = vertices_mm[:, 2]
    slack = _FLAT * np.ptp(z)
    at_end = (z[faces] <= z.min() + slack).all(axis=1) | (z[faces] >= z.max() - slack).all(axis=1)
    areas = _areas(vertices_mm[faces])
    return ~at_end, float(areas[at_end].sum() / areas.sum())


def _nearest_side(
    corners_mm: FloatArray, away: FloatArray, squared: FloatArray, least: FloatArray
) -> FloatArray:
    """On which side of its triangle a point is, for the triangles that are nearest; else 0.

    At an edge or a corner several are nearest; the sum over them, each weighted by how squarely it
    faces the point, has the right sign where the surface is not sharper than its noise.
    """
    edge_a, edge_b = corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0]
    normal = np.cross(edge_a, edge_b)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    facing = np.einsum("ij,ij->i", normal, away)
    return np.asarray(np.where(squared <= least * (1.0 + 1e-9) + 1e-18, facing, 0.0))


def _nearest_on(corners_mm: FloatArray, points_mm: FloatArray) -> FloatArray:
    """The nearest point of each triangle (n, 3, 3) to its point (n, 3): (n, 3).

    In the plane if the foot is inside, else on the nearest of the three edges.
    """
    a, b, c = corners_mm[:, 0], corners_mm[:, 1], corners_mm[:, 2]
    normal = np.cross(b - a, c - a)
    length = np.einsum("ij,ij->i", normal, normal)
    foot = points_mm - normal * (np.einsum("ij,ij->i", points_mm - a, normal) / length)[:, None]
    inside = np.ones(len(a), bool)
    best = foot.copy()
    best_squared = np.full(len(a), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= np.einsum("ij,ij->i", np.cross(edge, foot - start), normal) >= 0.0
        along = np.einsum("ij,ij->i", points_mm - start, edge) / np.einsum("ij,ij->i", edge, edge)
        on_edge = start + np.clip(along, 0.0, 1.0)[:, None] * edge
        away = np.einsum("ij,ij->i", points_mm - on_edge, points_mm - on_edge)
        nearer = away < best_squared
        best[nearer], best_squared[nearer] = on_edge[nearer], away[nearer]
    return np.asarray(np.where(inside[:, None], foot, best))


def _areas(corners_mm: FloatArray) -> FloatArray:
    cross = np.cross(corners_mm[:, 1] - corners_mm[:, 0], corners_mm[:, 2] - corners_mm[:, 0])
    return np.asarray(np.linalg.norm(cross, axis=1) / 2.0)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def main(arguments: list[str] | None = None) -> int:
    """Judge one mesh file and print the numbers as JSON."""
    parser = argparse.ArgumentParser(prog="python -m sim.judging", description=__doc__)
    parser.add_argument("mesh", type=Path, help="the result's mesh, in mm")
    parser.add_argument("--part", required=True, help="name of a part, or its mesh file")
    parser.add_argument("--samples", type=int, default=8_000)
    wanted = parser.parse_args(arguments)
    try:
        part = find_part(wanted.part)
        result = trimesh.load_mesh(wanted.mesh)
    except (OSError, ValueError) as bad:
        print(f"sim.judging: {bad}", file=sys.stderr)
        return 2
    truth = Surface(part.vertices_mm, part.faces)
    print(json.dumps(asdict(judge(truth, result, samples=wanted.samples))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
