"""Whether a row runs through a band, or through a heap that goes on beside it.

Any heap can be threaded: a row through it finds points on both sides, and takes half of the way
to its own next strand for its thickness. A band stands alone: beyond it there is nothing. ::

         :  beside  :
        --------------      half a thickness and a bit
    row ==============      within
        --------------
         :  beside  :
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray
from reconstruction.fitting.thinning import Row

_LOOKS = 64  # nodes of a row that look beside it
_WITHIN = math.sqrt(3.0)  # standard deviations: half of a uniform band
_BESIDE = (1.3, 2.3)  # half bands from the row
_CROWDED = 0.25  # of those within: so many beside a row are a heap's; a U that fills one has a half
_CHANCE = 2.0  # standard deviations by which there must be more


def is_crowded(row: Row, places: FloatArray) -> bool:
    """Whether places (k, 2) of the slice lie as well beside a row as within its thickness."""
    if row.exact or len(row.nodes) < 2:
        return False
    looks = np.unique(np.linspace(0, len(row.nodes) - 1, _LOOKS).astype(np.int64))
    tangents = _tangents(row)[looks]
    within, beside = count_beside(row.nodes[looks], tangents, _WITHIN * row.sigma[looks], places)
    borne = _CROWDED * within
    return beside > borne + _CHANCE * math.sqrt(borne)


def _tangents(row: Row) -> FloatArray:
    """Unit directions of a row at its nodes, (m, 2)."""
    if row.closed:
        arms = np.roll(row.nodes, -1, axis=0) - np.roll(row.nodes, 1, axis=0)
    else:
        arms = np.gradient(row.nodes, axis=0)
    return np.asarray(arms / np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-300))


@njit(cache=True, nogil=True)
def count_beside(
    nodes: FloatArray, tangents: FloatArray, half: FloatArray, places: FloatArray
) -> tuple[int, int]:
    """How many places lie within half a thickness of nodes, and how many beside that."""
    within = beside = 0
    for n in range(len(nodes)):
        c, s, wide = tangents[n, 0], tangents[n, 1], half[n]
        for k in range(len(places)):
            x, y = places[k, 0] - nodes[n, 0], places[k, 1] - nodes[n, 1]
            if abs(c * x + s * y) > wide:
                continue
            across = abs(c * y - s * x)
            if across <= wide:
                within += 1
            elif _BESIDE[0] * wide < across <= _BESIDE[1] * wide:
                beside += 1
    return within, beside
