"""Two views of one part become one; how the part was turned over is known, and to nobody else."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from acquisition.plan import ring, targets
from acquisition.poses import Pose, Sweep
from loftscan import reconstruct, register
from loftscan.inputs import Unit
from loftscan.registering import open_view, parse_near
from reconstruction.arrays import FloatArray
from reconstruction.errors import NotRegistered, TooFewPoints
from reconstruction.registration import View, register_views
from reconstruction.registration.searching import angles_between, small_turns, spread_turns
from sim import Flaws, Mounting, SeedKey
from sim.judging import Surface
from sim.optics import OpticalBench, OpticsSettings
from sim.solids import Part
from tests.campaigns.turned_over import errors_of, lobed, lump, scanned, spun, turned_over
from tests.loftscan.made_scans import KINEMATICS, SENSOR, _profile, sweeps, write_scan
from tests.loftscan.test_layouts import keep
from tests.system.command_cases import complaint, run, succeeded

CHI2_LIMIT = 27.9  # of 6 freedoms: 1 in 10 000


@cache
def views(make: object, seed: int) -> tuple[View, View, FloatArray, Part]:
    part: Part = make()  # type: ignore[operator]
    other, back = turned_over(part, np.random.default_rng([3, seed]))
    return scanned(part, 2 * seed + 1), scanned(other, 2 * seed + 2), back, part


def part_of(view: View, rows: np.ndarray) -> View:
    assert view.towards is not None
    return View(view.points_mm[rows], view.towards[rows])


@pytest.mark.parametrize("seed", [1, 2])
def test_a_part_that_was_turned_over_is_laid_back_within_the_told_errors(seed: int) -> None:
    first, second, back, _ = views(lump, seed)
    found = register_views(first, second)
    errors = errors_of(found, back)
    # Noise of 0.025 mm, averaged over patches of 100 points and 340 of these: 0.002 mm.
    assert np.linalg.norm(errors[3:]) < 0.01
    assert np.degrees(np.linalg.norm(errors[:3])) < 0.03
    assert errors @ np.linalg.solve(found.covariance, errors) < CHI2_LIMIT
    assert found.rms_mm < 0.02
    assert min(found.overlap) > 0.9


def test_what_only_one_view_sees_does_no_harm() -> None:
    """Each sees two thirds from its own top down: the middle third, and some more, is common."""
    first, second, back, _ = views(lump, 1)
    first = part_of(first, first.points_mm[:, 2] > 18.0)
    second = part_of(second, second.points_mm[:, 2] > 18.0)
    found = register_views(first, second)
    errors = errors_of(found, back)
    assert max(found.overlap) < 0.75
    assert errors @ np.linalg.solve(found.covariance, errors) < CHI2_LIMIT
    assert np.linalg.norm(errors[3:]) < 0.03


def test_clouds_that_do_not_say_where_they_were_seen_from_are_laid_likewise() -> None:
    first, second, back, _ = views(lump, 2)
    merged = register(first.points_mm, second.points_mm)
    errors = errors_of(merged.registration, back)
    assert np.linalg.norm(errors[3:]) < 0.01
    assert merged.points_mm.shape == (len(first.points_mm) + len(second.points_mm), 3)


def test_a_turned_part_is_refused_and_the_free_turn_is_named() -> None:
    first, second, *_ = views(spun, 1)
    with pytest.raises(NotRegistered, match=r"the turn about the axis through .* along .*1\.00\)"):
        register_views(first, second)


def test_a_symmetric_part_is_refused_unless_somebody_says_how_it_was_turned() -> None:
    first, second, back, _ = views(lobed, 1)
    with pytest.raises(NotRegistered, match=r"two ways fit alike, .* 120 deg"):
        register_views(first, second)
    roughly = back[:3, :3] @ small_turns(np.array([[0.1, -0.1, 0.2]]))[0]
    found = register_views(first, second, near=roughly)
    errors = errors_of(found, back)
    assert errors @ np.linalg.solve(found.covariance, errors) < CHI2_LIMIT


def test_two_parts_are_not_laid_onto_each_other() -> None:
    first, *_ = views(lump, 1)
    _, second, *_ = views(spun, 1)
    with pytest.raises(NotRegistered, match="registration: "):
        register_views(first, second)


@pytest.mark.parametrize("count", [0, 100])
def test_too_few_points_are_said_to_be(count: int) -> None:
    first, *_ = views(lump, 1)
    with pytest.raises(TooFewPoints, match=f"a view of {count} points is too small"):
        register_views(first, View(np.zeros((count, 3))))


def test_points_without_a_surface_are_said_to_have_none() -> None:
    rng = np.random.default_rng(4)
    dust = View(rng.uniform(-30.0, 30.0, (3000, 3)))
    with pytest.raises((TooFewPoints, NotRegistered), match="registration: "):
        register_views(dust, dust)


def test_the_merged_points_become_one_watertight_mesh(tmp_path: Path) -> None:
    first, second, _, part = views(lump, 1)
    merged = register(first.points_mm, second.points_mm)
    folder = merged.save(tmp_path / "merged")
    result = reconstruct(folder / "merged.ply", spacing_mm=1.5)
    assert result.metrics["watertight"]
    assert len(result.surface) == 1
    places_mm = result.mesh.vertices_mm
    walls = places_mm[(places_mm[:, 2] > 3.0) & (places_mm[:, 2] < 57.0)]
    off_mm = Surface(part.vertices_mm, part.faces).signed_distances_mm(walls)
    assert np.sqrt(np.mean(off_mm**2)) < 0.006  # 0.003 by one view alone
    told = json.loads((folder / "registration.json").read_text())
    assert told["unit"] == "mm"
    assert np.array(told["covariance"]).shape == (6, 6)
    assert "Residual where both views see the part" in (folder / "report.html").read_text()


def test_a_scan_says_from_where_its_points_were_seen(tmp_path: Path) -> None:
    named = open_view(write_scan(tmp_path / "vase.scan"), Unit.MM)
    points_mm, towards = named.view.points_mm, named.view.towards
    assert towards is not None
    assert named.spacing_mm == 4.0
    # The part turns counter-clockwise: seen from it, the sensor goes round clockwise, 225 mm off.
    turned = np.concatenate([
        np.full(len(profile.points_mm), -pose.table_rad)
        for sweep in sweeps() for profile, pose in zip(sweep.profiles, sweep.poses, strict=True)
    ])  # fmt: skip
    eyes_mm = 225.0 * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    ways = np.column_stack([eyes_mm - points_mm[:, :2], np.zeros(len(turned))])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    np.testing.assert_allclose(towards, ways, atol=1e-9)


def test_the_command_writes_the_folder_and_says_what_is_next(place: Path) -> None:
    first, second, *_ = views(lump, 2)
    np.save(place / "a.npy", first.points_mm)
    np.save(place / "b.npy", second.points_mm)
    said = succeeded(run("register", "a.npy", "b.npy", "--out", "m")).stdout
    assert "b.npy laid on a.npy: turned by 1" in said
    assert "loftscan reconstruct m/merged.ply --spacing-mm" in said
    assert {each.name for each in Path("m").iterdir()} == {
        "merged.ply", "registration.json", "report.html"
    }  # fmt: skip


def test_a_wrong_near_is_refused_in_one_line(place: Path) -> None:
    del place
    said = complaint(run("register", "a.npy", "b.npy", "--out", "m", "--near", "half"), 2)
    assert "--near 'half': three numbers in degrees expected" in said
    with pytest.raises(ValueError, match="finite numbers"):
        parse_near("nan,0,0")
    assert parse_near("180,0,0") == (180.0, 0.0, 0.0)


def test_turns_are_spread_evenly() -> None:
    turns = spread_turns(3000)
    whole = np.broadcast_to(np.eye(3), turns.shape)
    np.testing.assert_allclose(turns @ np.moveaxis(turns, 1, 2), whole, atol=1e-12)
    rng = np.random.default_rng(5)
    asked = small_turns(rng.normal(size=(200, 3)))
    nearest = [angles_between(turns, each).min() for each in asked]
    # The volume of the rotations over 3000 balls: 12 degrees; a grid reaches every place in twice.
    assert math.degrees(max(nearest)) < 24.0


def kept(path: Path, part: Part, seed: int) -> Path:
    """A .scan folder of 40 rings, as the simulator's optics see the part."""
    kinematics = replace(KINEMATICS, height_mm=0.0)
    flaws = Flaws(cloud_width_mm=0.1, outlier_rate=0.001, speckle_points=4, seed=seed)
    mounting = Mounting(standoff_mm=kinematics.standoff_mm)
    bench = OpticalBench(part, OpticsSettings(mounting=mounting, sensor=SENSOR, flaws=flaws))
    plan = ring(0.75, 59.25, 1.5, 24)
    taken = [
        Sweep(
            each.index,
            tuple(
                _profile(bench.profile(turn_rad, at_mm, SeedKey(each.index, stop)), stop)
                for stop, (at_mm, turn_rad) in enumerate(each.stops)
            ),
            tuple(Pose(turn_rad, at_mm, 0.0) for at_mm, turn_rad in each.stops),
        )
        for each in targets(plan)
    ]
    return keep(path, plan, kinematics, taken)


def test_two_scans_of_a_part_that_was_turned_over_become_one_part(place: Path) -> None:
    part = lump()
    other, back = turned_over(part, np.random.default_rng([3, 9]))
    kept(place / "upright.scan", part, 1)
    kept(place / "turned.scan", other, 2)
    words = ("register", "upright.scan", "turned.scan", "--out", "m", "--json")
    told = json.loads(succeeded(run(*words)).stdout.splitlines()[-1])
    apart = np.array(told["transform"]) @ np.linalg.inv(back)
    assert math.acos(min(1.0, (np.trace(apart[:3, :3]) - 1.0) / 2.0)) < math.radians(0.05)
    middle = np.append(told["about_mm"], 1.0)
    assert np.linalg.norm((apart @ middle - middle)[:3]) < 0.02
    assert told["spacing_mm"] == 1.5
    succeeded(
        run("reconstruct", "m/merged.ply", "--spacing-mm", "1.5", "--out", "r", "--formats", "ply")
    )
    assert json.loads(Path("r/metrics.json").read_text())["watertight"]
