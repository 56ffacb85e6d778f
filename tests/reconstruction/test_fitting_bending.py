"""Curvature and its derivatives against circles, finite differences and dense sums."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.fitting.bending import (
    add_penalty,
    control_normals,
    curvature_changes,
    row_values,
    row_variances,
)
from reconstruction.fitting.spline import evaluate, spans_of
from tests.reconstruction.test_fitting_spline import random_control


def test_curvature_at_the_knots_is_that_of_the_derivatives() -> None:
    control = random_control(14, 3)
    normals = control_normals(control, closed=True)
    found, changes, _ = curvature_changes(control, normals, 14, closed=True)
    _, first, second = evaluate(control, np.arange(14.0))
    expected = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    expected /= np.linalg.norm(first, axis=1) ** 3
    np.testing.assert_allclose(found[:-1], expected, rtol=1e-9)
    np.testing.assert_allclose(changes, np.diff(found), atol=1e-15)


def test_a_circle_costs_nothing_and_turns_left_when_counter_clockwise() -> None:
    turn = np.arange(40) / 40 * 2 * np.pi
    control = 25 * np.column_stack([np.cos(turn), np.sin(turn)])
    normals = control_normals(control, closed=True)
    curvatures, changes, _ = curvature_changes(control, normals, 40, closed=True)
    np.testing.assert_allclose(curvatures, 1 / 25, rtol=0.01)
    np.testing.assert_allclose(changes, 0, atol=1e-14)


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_rows_are_the_derivatives_of_the_changes_by_normal_moves(closed: bool) -> None:  # noqa: FBT001
    control = random_control(13, 4)
    spans = spans_of(control, closed=closed)
    normals = control_normals(control, closed=closed)
    _, _, rows = curvature_changes(control, normals, spans, closed=closed)
    for j in range(13):
        moved = [control.copy(), control.copy()]
        for sign, places in zip((1, -1), moved, strict=True):
            places[j] += sign * 1e-6 * normals[j]
        high, low = (curvature_changes(m, normals, spans, closed=closed)[1] for m in moved)
        moves = np.zeros((13, 1))
        moves[j] = 1.0
        np.testing.assert_allclose(row_values(rows, moves), (high - low) / 2e-6, atol=1e-6)


def test_penalty_and_variances_are_the_dense_products() -> None:
    rng = np.random.default_rng(5)
    rows, changes, weights = rng.normal(size=(9, 4)), rng.normal(size=9), rng.random(9)
    dense = np.zeros((9, 9))
    for i in range(9):
        dense[i, (i + np.arange(4)) % 9] = rows[i]
    band, right = np.zeros((9, 4)), np.zeros((9, 1))
    add_penalty(band, right, rows, changes, weights)
    product = dense.T @ np.diag(weights) @ dense
    covariance = np.linalg.inv(product + np.eye(9))
    stored = np.zeros((9, 4))
    for i in range(9):
        for k in range(4):
            assert band[i, k] == pytest.approx(product[i, (i + k) % 9])
            stored[i, k] = covariance[i, (i + k) % 9]
    np.testing.assert_allclose(right[:, 0], -dense.T @ (weights * changes))
    expected = np.diag(dense @ covariance @ dense.T)
    np.testing.assert_allclose(row_variances(rows, stored), expected)
