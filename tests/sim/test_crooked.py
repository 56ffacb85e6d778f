"""The crooked bench: level it is the other bench; crooked it sees what the physics say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim import Flaws, Mounting, OpticalBench, OpticsSettings, Reason, SeedKey, Sensor
from sim.artefacts import BALLS_MM, ball_plate, gauge_cylinder, step_gauge
from sim.crooked import CrookedBench, Crookedness
from sim.parts import vase

STRAIGHT = Crookedness(
    yaw_rad=0.0, pitch_rad=0.0, roll_rad=0.0, axis_tilt_rad=0.0, pivot_mm=(0.0, 0.0),
    table_scale=1.0, lift=(0.0, 0.0, 1.0), x_scale=1.0, z_scale=1.0,
)  # fmt: skip
SETTINGS = OpticsSettings(
    mounting=Mounting(height_mm=2.0, side_mm=1.5, azimuth_rad=0.3),
    sensor=Sensor(points=160),
    flaws=Flaws(cloud_width_mm=0.05, outlier_rate=0.01, seed=3),
)


def test_a_station_that_stands_straight_sees_what_the_level_bench_sees() -> None:
    part = vase(around=80, levels=30)
    level, crooked = OpticalBench(part, SETTINGS), CrookedBench(part, SETTINGS, STRAIGHT)
    for k, turn_rad in enumerate((0.0, 1.0, 4.0)):
        one = level.profile(turn_rad, 20.3, SeedKey(1, k))
        other = crooked.profile(turn_rad, 20.3, SeedKey(1, k))
        # Corners moved in another order of rounding: a beam at an edge may meet its neighbour.
        same = one.reasons == other.reasons
        assert same.mean() > 0.98
        assert np.abs(one.counts[same] - other.counts[same]).max() <= 1


def test_the_crooked_sheet_cuts_a_ball_where_its_pose_says() -> None:
    still = replace(SETTINGS, flaws=Flaws(cloud_width_mm=0.0))
    off = Crookedness()
    bench = CrookedBench(ball_plate(), still, off)
    table_rad, stage_mm = 0.2, 16.0
    profile = bench.profile(table_rad, stage_mm, SeedKey(0, 0))
    sensor = still.sensor
    counts = profile.counts[profile.reasons == Reason.MEASURED]
    seen = counts * [sensor.x_mm_per_count * off.x_scale, sensor.z_mm_per_count * off.z_scale]
    # By hand: the ball's middle, turned, leant and seen from the sensor, step by step.
    x, y, z = BALLS_MM["low"]
    turn = off.table_scale * table_rad
    x, y = math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y
    axis = np.array([math.sin(off.axis_tilt_rad) * math.cos(off.axis_towards_rad),
                     math.sin(off.axis_tilt_rad) * math.sin(off.axis_towards_rad),
                     math.cos(off.axis_tilt_rad)])  # fmt: skip
    about = np.cross([0.0, 0.0, 1.0], axis)
    about /= np.linalg.norm(about)
    p, c, s = np.array([x, y, z]), math.cos(off.axis_tilt_rad), math.sin(off.axis_tilt_rad)
    p = p * c + np.cross(about, p) * s + about * (about @ p) * (1 - c)
    p += [*off.pivot_mm, 0.0]
    start = np.array([225.0, -1.5, 2.0])
    az = 0.3
    origin = np.array([math.cos(az) * start[0] - math.sin(az) * start[1],
                       math.sin(az) * start[0] + math.cos(az) * start[1], start[2]])  # fmt: skip
    origin = origin + stage_mm * np.array(off.lift)
    yaw = az + off.yaw_rad
    flat = np.array([-math.cos(yaw), -math.sin(yaw), 0.0])
    beam = math.cos(off.pitch_rad) * flat + [0.0, 0.0, math.sin(off.pitch_rad)]
    level = np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    normal = np.cross(level, beam)
    right = math.cos(off.roll_rad) * level + math.sin(off.roll_rad) * normal
    up = np.cross(right, beam)
    ahead, across, over = (p - origin) @ beam, (p - origin) @ right, (p - origin) @ up
    away = np.hypot(seen[:, 1] - ahead, seen[:, 0] - across)
    circle = math.sqrt(10.0**2 - over**2)
    on = away < circle + 1.0
    assert on.sum() > 20
    # Half a count of 5 um each way, and 2 um of the polyhedron.
    assert np.abs(away[on] - circle).max() < 0.008


@pytest.mark.parametrize("make", [ball_plate, gauge_cylinder, step_gauge])
def test_artefacts_are_closed_and_face_outward(make: object) -> None:
    import trimesh

    part = make()  # type: ignore[operator]
    mesh = trimesh.Trimesh(part.vertices_mm, part.faces, process=False)
    assert mesh.is_watertight
    assert mesh.volume > 0.0
