"""Basis functions against the textbook recursion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.nurbs import basis_derivatives, basis_functions, find_spans
from reconstruction.nurbs.basis import domain_of, in_domain
from tests.reconstruction.nurbs_cases import naive_basis, naive_slope, random_knots

seeds = st.integers(0, 2**32 - 1)


def parameters_over(knots, degree, count=15):
    start, end = domain_of(degree, knots)
    inner = knots[(knots >= start) & (knots <= end)]
    return np.concatenate([np.linspace(start, end, count), inner])


@settings(max_examples=25, deadline=None)
@given(seeds, st.integers(1, 4), st.booleans())
def test_local_functions_are_the_recursion_of_the_paper(seed, degree, clamped):
    knots = random_knots(
        np.random.default_rng(seed), degree + 5, degree, periodic=False, clamped=clamped
    )
    end = domain_of(degree, knots)[1]
    u = parameters_over(knots, degree)
    spans, values = basis_functions(u, degree, knots)
    for row, t in enumerate(u):
        naive = [naive_basis(i, degree, t, knots, end=end) for i in range(len(knots) - degree - 1)]
        full = np.zeros(len(naive))
        full[spans[row] - degree : spans[row] + 1] = values[row]
        np.testing.assert_allclose(full, naive, rtol=0, atol=1e-14)


@settings(max_examples=15, deadline=None)
@given(seeds, st.integers(1, 4))
def test_derivatives_are_the_recursion_on_the_degree(seed, degree):
    knots = random_knots(np.random.default_rng(seed), degree + 4, degree, periodic=False)
    end = domain_of(degree, knots)[1]
    u = parameters_over(knots, degree, 7)
    spans, rows = basis_derivatives(u, degree, knots, degree + 1)
    for row, t in enumerate(u):
        for order in range(degree + 2):
            first = spans[row] - degree
            naive = [
                naive_slope(first + j, degree, t, knots, order, end=end) for j in range(degree + 1)
            ]
            np.testing.assert_allclose(rows[order, row], naive, rtol=1e-11, atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(seeds, st.integers(1, 5), st.booleans(), st.integers(6, 20))
def test_basis_functions_sum_to_one_and_their_derivatives_to_zero(seed, degree, periodic, count):
    knots = random_knots(np.random.default_rng(seed), count, degree, periodic=periodic)
    u = parameters_over(knots, degree)
    _, rows = basis_derivatives(u, degree, knots, 2, periodic=periodic)
    np.testing.assert_allclose(rows[0].sum(axis=1), 1.0, rtol=0, atol=1e-14)
    assert np.all(rows[0] >= 0)
    scale = np.abs(rows[1:]).max(axis=(1, 2))
    assert np.all(np.abs(rows[1:].sum(axis=2)).max(axis=1) <= 1e-13 * (1 + scale))


def test_a_span_starts_at_its_knot_and_the_end_belongs_to_the_last_real_one():
    knots = np.array([0, 0, 0, 1, 1, 4, 4, 4], dtype=float)
    assert find_spans(np.array([0, 0.5, 1, 3.9, 4]), 2, knots).tolist() == [2, 2, 4, 4, 4]


def test_spans_are_found_among_knots_of_very_uneven_spacing():
    rng = np.random.default_rng(5)
    inner = np.sort(np.concatenate([rng.uniform(0, 1e-6, 40), rng.uniform(0, 1000, 40)]))
    knots = np.concatenate([np.zeros(4), inner, np.full(4, 1000.0)])
    u = np.concatenate([inner, rng.uniform(0, 1e-6, 300), rng.uniform(0, 1000, 300)])
    expected = np.searchsorted(knots, u, side="right") - 1
    assert np.array_equal(find_spans(u, 3, knots), expected)


def test_open_domains_refuse_what_lies_outside_and_name_themselves():
    knots = np.array([0, 0, 2, 2], dtype=float)
    for wrong in (-1e-9, 2.5, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"outside the domain \[0, 2\]"):
            in_domain([1.0, wrong], 1, knots, periodic=False)


def test_periodic_domains_reduce_every_real_parameter_into_the_half_open_period():
    knots = np.arange(-3, 8, dtype=float)  # period 4
    u = in_domain([0, 4, -4, 4.5, -1e-20, 2.25, 1e6 + 1], 3, knots, periodic=True)
    np.testing.assert_array_equal(u, [0, 0, 0, 0.5, 0, 2.25, 1])
    with pytest.raises(ValueError, match="not finite"):
        in_domain([np.nan], 3, knots, periodic=True)
