"""The first net's smooth curves against hats on every column, as the textbook has them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.skinning.laying import _STIFFNESSES, _design, _smoother
from reconstruction.skinning.net import knots_of


def naive_smoother(
    t: FloatArray, knots: FloatArray, weights: FloatArray, places: FloatArray, *, closed: bool
) -> FloatArray:
    """The matrix (n, m) of least generalised cross-validation, by the hat of every stiffness."""
    design, bends = _design(t, knots, closed=closed)
    normal = design.T @ np.diag(weights) @ design
    scale = np.trace(normal) / len(normal)
    columns = places.reshape(len(places), -1)
    columns = columns - columns.mean(axis=0)
    scores, solvers = [], []
    for log in _STIFFNESSES:
        solver = np.linalg.solve(normal + scale * 10.0**log * bends, design.T @ np.diag(weights))
        left = columns - design @ solver @ columns
        misfit = (weights[:, None] * left**2).sum()
        scores.append(misfit / (len(t) - np.trace(design @ solver) + 1e-9) ** 2)
        solvers.append(solver)
    return np.asarray(solvers[int(np.argmin(scores))])


@pytest.mark.parametrize(
    ("places", "spans", "closed"), [(90, 30, True), (40, 12, False), (9, 20, False)]
)
@pytest.mark.parametrize("noise_mm", [1e-9, 0.01, 1.0])
def test_the_smoothest_likely_curves_are_those_of_the_hats(
    *, places: int, spans: int, closed: bool, noise_mm: float
) -> None:
    rng = np.random.default_rng(places)
    share = np.arange(places) / (places if closed else places - 1)
    waves = np.cos(math.tau * (share[:, None] - rng.random(17)) * rng.integers(1, 4, 17))
    lines = np.stack([waves, waves**2, np.broadcast_to(np.arange(17.0), waves.shape)], axis=2)
    lines = 10.0 * lines + rng.normal(0.0, noise_mm, lines.shape)
    weights = np.ones(places)
    if not closed:
        weights[[0, -1]] = 1e3
    knots = knots_of(spans, closed=closed)
    found = _smoother(share * spans, knots, weights, lines, closed=closed)
    expected = naive_smoother(share * spans, knots, weights, lines, closed=closed)
    # Fewer places than control points leave a system of a condition of some 1e8.
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 if places < spans else 1e-10)
