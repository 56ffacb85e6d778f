"""Reduction of 20 million points in slices, beside a plain sum and beside its peers.

The pipeline reads the points of a slice once here: between which corners they lie was noted when
they were sorted by slice (or made, from a scan). What that noting costs has a row of its own.

One process; medians of process time, which counts every thread, so a peer that uses two cores gains
nothing. Run: python benchmarks/reduction.py [points]
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from reconstruction.reduction import Box, bounding_box, reduce_points

CELL_MM = 0.5
SLICES = 200
RUNS = 5


def make_slices(points: int) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder of 100 mm, noise 0.2 mm, sorted by slice: points (n, 3) and slice borders."""
    rng = np.random.default_rng(1)
    angle = rng.uniform(0.0, 2.0 * math.pi, points)
    radius = 50.0 + rng.normal(0.0, 0.2, points)
    height = np.sort(rng.uniform(0.0, 100.0, points))
    cloud = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return cloud, np.linspace(0, points, SLICES + 1).astype(int)


def plain_sum(cloud: np.ndarray, borders: np.ndarray) -> float:
    """The floor: read the same bytes once."""
    return float(sum(cloud[a:b].sum() for a, b in pairwise(borders)))


def noted(cloud: np.ndarray, borders: np.ndarray) -> list[Box]:
    """Every slice's box, as it is noted while points are sorted."""
    return [bounding_box(cloud[a:b]) for a, b in pairwise(borders)]


def ours(cloud: np.ndarray, borders: np.ndarray, boxes: Sequence[Box | None]) -> int:
    """Counts and centres of mass of every slice."""
    size = (CELL_MM, CELL_MM, math.inf)
    return sum(
        len(reduce_points(cloud[a:b], size_mm=size, origin_mm=np.zeros(3), within=box))
        for (a, b), box in zip(pairwise(borders), boxes, strict=True)
    )


def bincount(cloud: np.ndarray, borders: np.ndarray) -> int:
    """The same with numpy: keys, then one bincount a column."""
    total = 0
    for a, b in pairwise(borders):
        points = cloud[a:b]
        low = points[:, :2].min(axis=0)
        lattice = ((points[:, :2] - low) / CELL_MM).astype(np.int64)
        width = int(lattice[:, 1].max()) + 1
        keys = lattice[:, 0] * width + lattice[:, 1]
        counts = np.bincount(keys)
        used = np.flatnonzero(counts)
        for column in range(3):
            np.bincount(keys, weights=points[:, column])[used] / counts[used]
        total += len(used)
    return total


def open3d_voxels(cloud: np.ndarray, borders: np.ndarray) -> int:
    """open3d's voxel_down_sample of every slice (no counts), its conversion included."""
    import open3d

    total = 0
    for a, b in pairwise(borders):
        flat = cloud[a:b].copy()
        flat[:, 2] = 0.0
        held = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(flat))
        total += len(held.voxel_down_sample(CELL_MM).points)
    return total


def median_ns(work: Callable[[], object], points: int) -> float:
    """Median process time of the runs after a warm-up, in ns a point."""
    work()
    seconds = []
    for _ in range(RUNS):
        begun = time.process_time()
        work()
        seconds.append(time.process_time() - begun)
    return float(np.median(seconds)) / points * 1e9


def main() -> None:
    """Print the table."""
    points = int(float(sys.argv[1])) if len(sys.argv) > 1 else 20_000_000
    cloud, borders = make_slices(points)
    boxes, unknown = noted(cloud, borders), [None] * SLICES
    floor = median_ns(lambda: plain_sum(cloud, borders), points)
    rows = [
        ("plain sum of the same bytes", floor),
        ("loftscan, as in the pipeline", median_ns(lambda: ours(cloud, borders, boxes), points)),
        ("  noting the boxes before that", median_ns(lambda: noted(cloud, borders), points)),
        ("loftscan, boxes not noted", median_ns(lambda: ours(cloud, borders, unknown), points)),
        ("numpy bincount", median_ns(lambda: bincount(cloud, borders), points)),
    ]
    try:
        rows.append(("open3d", median_ns(lambda: open3d_voxels(cloud, borders), points)))
    except ImportError:
        print("open3d is not installed: pip install --group bench")
    print(f"{points:,} points, {SLICES} slices, {CELL_MM} mm cells, process time, median of {RUNS}")
    for name, nanoseconds in rows:
        print(f"{name:32s} {nanoseconds:8.2f} ns/point {nanoseconds / floor:8.2f} x the sum")


if __name__ == "__main__":
    main()
