"""Block-tridiagonal systems, held against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.skinning.blocks import Blocks, factorise, inverse_blocks, solve


def system(blocks: int, size: int, seed: int) -> tuple[Blocks, np.ndarray]:
    """A random symmetric positive matrix in blocks, and the same dense."""
    rng = np.random.default_rng(seed)
    lower = rng.normal(size=(blocks - 1, size, size))
    dense = np.zeros((blocks * size, blocks * size))
    for k in range(blocks - 1):
        a, b = slice(k * size, (k + 1) * size), slice((k + 1) * size, (k + 2) * size)
        dense[b, a], dense[a, b] = lower[k], lower[k].T
    dense += np.eye(len(dense)) * (1.0 + np.abs(dense).sum(axis=1).max())
    diagonal = np.stack(
        [dense[k * size : (k + 1) * size, k * size : (k + 1) * size] for k in range(blocks)]
    )
    return Blocks(np.tril(diagonal), lower), dense


@pytest.mark.parametrize(("blocks", "size"), [(1, 4), (2, 3), (5, 6)])
def test_a_block_system_is_solved_as_the_dense_one(blocks: int, size: int) -> None:
    matrix, dense = system(blocks, size, 1)
    factor = factorise(matrix)
    assert factor is not None
    right = np.random.default_rng(2).normal(size=(blocks, size))
    assert solve(factor, right).ravel() == pytest.approx(
        np.linalg.solve(dense, right.ravel()), rel=1e-10
    )
    many = np.random.default_rng(3).normal(size=(blocks, size, 2))
    assert solve(factor, many).reshape(-1, 2) == pytest.approx(
        np.linalg.solve(dense, many.reshape(-1, 2)), rel=1e-10
    )


@pytest.mark.parametrize(("blocks", "size"), [(1, 4), (2, 3), (5, 6)])
def test_the_inverse_is_right_wherever_the_matrix_has_blocks(blocks: int, size: int) -> None:
    matrix, dense = system(blocks, size, 4)
    factor = factorise(matrix)
    assert factor is not None
    found, truth = inverse_blocks(factor), np.linalg.inv(dense)
    for k in range(blocks):
        own = slice(k * size, (k + 1) * size)
        assert found.diagonal[k] == pytest.approx(truth[own, own], rel=1e-9, abs=1e-14)
        if k + 1 < blocks:
            after = slice((k + 1) * size, (k + 2) * size)
            assert found.lower[k] == pytest.approx(truth[after, own], rel=1e-9, abs=1e-14)


def test_a_matrix_that_is_not_positive_has_no_factor() -> None:
    assert factorise(Blocks(-np.eye(3)[None], np.empty((0, 3, 3)))) is None
