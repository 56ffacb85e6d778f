"""Planes of meridians and stripes against the simulator's own idea of where its sheet is."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.frames import Kind, Kinematics, Lifting, Side, Turning
from acquisition.patterns import Meridian, SliceKind, Stripe
from acquisition.plan import Plan, StepAndShoot, ring
from acquisition.planes import check_sheet, slice_plane
from acquisition.poses import Pose, Sweep
from sim.crooked import CrookedBench, Crookedness
from sim.cuts import Cut, standing
from sim.optics import OpticsSettings
from sim.parts import cylinder
from sim.sensor import Hand, Mounting, Sensor
from sim.sensor import Lifting as SimLifting
from sim.sensor import Turning as SimTurning
from tests.acquisition.test_scan import Bench as FakeBench
from tests.acquisition.test_scan import FakeProfiler

UPRIGHT = Kinematics(
    kind=Kind.SIMULATED,
    table_sense=Turning.COUNTER_CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=-3.0,
    standoff_mm=225.0,
    roll_deg=90.0,
)
SLIDING = replace(UPRIGHT, stage_y_mm=1.0, stage_z_mm=0.0)
SHOOT = StepAndShoot()
MERIDIANS = Plan(meridian=Meridian(per_turn=8, first_mm=0.0), step_and_shoot=SHOOT)
STRIPES = Plan(stripe=Stripe(first_mm=0.0, last_mm=9.0, step_mm=1.0), step_and_shoot=SHOOT)


@st.composite
def stations(draw: st.DrawFn, cut: Cut) -> tuple[Kinematics, CrookedBench]:
    """The same station in the program's words and in the simulator's, which are not the same."""
    turning = draw(st.sampled_from(SimTurning))
    lifting = draw(st.sampled_from(SimLifting))
    hand = draw(st.sampled_from(Hand))
    azimuth_deg = draw(st.floats(-180.0, 180.0))
    lean_deg, pitch_deg = draw(st.floats(-1.5, 1.5)), draw(st.floats(-20.0, 20.0))
    side_mm, height_mm = draw(st.floats(-0.5, 0.5)), draw(st.floats(-10.0, 50.0))
    straight = Crookedness(
        yaw_rad=0.0, pitch_rad=math.radians(pitch_deg), roll_rad=math.radians(lean_deg),
        axis_tilt_rad=0.0, axis_towards_rad=0.0, pivot_mm=(0.0, 0.0), table_scale=1.0,
        lift=(0.0, 0.0, 1.0), x_scale=1.0, z_scale=1.0,
    )  # fmt: skip
    mounting = Mounting(
        side_mm=side_mm, height_mm=height_mm, azimuth_rad=math.radians(azimuth_deg),
        turning=turning, lifting=lifting, hand=hand,
    )  # fmt: skip
    off = standing(cut, straight)
    assert off is not None
    if cut is Cut.STRIPES:  # in the simulator the stage's way is not turned with the sensor
        x, y = -math.sin(mounting.azimuth_rad), math.cos(mounting.azimuth_rad)
        off = replace(off, lift=(x, y, 0.0))
    settings = OpticsSettings(mounting=mounting, sensor=Sensor(points=2))
    bench = CrookedBench(cylinder(around=8, levels=2), settings, off)
    words = replace(
        UPRIGHT if cut is Cut.MERIDIANS else SLIDING,
        table_sense=Turning[turning.name], stage_sense=Lifting[lifting.name],
        sensor_x=Side[hand.name], azimuth_deg=azimuth_deg, roll_deg=90.0 + lean_deg,
        pitch_deg=pitch_deg, side_mm=side_mm, height_mm=height_mm,
    )  # fmt: skip
    return words, bench


def taken_at(table_rad: float, *stage_mm: float) -> Sweep:
    profile = FakeProfiler(FakeBench()).profile(0)
    poses = tuple(Pose(table_rad, each, 0.0) for each in stage_mm)
    return Sweep(0, (profile,) * len(poses), poses)


def of_the_sheet(bench: CrookedBench, table_rad: float, stage_mm: float) -> tuple:
    """A point of the true sheet (the sensor's own place), its normal, in the part's frame."""
    turned, shift_mm = bench.pose(table_rad, stage_mm)
    return -turned.T @ shift_mm, turned[2]


@given(stations(Cut.MERIDIANS), st.floats(0.0, 6.0), st.floats(-20.0, 60.0))
def test_a_meridians_plane_is_the_sheet_and_opens_to_the_sensor(
    station: tuple[Kinematics, CrookedBench], table_rad: float, stage_mm: float
) -> None:
    kinematics, bench = station
    sweep = taken_at(table_rad, stage_mm - 5.0, stage_mm + 5.0)
    origin_mm, axes = slice_plane(sweep, kinematics, SliceKind.MERIDIAN)
    sensor_mm, normal = of_the_sheet(bench, table_rad, stage_mm)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert abs(axes[2] @ normal) == pytest.approx(1.0)
    assert abs(axes[2] @ (sensor_mm - origin_mm)) < 1e-9
    assert axes[0] @ sensor_mm > 0.9 * np.hypot(*sensor_mm[:2])  # away from the axis
    assert axes[1][2] > 0.99  # up
    # As near to the axis as the sheet comes at the height where the origin lies.
    on_axis_mm = np.array([0.0, 0.0, origin_mm[2] - (origin_mm[:2] @ normal[:2]) * normal[2]])
    beside_mm = abs(normal @ (sensor_mm - on_axis_mm))
    assert np.hypot(*origin_mm[:2]) <= beside_mm + 0.01


@given(stations(Cut.STRIPES), st.floats(0.0, 6.0), st.floats(-20.0, 60.0))
def test_a_stripes_plane_is_the_sheet_and_its_normal_goes_as_the_stage_does(
    station: tuple[Kinematics, CrookedBench], table_rad: float, stage_mm: float
) -> None:
    kinematics, bench = station
    one, other = (
        slice_plane(taken_at(table_rad, at_mm), kinematics, SliceKind.STRIPE)
        for at_mm in (stage_mm, stage_mm + 7.0)
    )
    sensor_mm, normal = of_the_sheet(bench, table_rad, stage_mm)
    np.testing.assert_allclose(one[1], other[1], atol=1e-12)
    assert np.linalg.det(one[1]) == pytest.approx(1.0)
    assert abs(one[1][2] @ normal) == pytest.approx(1.0)
    assert abs(one[1][2] @ (sensor_mm - one[0])) < 1e-9
    ahead_mm = (other[0] - one[0]) @ one[1][2]
    further_mm, _ = of_the_sheet(bench, table_rad, stage_mm + 7.0)
    assert ahead_mm == pytest.approx(abs(normal @ (further_mm - sensor_mm)))
    np.testing.assert_allclose((other[0] - one[0]) @ one[1][:2].T, 0.0, atol=1e-9)


def test_a_sweep_without_a_pose_has_no_plane() -> None:
    with pytest.raises(ValueError, match="sweep 3: no pose"):
        slice_plane(Sweep(3, (), ()), UPRIGHT, SliceKind.STRIPE)


@pytest.mark.parametrize(
    ("plan", "kinematics", "said"),
    [
        (MERIDIANS, replace(UPRIGHT, roll_deg=0.0), "meridian: the sheet leans 90 deg against the"),
        (MERIDIANS, replace(UPRIGHT, roll_deg=87.0), "meridian: the sheet leans 3 deg against the"),
        (MERIDIANS, replace(UPRIGHT, side_mm=1.4), "passes the table's axis by 1.4 mm, and may"),
        (
            Plan(
                meridian=Meridian(per_turn=8, first_mm=0.0, last_mm=60.0, step_mm=30.0),
                step_and_shoot=SHOOT,
            ),
            replace(UPRIGHT, stage_y_mm=0.02),
            "meridian.last_mm: the stage carries the sheet 1.2 mm out of its plane",
        ),
        (STRIPES, UPRIGHT, "stripe: the stage moves along the sheet, 0.0 deg off it"),
        (ring(0.0, 1.0, 1.0, 4), UPRIGHT, "ring: the sheet is rolled by 90 deg, and rings need"),
        (
            ring(0.0, 1.0, 1.0, 4),
            replace(UPRIGHT, roll_deg=0.0, pitch_deg=-75.0),
            "ring: the sheet is pitched by -75 deg",
        ),
    ],
)
def test_a_sheet_that_cannot_cut_such_slices_is_refused(
    plan: Plan, kinematics: Kinematics, said: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        check_sheet(plan, kinematics, "part.toml")
    assert str(refused.value).startswith("part.toml: ")
    assert ";" in str(refused.value)  # the remedy


@pytest.mark.parametrize(
    ("plan", "kinematics"),
    [
        (MERIDIANS, UPRIGHT),
        (MERIDIANS, replace(UPRIGHT, roll_deg=-91.0, side_mm=0.8, pitch_deg=2.0)),
        (STRIPES, SLIDING),
        (STRIPES, replace(UPRIGHT, roll_deg=0.0)),
        (STRIPES, replace(UPRIGHT, roll_deg=0.0, pitch_deg=-90.0, stage_x_mm=1.0, stage_z_mm=0.0)),
        (ring(0.0, 1.0, 1.0, 4), replace(UPRIGHT, roll_deg=178.0)),
    ],
)
def test_a_sheet_that_can_is_not(plan: Plan, kinematics: Kinematics) -> None:
    check_sheet(plan, kinematics)
