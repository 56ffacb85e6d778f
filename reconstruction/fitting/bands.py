"""Cyclic banded systems: factor, solve, and the entries of the inverse that lie on the band.

A symmetric positive definite matrix of half-bandwidth 3, as cubic B-splines make it, is stored by
its upper band, ``band[i, k] = A[i, (i + k) mod n]`` for k = 0..3; an open curve leaves the corner
entries zero. The last three unknowns are a border that takes the corners and their fill::

    x x x x . . . | x x x
      x x x x . . | . x x        A = L D L', columns 0 .. n - 4 eliminated along the band,
        x x x x . | . . x        the 3 x 3 block left over inverted as it is.

The inverse on the band (Takahashi, Fagan, Chin 1973; Erisman, Tinney 1975) costs as much as the
factor and gives every variance that local functions of the coefficients can ask for.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray

WIDTH = 4  # entries of a row: the diagonal and three beside it
LEAST = 7  # unknowns: with fewer the two sides of the band would meet

# The pivots; below them L along the band; L in the border rows; the inverse of the last block.
Factor = tuple[FloatArray, FloatArray, FloatArray]


@njit(cache=True, nogil=True, error_model="numpy")
def factorise(band: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (main (m, 4), border (3, m), corner inverse (3, 3)), m = n - 3.

    ``main[j, 0]`` is the pivot, ``main[j, k]`` is L[j + k, j]. A matrix that is not positive
    definite yields pivots that are not positive: the caller looks.
    """
    m = len(band) - 3
    main, border, block = np.zeros((m, 4)), np.zeros((3, m)), np.zeros((3, 3))
    for i in range(len(band)):
        for k in range(4):
            j = i + k
            if i < m and j < m:
                main[i, k] = band[i, k]
            elif i < m:
                border[j - m, i] = band[i, k]
            elif j < m + 3:
                block[i - m, j - m] = block[j - m, i - m] = band[i, k]
            else:
                border[i - m, j - m - 3] += band[i, k]
    for j in range(m):
        reach = min(3, m - 1 - j)
        inverse = 1.0 / main[j, 0]
        for k in range(1, reach + 1):
            part = main[j, k] * inverse
            for q in range(k, reach + 1):
                main[j + k, q - k] -= part * main[j, q]
            for r in range(3):
                border[r, j + k] -= part * border[r, j]
        for r in range(3):
            for s in range(3):
                block[r, s] -= border[r, j] * border[s, j] * inverse
        for k in range(1, reach + 1):
            main[j, k] *= inverse
        for r in range(3):
            border[r, j] *= inverse
    return main, border, _inverse_of_three(block)


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse_of_three(a: FloatArray) -> FloatArray:
    out = np.empty((3, 3))
    for i in range(3):
        p, q = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            out[j, i] = a[p, r] * a[q, s] - a[p, s] * a[q, r]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    out /= determinant
    return out


@njit(cache=True, nogil=True)
def solve(
    main: FloatArray, border: FloatArray, corner: FloatArray, right: FloatArray
) -> FloatArray:
    """Solve for several right sides at once, (n, d) -> (n, d)."""
    m = len(main)
    x = right.copy()
    for column in range(x.shape[1]):
        for j in range(m):
            for k in range(1, min(3, m - 1 - j) + 1):
                x[j + k, column] -= main[j, k] * x[j, column]
            for r in range(3):
                x[m + r, column] -= border[r, j] * x[j, column]
        a, b, c = x[m, column], x[m + 1, column], x[m + 2, column]
        for r in range(3):
            x[m + r, column] = corner[r, 0] * a + corner[r, 1] * b + corner[r, 2] * c
        for j in range(m - 1, -1, -1):
            total = x[j, column] / main[j, 0]
            for k in range(1, min(3, m - 1 - j) + 1):
                total -= main[j, k] * x[j + k, column]
            for r in range(3):
                total -= border[r, j] * x[m + r, column]
            x[j, column] = total
    return x


@njit(cache=True, nogil=True)
def inverse_band(main: FloatArray, border: FloatArray, corner: FloatArray) -> FloatArray:
    """Return the inverse's entries on the cyclic band, stored like the matrix itself, (n, 4)."""
    m = len(main)
    near, far = np.zeros((m, 4)), np.zeros((3, m))
    for j in range(m - 1, -1, -1):
        reach = min(3, m - 1 - j)
        for r in range(3):
            total = 0.0
            for q in range(1, reach + 1):
                total -= main[j, q] * far[r, j + q]
            for s in range(3):
                total -= border[s, j] * corner[s, r]
            far[r, j] = total
        for k in range(1, reach + 1):
            total = 0.0
            for q in range(1, reach + 1):
                low, high = min(k, q), max(k, q)
                total -= main[j, q] * near[j + low, high - low]
            for s in range(3):
                total -= border[s, j] * far[s, j + k]
            near[j, k] = total
        total = 1.0 / main[j, 0]
        for q in range(1, reach + 1):
            total -= main[j, q] * near[j, q]
        for s in range(3):
            total -= border[s, j] * far[s, j]
        near[j, 0] = total
    return _gathered(near, far, corner)


@njit(cache=True, nogil=True)
def _gathered(near: FloatArray, far: FloatArray, corner: FloatArray) -> FloatArray:
    m = len(near)
    out = np.empty((m + 3, 4))
    for i in range(m + 3):
        for k in range(4):
            j = i + k
            if i < m and j < m:
                out[i, k] = near[i, k]
            elif i < m:
                out[i, k] = far[j - m, i]
            elif j < m + 3:
                out[i, k] = corner[i - m, j - m]
            else:
                out[i, k] = far[i - m, j - m - 3]
    return out
