"""Which way from node to node a place lies nearest to."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_way(
    places: FloatArray, starts: FloatArray, arms: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Nearest way of each place, and how far off it is."""
    way, away = np.zeros(len(places), np.int64), np.empty(len(places))
    for n in range(len(places)):
        best = np.inf
        for k in range(len(starts)):
            x, y = places[n, 0] - starts[k, 0], places[n, 1] - starts[k, 1]
            square = arms[k, 0] * arms[k, 0] + arms[k, 1] * arms[k, 1]
            share = (x * arms[k, 0] + y * arms[k, 1]) / max(square, 1e-300)
            share = min(max(share, 0.0), 1.0)
            x, y = x - share * arms[k, 0], y - share * arms[k, 1]
            if x * x + y * y < best:
                best, way[n] = x * x + y * y, k
        away[n] = math.sqrt(best)
    return way, away
