from __future__ import annotations

import math

import numpy as np
import pytest

from sim import Flaws, OpticalBench, OpticsSettings, Reason, SeedKey, Sensor
from sim.parts import cylinder
from sim.speckle import Speckle

WIDTH_MM = 0.4
SENSOR = Sensor(points=640, width_mm=100.0)
FLAWS = Flaws(cloud_width_mm=WIDTH_MM, speckle_points=2, outlier_rate=0.01, seed=11)


def bench(flaws: Flaws) -> OpticalBench:
    return OpticalBench(cylinder(levels=3), OpticsSettings(sensor=SENSOR, flaws=flaws))


def keys(count: int) -> list[SeedKey]:
    return [SeedKey(3, number) for number in range(count)]


def ring(flaws: Flaws, count: int = 120):
    angles_rad = np.arange(count) * (math.tau / count)
    return bench(flaws).profiles(angles_rad, 31.0, keys(count))


def same(one, two) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(two, name))
        for name in ("counts", "reasons", "intensity")
    )


def across_mm(profiles) -> tuple[np.ndarray, np.ndarray]:
    """How far each point lies outside the circle, and the sine of its incidence."""
    points_mm = np.concatenate([each.counts[each.reasons == Reason.MEASURED] for each in profiles])
    x, z = points_mm.T * 0.005
    sine = 225.0 * np.abs(np.sin(np.arctan(x / z))) / 40.0
    return np.hypot(x, 225.0 - z) - 40.0, sine


def test_the_cloud_is_as_wide_across_the_contour_as_it_was_set():
    off_mm, sine = across_mm(ring(Flaws(cloud_width_mm=WIDTH_MM, seed=1)))
    for low, high in ((0.0, 0.3), (0.3, 0.6), (0.6, 0.9)):
        part_mm = off_mm[(sine >= low) & (sine < high)]
        assert len(part_mm) > 10_000  # so 0.7 % of the width is one sigma of its estimate
        assert 4.0 * part_mm.std() == pytest.approx(WIDTH_MM, rel=0.03)
        assert abs(part_mm.mean()) < 0.004


def test_along_the_beam_the_noise_grows_with_incidence():
    noisy, clean = ring(Flaws(cloud_width_mm=WIDTH_MM)), ring(Flaws())
    shift_mm = np.stack([a.counts - b.counts for a, b in zip(noisy, clean, strict=True)])
    seen = np.stack([a.seen & b.seen for a, b in zip(noisy, clean, strict=True)])
    beam_rad = np.arctan(np.linspace(-SENSOR.steepest, SENSOR.steepest, 640))
    sine = 225.0 * np.abs(np.sin(beam_rad)) / 40.0
    steep = (sine > 0.85) & (sine < 0.9)
    square = sine < 0.2
    z_mm = shift_mm[..., 1] * 0.005
    ratio = z_mm[:, steep][seen[:, steep]].std() / z_mm[:, square][seen[:, square]].std()
    assert ratio == pytest.approx(1.0 / math.sqrt(1.0 - 0.875**2), rel=0.08)


@pytest.mark.parametrize("window", [1, 2, 5])
def test_speckle_correlates_over_its_points_and_not_beyond_nor_between_profiles(window):
    flaws = Flaws(cloud_width_mm=1.0, speckle_points=window)
    normals, uniforms = Speckle(flaws).draw(keys(200), 1000)
    assert uniforms.size == 0  # none were asked for
    assert normals.std() == pytest.approx(1.0, abs=0.02)
    assert abs(normals.mean()) < 0.02
    for lag in range(1, 8):
        correlation = float((normals[:, lag:] * normals[:, :-lag]).mean())
        assert correlation == pytest.approx(max(1.0 - lag / window, 0.0), abs=0.03)
    assert abs(float((normals[1:] * normals[:-1]).mean())) < 0.02


