"""The sensor's clock and a turning table's course, from made-up arrivals and answers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from acquisition.clocks import SensorClock, table_course

RNG = np.random.default_rng


def arrivals(
    seed: int, drift_ppm: float, seconds: float = 6.0, rate_hz: float = 400.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps, true times of the station, and when they were heard: never early, sometimes late."""
    rng = RNG(seed)
    seen_s = 5000.0 + np.arange(0.0, seconds, 1.0 / rate_hz)
    stamps_s = 300.0 + (seen_s - 5000.0) * (1.0 + drift_ppm * 1e-6)
    late_s = 0.001 + rng.exponential(0.003, len(seen_s)) + 0.02 * (rng.random(len(seen_s)) < 0.02)
    return stamps_s, seen_s, np.maximum.accumulate(seen_s + late_s)


@pytest.mark.parametrize("drift_ppm", [-100.0, 0.0, 40.0, 2000.0])
def test_the_line_under_all_arrivals_maps_the_clock_but_for_a_constant(drift_ppm: float) -> None:
    stamps_s, seen_s, heard_s = arrivals(1, drift_ppm)
    clock = SensorClock()
    clock.hear(stamps_s, heard_s)
    line = clock.line()
    off_s = line.station_s(stamps_s) - seen_s
    # Of 20 in a cell the first is late by 3 ms / 20 in the mean, and the line lies under them all.
    assert np.ptp(off_s) < 3e-4
    assert off_s.mean() == pytest.approx(0.001, abs=2e-4)
    assert (line.station_s(stamps_s) <= heard_s + 1e-9).all()
    assert line.drift_ppm == pytest.approx(drift_ppm, abs=50.0)


def test_turn_after_turn_the_drift_is_told_better() -> None:
    off_ppm = []
    clock = SensorClock()
    for turn in range(8):
        stamps_s, _, heard_s = arrivals(turn, 40.0)
        clock.hear(stamps_s + 30.0 * turn * (1.0 + 40e-6), heard_s + 30.0 * turn)
        off_ppm.append(abs(clock.line().drift_ppm - 40.0))
    assert off_ppm[-1] < 2.0  # 0.3 ms in 210 s


def test_a_sensor_that_was_restarted_begins_a_clock_anew() -> None:
    stamps_s, seen_s, heard_s = arrivals(2, 0.0)
    clock = SensorClock()
    clock.hear(stamps_s + 1e4, heard_s - 60.0)
    clock.hear(stamps_s, heard_s)
    assert np.abs(clock.line().station_s(stamps_s) - seen_s - 0.001).max() < 3e-4


def test_a_clock_of_fewer_than_two_moments_is_refused() -> None:
    clock = SensorClock()
    clock.hear(np.array([1.0]), np.array([2.0]))
    with pytest.raises(ValueError, match="fewer than two"):
        clock.line()


def answers(seed: int, speed: float = math.radians(60.0)) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles of a steady table asked each 52 ms; one answer of twenty is 4 ms late."""
    rng = RNG(seed)
    asked_s = 100.0 + 0.052 * np.arange(120)
    late_s = rng.uniform(0.0, 2e-4, 120) + 0.004 * (rng.random(120) < 0.05)
    return asked_s, speed * (asked_s - 100.0 + late_s)


def test_a_steady_table_is_one_straight_piece_and_late_answers_do_not_pull() -> None:
    asked_s, told_rad = answers(3)
    course = table_course(asked_s, told_rad)
    assert len(course.knots_s) == 2
    off_rad = course.at(asked_s) - math.radians(60.0) * (asked_s - 100.0)
    # Between the earliest answer and the mean of those that are not late: 0.1 ms.
    assert (np.degrees(off_rad) >= 0.0).all()
    assert (np.degrees(off_rad) <= 60.0 * 1e-4).all()
    assert math.degrees(course.residual_rad) < 60.0 * 1e-4


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_busy_hour_turns_nothing_against_a_quiet_one(sense: float) -> None:
    rng, speed = RNG(5), sense * math.radians(60.0)
    asked_s = 100.0 + 0.052 * np.arange(120)
    quiet, busy = (
        table_course(asked_s, speed * (asked_s - 100.0 + rng.exponential(mean_s, 120)))
        for mean_s in (0.0002, 0.004)
    )
    # 4 ms in the mean are 0.24 deg.
    assert np.degrees(np.abs(quiet.at(asked_s) - busy.at(asked_s))).max() < 0.04


def test_a_table_that_speeds_up_has_more_pieces() -> None:
    asked_s, told_rad = answers(4)
    uneven_rad = told_rad + math.radians(1.0) * np.sin((asked_s - 100.0) * math.tau / 6.2)
    course = table_course(asked_s, uneven_rad)
    assert len(course.knots_s) > 4
    # A chord of a sixteenth of the turn lies 1 - cos(11 deg) = 2 % of a degree off.
    assert np.degrees(np.abs(course.at(asked_s) - uneven_rad)).max() < 0.3
    assert math.degrees(course.residual_rad) < 0.03


def test_beyond_its_ends_a_course_goes_on_as_it_was() -> None:
    course = table_course(np.arange(10.0), 2.0 * np.arange(10.0))
    np.testing.assert_allclose(course.at(np.array([-1.0, 4.5, 12.0])), [-2.0, 9.0, 24.0])


def test_too_few_answers_are_no_course() -> None:
    with pytest.raises(ValueError, match="only 3 positions"):
        table_course(np.arange(3.0), np.arange(3.0))
