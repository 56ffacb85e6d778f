"""A plan says where each slice is taken, and is refused before anything moves."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.plan import (
    Plan,
    StepAndShoot,
    Target,
    check_plan,
    estimate,
    parse_plan,
    read_plan,
    ring,
    targets,
    write_plan,
)
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.scan_cases import STATION, sweep

PLAN = """
[ring]
first_mm = 10
last_mm = 30.0
step_mm = 5.0
profiles_per_turn = 4

[step_and_shoot]
settle_s = 0.1
"""


def test_a_ring_plan_lists_its_slices() -> None:
    quarter = math.tau / 4
    turn = (0.0, quarter, 2 * quarter, 3 * quarter)
    assert list(targets(parse_plan(PLAN))) == [
        Target(0, 10.0, turn),
        Target(1, 15.0, turn),
        Target(2, 20.0, turn),
        Target(3, 25.0, turn),
        Target(4, 30.0, turn),
    ]


@settings(max_examples=50, deadline=None)
@given(st.floats(-100, 100), st.integers(0, 300), st.floats(0.01, 5.0), st.floats(0.01, 0.99))
def test_the_last_ring_is_the_last_step_that_does_not_pass_the_end(
    first_mm: float, steps: int, step_mm: float, rest: float
) -> None:
    exact = list(targets(ring(first_mm, first_mm + steps * step_mm, step_mm, 3)))
    more = list(targets(ring(first_mm, first_mm + (steps + rest) * step_mm, step_mm, 3)))
    assert [each.index for each in exact] == list(range(steps + 1))
    assert exact == more
    assert exact[-1].stage_mm == pytest.approx(first_mm + steps * step_mm, abs=1e-9)


def test_one_ring_is_a_plan() -> None:
    assert [each.stage_mm for each in targets(ring(7.0, 7.0, 1.0, 3))] == [7.0]


@pytest.mark.parametrize(
    ("pattern", "instead", "said"),
    [
        ("last_mm = 30.0", "last_mm = 3.0", "ring.last_mm: 3.0 is below first_mm 10.0; swap them"),
        (
            "step_mm = 5.0",
            "step_mm = 0.0",
            "ring.step_mm: 0.0 is out of bounds; write a number above 0",
        ),
        ("step_mm = 5.0", "step_mm = 1e-300", "ring.step_mm: 1e-300 makes over 1000000 positions"),
        ("step_mm = 5.0", "step = 5.0", "ring.step: the unit is missing; write ring.step_mm"),
        (
            "profiles_per_turn = 4",
            "profiles_per_turn = 2",
            "ring.profiles_per_turn: 2 is out of bounds",
        ),
        (
            "settle_s",
            "settel_s",
            "step_and_shoot.settel_s: unknown key; did you mean step_and_shoot.settle_s?",
        ),
        (
            r"\[step_and_shoot\]\nsettle_s = 0.1",
            "",
            "step_and_shoot is missing; add a [step_and_shoot] table",
        ),
    ],
)
def test_a_wrong_plan_is_refused_with_file_key_and_fix(
    pattern: str, instead: str, said: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        parse_plan(re.sub(pattern, instead, PLAN), "vase.toml")
    assert str(refused.value).startswith("vase.toml: ")
    assert "\n" not in str(refused.value)


def test_a_written_plan_parses_back(tmp_path: Path) -> None:
    plan = Plan(ring=ring(0.1, 9.7, 0.3, 90).ring, step_and_shoot=StepAndShoot(settle_s=0.2))
    (tmp_path / "plan.toml").write_text(write_plan(plan), encoding="utf-8")
    assert read_plan(tmp_path / "plan.toml") == plan


def test_a_plan_inside_the_soft_limits_passes() -> None:
    check_plan(ring(0.0, 300.0, 1.0, 360), STATION)
    check_plan(ring(0.0, 300.9, 1.0, 360), STATION)  # no ring stands above 300


@pytest.mark.parametrize(
    ("first_mm", "last_mm", "said"),
    [
        (-0.1, 20.0, "ring.first_mm: -0.1 is below the stage's soft limit lowest_mm 0.0"),
        (0.0, 301.0, "ring.last_mm: the last ring, at 301, is above the stage's soft limit"),
    ],
)
def test_a_ring_outside_the_stages_soft_limits_is_refused(
    first_mm: float, last_mm: float, said: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(f"vase.toml: {said}")):
        check_plan(ring(first_mm, last_mm, 1.0, 36), STATION, "vase.toml")


@pytest.mark.parametrize(("lowest", "highest"), [(-10.0, 269.0), (1.0, 370.0)])
def test_a_turn_outside_the_tables_soft_limits_is_refused(lowest: float, highest: float) -> None:
    table = replace(STATION.table, lowest_deg=lowest, highest_deg=highest)
    with pytest.raises(ValueError, match="from 0 to 270 deg leaves the table's soft limits"):
        check_plan(ring(0.0, 1.0, 1.0, 4), replace(STATION, table=table))


def test_the_time_is_turning_there_and_back_lifting_settling_and_measuring() -> None:
    cost = estimate(parse_plan(PLAN), STATION)
    turning_s = 5 * 2 * 270.0 / 90.0
    lifting_s = 20.0 / 20.0
    standing_s = 20 * 0.1 + 20 / 100.0
    assert (cost.slices, cost.profiles) == (5, 20)
    assert cost.seconds_at_least == pytest.approx(turning_s + lifting_s + standing_s)


@pytest.mark.parametrize(("profiles", "points"), [(3, 1), (3, 600), (400, 40)])
def test_the_bytes_are_an_upper_bound_and_not_a_far_one(profiles: int, points: int) -> None:
    profiler = replace(STATION.profiler, points_per_profile=points + profiles)
    bound = estimate(ring(0.0, 0.0, 1.0, profiles), replace(STATION, profiler=profiler))
    kept = len(encode_sweep(sweep(0, profiles=profiles, points=points)))
    assert kept <= bound.bytes_at_most
    assert bound.bytes_at_most < 20 * kept