def test_every_draw_differs_from_profile_to_profile_from_the_first_on():
    normals, uniforms = Speckle(FLAWS).draw(keys(400), 20)
    assert np.all(np.abs(normals.std(axis=0) - 1.0) < 0.2)
    assert np.all(np.abs(uniforms.std(axis=0) - math.sqrt(1 / 12)) < 0.06)
    assert len(np.unique(normals[:, 0])) > 390


def test_no_answer_depends_on_the_order_in_which_profiles_are_asked_for():
    angles_rad = np.arange(60) * 0.1
    together = bench(FLAWS).profiles(angles_rad, 31.0, keys(60))
    other = bench(FLAWS)
    for number in reversed(range(60)):
        other.profile(0.0, 55.0, SeedKey(9, 9))  # something else between
        assert same(other.profile(angles_rad[number], 31.0, SeedKey(3, number)), together[number])


@pytest.mark.parametrize(
    ("flaws", "key"),
    [
        (FLAWS, SeedKey(3, 1)),
        (FLAWS, SeedKey(4, 0)),
        (
            Flaws(cloud_width_mm=WIDTH_MM, speckle_points=2, outlier_rate=0.01, seed=12),
            SeedKey(3, 0),
        ),
    ],
)
def test_another_profile_slice_or_seed_is_another_noise(flaws, key):
    one = bench(FLAWS).profile(0.0, 31.0, SeedKey(3, 0))
    two = bench(flaws).profile(0.0, 31.0, key)
    both = one.seen & two.seen
    moved = (one.counts[both, 1] - two.counts[both, 1]).astype(float)
    assert (moved != 0).mean() > 0.9


def test_slice_and_profile_are_not_interchangeable():
    one, two = (bench(FLAWS).profile(0.0, 31.0, key) for key in (SeedKey(1, 2), SeedKey(2, 1)))
    assert not same(one, two)


def test_without_flaws_the_seed_changes_nothing():
    one, two = (bench(Flaws(seed=seed)).profile(0.0, 31.0, SeedKey(0, 0)) for seed in (1, 2))
    assert same(one, two)


def test_outliers_come_at_their_rate_anywhere_in_the_range_and_alone():
    rate = 0.02
    noisy = ring(Flaws(outlier_rate=rate, seed=4))
    clean = ring(Flaws())
    stray_mm, measured = [], 0
    for one, two in zip(noisy, clean, strict=True):
        stray = one.reasons == Reason.OUTLIER
        assert np.array_equal(one.seen, two.seen)
        assert np.array_equal(one.counts[~stray], two.counts[~stray])
        stray_mm.extend(one.counts[stray, 1] * 0.005)
        measured += int(two.seen.sum())
    expected = rate * measured
    assert abs(len(stray_mm) - expected) < 5.0 * math.sqrt(expected)
    share = (np.sort(stray_mm) - SENSOR.near_mm) / (SENSOR.far_mm - SENSOR.near_mm)
    uniform = (np.arange(len(share)) + 0.5) / len(share)
    assert np.abs(share - uniform).max() < 1.95 / math.sqrt(len(share))  # Kolmogorov, 0.1 %


def test_noise_never_pushes_a_count_off_the_wire():
    sensor = Sensor(near_mm=184.0, far_mm=200.0, width_mm=60.0, z_offset_mm=183.9)
    flaws = Flaws(cloud_width_mm=20.0, seed=2)
    subject = OpticalBench(cylinder(levels=3), OpticsSettings(sensor=sensor, flaws=flaws))
    for profile in subject.profiles(np.arange(20.0), 31.0, keys(20)):
        z_mm = profile.counts[profile.seen, 1] * 0.005 + 183.9
        assert (profile.reasons == Reason.OUT_OF_RANGE).any()
        assert z_mm.min() >= 184.0 - 0.003
        assert z_mm.max() <= 200.0 + 0.003


@pytest.mark.parametrize(
    "wrong",
    [
        {"cloud_width_mm": -1.0},
        {"outlier_rate": 1.5},
        {"speckle_points": 0},
        {"seed": -1},
        {"steepest_incidence_rad": math.pi / 2},
    ],
)
def test_flaws_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Flaws(**wrong)
