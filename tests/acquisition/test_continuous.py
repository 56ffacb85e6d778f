"""What a plan of continuous motion may say, and which stations it is refused on, by name."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest

from acquisition.continuous import Continuous, WayBack, speed_deg_s
from acquisition.motion_settings import AzTable, TableTurning, ZaberTable
from acquisition.plan import (
    Plan,
    StepAndShoot,
    check_plan,
    estimate,
    parse_plan,
    read_plan,
    ring,
    write_plan,
)
from acquisition.profiler_settings import (
    BannerEzArray,
    Hokuyo,
    Riftek,
    RiftekTrigger,
    SickProfiler2,
)
from acquisition.station import Station
from acquisition.sweep_codec import encode_sweep
from tests.acquisition.scan_cases import STATION, sweep

TEXT = """\
[ring]
first_mm = 10.0
last_mm = 30.0
step_mm = 5.0
profiles_per_turn = 600

[continuous]
run_in_deg = 10.0
way_back = "empty"
"""
WIDE = replace(STATION, table=replace(STATION.table, lowest_deg=-20.0, highest_deg=380.0))
RIFTEK = Riftek(
    address="tcp://192.0.2.7:80",
    profiles="udp://:50001",
    rate_hz=100.0,
    points_per_profile=640,
)
AZ = AzTable(
    address="serial:///dev/ttyUSB0?baud=115200",
    steps_per_deg=100.0,
    speed_deg_s=90.0,
    acceleration_deg_s2=500.0,
    lowest_deg=-20.0,
    highest_deg=380.0,
)


def turning(profiles: int = 600, **options: object) -> Plan:
    return Plan(ring=ring(10.0, 30.0, 5.0, profiles).ring, continuous=Continuous(**options))  # type: ignore[arg-type]


def test_a_plan_says_it_in_toml_and_is_written_back(tmp_path: Path) -> None:
    plan = parse_plan(TEXT)
    assert plan.continuous == Continuous(run_in_deg=10.0, way_back=WayBack.EMPTY)
    assert plan.step_and_shoot is None
    (tmp_path / "plan.toml").write_text(write_plan(plan))
    assert read_plan(tmp_path / "plan.toml") == plan


def test_an_empty_table_is_enough() -> None:
    text = TEXT.partition("run_in_deg")[0]
    assert parse_plan(text).continuous == Continuous()


def test_one_of_the_two_ways_is_given_and_not_both() -> None:
    with pytest.raises(ValueError, match=re.escape("plan.toml: continuous: there is [step_and_sh")):
        parse_plan(TEXT + "\n[step_and_shoot]\n")
    with pytest.raises(ValueError, match=re.escape("or a [continuous] one")):
        parse_plan(TEXT.partition("[continuous]")[0])
    with pytest.raises(ValueError, match="remove one"):
        Plan(
            ring=ring(1.0, 1.0, 1.0, 3).ring, step_and_shoot=StepAndShoot(), continuous=Continuous()
        )


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("run_in_deg = 10.0", "run_in_deg = 0.5", "continuous.run_in_deg: 0.5 is out of bounds"),
        ("run_in_deg = 10.0", "run_in = 10.0", "the unit is missing; write continuous.run_in_deg"),
        ('"empty"', '"full"', 'write "empty" or "measured"'),
    ],
)
def test_a_wrong_key_is_refused_with_the_fix(before: str, after: str, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        parse_plan(TEXT.replace(before, after))


@pytest.mark.parametrize("station", [WIDE, replace(WIDE, profiler=RIFTEK), replace(WIDE, table=AZ)])
def test_stations_that_stream_and_turn_steadily_pass(station: Station) -> None:
    check_plan(turning(), station)


HOKUYO = Hokuyo(address="serial:///dev/ttyACM0", first_step=480, last_step=540, rate_hz=10.0)
SICK = SickProfiler2(
    address="serial:///dev/ttyUSB7", points=640, x_mm_per_count=0.01, z_mm_per_count=0.01
)
SCREEN = BannerEzArray(
    address="tcp://192.0.2.7:502", rate_hz=50.0, points_per_profile=64, channel_pitch_mm=5.0
)


@pytest.mark.parametrize(
    ("station", "said"),
    [
        (replace(WIDE, profiler=HOKUYO), "a hokuyo profiler does not stream profiles with time"),
        (replace(WIDE, profiler=SICK), "a sick profiler does not stream profiles with time"),
        (replace(WIDE, profiler=SCREEN), "a banner_ez_array profiler does not stream"),
        (
            replace(WIDE, profiler=replace(RIFTEK, trigger=RiftekTrigger.SOFTWARE)),
            'does not measure by itself; write profiler.trigger = "sensor"',
        ),
        (
            replace(WIDE, table=replace(AZ, turning=TableTurning.WRAP_PROXIMITY)),
            'no whole turn; write table.turning = "unwrapped"',
        ),
        (
            replace(
                WIDE,
                table=ZaberTable(
                    address="serial:///dev/ttyUSB0?baud=115200",
                    microsteps_per_deg=800.0,
                    speed_deg_s=90.0,
                    lowest_deg=-20.0,
                    highest_deg=380.0,
                ),
            ),
            "a zaber table is not told a speed of its own",
        ),
        (STATION, "a turn with its run-in goes from -15 to 375 deg, past the table's soft limits"),
        (
            replace(WIDE, table=replace(WIDE.table, highest_deg=300.0)),
            "past the table's soft limits -20 to 300; widen them",
        ),
        (
            replace(WIDE, table=replace(WIDE.table, speed_deg_s=45.0)),
            "60 deg/s, and its speed_deg_s is 45; write ring.profiles_per_turn = 800 or more",
        ),
        (
            replace(WIDE, table=replace(WIDE.table, backlash_deg=8.0)),
            "does not take up the table's backlash_deg 8; write 17 or more",
        ),
    ],
)
def test_a_station_that_cannot_is_refused_by_name_with_the_fix(station: Station, said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        check_plan(turning(), station, "vase.toml")
    assert str(refused.value).startswith("vase.toml: continuous")
    assert "\n" not in str(refused.value)


def test_the_speed_is_what_makes_so_many_profiles_of_a_turn() -> None:
    assert speed_deg_s(2400, 400.0) == 60.0


def test_the_time_is_turns_at_that_speed_and_ways_back_at_the_tables() -> None:
    cost = estimate(turning(run_in_deg=10.0), WIDE)
    # Three of five slices are measured on the way back as well, at most.
    turning_s = 8 * 380.0 / 60.0 + 2 * 380.0 / 90.0
    assert cost.profiles == 8 * 600
    assert cost.seconds_at_least == pytest.approx(turning_s + 20.0 / 20.0)
    both = estimate(turning(run_in_deg=10.0, way_back=WayBack.MEASURED), WIDE)
    assert both.profiles == 10 * 600
    assert both.seconds_at_least == pytest.approx(10 * 380.0 / 60.0 + 1.0)


def test_the_bytes_are_an_upper_bound() -> None:
    # What the codec adds for a table that turned: a time a profile, two numbers an answer.
    profiler = replace(STATION.profiler, points_per_profile=610)
    one = replace(turning(), ring=ring(10.0, 10.0, 1.0, 600).ring)
    bound = estimate(one, replace(WIDE, profiler=profiler)).bytes_at_most
    kept = len(encode_sweep(sweep(0, profiles=600, points=10)))
    timing = 8 * 1200 + 16 * math.ceil(2 * 390.0 / 60.0 / 0.02) + 4096
    assert 2 * kept + timing <= bound


@pytest.mark.parametrize(
    ("pattern", "kind"),
    [
        ("[meridian]\nper_turn = 4\nfirst_mm = 10.0\nlast_mm = 20.0\nstep_mm = 10.0", "meridian"),
        ("[stripe]\nfirst_mm = 5.0\nlast_mm = 8.0\nstep_mm = 1.0", "stripe"),
    ],
)
def test_only_rings_are_measured_while_the_table_turns(pattern: str, kind: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"turns for [ring] only, not for [{kind}]")):
        parse_plan(f"{pattern}\n[continuous]\n")
