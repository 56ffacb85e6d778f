"""Points on a mesh, spread evenly by area."""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.meshing import Mesh


def sample_surface(mesh: Mesh, count: int, *, seed: int) -> FloatArray:
    """Draw `count` points uniformly by area; (count, 3) in mm.

    The place in a triangle is drawn after Osada et al. 2002 (doi:10.1145/571647.571648), eq. 1.

    Raises
    ------
    ValueError
        The mesh has no area.
    """
    corners = mesh.vertices_mm[mesh.faces]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    total = float(areas.sum())
    if not total > 0:
        raise ValueError("a mesh without area cannot be sampled")
    random = np.random.default_rng(seed)
    chosen = random.choice(len(areas), size=count, p=areas / total)
    root, share = np.sqrt(random.random((count, 1))), random.random((count, 1))
    points = (1 - root) * a[chosen] + root * (1 - share) * b[chosen] + root * share * c[chosen]
    return np.asarray(points)
