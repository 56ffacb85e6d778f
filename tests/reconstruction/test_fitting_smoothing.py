"""The compiled rounds of the smoothing fits against the same, step by step in numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bands import factorise, inverse_band, solve
from reconstruction.fitting.bending import (
    add_penalty,
    control_normals,
    curvature_changes,
    row_values,
    row_variances,
    span_lengths,
)
from reconstruction.fitting.preliminary import _third_differences, normal_equations, smoothed
from reconstruction.fitting.smoothing import _RIDGE, _solved, _tied, _ties
from reconstruction.fitting.spline import evaluate
from reconstruction.fitting.sweep import sweep


def places(rng: np.random.Generator, count: int, *, closed: bool) -> FloatArray:
    """Noisy places along a lobed ring, or three quarters of it."""
    turn = np.arange(count) / count * (math.tau if closed else 4.7)
    radius = 20.0 + 3.0 * np.cos(3.0 * turn)
    ring = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(ring + rng.normal(0.0, 0.1, ring.shape))


@pytest.mark.parametrize("closed", [False, True])
def test_a_round_is_what_its_steps_are_one_by_one(*, closed: bool) -> None:
    rng = np.random.default_rng(1)
    control = places(rng, 20, closed=closed)
    spans = 20 if closed else 17
    t = np.sort(rng.uniform(0.0, spans, 300))
    counts, kinship = rng.integers(1, 9, 300).astype(float), rng.uniform(1.0, 2.0, 300)
    means = evaluate(control, t)[0] + rng.normal(0.0, 0.2, (300, 2))
    covariances = np.tile([0.02, 0.0, 0.03], (300, 1))
    relative, logs = rng.uniform(0.5, 1.5, 300), rng.normal(4.0, 1.0, spans)
    start, leash = control + rng.normal(0.0, 0.1, control.shape), 4.0

    feet = t.copy()
    normals = control_normals(control, closed=closed)
    _, changes, rows = curvature_changes(control, normals, spans, closed=closed)
    band, right = np.zeros((20, 4)), np.zeros((20, 1))
    distances, scatters, weights = sweep(
        control, normals, feet, counts, counts / kinship, means, covariances, 0.04 * relative,
        band, right, closed=closed, rounds=2,
    )  # fmt: skip
    lengths = span_lengths(control, spans)
    stiffness = np.exp(logs) / np.maximum(lengths, 1e-3 * lengths.mean())
    add_penalty(band, right, rows, changes, stiffness)
    band[:, 0] += 1.0 / leash
    right[:, 0] -= ((control - start) * normals).sum(axis=1) / leash
    band[:, 0] += _RIDGE * band[:, 0].max()
    factor = factorise(band)
    moves, inverse = solve(*factor, right), inverse_band(*factor)
    shares = stiffness * row_variances(rows, inverse)
    forms = stiffness * (changes + row_values(rows, moves)) ** 2
    held = counts * weights
    square = (held * (distances**2 + scatters) / relative).sum()
    moves = moves * min(1.0, lengths.mean() / np.abs(moves).max())

    found_feet = t.copy()
    found = _solved(
        control, found_feet, counts, kinship, means, covariances, relative, 0.04, logs, start,
        leash, closed=closed, rounds=2,
    )  # fmt: skip
    expected = (control + moves * normals, moves, distances, scatters, weights, inverse, shares,
                forms, held.sum(), square)  # fmt: skip
    np.testing.assert_array_equal(found_feet, feet)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("stations", [1, 2, 3, 9, 48])
@pytest.mark.parametrize("closed", [False, True])
def test_tied_stations_step_as_the_dense_system_says(stations: int, *, closed: bool) -> None:
    rng = np.random.default_rng(stations)
    free, bent = rng.uniform(0.05, 2.0, stations), 10.0 ** rng.uniform(-3, 3, stations)
    logs = rng.normal(0.0, 2.0, stations)
    expected = np.clip(np.log(free / bent), -3.0, 3.0)
    ties = _ties(stations, closed)
    if stations >= 3:
        gradient = 0.5 * free * expected - ties @ logs
        expected = np.clip(np.linalg.solve(np.diag(0.5 * free) + ties, gradient), -3.0, 3.0)
    np.testing.assert_allclose(_tied(free, bent, logs, ties), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("closed", [False, True])
def test_a_preliminary_curve_is_that_of_its_rounds_in_numpy(*, closed: bool) -> None:
    nodes = places(np.random.default_rng(2), 60, closed=closed)
    spans, unknowns = 24, 24 if closed else 27
    t = np.arange(60) / 60 * spans
    data, right = normal_equations(t, nodes, unknowns, closed=closed)
    rank, ratio = (spans - 1 if closed else spans), 1.0
    for _ in range(12):
        band = data.copy()
        add_penalty(
            band, np.zeros((unknowns, 1)), _third_differences(spans), np.zeros(spans),
            np.full(spans, ratio),
        )  # fmt: skip
        band[:, 0] += 1e-12 * data[:, 0].max()
        factor = factorise(band)
        control = solve(*factor, right)
        spent = ratio * row_variances(_third_differences(spans), inverse_band(*factor)).sum()
        edf = unknowns - spent
        misfit = ((nodes - evaluate(control, t)[0]) ** 2).sum()
        scatter = misfit / (2 * max(60 - edf, 0.5 + 0.1 * 60)) + 1e-300
        bends = np.diff(control[np.arange(unknowns + 3 * closed) % unknowns], n=3, axis=0)
        form = (bends**2).sum() / scatter
        ratio *= min(max(2 * max(rank - spent, 0.1) / max(ratio * form, 1e-3), 0.05), 20.0)
        ratio = min(max(ratio, 1e-6), 1e9)
    found, freedom = smoothed(nodes, t, spans, closed=closed)
    assert freedom == pytest.approx(edf, rel=1e-9)
    np.testing.assert_allclose(found, control, rtol=1e-9, atol=1e-9)
