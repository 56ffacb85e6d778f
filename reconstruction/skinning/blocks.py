r"""Symmetric positive systems of a net: block-tridiagonal, a few rows of the net a block.

A cubic net couples control points at most three rows apart, so that blocks of three rows (of six,
folded, where the net runs back into itself) touch only their neighbours::

    | D0  E0' .   |       D_k (b, b), symmetric, lower triangle given
    | E0  D1  E1' |       E_k (b, b), block k + 1 against block k
    | .   E1  D2  |

Dense Cholesky of the blocks (LAPACK) does the work; the inverse is found inside the blocks only
(Takahashi's recursion), which is all that variances need.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri

from reconstruction.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """A block-tridiagonal matrix, or what is known of its inverse."""

    diagonal: FloatArray  # (k, b, b)
    lower: FloatArray  # (k - 1, b, b)


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """Cholesky factor: lower triangles, and what stands below them."""

    diagonal: FloatArray  # (k, b, b), lower triangular
    lower: FloatArray  # (k - 1, b, b)


def factorise(matrix: Blocks) -> Factor | None:
    """Return the Cholesky factor; None for a matrix that is not positive definite."""
    diagonal, lower = matrix.diagonal.copy(), matrix.lower.copy()
    for k in range(len(diagonal)):
        if k > 0:
            diagonal[k] -= lower[k - 1] @ lower[k - 1].T
        diagonal[k], failed = dpotrf(diagonal[k], lower=True)
        if failed:
            return None
        if k < len(lower):
            lower[k] = solve_triangular(diagonal[k], lower[k].T, lower=True, check_finite=False).T
    return Factor(diagonal, lower)


def solve(factor: Factor, right: FloatArray) -> FloatArray:
    """Solve for a right side (k, b), or several, (k, b, r)."""
    out = np.empty_like(right)
    last = len(factor.diagonal) - 1
    for k in range(last + 1):
        rest = right[k] if k == 0 else right[k] - factor.lower[k - 1] @ out[k - 1]
        out[k] = solve_triangular(factor.diagonal[k], rest, lower=True, check_finite=False)
    for k in range(last, -1, -1):
        rest = out[k] if k == last else out[k] - factor.lower[k].T @ out[k + 1]
        out[k] = solve_triangular(factor.diagonal[k], rest, lower=True, trans=1, check_finite=False)
    return out


def inverse_blocks(factor: Factor) -> Blocks:
    """Return the inverse inside the blocks of the matrix; full symmetric diagonal blocks."""
    diagonal, lower = np.empty_like(factor.diagonal), np.empty_like(factor.lower)
    for k in range(len(diagonal) - 1, -1, -1):
        own, _ = dpotri(factor.diagonal[k], lower=True)
        diagonal[k] = np.tril(own) + np.tril(own, -1).T
        if k < len(lower):
            # G: what a unit of block k leaves for block k + 1.
            passed = solve_triangular(
                factor.diagonal[k], factor.lower[k].T, lower=True, trans=1, check_finite=False
            ).T
            lower[k] = -diagonal[k + 1] @ passed
            diagonal[k] -= passed.T @ lower[k]
    return Blocks(diagonal, lower)
