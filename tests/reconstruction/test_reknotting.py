"""Re-knotting: equidistant points of the old curve, and gaps that keep their place."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.nurbs import Curve, evaluate_curve, interpolate_periodic, periodic_uniform
from reconstruction.reknotting import map_gaps, measure_lengths, reknot
from tests.reconstruction.part_cases import ring


def wavy(seed: int, count: int) -> Curve:
    """A closed curve of uneven control points around a circle of 20 mm."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, count))
    radius = rng.uniform(17.0, 23.0, count)
    return periodic_uniform(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def naive_lengths(curve: Curve, parameters: FloatArray) -> FloatArray:
    """Arc length up to each parameter, by 600 chords a span."""
    start, end = curve.domain
    fine = np.linspace(start, end, 600 * len(curve.control_points_mm) + 1)
    steps = np.linalg.norm(np.diff(evaluate_curve(curve, fine), axis=0), axis=1)
    return np.asarray(np.interp(parameters, fine, np.concatenate([[0.0], steps.cumsum()])))


shapes = st.builds(wavy, st.integers(0, 2**32 - 1), st.integers(6, 40))


@given(shapes, st.integers(4, 60))
@settings(max_examples=50, deadline=None)
def test_the_new_curve_meets_the_old_one_at_every_knot_at_equal_steps_of_arc(
    old: Curve, count: int
) -> None:
    new = reknot(old, count)
    assert (len(new.control_points_mm), new.domain, new.periodic) == (count, (0.0, count), True)
    met = evaluate_curve(new, np.arange(count, dtype=float))
    start, end = old.domain
    fine = np.linspace(start, end, 400 * len(old.control_points_mm) + 1)
    polygon = evaluate_curve(old, fine)
    away = np.linalg.norm(met[:, None] - polygon, axis=2)
    lengths = naive_lengths(old, fine)
    half_step = np.diff(lengths).max() / 2.0
    assert away.min(axis=1).max() <= half_step + 1e-9, "a knot point is not on the old curve"
    at = lengths[away.argmin(axis=1)]
    wanted = np.arange(count) * lengths[-1] / count
    # Lengths by 16 chords a span are short by their sagittas, and within a chord the parameter is
    # not the length: together below 1 % of a span of the old curve.
    longest_span = np.diff(naive_lengths(old, np.arange(start, end + 0.5))).max()
    around = np.abs(at - wanted)
    around = np.minimum(around, lengths[-1] - around)
    assert around.max() <= half_step + 0.01 * longest_span


@given(shapes, st.integers(4, 60))
@settings(max_examples=30, deadline=None)
def test_the_new_curve_begins_where_the_old_one_does(old: Curve, count: int) -> None:
    new = reknot(old, count)
    np.testing.assert_allclose(
        evaluate_curve(new, np.zeros(1)), evaluate_curve(old, np.array([old.domain[0]])), atol=1e-9
    )


def test_a_regular_circle_stays_itself_at_its_own_count() -> None:
    circle = interpolate_periodic(ring(20.0, 24)[:, :2])
    np.testing.assert_allclose(
        reknot(circle, 24).control_points_mm, circle.control_points_mm, atol=1e-9
    )


def test_re_knotting_many_times_does_not_shrink_a_section() -> None:
    curve = interpolate_periodic(ring(20.0, 24)[:, :2])
    for count in (30, 24, 18, 24, 30, 24):
        curve = reknot(curve, count)
    points = evaluate_curve(curve, np.linspace(0.0, 24.0, 500))
    # Points for control points would lose h^2 R / 6 = 0.23 mm each time. A cubic through 18 points
    # of a circle stays within R h^4 / 384 = 0.8 um of it.
    np.testing.assert_allclose(np.hypot(*points.T), 20.0, atol=6 * 0.0008)


@given(shapes)
@settings(max_examples=30, deadline=None)
def test_lengths_are_measured_within_two_thousandths_of_the_whole(curve: Curve) -> None:
    parameters, lengths = measure_lengths(curve)
    assert (parameters[0], parameters[-1]) == curve.domain
    # 16 chords of a span that turns by half a circle are short by (pi / 16)^2 / 24 = 0.16 %.
    exact = naive_lengths(curve, parameters)
    np.testing.assert_allclose(lengths, exact, rtol=0.0, atol=2e-3 * exact[-1])


def naive_marks(curve: Curve, bridged: BoolArray, lengths: FloatArray) -> BoolArray:
    """Whether each arc length lies in a gap: from where the curve passes the centre before a run of
    bridged segments, within its last span there, to where it passes the one behind."""
    count = len(bridged)
    fine = np.linspace(0.0, 1.0, 401)
    total = naive_lengths(curve, np.array([float(count)]))[0]
    marks = np.zeros(len(lengths), dtype=np.bool_)

    def passing(centre: int, span: int) -> float:
        stands_for = curve.control_points_mm[(centre + 1) % count]
        parameters = span % count + fine
        away = np.linalg.norm(evaluate_curve(curve, parameters) - stands_for, axis=1)
        at = naive_lengths(curve, parameters[[int(away.argmin())]])[0]
        return float(at + span // count * total)

    for first in range(count):
        if not bridged[first] or (bridged[first - 1] and not bridged.all()):
            continue
        after = first + 1
        while bridged[after % count] and after < first + count:
            after += 1
        start, end = passing(first, first - 1), passing(after, after)
        if bridged.all():
            end = start + total
        for turn in (-total, 0.0, total):
            marks |= (lengths + turn > start) & (lengths + turn < end)
    return marks


@given(shapes, st.integers(0, 2**32 - 1), st.integers(4, 60), st.floats(0.0, 1.0))
@settings(max_examples=40, deadline=None)
def test_gaps_reach_from_measured_centre_to_measured_centre_and_no_farther(
    curve: Curve, seed: int, count: int, share: float
) -> None:
    bridged = np.random.default_rng(seed).random(len(curve.control_points_mm)) < share
    gaps, total_mm = map_gaps(curve, bridged, count)
    knots = naive_lengths(curve, np.arange(len(bridged) + 1.0))
    # Borders are found to one of 16 steps of a span, whose lengths differ by a few times.
    slack = 0.2 * np.diff(knots).max() * count / knots[-1]
    fine = np.linspace(0.0, count, 1500, endpoint=False)
    inside = np.zeros(len(fine), dtype=bool)
    clear = np.ones(len(fine), dtype=bool)
    for u0, u1 in gaps:
        assert 0.0 <= u0 < count
        assert u0 < u1 <= u0 + count + 1e-9
        for turn in (-count, 0, count):
            inside |= (fine + turn > u0) & (fine + turn < u1)
            for border in (u0, u1):
                clear &= np.abs(fine + turn - border) > slack
    marks = naive_marks(curve, bridged, fine * knots[-1] / count)
    for border in fine[marks != np.roll(marks, 1)]:  # where gaps nearly touch, they may be one
        clear &= np.abs(fine - border) > slack
    np.testing.assert_array_equal(inside[clear], marks[clear])
    assert total_mm == pytest.approx(inside.mean() * knots[-1], abs=0.02 * knots[-1])
    for before, behind in pairwise(gaps):
        assert before[1] < behind[0], "gaps that touch are one"


@pytest.mark.parametrize("missing", [2, 5, 11])
def test_a_wide_gap_is_told_at_its_full_width_although_the_curve_is_pulled_into_it(
    missing: int,
) -> None:
    points = np.roll(ring(20.0, 40)[:, :2], 7, axis=0)[missing:]
    contour_curve = periodic_uniform(np.roll(points, 1, axis=0))
    bridged = np.zeros(len(points), dtype=np.bool_)
    bridged[-1] = True
    _, total_mm = map_gaps(contour_curve, bridged, 40)
    chord = float(np.linalg.norm(points[-1] - points[0]))
    # From knot to knot it would be two thirds of it.
    assert 0.95 * chord <= total_mm <= 1.05 * chord + 0.4


def test_gaps_that_meet_at_a_centre_are_one_gap() -> None:
    # Two sectors were not seen, and what was seen between them is one place.
    points = ring(20.0, 40)[:, :2]
    left = np.concatenate([points[:20], [points[24], points[24] + 1e-9], points[29:]])
    bridged = np.zeros(len(left), dtype=np.bool_)
    bridged[[19, 21]] = True
    gaps, total_mm = map_gaps(periodic_uniform(np.roll(left, 1, axis=0)), bridged, 40)
    assert len(gaps) == 1
    chords = np.linalg.norm(points[19] - points[24]) + np.linalg.norm(points[24] - points[29])
    assert 0.9 * chords <= total_mm <= 1.1 * chords


def test_a_gap_across_the_start_is_one_gap_that_ends_beyond_the_count() -> None:
    circle = periodic_uniform(ring(20.0, 12)[:, :2])
    bridged = np.zeros(12, dtype=np.bool_)
    bridged[[10, 11, 0]] = True
    gaps, total_mm = map_gaps(circle, bridged, 24)
    assert len(gaps) == 1
    np.testing.assert_allclose(gaps[0], (20.0, 26.0), atol=1e-6)
    assert total_mm == pytest.approx(measure_lengths(circle)[1][-1] / 4.0, rel=1e-9)


def test_a_curve_that_is_bridged_all_round_is_one_gap() -> None:
    circle = periodic_uniform(ring(20.0, 12)[:, :2])
    gaps, _ = map_gaps(circle, np.ones(12, dtype=np.bool_), 24)
    assert len(gaps) == 1
    np.testing.assert_allclose(gaps[0], (0.0, 24.0), atol=1e-9)


def test_without_a_bridge_there_is_no_gap() -> None:
    circle = periodic_uniform(ring(20.0, 12)[:, :2])
    assert map_gaps(circle, np.zeros(12, dtype=np.bool_), 24) == ((), 0.0)
