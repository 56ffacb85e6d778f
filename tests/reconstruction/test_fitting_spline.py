"""Uniform splines against the NURBS they are, and linear smoothing against dense least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bending import span_lengths
from reconstruction.fitting.preliminary import normal_equations, preliminary, reknotted
from reconstruction.fitting.spline import evaluate, nurbs_of, spans_of
from reconstruction.nurbs import curve_derivatives
from tests.reconstruction.fit_cases import chain_of, circle, noisy, rms_to, superformula, wave


def random_control(count: int, seed: int) -> FloatArray:
    turn = np.arange(count) / count * 2 * np.pi
    noise = np.random.default_rng(seed).normal(0, 1.5, (count, 2))
    return 20 * np.column_stack([np.cos(turn), np.sin(turn)]) + noise


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_a_spline_is_the_nurbs_curve_it_becomes(closed: bool) -> None:  # noqa: FBT001
    control = random_control(12, 1)
    spans = spans_of(control, closed=closed)
    t = np.linspace(0, spans, 101)[: -1 if closed else None]
    expected = curve_derivatives(nurbs_of(control, closed=closed), t / spans, 2)
    for order, found in enumerate(evaluate(control, t)):
        np.testing.assert_allclose(found, expected[order] / spans**order, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_normal_equations_are_those_of_the_design_matrix(closed: bool) -> None:  # noqa: FBT001
    rng = np.random.default_rng(4)
    unknowns, spans = 11, 11 if closed else 8
    t, places = rng.random(60) * spans, rng.normal(size=(60, 2))
    full = BSpline.design_matrix(t, np.arange(-3.0, spans + 4.0), 3).toarray()
    design = full[:, :unknowns].copy()
    if closed:
        design[:, :3] += full[:, unknowns:]
    band, right = normal_equations(t, places, unknowns, closed=closed)
    np.testing.assert_allclose(right, design.T @ places, atol=1e-12)
    dense = design.T @ design
    for i in range(unknowns):
        for k in range(4 if closed else min(4, unknowns - i)):
            assert band[i, k] == pytest.approx(dense[i, (i + k) % unknowns], abs=1e-12)


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_span_lengths_are_those_of_a_fine_polyline(closed: bool) -> None:  # noqa: FBT001
    control = random_control(15, 2)
    spans = spans_of(control, closed=closed)
    fine = evaluate(control, np.linspace(0, spans, 400 * spans + 1))[0]
    expected = np.linalg.norm(np.diff(fine, axis=0), axis=1).reshape(spans, -1).sum(axis=1)
    np.testing.assert_allclose(span_lengths(control, spans), expected, rtol=2e-3)


def test_the_first_curve_smooths_its_nodes_and_finds_how_much_by_itself() -> None:
    outline = circle()
    points, share = noisy(outline, 200, 1.0, 5)
    chain = chain_of(points, share, 1.0, pieces=200)
    control, edf = preliminary(chain)
    places = evaluate(control, np.linspace(0, len(control), 200, endpoint=False))[0]
    assert rms_to(places, outline) < 0.3  # nodes scatter by 1
    assert 3 < edf < 20


def test_reknotting_keeps_the_curve_and_makes_spans_equally_long() -> None:
    outline = superformula()
    points, share = noisy(outline, 2000, 0.2, 6)
    control, _ = preliminary(chain_of(points, share, 0.2))
    finer = reknotted(control, 150, closed=True)
    lengths = span_lengths(finer, 150)
    assert lengths.std() < 0.01 * lengths.mean()
    old = evaluate(control, np.linspace(0, len(control), 8000, endpoint=False))[0]
    new = evaluate(finer, np.linspace(0, 150, 400, endpoint=False))[0]
    gaps = np.array([np.hypot(*(old - place).T).min() for place in new])
    assert gaps.max() < 0.05


def test_reknotting_a_stretch_of_an_open_curve_keeps_its_ends() -> None:
    points, share = noisy(wave(), 1000, 0.1, 7)
    control, _ = preliminary(chain_of(points, share, 0.1, closed=False))
    shorter = reknotted(control, 40, closed=False, within=(10.0, 60.0))
    ends = evaluate(shorter, np.array([0.0, 40.0]))[0]
    np.testing.assert_allclose(ends, evaluate(control, np.array([10.0, 60.0]))[0], atol=1e-3)
