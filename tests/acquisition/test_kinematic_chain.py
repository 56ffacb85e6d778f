"""The whole chain: each key alone against points placed by hand, all together against its twin."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.frames import (
    Kinematics,
    Lifting,
    SecondStage,
    Side,
    Turning,
    ring_plane,
    sensor_to_station,
    station_to_part,
    station_to_sensor,
)
from acquisition.poses import Pose, Sweep
from acquisition.settings import as_table, read_table
from acquisition.transformations import placed, transformations
from drivers.profiler import Profile
from tests.acquisition.scan_cases import KINEMATICS

SQUARE = replace(KINEMATICS, standoff_mm=100.0, height_mm=10.0)
small = st.floats(-0.2, 0.2)
lengths = st.floats(-300.0, 300.0)


def seen(kinematics: Kinematics, x_mm: float, z_mm: float, stage_mm: float = 0.0) -> list[float]:
    planar, stage = np.array([[x_mm, z_mm]]), np.array([stage_mm])
    return [float(each) for each in sensor_to_station(planar, stage, kinematics)[0]]


@st.composite
def any_chain(draw: st.DrawFn) -> Kinematics:
    return Kinematics(
        kind=KINEMATICS.kind,
        table_sense=draw(st.sampled_from(Turning)),
        stage_sense=draw(st.sampled_from(Lifting)),
        sensor_x=draw(st.sampled_from(Side)),
        height_mm=draw(lengths),
        standoff_mm=draw(lengths),
        side_mm=draw(lengths),
        azimuth_deg=draw(st.floats(-360.0, 360.0)),
        pitch_deg=draw(st.floats(-60.0, 60.0)),
        roll_deg=draw(st.floats(-180.0, 180.0)),
        table_deg_per_deg=draw(st.floats(0.5, 2.0)),
        stage_x_mm=draw(small),
        stage_y_mm=draw(small),
        stage_z_mm=draw(st.floats(0.9, 1.1)),
        x_mm_per_mm=draw(st.floats(0.9, 1.1)),
        z_mm_per_mm=draw(st.floats(0.9, 1.1)),
        x_mm_per_z_mm=draw(small),
        second_stage=draw(
            st.none() | st.builds(SecondStage, position_mm=lengths, y_mm=small, z_mm=small)
        ),
    )


def test_a_pitched_beam_rises_on_its_way() -> None:
    found = seen(replace(SQUARE, pitch_deg=30.0), 0.0, 50.0)
    assert found == pytest.approx([100.0 - 50.0 * math.cos(math.pi / 6), 0.0, 10.0 + 25.0])


def test_a_rolled_sheet_goes_up_on_its_right() -> None:
    assert seen(replace(SQUARE, roll_deg=90.0), 7.0, 50.0) == pytest.approx([50.0, 0.0, 17.0])


def test_the_stage_goes_where_its_step_says() -> None:
    leaning = replace(SQUARE, stage_x_mm=0.01, stage_y_mm=-0.02, stage_z_mm=1.5)
    assert seen(leaning, 0.0, 100.0, stage_mm=10.0) == pytest.approx([0.1, -0.2, 25.0])


def test_scales_and_shear_act_in_the_sensors_plane() -> None:
    stretched = replace(SQUARE, x_mm_per_mm=2.0, z_mm_per_mm=0.5, x_mm_per_z_mm=0.1)
    assert seen(stretched, 3.0, 50.0) == pytest.approx([75.0, 11.0, 10.0])


def test_a_rail_carries_the_sensor_outward() -> None:
    moved = replace(SQUARE, second_stage=SecondStage(position_mm=20.0, x_mm=1.1))
    assert seen(moved, 0.0, 100.0) == pytest.approx([22.0, 0.0, 10.0])


def test_a_table_that_turns_farther_than_it_says_turns_the_part_farther() -> None:
    twice = replace(SQUARE, table_deg_per_deg=2.0)
    point, quarter = np.array([[1.0, 0.0, 0.0]]), np.array([math.tau / 8.0])
    np.testing.assert_allclose(station_to_part(point, quarter, twice), [[0, -1, 0]], atol=1e-12)


@given(any_chain(), lengths, lengths, st.floats(-20.0, 20.0), st.floats(-100.0, 100.0))
@settings(max_examples=200, deadline=None)
def test_the_chain_is_its_nexus_steps_one_after_the_other(
    kinematics: Kinematics, x_mm: float, z_mm: float, table_rad: float, stage_mm: float
) -> None:
    planar = np.array([[x_mm, z_mm]])
    station = sensor_to_station(planar, np.array([stage_mm]), kinematics)
    part = station_to_part(station, np.array([table_rad]), kinematics)
    chain = transformations(kinematics, table_rad=table_rad, stage_mm=stage_mm)
    # 1e-9 mm: double rounding of a thousand mm through seven steps.
    np.testing.assert_allclose(placed(planar, kinematics, chain), part, atol=1e-9)
    assert [each.depends_on for each in chain] == [".", *(each.name for each in chain[:-1])]
    assert all(math.isclose(math.hypot(*each.vector), 1.0) for each in chain)


@given(any_chain(), lengths, lengths, st.floats(-100.0, 100.0))
@settings(max_examples=100, deadline=None)
def test_the_sensors_view_inverts_its_placing(
    kinematics: Kinematics, x_mm: float, z_mm: float, stage_mm: float
) -> None:
    upright = replace(kinematics, roll_deg=kinematics.roll_deg / 3.0)  # the stage leaves its plane
    planar = np.array([[x_mm, z_mm]])
    station = sensor_to_station(planar, np.array([stage_mm]), upright)
    back_mm, back_stage_mm = station_to_sensor(station, upright)
    np.testing.assert_allclose(back_mm, planar, atol=1e-8)
    np.testing.assert_allclose(back_stage_mm, [stage_mm], atol=1e-8)


def test_the_plane_of_a_pitched_ring_lies_where_the_points_of_a_round_part_are() -> None:
    pitched = replace(SQUARE, pitch_deg=2.0)
    # A cylinder of 30 mm around the axis, seen 80 degrees each way from every side.
    angle = np.radians(np.linspace(-80.0, 80.0, 161))
    rise = math.tan(math.radians(2.0))
    x_mm, z_facing = 30.0 * np.sin(angle), 100.0 - 30.0 * np.cos(angle)
    counts = np.round(np.column_stack([x_mm, z_facing / math.cos(math.radians(2.0))]) * 1000)
    seen = profile_of(counts)
    sweep = Sweep(0, (seen,) * 12, tuple(Pose(k * math.tau / 12, 5.0, 0.0) for k in range(12)))
    heights = 15.0 + rise * z_facing
    origin_mm, _ = ring_plane(sweep, pitched)
    # 0.7 for 0.7053, and the median radius: within 0.02 mm at 2 degrees and 30 mm.
    assert origin_mm[2] == pytest.approx(float(heights.mean()), abs=0.02)


def profile_of(counts: np.ndarray) -> Profile:
    reasons = np.zeros(len(counts), np.uint8)
    return Profile(counts.astype(np.int32), (0.001, 0.001), (0.0, 0.0), reasons,
                   np.empty(0, np.uint16), 0.0, 0, 0)  # fmt: skip


def test_planes_follow_the_stage_though_the_top_ring_is_only_half_there() -> None:
    pitched = replace(SQUARE, pitch_deg=2.0)
    near = np.array([[0.0, 70.0]]) * 1000
    far = np.array([[0.0, 130.0]]) * 1000
    whole = Sweep(0, (profile_of(np.vstack([near, far])),), (Pose(0.0, 5.0, 0.0),))
    half = Sweep(1, (profile_of(near),), (Pose(0.0, 5.1, 0.0),))
    assert ring_plane(half, pitched)[0][2] > ring_plane(whole, pitched)[0][2]


def test_a_stage_within_the_plane_has_no_inverse() -> None:
    meridian = replace(SQUARE, roll_deg=90.0)
    with pytest.raises(ValueError, match="within the laser plane"):
        station_to_sensor(np.zeros((1, 3)), meridian)


def test_a_stage_that_moves_nowhere_is_refused() -> None:
    with pytest.raises(ValueError, match="it moves nowhere"):
        replace(SQUARE, stage_z_mm=0.0)


@given(any_chain())
@settings(max_examples=50, deadline=None)
def test_a_chain_survives_its_table(kinematics: Kinematics) -> None:
    assert read_table(Kinematics, as_table(kinematics), "station.toml") == kinematics
