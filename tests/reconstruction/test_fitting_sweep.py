"""Foot points, distances and normal equations against a search and dense products."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bending import control_normals
from reconstruction.fitting.spline import evaluate
from reconstruction.fitting.sweep import sweep

Swept = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def ring(count: int = 24, radius: float = 30.0) -> FloatArray:
    turn = np.arange(count) / count * 2 * np.pi
    return radius * np.column_stack([np.cos(turn), 0.7 * np.sin(turn)])


def swept(
    control: FloatArray,
    t: FloatArray,
    places: FloatArray,
    *,
    variance: float = 1e-12,
    counts: FloatArray | None = None,
    covariances: FloatArray | None = None,
) -> Swept:
    m = len(places)
    band, right = np.zeros((len(control), 4)), np.zeros((len(control), 1))
    distances, _, weights = sweep(
        control, control_normals(control, closed=True), t,
        np.ones(m) if counts is None else counts, np.ones(m) if counts is None else counts, places,
        np.zeros((m, 3)) if covariances is None else covariances,
        np.full(m, variance), band, right, closed=True, rounds=6,
    )  # fmt: skip
    return t, distances, weights, band, right


def test_foot_points_and_distances_are_those_of_a_fine_search() -> None:
    control = ring()
    rng = np.random.default_rng(1)
    start = rng.random(50) * 24
    places = evaluate(control, start)[0] + rng.normal(0, 2, (50, 2))
    t, distances, *_ = swept(control, (start + rng.normal(0, 0.3, 50)) % 24, places)
    fine = evaluate(control, np.linspace(0, 24, 240_001))[0]
    for n in range(50):
        nearest = np.hypot(*(fine - places[n]).T).min()
        assert abs(distances[n]) == pytest.approx(nearest, abs=1e-4)
        inside = np.hypot(places[n, 0], places[n, 1] / 0.7) < np.hypot(
            *(evaluate(control, t[n : n + 1])[0][0] / [1, 0.7])
        )
        assert (distances[n] > 0) == inside


def test_normal_equations_are_those_of_the_derivatives_of_the_distances() -> None:
    control = ring()
    rng = np.random.default_rng(2)
    t = rng.random(30) * 24
    places = evaluate(control, t)[0] + rng.normal(0, 0.01, (30, 2))
    t, distances, weights, band, right = swept(control, t, places, variance=0.25)
    normals = control_normals(control, closed=True)
    dense = np.zeros((30, 24))
    for j in range(24):
        moved = control.copy()
        moved[j] += 1e-5 * normals[j]
        dense[:, j] = (distances - swept(moved, t.copy(), places, variance=0.25)[1]) / 1e-5
    assert (weights == 1.0).all()
    np.testing.assert_allclose(right[:, 0], dense.T @ distances / 0.25, atol=2e-3)
    product = dense.T @ dense / 0.25
    found = np.array([[product[i, (i + k) % 24] for k in range(4)] for i in range(24)])
    np.testing.assert_allclose(band, found, atol=0.02 * found.max())


def test_points_far_off_count_less_and_at_last_not_at_all() -> None:
    control = ring()
    t = np.full(4, 6.0)
    foot, first, _ = evaluate(control, t)
    normal = np.column_stack([-first[:, 1], first[:, 0]]) / np.linalg.norm(first, axis=1)[:, None]
    places = foot + normal * np.array([[0.0], [2.9], [4.0], [5.1]])
    _, _, weights, *_ = swept(control, t.copy(), places, variance=1.0)
    assert weights[0] == weights[1] == 1.0
    assert 0.0 < weights[2] < 1.0
    assert weights[3] == 0.0


def test_a_cell_stands_for_the_mean_distance_of_its_points() -> None:
    """The centroid of an arc lies inside it; without the correction this fails by 0.02 mm."""
    control = ring()
    rng = np.random.default_rng(3)
    foot, first, _ = evaluate(control, np.linspace(5.5, 6.5, 200))
    normal = np.column_stack([-first[:, 1], first[:, 0]]) / np.linalg.norm(first, axis=1)[:, None]
    across = rng.normal(0, 0.05, (200, 1))
    places = foot + across * normal
    spread = np.cov(places.T, bias=True)
    packed = np.array([[spread[0, 0], spread[0, 1], spread[1, 1]]])
    _, distances, *_ = swept(
        control, np.array([6.0]), places.mean(axis=0)[None], counts=np.array([200.0]),
        covariances=packed,
    )  # fmt: skip
    assert distances[0] == pytest.approx(across.mean(), abs=1e-3)


def test_isotropic_noise_about_a_ring_leaves_no_bias() -> None:
    """The mean radius grows by sigma**2 / 2R, here 0.04 mm."""
    turn = np.arange(200) / 200 * 2 * np.pi
    control = 12 * np.column_stack([np.cos(turn), np.sin(turn)])
    rng = np.random.default_rng(4)
    t = rng.random(200_000) * 200
    places = evaluate(control, t)[0] + rng.normal(0, 1.0, (200_000, 2))
    _, distances, *_ = swept(control, t, places, variance=1.0)
    assert abs(distances.mean()) < 0.008
