from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sim import Flaws, Mounting, OpticalBench, OpticsSettings, Reason, SeedKey, Sensor
from sim.parts import badly_acquired, cylinder, vase
from sim.sensor import Hand, Lifting, Turning
from sim.solids import radial_solid
from tests.sim.optics_cases import FINE, naive_profile, part_xy_mm, peg, planar_mm, shifted

KEY = SeedKey(0, 0)
MOUNTINGS = [
    Mounting(side_mm=1.5, azimuth_rad=0.4, turning=turning, hand=hand)
    for turning in Turning
    for hand in Hand
]


def keys(count: int, slice_index: int = 0) -> list[SeedKey]:
    return [SeedKey(slice_index, number) for number in range(count)]


def mushroom():
    """A stem under a five-cornered hat: from above the hat hides the stem's upper half."""

    def law(angle_rad, height_mm):
        lobes = 1.0 + 0.2 * np.cos(5 * angle_rad + 0.3)
        return np.where(height_mm > 27.0, 45.0, 12.0) * lobes

    return radial_solid("mushroom", law, np.array([0.0, 13.0, 26.0, 28.0, 40.0]), 35)


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("stage_mm", [5.0, 12.3])  # on a row of vertices and between two
def test_every_beam_meets_the_cylinder_where_the_formula_says(mounting, stage_mm):
    bench = OpticalBench(peg(2.0, -1.0), OpticsSettings(mounting=mounting, sensor=FINE))
    angles_rad = np.linspace(-7.0, 9.0, 41)
    profiles = bench.profiles(angles_rad, stage_mm, keys(41))
    for angle_rad, profile in zip(angles_rad, profiles, strict=True):
        points_mm = planar_mm(profile, FINE)[profile.seen]
        x, y = part_xy_mm(points_mm, mounting, angle_rad).T
        assert profile.seen.sum() > 150
        assert np.abs(np.hypot(x - 2.0, y + 1.0) - 10.0).max() < 1e-3
        assert points_mm[:, 1].max() < 226.0  # the near side: no beam went through a seam


def test_no_beam_slips_through_the_mesh_between_two_that_meet_it():
    bench = OpticalBench(vase(), OpticsSettings())
    angles_rad = np.arange(150) * (math.tau / 400)  # the rows and columns of the vertices
    for stage_mm in (20.0, 40.0, 100.0):
        for profile in bench.profiles(angles_rad, stage_mm, keys(150)):
            met = np.flatnonzero(profile.reasons != Reason.NO_HIT)
            assert len(met) == met[-1] - met[0] + 1 > 400


def test_no_beam_reaches_the_far_side_through_a_seam():
    bench = OpticalBench(cylinder(around=256), OpticsSettings())
    angles_rad = np.arange(150) * (math.tau / 256)  # the seams
    for stage_mm in (10.0, 33.0, 80.0):
        for profile in bench.profiles(angles_rad, stage_mm, keys(150)):
            assert profile.seen.sum() > 800
            assert profile.counts[profile.seen, 1].max() * 0.005 < 225.0


@pytest.mark.parametrize("lifting", Lifting)
def test_the_stage_lifts_the_sheet_by_its_sense(lifting):
    cone_like = radial_solid(
        "cone", lambda a, z: 40.0 - 0.3 * z + 0.0 * a, np.linspace(0.0, 80.0, 9), 2048
    )
    mounting = Mounting(height_mm=30.0, lifting=lifting)
    profile = OpticalBench(cone_like, OpticsSettings(mounting=mounting)).profile(0.0, 10.0, KEY)
    nearest_mm = profile.counts[profile.seen, 1].min() * 0.005
    radius_mm = 40.0 - 0.3 * (30.0 + lifting.value * 10.0)
    assert 225.0 - nearest_mm == pytest.approx(radius_mm, abs=0.004)


