"""Block-banded systems, held against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.skinning.assembly import add_stiffness, empty_system
from reconstruction.skinning.bending import stiffness_rows
from reconstruction.skinning.blocks import Blocks, empty_blocks, factorise, inverse_blocks, solve
from reconstruction.skinning.unknowns import unknowns_of
from tests.reconstruction.skinning_parts import tube_net

SHAPES = [(1, 4, 3), (2, 3, 3), (7, 4, 3), (9, 3, 6), (5, 2, 1)]


def dense(matrix: Blocks) -> np.ndarray:
    """The symmetric matrix that panels stand for."""
    blocks, size, length = matrix.panels.shape
    out = np.zeros((blocks * size, blocks * size + length))
    for k, panel in enumerate(matrix.panels):
        out[k * size : (k + 1) * size, k * size : k * size + length] = panel
    upper = np.triu(out[:, : blocks * size])
    return upper + np.triu(upper, 1).T


def system(blocks: int, size: int, reach: int, seed: int) -> tuple[Blocks, np.ndarray]:
    """A random symmetric positive matrix in panels, and the same dense."""
    rng = np.random.default_rng(seed)
    matrix = empty_blocks(blocks, size, reach)
    for k, panel in enumerate(matrix.panels):
        inside = min(panel.shape[1], (blocks - k) * size)
        panel[:, :inside] = np.triu(rng.normal(size=(size, inside)))
    matrix.diagonal[:] += 1.0 + np.abs(dense(matrix)).sum(axis=1).max()
    return matrix, dense(matrix)


@pytest.mark.parametrize(("blocks", "size", "reach"), SHAPES)
def test_a_banded_system_is_solved_as_the_dense_one(blocks: int, size: int, reach: int) -> None:
    matrix, full = system(blocks, size, reach, 1)
    factor = factorise(matrix)
    assert factor is not None
    right = np.random.default_rng(2).normal(size=(blocks, size))
    assert solve(factor, right).ravel() == pytest.approx(
        np.linalg.solve(full, right.ravel()), rel=1e-10
    )
    many = np.random.default_rng(3).normal(size=(blocks, size, 2))
    assert solve(factor, many).reshape(-1, 2) == pytest.approx(
        np.linalg.solve(full, many.reshape(-1, 2)), rel=1e-10
    )


@pytest.mark.parametrize(("blocks", "size", "reach"), SHAPES)
def test_the_inverse_is_right_wherever_the_matrix_has_blocks(
    blocks: int, size: int, reach: int
) -> None:
    matrix, full = system(blocks, size, reach, 4)
    factor = factorise(matrix)
    assert factor is not None
    found, truth = dense(inverse_blocks(factor)), np.linalg.inv(full)
    beside = np.subtract.outer(np.arange(len(full)) // size, np.arange(len(full)) // size)
    near = np.abs(beside) <= reach
    assert found[near] == pytest.approx(truth[near], rel=1e-9, abs=1e-14)


def test_the_inverse_holds_where_hardly_anything_holds_the_net() -> None:
    """Stiffness alone on a long net: rounding that is not symmetric would grow beyond all bounds.

    The ridge is that of the fit; what double precision leaves of it is a part in a million.
    """
    net = tube_net(50.0, (17, 38))
    unknowns = unknowns_of(net, (None, None))
    matrix, _ = empty_system(unknowns)
    for rows in stiffness_rows(net, unknowns):
        add_stiffness((matrix, np.zeros(unknowns.count)), rows, np.ones(len(rows.values_mm)))
    matrix.diagonal[:] += 1e-8 * matrix.diagonal.max()
    truth = np.linalg.inv(dense(matrix))
    factor = factorise(matrix)
    assert factor is not None
    found = inverse_blocks(factor).diagonal.ravel()
    assert found == pytest.approx(truth.diagonal(), rel=1e-6)


def test_a_matrix_that_is_not_positive_has_no_factor() -> None:
    assert factorise(Blocks(-np.eye(3)[None])) is None
