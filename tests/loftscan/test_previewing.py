"""What a plan will see, against geometry done by hand; and the command."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.patterns import Meridian, Stripe
from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.station import FieldOfView, Station, parse_station, write_station
from loftscan.previewing import Preview, Seen, parse_region, preview, region
from sim.parts import vase
from sim.stations import truth_ply
from tests.acquisition.scan_cases import STATION
from tests.loftscan.test_layouts import SLIDING, UPRIGHT
from tests.system.command_cases import complaint, run, succeeded

VIEW = FieldOfView(near_mm=100.0, far_mm=200.0, near_width_mm=60.0, far_width_mm=120.0)
WATCHED = replace(STATION, field_of_view=VIEW)  # level sheet, 12.5 mm over the plate at stage 0
SHOOT = StepAndShoot()


def seen_by(plan: Plan, *where: float, station: Station = WATCHED) -> Preview:
    return preview(station, plan, station.kinematics, *region(*where))


def test_rings_over_the_whole_region_see_all_of_it() -> None:
    found = seen_by(ring(0.0, 40.0, 1.0, 12), 30.0, 50.0, station=raised(0.0))
    # The rings end at 40 mm, and the last half step with them.
    assert found.share == pytest.approx(0.81, abs=0.03)
    assert found.heights_mm == pytest.approx((50 / 90, 40.0), abs=1.2)
    assert found.shares()["no_slice"] == pytest.approx(0.2, abs=0.03)


def raised(height_mm: float) -> Station:
    return replace(WATCHED, kinematics=replace(WATCHED.kinematics, height_mm=height_mm))


def test_a_sheet_that_passes_over_the_foot_leaves_it_out() -> None:
    found = seen_by(ring(0.0, 60.0, 1.0, 12), 30.0, 50.0)
    assert found.heights_mm is not None
    assert found.heights_mm[0] == pytest.approx(12.5, abs=1.2)
    assert found.share == pytest.approx(0.75, abs=0.03)


def test_a_part_that_comes_too_near_is_said_to_be() -> None:
    """The sensor stands 150 mm off and measures from 100 mm: a radius of 60 mm is nearer."""
    found = seen_by(ring(0.0, 40.0, 1.0, 24), 60.0, 40.0, station=raised(0.0))
    assert found.shares()["too_near"] > 0.9
    assert found.share == 0.0
    assert found.heights_mm is None


def test_too_few_stops_leave_places_that_no_stop_looks_at() -> None:
    """From 150 mm a radius of 30 mm is seen within 75 degrees of incidence: 64 degrees each way."""
    half_deg = 75.0 - math.degrees(math.asin(math.sin(math.radians(75.0)) * 30.0 / 150.0))
    found = seen_by(ring(0.0, 40.0, 1.0, 3), 30.0, 40.0, station=raised(0.0))
    assert 3 * 2 * half_deg > 360.0  # three stops do
    assert found.share > 0.99
    stripe = Plan(stripe=Stripe(first_mm=0.0, last_mm=60.0, step_mm=1.0), step_and_shoot=SHOOT)
    seen = seen_by(stripe, 30.0, 40.0, station=raised(0.0))
    assert seen.share == pytest.approx(2 * half_deg / 360.0, abs=0.03)


@pytest.mark.parametrize(("places", "share"), [(1, 72.0 / 120.0), (2, 1.0)])
def test_a_meridian_sees_as_high_as_the_sheet_is_wide(places: int, share: float) -> None:
    """At a radius of 30 mm, 120 mm off, the field is 72 mm wide; two positions see 120 mm."""
    station = replace(WATCHED, kinematics=replace(UPRIGHT, standoff_mm=150.0, height_mm=0.0))
    meridian = (
        Meridian(per_turn=36, first_mm=60.0)
        if places == 1
        else Meridian(per_turn=36, first_mm=30.0, last_mm=90.0, step_mm=60.0)
    )
    plan = Plan(meridian=meridian, step_and_shoot=SHOOT)
    found = seen_by(plan, 30.0, 120.0, station=station)
    assert found.share == pytest.approx(share, abs=0.03)
    assert found.distances_mm == pytest.approx([120.0, 120.0], abs=0.2)


def test_meridians_over_part_of_a_turn_see_that_part() -> None:
    station = replace(WATCHED, kinematics=replace(UPRIGHT, standoff_mm=150.0, height_mm=0.0))
    meridian = Meridian(per_turn=36, first_mm=30.0, last_deg=90.0)
    plan = Plan(meridian=meridian, step_and_shoot=SHOOT)
    found = seen_by(plan, 30.0, 60.0, station=station)
    assert found.share == pytest.approx(100.0 / 360.0, abs=0.02)


def test_a_sliding_sheet_sees_one_side() -> None:
    station = replace(WATCHED, kinematics=replace(SLIDING, standoff_mm=150.0))
    plan = Plan(stripe=Stripe(first_mm=50.0, last_mm=110.0, step_mm=1.0), step_and_shoot=SHOOT)
    found = seen_by(plan, 30.0, 50.0, station=station)
    sides = found.places_mm[found.fate == Seen.SEEN]
    assert (sides[:, 0] > 0.0).all()
    # The way to the sensor is square to the sheet's way: 75 degrees to either side.
    assert found.share == pytest.approx(150.0 / 360.0, abs=0.03)


def test_a_station_without_its_field_of_view_is_told_what_to_add() -> None:
    with pytest.raises(ValueError, match=r"add a \[field_of_view\] table with near_mm"):
        seen_by(ring(0.0, 4.0, 1.0, 12), 30.0, 50.0, station=STATION)


def test_the_field_of_view_is_written_and_read_back() -> None:
    assert parse_station(write_station(WATCHED)).field_of_view == VIEW
    assert "# [field_of_view]" in write_station(STATION)
    with pytest.raises(ValueError, match=r"near_mm: 9\.0 is not below far_mm 3\.0; swap them"):
        FieldOfView(near_mm=9.0, far_mm=3.0, near_width_mm=1.0, far_width_mm=1.0)
    behind = write_station(WATCHED).replace("near_mm = 100.0", "near_mm = -100.0")
    with pytest.raises(ValueError, match=r"near_mm"):
        parse_station(behind)


@pytest.mark.parametrize("text", ["30", "30,x", "0,10", "nan,10", "30,inf"])
def test_a_region_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="--region"):
        parse_region(text)


def test_the_command_tells_and_draws(place: Path) -> None:
    (place / "station.toml").write_text(write_station(raised(0.0)))
    (place / "plan.toml").write_text(write_plan(ring(0.0, 40.0, 1.0, 12)))
    (place / "part.ply").write_bytes(truth_ply(vase(18.0, 50.0, around=100, levels=20)))
    words = ("preview", "station.toml", "plan.toml", "--region", "30,50")
    said = succeeded(run(*words, "--out", "seen.png")).stdout
    assert "41 slices, 492 profiles, at least" in said
    assert "%  seen" in said
    assert Path("seen.png").read_bytes().startswith(b"\x89PNG")
    told = json.loads(succeeded(run(*words[:-2], "--part", "part.ply", "--json")).stdout)
    assert 0.5 < told["share"] < 0.9  # neither foot nor top of the vase
    assert np.isclose(sum(told["shares"].values()), 1.0)
    either = "give either --region RADIUS,HEIGHT or --part"
    assert either in complaint(run(*words[:-2]), 2)
    assert either in complaint(run(*words, "--part", "part.ply"), 2)
    assert "there is no such file" in complaint(run(*words[:-2], "--part", "none.ply"), 2)
    assert "no mesh" in complaint(run(*words[:-2], "--part", "plan.toml"), 2)
