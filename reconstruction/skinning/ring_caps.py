"""The flat cap between a contour and the hole in it, as triangles that use each edge once.

A folded branch that ends in one plane is closed by it (`branching.is_ring_ended`).
"""

from __future__ import annotations

import manifold3d
import numpy as np

from reconstruction.arrays import FloatArray, IntArray


def triangulate_ring(outer_mm: FloatArray, inner_mm: FloatArray) -> IntArray:
    """Cut a ring between two polygons into triangles.

    Parameters
    ----------
    outer_mm
        (n, 2) corners, counter-clockwise.
    inner_mm
        (m, 2) corners, counter-clockwise too, inside of the outer ones.

    Returns
    -------
    (n + m, 3) int
        Corner indices, counter-clockwise; the inner corners are n..n+m-1.
    """
    n, m = len(outer_mm), len(inner_mm)
    around = np.arange(m)[::-1]  # the library takes holes clockwise
    polygons = [np.ascontiguousarray(outer_mm), np.ascontiguousarray(inner_mm[around])]
    corners = np.concatenate([np.arange(n), n + around])
    return corners[np.asarray(manifold3d.triangulate(polygons), dtype=np.int64)]
