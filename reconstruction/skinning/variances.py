"""Variances under the inverse of a system: of rows of the stiffness, and across the surface."""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.assembly import row_at
from reconstruction.skinning.bending import Rows
from reconstruction.skinning.blocks import Blocks
from reconstruction.skinning.net import Basis, Net
from reconstruction.skinning.unknowns import Unknowns


def row_variances(rows: Rows, inverse: Blocks) -> FloatArray:
    """Variance of each row's value under the inverse of the system, (r,)."""
    return np.asarray(_variances(inverse.panels, rows.numbers, rows.slopes))


@njit(cache=True, nogil=True)
def _variances(panels: FloatArray, numbers: IntArray, slopes: FloatArray) -> FloatArray:
    size = panels.shape[1]
    out = np.zeros(len(numbers))
    for r in range(len(numbers)):
        for p in range(numbers.shape[1]):
            low = numbers[r, p]
            if low < 0:
                continue
            block = low // size
            start = block * size
            out[r] += slopes[r, p] * slopes[r, p] * panels[block, low - start, low - start]
            for q in range(numbers.shape[1]):
                high = numbers[r, q]
                if high > low:
                    part = slopes[r, p] * slopes[r, q]
                    out[r] += 2.0 * part * panels[block, low - start, high - start]
    return out


def variances_across(
    inverse: Blocks,
    net: Net,
    unknowns: Unknowns,
    at: tuple[Basis, Basis],
    normals: FloatArray,
) -> FloatArray:
    """Variance of the surface along normals (m, 3) at parameters, (m,)."""
    at_u, at_v = at
    # In the order of the net: neighbours read the same part of an inverse that no cache holds.
    order = np.argsort(at_v.first * len(unknowns.directions) + at_u.first)
    return np.asarray(
        _variances_at(
            inverse.panels, unknowns.directions, unknowns.numbers, net.apex,
            at_u.first, at_u.values[:, 0], at_v.first, at_v.values[:, 0], normals, order,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _variances_at(
    panels: FloatArray, directions: FloatArray, number: IntArray,
    apex: BoolArray, first_u: IntArray, values_u: FloatArray, first_v: IntArray,
    values_v: FloatArray, normals: FloatArray, order: IntArray,
) -> FloatArray:  # fmt: skip
    size = panels.shape[1]
    numbers, slopes = np.empty(16, np.int64), np.empty(16)
    out = np.zeros(len(normals))
    for m in order:
        held = row_at(
            directions, number, apex, first_u[m], values_u[m], first_v[m], values_v[m],
            normals[m], numbers, slopes,
        )  # fmt: skip
        total = 0.0
        for p in range(held):
            # Divided once a number, not once a pair: 16 times for 136 reads.
            block = numbers[p] // size
            start = block * size
            part = 0.0
            for q in range(held):
                if numbers[q] > numbers[p]:
                    part += slopes[q] * panels[block, numbers[p] - start, numbers[q] - start]
            own = slopes[p] * panels[block, numbers[p] - start, numbers[p] - start]
            total += slopes[p] * (own + 2.0 * part)
        out[m] = max(total, 0.0)
    return out
