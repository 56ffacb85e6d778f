"""Plans of meridians and stripes: what they say, where they go, what they refuse."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from acquisition.patterns import Meridian, SliceKind, Stripe
from acquisition.plan import (
    Plan,
    StepAndShoot,
    check_plan,
    estimate,
    parse_plan,
    read_plan,
    ring,
    targets,
    write_plan,
)
from tests.acquisition.scan_cases import STATION
from tests.acquisition.test_scan import rig

SHOOT = StepAndShoot(settle_s=0.1)
MERIDIANS = Plan(
    meridian=Meridian(per_turn=4, first_mm=10.0, last_mm=31.0, step_mm=10.0), step_and_shoot=SHOOT
)
STRIPES = Plan(
    stripe=Stripe(first_mm=5.0, last_mm=8.0, step_mm=1.0, table_deg=30.0), step_and_shoot=SHOOT
)


def test_a_meridian_is_one_table_angle_with_every_stage_position_upward() -> None:
    quarter = math.tau / 4
    stops = [each.stops for each in targets(MERIDIANS)]
    assert stops == [tuple((at_mm, k * quarter) for at_mm in (10.0, 20.0, 30.0)) for k in range(4)]
    assert MERIDIANS.kind is SliceKind.MERIDIAN


def test_a_stripe_is_one_profile_and_the_table_stands() -> None:
    assert [each.stops for each in targets(STRIPES)] == [
        ((at_mm, math.radians(30.0)),) for at_mm in (5.0, 6.0, 7.0, 8.0)
    ]
    assert STRIPES.kind is SliceKind.STRIPE


@pytest.mark.parametrize(
    ("first_deg", "last_deg", "count"),
    [(0.0, None, 36), (20.0, None, 36), (0.0, 90.0, 10), (10.0, 10.0, 1), (-45.0, 44.9, 9)],
)
def test_meridians_may_cover_part_of_a_turn(
    first_deg: float, last_deg: float | None, count: int
) -> None:
    meridian = Meridian(per_turn=36, first_deg=first_deg, last_deg=last_deg, first_mm=0.0)
    assert meridian.count == count
    assert meridian.angle_deg(0) == first_deg


@pytest.mark.parametrize("plan", [MERIDIANS, STRIPES, ring(0.0, 4.0, 1.0, 12)])
def test_a_written_plan_parses_back_and_names_the_other_tables(plan: Plan, tmp_path: Path) -> None:
    text = write_plan(plan)
    (tmp_path / "plan.toml").write_text(text, encoding="utf-8")
    assert read_plan(tmp_path / "plan.toml") == plan
    for kind in SliceKind:
        assert f"[{kind.value}]" in text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "ring is missing; add a [ring] table, or [meridian], or [stripe]"),
        (
            "[meridian]\nper_turn = 8\nfirst_mm = 0\n[stripe]\nfirst_mm=0\nlast_mm=1\nstep_mm=1\n",
            "stripe: stands beside [meridian]; a plan has one of them",
        ),
        (
            "[meridian]\nper_turn = 2\nfirst_mm = 0\n",
            "meridian.per_turn: 2 is out of bounds; write a number at least 3",
        ),
        (
            "[meridian]\nper_turn = 8\nfirst_mm = 0\nlast_mm = 9\n",
            "meridian.step_mm: is missing; more than one stage position needs",
        ),
        (
            "[meridian]\nper_turn = 8\nfirst_mm = 9\nlast_mm = 0\nstep_mm = 1\n",
            "meridian.last_mm: 0.0 is below first_mm 9.0; swap them",
        ),
        (
            "[meridian]\nper_turn = 8\nfirst_mm = 0\nlast_deg = 360\n",
            "meridian.last_deg: 360.0 is not within a turn above first_deg 0.0",
        ),
        (
            "[meridian]\nper_turn = 8\nfirst_mm = 0\nlast_mm = 9\nstep_mm = 1e-9\n",
            "meridian.step_mm: 1e-09 makes over 1000 positions; widen it",
        ),
        (
            "[stripe]\nfirst_mm = 3\nlast_mm = 2\nstep_mm = 1\n",
            "stripe.last_mm: 2.0 is below first_mm 3.0; swap them",
        ),
        (
            "[stripes]\nfirst_mm = 3\nlast_mm = 2\nstep_mm = 1\n",
            "stripes: unknown key; did you mean stripe?",
        ),
    ],
)
def test_a_wrong_plan_is_refused_with_key_and_fix(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"plan.toml: {said}")) as refused:
        parse_plan(f"{text}[step_and_shoot]\n")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (
            replace(MERIDIANS, meridian=Meridian(per_turn=4, first_mm=-0.5)),
            "meridian.first_mm: -0.5 is below the stage's soft limit lowest_mm 0.0",
        ),
        (
            replace(MERIDIANS, meridian=Meridian(per_turn=4, first_mm=301.0)),
            "meridian.last_mm: the last meridian, at 301, is above the stage's soft limit",
        ),
        (
            replace(MERIDIANS, meridian=Meridian(per_turn=4, first_mm=1.0, first_deg=150.0)),
            "meridian: a turn from 150 to 420 deg leaves the table's soft limits -10.0 to 370.0",
        ),
        (
            replace(STRIPES, stripe=Stripe(first_mm=0.0, last_mm=301.0, step_mm=1.0)),
            "stripe.last_mm: the last stripe, at 301, is above the stage's soft limit",
        ),
    ],
)
def test_what_leaves_the_soft_limits_is_refused(plan: Plan, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"vase.toml: {said}")):
        check_plan(plan, STATION, "vase.toml")


def test_the_time_is_the_way_of_both_axes_settling_and_measuring() -> None:
    cost = estimate(MERIDIANS, STATION)
    turning_s = (270.0 + 270.0) / 90.0  # there in steps, and back once
    lifting_s = (4 + 3) * 20.0 / 20.0  # up in each, down between them
    standing_s = 12 * 0.1 + 12 / 100.0
    assert (cost.slices, cost.profiles) == (4, 12)
    assert cost.seconds_at_least == pytest.approx(turning_s + lifting_s + standing_s)
    assert estimate(STRIPES, STATION).profiles == 4


def test_the_table_goes_on_from_meridian_to_meridian_and_home_at_the_end() -> None:
    at = rig()
    sweeps = at.take(MERIDIANS)
    assert [len(each.profiles) for each in sweeps] == [3, 3, 3, 3]
    for k, each in enumerate(sweeps):
        assert [pose.stage_mm for pose in each.poses] == pytest.approx([10.0, 20.0, 30.0], abs=1e-3)
        turned = [pose.table_rad for pose in each.poses]
        assert turned == pytest.approx([k * math.tau / 4] * 3, abs=1e-3)
    wanted = [k * math.tau / 4 for k in (0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3)]
    assert at.table.moves == pytest.approx([*wanted, 0.0])
    # From below, always: the screw's backlash is taken up by the way it comes.
    assert at.stage.moves == pytest.approx([10, 20, 30, *(3 * [9.5, 10, 20, 30])])
    assert at.at_rest


def test_a_stripe_scan_leaves_the_table_where_it_stands() -> None:
    at = rig()
    sweeps = at.take(STRIPES)
    assert [len(each.profiles) for each in sweeps] == [1, 1, 1, 1]
    assert set(at.table.moves) == {math.radians(30.0)}