@pytest.mark.parametrize("mounting", [*MOUNTINGS, Mounting(lifting=Lifting.DOWN, height_mm=31.0)])
@pytest.mark.parametrize("triangulation_deg", [25.0, -25.0, 50.0])
def test_reasons_and_ranges_are_those_of_the_naive_twin(mounting, triangulation_deg):
    sensor = Sensor(points=41, near_mm=190.0, far_mm=245.0, width_mm=104.0)
    sensor = replace(sensor, triangulation_rad=math.radians(triangulation_deg))
    flaws = Flaws(steepest_incidence_rad=math.radians(60.0), faintest=0.0)
    settings = OpticsSettings(mounting=mounting, sensor=sensor, flaws=flaws)
    part = shifted(mushroom(), 3.0, -2.0)
    bench = OpticalBench(part, settings)
    for stage_mm in (4.1, 12.0, 21.7, 27.0):
        for angle_rad in (0.11, 2.3):
            profile = bench.profile(angle_rad, stage_mm, KEY)
            expected_mm, reasons = naive_profile(part, settings, angle_rad, stage_mm)
            assert profile.reasons.tolist() == reasons.tolist()
            z_mm = planar_mm(profile, sensor)[:, 1]
            assert np.abs(z_mm - expected_mm)[profile.seen].max(initial=0.0) <= 0.0025 + 1e-6


def test_the_twin_meets_every_reason_that_geometry_has():
    sensor = Sensor(points=161, near_mm=190.0, far_mm=245.0, width_mm=104.0)
    flaws = Flaws(steepest_incidence_rad=math.radians(60.0))
    bench = OpticalBench(mushroom(), OpticsSettings(sensor=sensor, flaws=flaws))
    found = set()
    for stage_mm in (4.1, 21.7, 27.0, 33.0):
        found |= set(bench.profile(0.11, stage_mm, KEY).reasons.tolist())
    geometric = {Reason.MEASURED, Reason.NO_HIT, Reason.GRAZING, Reason.OCCLUDED}
    assert found == geometric | {Reason.OUT_OF_RANGE}


def test_the_hat_hides_the_stem_from_a_camera_above_and_not_from_one_below():
    for degrees, hidden in ((25.0, True), (-25.0, False)):
        sensor = Sensor(triangulation_rad=math.radians(degrees))
        bench = OpticalBench(mushroom(), OpticsSettings(sensor=sensor))
        profile = bench.profile(0.0, 20.0, KEY)
        assert (Reason.OCCLUDED in profile.reasons) == hidden
        assert (Reason.MEASURED in profile.reasons) != hidden


def test_steep_surfaces_return_nothing_and_the_cut_is_at_the_angle_that_was_set():
    steepest_rad = math.radians(50.0)
    flaws = Flaws(steepest_incidence_rad=steepest_rad)
    bench = OpticalBench(cylinder(), OpticsSettings(flaws=flaws))
    profile = bench.profile(0.3, 33.0, KEY)
    half = Sensor().steepest
    beam_rad = np.arctan(np.linspace(-half, half, 1280))
    sine = 225.0 * np.abs(np.sin(beam_rad)) / 40.0
    met = sine < 0.9999
    incidence_rad = np.arcsin(np.minimum(sine, 1.0))
    clear = met & (np.abs(incidence_rad - steepest_rad) > 0.005)  # a facet is 0.003 rad wide
    assert np.all(profile.reasons[sine > 1.0] == Reason.NO_HIT)
    steep = incidence_rad > steepest_rad
    assert np.all(profile.reasons[clear & steep] == Reason.GRAZING)
    assert np.all(profile.reasons[clear & ~steep] == Reason.MEASURED)
    bright = profile.intensity[profile.seen] / 1000.0
    assert np.abs(bright - np.cos(incidence_rad[profile.seen])).max() < 0.004


