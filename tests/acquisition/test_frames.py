"""The chain from the sensor's plane to the part, against points placed by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.frames import (
    Kinematics,
    Lifting,
    Side,
    Turning,
    part_points,
    part_to_station,
    ring_plane,
    sensor_to_station,
    station_to_part,
    station_to_sensor,
)
from acquisition.poses import Pose, Sweep
from drivers.profiler import Profile, Reason
from tests.acquisition.scan_cases import KINEMATICS, sweep

CLOCKWISE = replace(KINEMATICS, table_sense=Turning.CLOCKWISE)
lengths = st.floats(-500.0, 500.0)
angles = st.floats(-100.0, 100.0)


@st.composite
def any_kinematics(draw: st.DrawFn) -> Kinematics:
    return replace(
        KINEMATICS,
        table_sense=draw(st.sampled_from(Turning)),
        stage_sense=draw(st.sampled_from(Lifting)),
        sensor_x=draw(st.sampled_from(Side)),
        height_mm=draw(lengths),
        standoff_mm=draw(lengths),
        side_mm=draw(lengths),
        azimuth_deg=draw(st.floats(-360.0, 360.0)),
    )


def row(*values: float) -> np.ndarray:
    return np.array([values])


def test_the_sensor_looks_along_minus_x_from_its_standoff() -> None:
    # 150 mm from the axis; 120 mm away from the sensor leaves 30 mm to the axis.
    seen = sensor_to_station(row(7.0, 120.0), row(0.0)[0], KINEMATICS)
    np.testing.assert_allclose(seen, [[30.0, 7.0, 12.5]])


def test_a_sensor_whose_x_points_left_sees_the_mirror_side() -> None:
    turned_over = replace(KINEMATICS, sensor_x=Side.LEFT)
    seen = sensor_to_station(row(7.0, 120.0), row(0.0)[0], turned_over)
    np.testing.assert_allclose(seen, [[30.0, -7.0, 12.5]])


def test_a_sensor_beside_the_axis_sees_everything_shifted_to_its_left() -> None:
    beside = replace(KINEMATICS, side_mm=4.0)
    seen = sensor_to_station(row(0.0, 150.0), row(0.0)[0], beside)
    np.testing.assert_allclose(seen, [[0.0, -4.0, 12.5]])


def test_a_sensor_at_ninety_degrees_looks_along_minus_y() -> None:
    around = replace(KINEMATICS, azimuth_deg=90.0)
    seen = sensor_to_station(row(7.0, 120.0), row(0.0)[0], around)
    np.testing.assert_allclose(seen, [[-7.0, 30.0, 12.5]], atol=1e-12)


@pytest.mark.parametrize(("sense", "height_mm"), [(Lifting.UP, 32.5), (Lifting.DOWN, -7.5)])
def test_the_stage_moves_the_plane_in_its_sense(sense: Lifting, height_mm: float) -> None:
    kinematics = replace(KINEMATICS, stage_sense=sense)
    assert sensor_to_station(row(0.0, 0.0), row(20.0)[0], kinematics)[0, 2] == height_mm


def test_a_quarter_turn_brings_the_parts_minus_y_side_before_the_sensor() -> None:
    # Seen from above the part turns counter-clockwise: what was at -y comes to +x.
    quarter = row(math.pi / 2)[0]
    np.testing.assert_allclose(
        part_to_station(row(0.0, -30.0, 5.0), quarter, KINEMATICS), [[30.0, 0.0, 5.0]], atol=1e-12
    )
    np.testing.assert_allclose(
        part_to_station(row(0.0, 30.0, 5.0), quarter, CLOCKWISE), [[30.0, 0.0, 5.0]], atol=1e-12
    )


@settings(max_examples=50, deadline=None)
@given(any_kinematics(), st.lists(st.tuples(lengths, lengths, lengths, angles), max_size=5))
def test_there_and_back_is_where_it_was(
    kinematics: Kinematics, rows: list[tuple[float, float, float, float]]
) -> None:
    values = np.array(rows).reshape(-1, 4)
    points_mm, stage_mm, table_rad = values[:, :2], values[:, 2], values[:, 3]
    station = sensor_to_station(points_mm, stage_mm, kinematics)
    part = station_to_part(station, table_rad, kinematics)
    again = part_to_station(part, table_rad, kinematics)
    np.testing.assert_allclose(again, station, atol=1e-9)
    planar, positions = station_to_sensor(again, kinematics)
    np.testing.assert_allclose(planar, points_mm, atol=1e-9)
    np.testing.assert_allclose(positions, stage_mm, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(any_kinematics(), lengths, lengths, angles)
def test_turning_the_table_turns_the_points_as_far_the_other_way(
    kinematics: Kinematics, x: float, z: float, turn_rad: float
) -> None:
    station = sensor_to_station(row(x, z), row(0.0)[0], kinematics)
    part = station_to_part(station, row(turn_rad)[0], kinematics)
    way = -1 if kinematics.table_sense is Turning.COUNTER_CLOCKWISE else 1
    before, after = (complex(each[0, 0], each[0, 1]) for each in (station, part))
    expected = before * complex(math.cos(way * turn_rad), math.sin(way * turn_rad))
    assert abs(after - expected) < 1e-9
    assert part[0, 2] == station[0, 2]


@settings(max_examples=50, deadline=None)
@given(any_kinematics())
def test_the_sensor_sees_true_distances(kinematics: Kinematics) -> None:
    planar = np.array([[0.0, 0.0], [3.0, 4.0], [-20.0, 60.0]])
    seen = sensor_to_station(planar, np.zeros(3), kinematics)
    for i, j in product(range(3), repeat=2):
        assert math.dist(seen[i], seen[j]) == pytest.approx(math.dist(planar[i], planar[j]))


def seen_cylinder(kinematics: Kinematics, radius_mm: float, eccentric_mm: float) -> Sweep:
    """One count straight ahead of a sensor, of a cylinder beside the axis, computed by hand.

    The ray runs along x at y = 0; the cylinder's centre is on the part's y, turned by the table.
    """
    way = 1 if kinematics.table_sense is Turning.COUNTER_CLOCKWISE else -1
    profiles, poses = [], []
    for k in range(40):
        angle = math.tau * k / 40
        centre = eccentric_mm * np.array([-math.sin(way * angle), math.cos(way * angle)])
        reach = centre[0] + math.sqrt(radius_mm**2 - centre[1] ** 2)
        counts = [[0, round((kinematics.standoff_mm - reach) / 1e-6)], [999, 0]]
        reasons = [Reason.MEASURED, Reason.NO_RETURN]
        profiles.append(
            Profile(
                counts=np.array(counts),
                scale_mm=(1e-3, 1e-6),
                offset_mm=(0.0, 0.0),
                reasons=np.array(reasons),
                intensity=np.zeros(0),
                sensor_time_s=0.0,
                encoder=0,
                frame=k,
            )
        )
        poses.append(Pose(table_rad=angle, stage_mm=3.0, time_s=0.0))
    return Sweep(0, tuple(profiles), tuple(poses))


@pytest.mark.parametrize("kinematics", [KINEMATICS, CLOCKWISE])
def test_an_eccentric_cylinder_comes_out_round_where_it_stands(kinematics: Kinematics) -> None:
    points_mm = part_points(seen_cylinder(kinematics, 20.0, 6.0), kinematics)
    assert points_mm.shape == (40, 3), "a point without a measurement is none"
    radii = np.hypot(points_mm[:, 0], points_mm[:, 1] - 6.0)
    np.testing.assert_allclose(radii, 20.0, atol=1e-5)
    np.testing.assert_allclose(points_mm[:, 2], 15.5)


def test_the_wrong_sense_of_the_table_is_seen_in_an_eccentric_cylinder() -> None:
    points_mm = part_points(seen_cylinder(CLOCKWISE, 20.0, 6.0), KINEMATICS)
    assert np.ptp(np.hypot(points_mm[:, 0], points_mm[:, 1] - 6.0)) > 0.5


def test_a_ring_lies_in_its_plane() -> None:
    origin_mm, axes = ring_plane(sweep(4), KINEMATICS)
    np.testing.assert_array_equal(origin_mm, [0.0, 0.0, 16.5])
    np.testing.assert_array_equal(axes, np.eye(3))
    assert set(part_points(sweep(4), KINEMATICS)[:, 2]) == {16.5}


def test_a_sweep_without_profiles_has_no_points_and_no_plane() -> None:
    assert part_points(Sweep(3, (), ()), KINEMATICS).shape == (0, 3)
    with pytest.raises(ValueError, match="sweep 3: no pose"):
        ring_plane(Sweep(3, (), ()), KINEMATICS)
