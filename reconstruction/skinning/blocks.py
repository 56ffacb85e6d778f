r"""Symmetric positive systems of a net: banded, by blocks of one row of the net.

A cubic net couples control points at most three rows apart (six, folded, where the net runs back
into itself), so that a column of blocks holds its own and the p below it::

    | D0              |       panel k, transposed: (b, (p + 1) b), row by row
    | E01 D1          |
    | E02 E12 D2      |           D_k' | E_k1' | E_k2' | ..
    | .   E13 E23 D3  |
                              of D_k the lower triangle is given
Dense Cholesky of the panels (BLAS) does the work, in place; the inverse is found inside the band
only (Takahashi's recursion), which is all that variances need. It takes the factor's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpotrf, dpotri, dtrtrs

from reconstruction.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The lower half of a block-banded symmetric matrix, or what is known of its inverse."""

    panels: FloatArray  # (k, b, (p + 1) b): panels[k, j, i] is entry (k b + i, k b + j)

    @property
    def reach(self) -> int:
        """How many blocks stand below the diagonal."""
        return int(self.panels.shape[2] // self.panels.shape[1]) - 1

    @property
    def diagonal(self) -> FloatArray:
        """Entries on the diagonal, (k, b); a view."""
        return np.asarray(np.einsum("kii->ki", self.panels[:, :, : self.panels.shape[1]]))


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """Cholesky factor, in panels alike."""

    panels: FloatArray  # (k, b, (p + 1) b); of the diagonal blocks the lower triangle counts


def empty_blocks(blocks: int, size: int, reach: int) -> Blocks:
    """A zero matrix."""
    return Blocks(np.zeros((blocks, size, (reach + 1) * size)))


def factorise(matrix: Blocks) -> Factor | None:
    """Return the Cholesky factor in the matrix's place; None if that is not positive definite."""
    panels, reach = matrix.panels, matrix.reach
    count, size = panels.shape[:2]
    for k in range(count):
        own, failed = dpotrf(panels[k, :, :size].T, lower=True)
        if failed:
            return None
        panels[k, :, :size] = own.T
        below = _below(panels, k)
        if below.shape[1]:
            below[:] = dtrsm(1.0, own, below.T, side=1, lower=1, trans_a=1).T
        for a in range(min(reach, count - 1 - k)):
            rest = below[:, a * size :]
            panels[k + a + 1, :, : rest.shape[1]] -= rest[:, :size].T @ rest
    return Factor(panels)


def _below(panels: FloatArray, k: int) -> FloatArray:
    """What stands below the diagonal block of a panel, without what is past the last row."""
    count, size, length = panels.shape
    return panels[k, :, size : min(length, (count - k) * size)]


def solve(factor: Factor, right: FloatArray) -> FloatArray:
    """Solve for a right side (k, b), or several, (k, b, r)."""
    panels = factor.panels
    count, size = panels.shape[:2]
    out = right.reshape(count * size, -1).copy()
    for k in range(count):
        own, below = slice(k * size, (k + 1) * size), _below(panels, k)
        out[own], _ = dtrtrs(panels[k, :, :size].T, out[own], lower=1)
        out[own.stop : own.stop + below.shape[1]] -= below.T @ out[own]
    for k in range(count - 1, -1, -1):
        own, below = slice(k * size, (k + 1) * size), _below(panels, k)
        rest = out[own] - below @ out[own.stop : own.stop + below.shape[1]]
        out[own], _ = dtrtrs(panels[k, :, :size].T, rest, lower=1, trans=1)
    return out.reshape(right.shape)


def inverse_blocks(factor: Factor) -> Blocks:
    """Return the inverse inside the band, in the factor's place; diagonal blocks are full."""
    panels = factor.panels
    count, size, length = panels.shape
    known = np.zeros((length - size, length - size))  # of the inverse, below the present panel
    spare = np.zeros_like(known)
    for k in range(count - 1, -1, -1):
        root = panels[k, :, :size].T
        own, _ = dpotri(root, lower=True)
        own = own + own.T  # above the diagonal of a factor there are zeros
        np.einsum("ii->i", own)[:] *= 0.5
        below = _below(panels, k)
        width = below.shape[1]
        # What a unit of block k leaves for those below it, transposed.
        passed = dtrsm(1.0, root, below.T, side=1, lower=1).T
        below[:] = -passed @ known[:width, :width]
        own -= below @ passed.T
        # What rounding leaves unsymmetric would grow from panel to panel.
        own = 0.5 * (own + own.T)
        panels[k, :, :size] = own
        spare[:size, :size] = own
        spare[:size, size:], spare[size:, :size] = _kept(below, length, size)
        spare[size:, size:] = known[: length - 2 * size, : length - 2 * size]
        known, spare = spare, known
    return Blocks(panels)


def _kept(below: FloatArray, length: int, size: int) -> tuple[FloatArray, FloatArray]:
    """The part of a panel's inverse that the next one needs, and its transpose."""
    wide = np.zeros((size, length - 2 * size))
    part = below[:, : wide.shape[1]]
    wide[:, : part.shape[1]] = part
    return wide, wide.T
