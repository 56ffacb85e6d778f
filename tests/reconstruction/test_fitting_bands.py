"""The banded solver against dense matrices."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bands import LEAST, factorise, inverse_band, solve


def random_band(count: int, seed: int, *, cyclic: bool) -> tuple[FloatArray, FloatArray]:
    """A positive definite matrix and its band."""
    rng = np.random.default_rng(seed)
    dense = np.zeros((count, count))
    for row in range(count if cyclic else count - 3):
        at = (row + np.arange(4)) % count
        values = rng.normal(size=4)
        dense[np.ix_(at, at)] += np.outer(values, values)
    dense += 0.1 * np.eye(count)
    band = np.zeros((count, 4))
    for i in range(count):
        for k in range(4):
            if cyclic or i + k < count:
                band[i, k] = dense[i, (i + k) % count]
    return dense, band


@pytest.mark.parametrize("cyclic", [True, False], ids=["cyclic", "open"])
@pytest.mark.parametrize("count", [LEAST, LEAST + 1, 20, 101])
def test_a_banded_system_is_solved_as_by_a_dense_one(count: int, cyclic: bool) -> None:  # noqa: FBT001
    dense, band = random_band(count, count, cyclic=cyclic)
    right = np.random.default_rng(1).normal(size=(count, 2))
    found = solve(*factorise(band), right)
    np.testing.assert_allclose(found, np.linalg.solve(dense, right), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("cyclic", [True, False], ids=["cyclic", "open"])
@pytest.mark.parametrize("count", [LEAST, LEAST + 1, 20, 101])
def test_the_band_of_the_inverse_is_that_of_the_dense_inverse(
    count: int,
    cyclic: bool,  # noqa: FBT001
) -> None:
    dense, band = random_band(count, count + 7, cyclic=cyclic)
    inverse = np.linalg.inv(dense)
    expected = np.array([[inverse[i, (i + k) % count] for k in range(4)] for i in range(count)])
    np.testing.assert_allclose(inverse_band(*factorise(band)), expected, rtol=1e-8, atol=1e-9)


def test_a_matrix_that_is_not_positive_definite_shows_in_its_pivots_or_its_inverse() -> None:
    _, band = random_band(20, 3, cyclic=True)
    band[5, 0] = -1.0
    main, _, _ = factorise(band)
    assert main[:, 0].min() <= 0.0