def test_black_patches_leave_gaps_in_a_ring_as_wide_as_they_are():
    part = badly_acquired()
    bench = OpticalBench(part, OpticsSettings())
    profiles = bench.profiles(np.arange(72) * (math.tau / 72), 51.0, keys(72))
    dark = sum(int((each.reasons == Reason.DARK).sum()) for each in profiles)
    light = sum(int(each.seen.sum()) for each in profiles)
    z = part.vertices_mm[part.faces][:, :, 2]
    band = part.reflectance[(z.min(axis=1) < 51.0) & (z.max(axis=1) > 51.0)]
    assert dark / (dark + light) == pytest.approx((band == 0.0).mean(), abs=0.02)
    assert 0.1 < dark / (dark + light) < 0.9


@pytest.mark.parametrize(("near_mm", "far_mm"), [(150.0, 180.0), (230.0, 300.0)])
def test_what_is_nearer_or_farther_than_the_range_is_out_of_range(near_mm, far_mm):
    sensor = Sensor(near_mm=near_mm, far_mm=far_mm, width_mm=60.0)
    profile = OpticalBench(cylinder(), OpticsSettings(sensor=sensor)).profile(0.0, 20.0, KEY)
    assert not profile.seen.any() or near_mm < 185.0
    assert (profile.reasons == Reason.OUT_OF_RANGE).any() != (near_mm < 185.0 < far_mm)


def test_above_the_part_and_at_its_foot_the_sheet_meets_nothing_and_at_its_top_the_wall():
    bench = OpticalBench(cylinder(40.0, 80.0), OpticsSettings())
    for stage_mm, met in ((0.0, False), (1e-3, True), (80.0, True), (80.001, False)):
        profile = bench.profile(0.0, stage_mm, KEY)
        assert (profile.reasons != Reason.NO_HIT).any() == met


def test_a_count_is_at_most_half_a_count_off_and_unseen_beams_are_zero():
    fine = OpticalBench(peg(), OpticsSettings(sensor=FINE))
    coarse_sensor = replace(
        FINE, x_mm_per_count=0.05, z_mm_per_count=0.02, x_offset_mm=0.013, z_offset_mm=100.003
    )
    coarse = OpticalBench(peg(), OpticsSettings(sensor=coarse_sensor))
    one, two = fine.profile(0.2, 7.0, KEY), coarse.profile(0.2, 7.0, KEY)
    off_mm = np.abs(planar_mm(one, FINE) - planar_mm(two, coarse_sensor))[one.seen]
    assert np.array_equal(one.reasons, two.reasons)
    assert np.all(off_mm <= np.array([0.025, 0.01]) + 0.00025 + 1e-9)
    assert off_mm[:, 1].max() > 0.008  # it does round
    assert np.array_equal(two.seen, two.counts[:, 1] > 0)
    assert not two.counts[~two.seen].any()
    assert not two.intensity[~two.seen].any()


def test_counts_fit_the_wire():
    profile = OpticalBench(vase(), OpticsSettings()).profile(0.0, 50.0, KEY)
    assert np.array_equal(profile.counts[:, 0], profile.counts[:, 0].astype(np.int16))
    assert np.array_equal(profile.counts[:, 1], profile.counts[:, 1].astype(np.uint16))
    assert profile.counts[:, 0].min() < 0 < profile.counts[:, 0].max()


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ({"x_mm_per_count": 0.0005}, "int16"),
        ({"z_mm_per_count": 0.001}, "uint16"),
        ({"z_offset_mm": 150.0}, "uint16"),
        ({"near_mm": 300.0}, "near < far"),
        ({"triangulation_rad": 0.0}, "triangulation_rad"),
    ],
)
def test_a_sensor_that_could_not_count_what_it_sees_is_refused(wrong, word):
    with pytest.raises(ValueError, match=word):
        Sensor(**wrong)


def test_angles_and_keys_must_be_as_many():
    bench = OpticalBench(peg(), OpticsSettings(sensor=FINE))
    with pytest.raises(ValueError, match="2 seed keys"):
        bench.profiles([0.0], 5.0, keys(2))
