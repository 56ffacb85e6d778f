"""A slice taken again agrees within the noise, or the difference is named."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import NotAsKept
from acquisition.loop_closure import Closure, comparable, compare, in_words, must_agree
from acquisition.poses import Pose, Sweep
from acquisition.resuming import known_slice
from acquisition.scanfile import ScanFolder
from drivers.profiler import Profile, Reason
from tests.acquisition.scan_cases import KINEMATICS, record
from tests.acquisition.scan_cases import sweep as any_sweep

STOPS, POINTS, COUNT_MM = 36, 120, 0.002


def sweep(
    seed: int,
    *,
    noise_mm: float = 0.02,
    nearer_mm: float = 0.0,
    turned_deg: float = 0.0,
    lobes: int = 1,
    missing: float = 0.0,
) -> Sweep:
    """A lobed part; what the sensor sees is a formula of x and the table's angle."""
    rng = np.random.default_rng(seed)
    x_mm = np.linspace(-12.0, 12.0, POINTS)
    profiles, poses = [], []
    for stop in range(STOPS):
        angle = math.tau * stop / STOPS
        turn = angle + math.radians(turned_deg)
        lobe = 2.0 * math.cos(lobes * turn) + 0.7 * math.cos((lobes + 1) * turn)
        z_mm = 130.0 + x_mm**2 / 40.0 - lobe - nearer_mm + rng.normal(0.0, noise_mm, POINTS)
        counts = np.column_stack([x_mm / COUNT_MM, z_mm / COUNT_MM]).round().astype(np.int32)
        reasons = np.where(rng.random(POINTS) < missing, Reason.NO_RETURN, Reason.MEASURED)
        none = np.empty(0, np.uint16)
        scale, offset = (COUNT_MM, COUNT_MM), (0.0, 0.0)
        profiles.append(
            Profile(counts, scale, offset, reasons.astype(np.uint8), none, 0.0, 0, stop)
        )
        poses.append(Pose(angle, 10.0, float(stop)))
    return Sweep(3, tuple(profiles), tuple(poses))


@pytest.mark.parametrize("noise_mm", [0.0, 0.01, 0.05, 0.2])
@pytest.mark.parametrize("seed", range(5))
def test_the_same_part_agrees_and_its_noise_is_measured(seed: int, noise_mm: float) -> None:
    found = compare(
        sweep(seed, noise_mm=noise_mm), sweep(seed + 100, noise_mm=noise_mm), KINEMATICS
    )
    must_agree(found)
    # 4320 points: the noise's own error is 1 %; interpolation halves a part of the kept one's.
    assert found.noise_mm == pytest.approx(max(noise_mm, COUNT_MM), rel=0.2)
    assert found.difference_mm < 0.35 * found.noise_mm
    assert "taken again lies" in in_words(found)


@pytest.mark.parametrize("seed", range(3))
def test_a_part_that_is_nearer_by_some_noise_is_refused_with_the_distance(seed: int) -> None:
    kept = sweep(seed)
    must_agree(compare(kept, sweep(seed + 50, nearer_mm=0.03), KINEMATICS))
    found = compare(kept, sweep(seed + 50, nearer_mm=0.1), KINEMATICS)
    # Along the normal, of slopes up to 0.6: 0.1 mm is between 0.086 and 0.1.
    assert 0.08 < found.difference_mm < 0.105
    with pytest.raises(NotAsKept, match=r"slice 3, taken again, lies 0\.09.* mm .*another part"):
        must_agree(found)


@pytest.mark.parametrize("turned_deg", [10.0, -20.0, 90.0, 170.0, 31.0])
def test_a_table_that_lost_its_place_is_refused_with_the_angle(turned_deg: float) -> None:
    found = compare(sweep(1), sweep(2, turned_deg=turned_deg), KINEMATICS)
    with pytest.raises(NotAsKept, match=r"turned by .* deg: the table lost its place"):
        must_agree(found)
    assert found.turned_rad is not None
    # Known to whole stops, 10 degrees apart.
    assert math.degrees(found.turned_rad) == pytest.approx(turned_deg, abs=5.0)


def test_another_part_is_refused_and_no_turn_is_made_up() -> None:
    found = compare(sweep(1), sweep(2, lobes=4), KINEMATICS)
    assert found.turned_rad is None
    with pytest.raises(NotAsKept, match="another part"):
        must_agree(found)


def test_an_empty_table_is_refused() -> None:
    found = compare(sweep(1), sweep(2, missing=1.0), KINEMATICS)
    assert (found.overlap, found.agrees) == (0.0, False)
    with pytest.raises(NotAsKept, match="meets no point of the kept one"):
        must_agree(found)


def test_shadows_take_no_part_in_it() -> None:
    assert compare(sweep(1), sweep(2, missing=0.3), KINEMATICS).agrees


def test_a_pose_that_was_read_back_otherwise_is_taken_into_account() -> None:
    """The same points, seen where the part is after another 0.2 deg; the axis 150 mm away."""
    kept, turn = sweep(1, noise_mm=0.0), math.radians(0.2)
    cosine, sine = math.cos(turn), math.sin(turn)
    profiles = []
    for profile in kept.profiles:
        x_mm, z_mm = profile.points_mm.T
        out_mm, side_mm = 150.0 - z_mm, x_mm
        seen = [sine * out_mm + cosine * side_mm, 150.0 - (cosine * out_mm - sine * side_mm)]
        counts = np.round(np.column_stack(seen) / COUNT_MM).astype(np.int32)
        profiles.append(replace(profile, counts=counts))
    poses = tuple(replace(each, table_rad=each.table_rad + turn) for each in kept.poses)
    told = compare(kept, Sweep(3, tuple(profiles), poses), KINEMATICS)
    untold = compare(kept, Sweep(3, tuple(profiles), kept.poses), KINEMATICS)
    assert told.difference_mm <= COUNT_MM
    assert told.difference_mm < 0.1 * untold.difference_mm


def test_a_limit_is_three_times_the_noise() -> None:
    assert Closure(0, 0.029, 0.01, 1.0).agrees
    assert not Closure(0, 0.031, 0.01, 1.0).agrees
    assert not Closure(0, 0.0, 0.01, 0.4).agrees


def test_the_known_slice_is_the_last_before_what_is_missing_that_has_points(tmp_path: Path) -> None:
    with ScanFolder.create(tmp_path / "part.scan", record(8)) as writer:
        for index in (0, 1, 2, 6):
            writer.append(replace(sweep(index), index=index))
        writer.append(any_sweep(3, profiles=1))
        folder = writer.folder
        assert not comparable(folder.read(3))
        missing = folder.missing()
        assert missing == (4, 5, 7)
        assert known_slice(folder, missing).index == 2  # type: ignore[union-attr]
        assert known_slice(folder, ()) is None
        folder.file(2).write_bytes(b"")
        assert known_slice(folder, missing).index == 1  # type: ignore[union-attr]
        folder.file(0).unlink()
        folder.file(1).unlink()
        assert known_slice(folder, folder.missing()).index == 6  # type: ignore[union-attr]
