from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sim.motion import AxisMotion, Limits, Play, ScaledClock, move, stop

places = st.floats(-1e3, 1e3)
limits = st.builds(Limits, st.floats(0.1, 100.0), st.floats(0.1, 500.0))
shares = st.floats(0.0, 1.0)


def naive_position(start: float, target: float, bounds: Limits, seconds: float) -> float:
    """Step through time: speed up while there is room to slow down again."""
    steps = 40_000
    step_s, here, speed = seconds / steps, start, 0.0
    sign = math.copysign(1.0, target - start)
    for _ in range(steps):
        left = (target - here) * sign
        if left <= speed * speed / (2.0 * bounds.acceleration):
            speed = max(speed - bounds.acceleration * step_s, 0.0)
        else:
            speed = min(speed + bounds.acceleration * step_s, bounds.speed)
        here += sign * speed * step_s
    return here


@pytest.mark.parametrize(("target", "share"), [(50.0, 0.3), (50.0, 0.9), (-2.0, 0.5), (-2.0, 0.8)])
def test_a_move_goes_where_small_steps_go(target, share):
    bounds = Limits(10.0, 20.0)
    way = move(1.0, target, bounds, 0.0)
    seconds = share * way.ends_s
    expected = naive_position(1.0, target, bounds, seconds)
    assert way.position(seconds) == pytest.approx(expected, abs=5e-3)


@settings(deadline=None)
@given(places, places, limits, shares)
def test_a_move_stays_between_its_ends_and_within_its_limits(start, target, bounds, share):
    way = move(start, target, bounds, 5.0)
    time_s = 5.0 + share * (way.ends_s - 5.0)
    low, high = sorted((start, target))
    assert low - 1e-6 <= way.position(time_s) <= high + 1e-6
    assert abs(way.speed(time_s)) <= bounds.speed * (1 + 1e-9)
    assert way.position(4.0) == start
    assert way.position(way.ends_s) == target
    assert way.done(way.ends_s)
    assert abs(target - start) < 1e-9 or not way.done(5.0)


@settings(deadline=None)
@given(places, places, limits, shares)
def test_a_move_arrives_without_a_jump(start, target, bounds, share):
    way = move(start, target, bounds, 0.0)
    assert way.position(way.ends_s * (1 - 1e-12)) == pytest.approx(target, abs=1e-6)


def test_a_long_move_takes_its_way_over_speed_and_one_ramp_more():
    assert move(0.0, 100.0, Limits(10.0, 20.0), 0.0).ends_s == pytest.approx(10.0 + 0.5)


@settings(deadline=None)
@given(places, places, limits, shares)
@example(1.0, 0.0, Limits(1.0, 3.0), 1.0)  # a rounding of speed is left at its very end
def test_a_stop_begins_where_and_as_fast_as_the_move_was_and_takes_v_squared_over_2a(
    start, target, bounds, share
):
    way = move(start, target, bounds, 0.0)
    time_s = share * way.ends_s
    halt = stop(way, bounds.acceleration, time_s)
    speed = way.speed(time_s)
    assert halt.position(time_s) == way.position(time_s)
    assert halt.speed(time_s) == pytest.approx(speed, rel=1e-12)
    braking = math.copysign(speed * speed / (2 * bounds.acceleration), speed)
    assert halt.target - way.position(time_s) == pytest.approx(braking, abs=1e-9)
    low, high = sorted((start, target))
    assert low - 1e-6 <= halt.target <= high + 1e-6
    assert halt.ends_s <= way.ends_s + 1e-9


def test_the_play_is_lost_when_the_direction_turns_and_taken_up_upward():
    axis = AxisMotion.standing(0.0, Limits(10.0, 100.0), Play(0.08))
    up = axis.moved_to(5.0, 0.0)
    assert up.load(up.way.ends_s) == 5.0
    down = up.moved_to(4.0, 10.0)
    assert down.load(10.0) == 5.0
    assert down.motor(20.0) == 4.0
    assert down.load(20.0) == pytest.approx(4.08)
    little = down.moved_to(4.05, 30.0)
    assert little.load(40.0) == pytest.approx(4.08)  # inside the slack nothing follows
    again = little.moved_to(5.0, 50.0)
    assert again.load(60.0) == 5.0


def test_an_axis_refuses_a_move_while_it_moves_and_takes_a_stop_at_any_time():
    axis = AxisMotion.standing(0.0, Limits(10.0, 100.0)).moved_to(10.0, 1.0)
    with pytest.raises(ValueError, match="while moving to 10"):
        axis.moved_to(0.0, 1.5)
    halted = axis.stopped(1.5)
    assert not halted.done(1.5)
    assert halted.done(1.6 + 1e-9)
    assert halted.motor(9.0) == pytest.approx(axis.motor(1.5) + 0.5)
    assert halted.stopped(9.0).motor(10.0) == halted.motor(9.0)


def test_a_scaled_clock_runs_faster_than_its_source():
    now_s = [100.0]
    clock = ScaledClock.started(lambda: now_s[0], scale=10.0)
    assert clock() == 0.0
    now_s[0] = 100.5
    assert clock() == pytest.approx(5.0)
    assert clock.wall_s(5.0) == 0.5


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_what_is_no_speed_acceleration_scale_or_target_is_refused(bad):
    with pytest.raises(ValueError, match="speed"):
        Limits(bad, 1.0)
    with pytest.raises(ValueError, match="acceleration"):
        Limits(1.0, bad)
    with pytest.raises(ValueError, match="time scale"):
        ScaledClock.started(lambda: 0.0, bad)


def test_a_target_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="no position"):
        move(0.0, math.nan, Limits(1.0, 1.0), 0.0)


def test_a_move_so_short_that_its_square_root_vanishes_is_done_at_once():
    assert move(0.0, 5e-324, Limits(0.1, 0.1), 1.0).done(1.0)
