"""Slices of a scan become a result: from a folder, while it is written, or from a script."""

from __future__ import annotations

import gc
import itertools
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import DamagedSlice, NotAScan
from acquisition.folder_lock import is_locked
from acquisition.frames import Kinematics, Lifting
from acquisition.poses import Sweep
from acquisition.scan_record import State, calibration_hash
from acquisition.scanfile import ScanFolder, ScanWriter
from drivers.profiler import Profile, Reason
from loftscan import Finished, Fitted, Missed, gathering, reconstruct, reconstruct_stream
from loftscan.following import FollowedScan, KeptScan, WriterWatch, read_piece
from loftscan.gathering import EvenSample, coverage, find_strays
from loftscan.methods import Method
from loftscan.reconstructing import Settings
from loftscan.result import Result
from loftscan.scans import Absent, GivenSweeps, Piece, slice_of
from loftscan.streaming import finish, stream
from reconstruction.errors import NotLoftable, TooFewPoints
from reconstruction.slices import Frame, Slice
from sim.parts import superformula
from tests.loftscan.made_scans import (
    FIRST_MM,
    HEIGHT_MM,
    KINEMATICS,
    PART,
    SLICES,
    STEP_MM,
    STOPS,
    damage,
    record,
    sweeps,
    write_scan,
)

OF_THE_RUN = {"seconds", "seconds_by_stage", "peak_memory_mb", "peak_memory_children_mb"}
LAGS = {"lag_median_s", "lag_max_s", "lag_slices", "slice_period_median_s"}
DOWN = replace(KINEMATICS, stage_sense=Lifting.DOWN, height_mm=49.5)
REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs/scan-folder.md"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "vase.scan"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scan(tmp_path_factory.mktemp("whole") / "vase.scan")


@pytest.fixture(scope="module")
def result(whole: Path) -> Result:
    return reconstruct(whole)


ENDS = "ends of the part that no slice samples: 2 closed by a flat cap; do not measure on them"
PAPER = Settings(method=Method.PAPER)


def beside_the_surface(found: Result) -> tuple[str, ...]:
    """What is said besides the ends of a fit."""
    assert ENDS in found.warnings
    return tuple(said for said in found.warnings if said != ENDS)


def radius_mm(angle_rad: np.ndarray, height_mm: float) -> np.ndarray:
    """The vase's outline, by the formula that the simulated part is made of."""
    share = height_mm / HEIGHT_MM
    belly = 1.0 + 0.25 * math.sin(1.5 * math.pi * share) - 0.15 * share
    return PART["radius_mm"] * belly * superformula(angle_rad - 0.8 * share)


def ring_heights_mm() -> np.ndarray:
    return KINEMATICS.height_mm + FIRST_MM + STEP_MM * np.arange(SLICES)


def slices(kinematics: Kinematics = KINEMATICS) -> list[Slice]:
    return [slice_of(each, kinematics) for each in sweeps(kinematics)]


# -- sweeps become slices ------------------------------------------------------------------------


@pytest.mark.parametrize("kinematics", [KINEMATICS, DOWN])
def test_a_sweep_becomes_a_slice_of_the_part_at_its_own_height(kinematics: Kinematics) -> None:
    heights = ring_heights_mm() if kinematics is KINEMATICS else 49.5 - FIRST_MM - 4 * np.arange(10)
    for index, piece in enumerate(slices(kinematics)):
        assert piece.index == index
        np.testing.assert_array_equal(piece.points_mm[:, 2], heights[index])
        assert np.linalg.det(piece.frame.axes) == pytest.approx(1.0)
        np.testing.assert_array_equal(piece.corners_mm[0], piece.points_mm.min(axis=0))
        np.testing.assert_array_equal(piece.corners_mm[1], piece.points_mm.max(axis=0))
        x, y, _ = piece.points_mm.T
        off = np.hypot(x, y) - radius_mm(np.arctan2(y, x), heights[index])
        assert abs(np.median(off)) < 0.02
        assert np.median(np.abs(off)) < 0.04  # 0.67 sigma of the noise is 0.02


def test_the_normal_points_from_slice_to_slice_whichever_way_the_stage_goes() -> None:
    for kinematics in (KINEMATICS, DOWN):
        pieces = slices(kinematics)
        along = [piece.frame.origin_mm @ pieces[0].frame.axes[2] for piece in pieces]
        np.testing.assert_allclose(np.diff(along), STEP_MM)


def volume_mm3(heights_mm: np.ndarray) -> float:
    """Of the vase's outlines at some heights, joined by straight lines: from integrals alone."""
    angles = np.linspace(0.0, math.tau, 2000, endpoint=False)
    outlines = [radius_mm(angles, height) for height in heights_mm]
    steps_mm = np.abs(np.diff(heights_mm))
    return sum(
        step * math.pi * float(np.mean(low**2 + low * high + high**2)) / 3.0
        for step, (low, high) in zip(steps_mm, itertools.pairwise(outlines), strict=True)
    )


def bodies(settings: Settings) -> tuple[tuple[Result, np.ndarray], tuple[Result, np.ndarray]]:
    """The part by a stage that rises and by one that falls, with the heights of the slices."""
    rising = finish(stream(GivenSweeps(sweeps(), KINEMATICS), settings))
    falling = finish(stream(GivenSweeps(sweeps(DOWN), DOWN), settings))
    return (rising, ring_heights_mm()), (falling, 49.5 - FIRST_MM - STEP_MM * np.arange(SLICES))


def test_the_body_is_that_of_the_part_whichever_way_the_stage_goes() -> None:
    for each, heights in bodies(PAPER):
        assert each.metrics["volume_mm3"] == pytest.approx(volume_mm3(heights), rel=0.001)
        assert each.metrics["watertight"]
        assert each.warnings == ()
        assert len(each.sections) == SLICES


def test_a_fit_is_closed_and_upright_whichever_way_the_stage_goes() -> None:
    for each, heights in bodies(Settings()):
        assert each.metrics["watertight"]
        assert beside_the_surface(each) == ()
        assert len(each.sections) == SLICES
        ends = each.mesh.vertices_mm[:, 2]
        # It goes on for half a step at either end.
        assert ends.min() == pytest.approx(heights.min() - STEP_MM / 2, abs=0.01)
        assert ends.max() == pytest.approx(heights.max() + STEP_MM / 2, abs=0.01)


def test_the_body_of_a_fit_is_that_of_the_part_itself() -> None:
    # Not that of outlines joined by straight lines, which is 0.26 % smaller: a vase is bellied.
    for each, heights in bodies(Settings()):
        low, high = heights.min() - STEP_MM / 2, heights.max() + STEP_MM / 2
        body_mm3 = volume_mm3(np.linspace(low, high, 1001))
        assert each.metrics["volume_mm3"] == pytest.approx(body_mm3, rel=0.001)


# -- the result ----------------------------------------------------------------------------------


def test_every_place_of_every_profile_is_counted(result: Result) -> None:
    told = result.metrics
    every = sum(len(p.reasons) for sweep in sweeps() for p in sweep.profiles)
    measured = sum(len(p.points_mm) for sweep in sweeps() for p in sweep.profiles)
    assert (told["points_in"], told["points_invalid"]) == (measured, every - measured)
    assert told["points_in"] == told["points_set_aside"] + told["points_in_sections"]
    assert told["points_set_aside"] == told["points_set_aside_by_reason"]["stray"] > 50
    assert told["profiles"] == SLICES * STOPS
    assert (told["slices"], told["sections"], told["slices_missing"]) == (SLICES, SLICES, 0)
    assert told["spacing_mm"] == pytest.approx(STEP_MM)
    assert told["residual_all_max_mm"] < 3.0  # the outliers stand up to 55 mm away


def test_every_number_of_a_scan_is_explained(whole: Path, result: Result) -> None:
    cloud_page = (PAGE.parent / "result-folder.md").read_text(encoding="utf-8")
    known = set(re.findall(r"`(\w+)`", cloud_page))
    numbers = PAGE.read_text(encoding="utf-8").partition("## Reconstructing a scan")[2]
    rows = [line for line in numbers.splitlines() if line.startswith("| `")]
    explained = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert explained == set(result.metrics) - known | LAGS
    for reason in result.metrics["points_invalid_by_reason"]:
        assert f"`{reason}`" in numbers


def test_provenance_says_station_plan_and_hashes_but_no_address(
    whole: Path, result: Result
) -> None:
    import hashlib

    told = result.provenance["input"]
    assert (told["name"], told["format"], told["state"]) == ("vase.scan", "scan", "complete")
    assert told["plan"]["ring"]["profiles_per_turn"] == STOPS
    assert told["station"]["stage"]["screw_lead_mm"] == 5.0
    assert told["calibration_sha256"] == calibration_hash(KINEMATICS)
    assert told["software"] == "loftscan 0.0.0"
    lines = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"
        for file in sorted((whole / "slices").iterdir())
    ]
    assert told["sha256"] == hashlib.sha256("".join(lines).encode()).hexdigest()
    said = json.dumps(result.provenance)
    assert not re.search(r"://|tty|192\.0\.2", said)
    assert str(whole.parent) not in said


def test_a_replay_and_a_follower_save_the_same_folder(
    whole: Path, result: Result, tmp_path: Path
) -> None:
    follower = finish(reconstruct_stream(whole))
    saved = []
    for name, each in (("replay", result), ("follower", follower)):
        each.save(tmp_path / name, formats=["step", "stl", "ply", "glb"])
        saved.append(_without_the_run(tmp_path / name, each))
    assert saved[0].keys() == saved[1].keys()
    differing = [name for name in saved[0] if saved[0][name] != saved[1][name]]
    assert differing == []
    assert set(saved[0]) >= {"mesh.ply", "surface.step", "surface.json", "report.html"}


def test_two_replays_save_the_same_folder(
    whole: Path, result: Result, tmp_path: Path, without_pictures: None
) -> None:
    again = reconstruct(whole)
    saved = []
    for name, each in (("one", result), ("other", again)):
        each.save(tmp_path / name, formats=["stl", "ply", "glb"])
        saved.append(_without_the_run(tmp_path / name, each))
    assert saved[0] == saved[1]
    # What the pictures are drawn from.
    assert again.sample_mm.tobytes() == result.sample_mm.tobytes()
    for index in range(SLICES):
        one, other = (each.cutting.slice_at(index).points_mm for each in (result, again))
        assert one.tobytes() == other.tobytes()
        assert 0 < len(one) <= 3000


def _without_the_run(folder: Path, result: Result) -> dict[str, bytes]:
    """Files of a result folder without the time of day, the time taken, and the memory."""
    created = str(result.provenance["created"]).partition("+")[0].encode()
    files = {file.name: file.read_bytes().replace(created, b"") for file in folder.iterdir()}
    if "surface.step" in files:
        files["surface.step"] = re.sub(
            rb"FILE_NAME\('[^']*','[^']*'", b"FILE_NAME(", files["surface.step"], count=1
        )
    numbers = json.loads(files["metrics.json"])
    kept = {name: value for name, value in numbers.items() if name not in OF_THE_RUN | LAGS}
    report = re.sub(
        rb"<tr><th[^>]*>(seconds|peak|lag|slice period)[^\n]*", b"", files["report.html"]
    )
    return {**files, "metrics.json": json.dumps(kept).encode(), "report.html": report}


def test_a_crop_uses_only_its_box_and_says_how_much_it_left(result: Result, whole: Path) -> None:
    cropped = reconstruct(whole, crop_mm=((-100, -100, 12), (100, 100, 30)))
    inside = [h for h in ring_heights_mm() if 12 <= h <= 30]
    assert [s.height_mm for s in cropped.sections] == pytest.approx(inside)
    told = cropped.metrics
    assert told["points_in"] == result.metrics["points_in"]
    assert told["points_set_aside_by_reason"]["cropped"] > 0
    assert told["points_in"] == told["points_set_aside"] + told["points_in_sections"]
    assert told["sections"] + told["slices_skipped"] == told["slices"] == SLICES
    assert beside_the_surface(cropped) == ()  # empty slices beyond the ends are no news


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"axis": "x"}, "--axis x: the slices of a scan say"),
        ({"spacing_mm": 1.0}, "--spacing-mm: the slices of a scan say"),
        ({"unit": "cm"}, "--unit cm: the slices of a scan say"),
    ],
)
def test_what_the_scan_says_itself_is_refused(whole: Path, options: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        reconstruct(whole, **options)


# -- what is not there ---------------------------------------------------------------------------


def test_a_damaged_slice_is_left_out_named_and_counted(path: Path) -> None:
    damage(write_scan(path), 4)
    found = reconstruct(path)
    assert [section.index for section in found.sections] == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    told = found.metrics
    assert (told["slices"], told["slices_damaged"], told["slices_missing"]) == (9, 1, 0)
    (warning,) = beside_the_surface(found)
    assert warning.startswith("slice 4 damaged, so left out (damaged archive")
    assert "--out vase.scan --resume` takes what is damaged again" in warning


@pytest.mark.parametrize("method", ["fit", "paper"])
def test_the_mesh_of_a_damaged_slice_stands_on_no_measured_point(path: Path, method: str) -> None:
    damage(write_scan(path), 4)
    found = reconstruct(path, method=method)
    # Between 3 and 5.
    heights = ring_heights_mm()
    within = np.abs(found.mesh.vertices_mm[:, 2] - heights[4]) < 0.9 * STEP_MM
    assert within.any()
    assert found.mesh.synthetic[within].all()


def test_slices_that_are_not_there_are_named_with_the_way_to_take_them(path: Path) -> None:
    kept = [each for each in sweeps() if each.index not in {3, 4, 9}]
    found = reconstruct(write_scan(path, kept, State.ABORTED))
    assert found.metrics["slices_missing"] == 3
    assert found.provenance["input"]["state"] == "aborted"
    stopped, missing = beside_the_surface(found)
    assert stopped.startswith("vase.scan: the scan was stopped")
    assert "loftscan scan STATION.toml PLAN.toml --out vase.scan --resume" in stopped
    assert missing.startswith("slices 3-4, 9 of the plan: not there")


def test_a_scan_whose_program_died_says_so_and_one_that_goes_on_says_that(path: Path) -> None:
    write_scan(path, sweeps()[:4], State.SCANNING)
    assert reconstruct(path).warnings[0].startswith("vase.scan: the program that scanned died")
    with ScanFolder.open(path).resume():
        assert "use --follow to wait for its end" in reconstruct(path).warnings[0]


def test_no_slice_and_no_slice_that_can_be_read_are_errors_with_a_remedy(path: Path) -> None:
    write_scan(path, (), State.ABORTED)
    with pytest.raises(TooFewPoints, match=r"vase.scan: no slice in it yet; scan first"):
        reconstruct(path)
    with ScanFolder.open(path).resume() as writer:
        writer.append(sweeps()[0])
    damage(path, 0)
    with pytest.raises(DamagedSlice, match=r"no slice that can be read \(slice 0: .*resume"):
        reconstruct(path)


def test_one_section_is_no_surface_and_the_slices_say_why(path: Path) -> None:
    dark = [
        replace(each, profiles=tuple(_unseen(p, Reason.NO_RETURN) for p in each.profiles))
        for each in sweeps()[1:3]
    ]
    with pytest.raises(NotLoftable, match=r"1 of 3 slices .* slice 1: 0 points; a curve needs 4"):
        reconstruct(write_scan(path, [sweeps()[0], *dark], State.ABORTED))
    with pytest.raises(NotLoftable, match=r"1 of 3 slices .* slice 1: 0 points, a section needs"):
        reconstruct(path, method="paper")


def _unseen(profile: Profile, why: Reason) -> Profile:
    return replace(profile, reasons=np.full(len(profile.reasons), why, np.uint8))


def test_lost_profiles_are_counted_and_blamed_on_the_way_from_the_sensor(path: Path) -> None:
    torn = [
        replace(each, profiles=(_unseen(each.profiles[0], Reason.LOST), *each.profiles[1:]))
        for each in sweeps()
    ]
    found = reconstruct(write_scan(path, torn))
    lost = SLICES * 160
    assert found.metrics["points_lost"] == lost
    assert found.metrics["points_invalid_by_reason"]["lost"] == lost
    assert found.warnings[0].startswith(f"{lost} of {lost * STOPS} places (1.7%) of the profiles")
    one = [torn[0], *sweeps()[1:]]
    shutil.rmtree(path)
    assert beside_the_surface(reconstruct(write_scan(path, one))) == ()


# -- strays, samples, coverage -------------------------------------------------------------------


def ring_slice(index: int = 0, *, points: int = 2000, turn: float = 1.0) -> Slice:
    rng = np.random.default_rng(index)
    angle = rng.uniform(0.0, turn * math.tau, points)
    radius = 20.0 + rng.normal(0.0, 0.05, points)
    flat = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    height = np.full(points, float(index))
    return Slice(index, np.column_stack([flat, height]), Frame([0.0, 0.0, height[0]], np.eye(3)))


@pytest.mark.parametrize("height_mm", [0.0, 7.3, -11.1, 123.456])
def test_lonely_points_are_strays_at_any_height_and_a_second_contour_is_none(
    height_mm: float,
) -> None:
    rng = np.random.default_rng(3)
    lonely = np.array([[70.0, 3.0], [-55.0, 40.0], [0.5, 0.5], [31.0, -31.0]])
    handle = [35.0, 0.0] + 3.0 * rng.normal(0.0, 0.3, (300, 2))
    flat = np.concatenate([ring_slice().points_mm[:, :2], handle, lonely])
    points = np.column_stack([flat, np.full(len(flat), height_mm)])
    strays = find_strays(Slice(0, points, Frame([0.0, 0.0, height_mm], np.eye(3))))
    assert strays[-4:].all()
    assert not strays[:2000].any()
    assert strays[2000:-4].sum() < 30


def test_a_slice_too_small_to_judge_keeps_its_points() -> None:
    for points in (np.empty((0, 3)), np.ones((7, 3)), np.ones((50, 3))):
        assert not find_strays(Slice(0, points, Frame([0.0, 0.0, 1.0], np.eye(3)))).any()


def test_the_coverage_is_the_share_of_the_turn_with_points() -> None:
    assert coverage(ring_slice(points=20_000)) == 1.0
    assert coverage(ring_slice(points=20_000, turn=0.25)) == pytest.approx(0.25, abs=1 / 360)
    assert coverage(ring_slice(points=1)) == pytest.approx(1 / 360)


def test_an_even_sample_is_bounded_fair_and_the_same_again() -> None:
    def sampled() -> np.ndarray:
        sample = EvenSample(1000)
        for seed in range(50):
            sample.add(np.full((700, 3), float(seed)), seed=seed)
            assert len(sample.points) <= 1000
        return sample.points

    points = sampled()
    assert 500 <= len(points) <= 1000
    np.testing.assert_array_equal(points, sampled())
    counts = np.bincount(points[:, 0].astype(int), minlength=50)
    # Each chunk is a fiftieth: 10 to 20 points, give or take five standard deviations.
    assert counts.min() > 0
    assert counts.max() < len(points) / 50 + 5 * math.sqrt(len(points) / 50)


def test_a_slice_leaves_far_less_behind_than_its_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gathering, "_SAMPLE", 10_000)
    monkeypatch.setattr(gathering, "_DRAWN_A_SLICE", 500)
    points, held = 30_000, {}
    updates = reconstruct_stream(ring_slice(k, points=points) for k in range(13))
    next(updates)
    tracemalloc.start()
    try:
        for number, _ in zip(range(12), updates, strict=False):
            gc.collect()
            held[number] = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
        updates.close()
    # A section with its histograms; the points of a slice are 720 kB.
    assert (held[11] - held[3]) / 8 < 200_000


# -- scripts -------------------------------------------------------------------------------------


class Scan:
    """What the verb `scan` gives, without a station."""

    kinematics = KINEMATICS
    total = SLICES

    def __init__(self) -> None:
        self.taken = 0
        self.closed = False
        self._sweeps = iter(sweeps())

    def __iter__(self) -> Iterator[Sweep]:
        return self

    def __next__(self) -> Sweep:
        self.taken += 1
        return next(self._sweeps)

    def close(self) -> None:
        self.closed = True


def mesh_bytes(found: Result) -> bytes:
    return found.mesh.vertices_mm.tobytes() + found.mesh.faces.tobytes()


def test_a_folder_a_scan_sweeps_and_slices_give_the_same_mesh(result: Result) -> None:
    wanted = mesh_bytes(result)
    for source in (Scan(), slices()):
        assert mesh_bytes(reconstruct(source)) == wanted
    for source, kinematics in ((iter(sweeps()), KINEMATICS), (iter(slices()), None)):
        assert mesh_bytes(finish(reconstruct_stream(source, kinematics=kinematics))) == wanted


@pytest.mark.parametrize("method", ["fit", "paper"])
def test_every_slice_is_told_before_the_next_is_asked_for_and_the_mesh_grows(method: str) -> None:
    scan, volumes = Scan(), []
    for number, update in enumerate(reconstruct_stream(scan, method=method), start=1):
        if isinstance(update, Finished):
            break
        assert isinstance(update, Fitted)
        assert scan.taken == number
        assert (update.index, update.standing.done, update.standing.total) == (
            number - 1, number, SLICES
        )  # fmt: skip
        assert update.standing.coverage == 1.0
        assert update.standing.lag_s is None
        mesh = update.mesh()
        if number == 1:
            assert mesh is None
        elif number in (2, 5):
            corners = mesh.vertices_mm[mesh.faces]
            volumes.append(np.linalg.det(corners).sum() / 6.0)
            edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
            assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    assert isinstance(update, Finished)
    assert update.result.name == "scan"
    # From 2 slices to 5: by the paper 1 step to 4 high, by a fit 2 to 5.
    growth = 3.0 if method == "paper" else 2.25
    assert 0.0 < growth * volumes[0] < volumes[1] < update.result.metrics["volume_mm3"]


def test_leaving_the_loop_closes_the_scan() -> None:
    scan = Scan()
    updates = reconstruct_stream(scan)
    next(updates)
    assert not scan.closed
    updates.close()
    assert scan.closed
    assert scan.taken == 1


def test_an_error_of_the_scan_reaches_the_script_and_the_scan_is_closed() -> None:
    class Failing(Scan):
        def __next__(self) -> Sweep:
            if self.taken == 2:
                raise NotAScan("the disk is gone")
            return super().__next__()

    scan = Failing()
    with pytest.raises(NotAScan, match="the disk is gone"):
        finish(reconstruct_stream(scan))
    assert scan.closed


def test_a_slice_without_points_is_told_with_its_reason() -> None:
    pieces = slices()
    pieces[5] = Slice(5, np.empty((0, 3)), pieces[5].frame)
    updates = list(reconstruct_stream(pieces))
    assert isinstance(updates[5], Missed)
    assert (updates[5].index, updates[5].points) == (5, 0)
    assert updates[5].why == "0 points; a curve needs 4"
    assert any(
        said.startswith("slice 5: no section, so bridged") for said in updates[-1].result.warnings
    )
    on_paper = list(reconstruct_stream(pieces, method="paper"))
    assert on_paper[5].why.startswith("0 points, a section needs")
    assert on_paper[-1].result.warnings[0].startswith("slice 5: no section, so bridged")


@pytest.mark.parametrize("order", [(1, 0), (0, 0)])
def test_slices_out_of_order_are_refused(order: tuple[int, int]) -> None:
    pieces = slices()
    with pytest.raises(ValueError, match="indices and heights along the normal must both increase"):
        reconstruct([pieces[k] for k in order])


def test_sweeps_without_their_kinematics_are_no_slices() -> None:
    with pytest.raises(TypeError, match=r"Sweep among the slices: .* sweeps need their kinematics"):
        finish(reconstruct_stream(list(sweeps())))


# -- following -----------------------------------------------------------------------------------


class Wait:
    """A clock that stands but for the pauses, in which somebody may do something."""

    def __init__(self, *doings: Callable[[], object], every: int = 1) -> None:
        self.seconds = 0.0
        self._doings = itertools.chain.from_iterable(
            (*([lambda: None] * (every - 1)), doing) for doing in doings
        )

    def pause(self, seconds: float) -> None:
        self.seconds += seconds
        assert self.seconds < 3600.0, "nobody ended the wait"
        next(self._doings, lambda: None)()

    def clock(self) -> float:
        return self.seconds

    def follow(self, path: Path, patience_s: float = 60.0) -> FollowedScan:
        return FollowedScan(path, patience_s, self.pause, self.clock)


class Station:
    """Writes a folder, one doing after the other."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.writer: ScanWriter | None = None

    def begin(self) -> None:
        self.writer = ScanFolder.create(self.path, record())

    def taking(self, *indices: int) -> Callable[[], None]:
        def take() -> None:
            for index in indices:
                self.writer.append(sweeps()[index])

        return take

    def finish(self, state: State = State.COMPLETE) -> None:
        self.writer.finish(state)

    def die(self) -> None:
        self.writer.close()


def indices_of(pieces: Iterator[Piece]) -> tuple[list[int], list[int]]:
    """Of the slices that came, and of those that did not."""
    came, absent = [], []
    for piece in pieces:
        if isinstance(piece, Absent):
            absent.append(piece.index)
        else:
            came.append(piece.piece.index)
    return came, absent


def test_slices_are_taken_as_they_appear_however_long_a_living_writer_takes(path: Path) -> None:
    station = Station(path)
    takes = [station.taking(index) for index in range(SLICES)]
    # 6 s from slice to slice: the lock is looked at a dozen times in between.
    wait = Wait(station.begin, *takes, station.finish, every=120)
    source = wait.follow(path)
    assert source.total is None
    assert indices_of(source.pieces()) == (list(range(SLICES)), [])
    assert source.total == SLICES
    assert source.remarks() == ()
    assert wait.seconds < 6.0 * (SLICES + 2)


def test_a_folder_that_never_comes_is_waited_for_so_long_and_no_longer(path: Path) -> None:
    wait = Wait()
    with pytest.raises(NotAScan, match=r"no scan began there within 7 s; start .*--patience-s"):
        next(wait.follow(path, 7.0).pieces())
    assert wait.seconds == pytest.approx(7.0, abs=0.1)
    path.write_text("not a folder")
    with pytest.raises(NotAScan, match=r"a file, no .scan folder"):
        next(Wait().follow(path).pieces())


def test_a_scan_that_dies_ends_the_wait_with_what_is_there(path: Path) -> None:
    station = Station(path)
    wait = Wait(station.begin, station.taking(0, 1), station.taking(2, 3, 6), station.die)
    source = wait.follow(path)
    assert indices_of(source.pieces()) == ([0, 1, 2, 3, 6], [4, 5, 7, 8, 9])
    assert wait.seconds < 3.0
    (remark,) = source.remarks()
    assert remark.startswith("vase.scan: the program that scanned died before the end")
    assert "--out vase.scan --resume" in remark
    assert source.origin()["state"] == "interrupted"


def test_a_scan_that_is_stopped_ends_the_wait_at_once(path: Path) -> None:
    station = Station(path)
    wait = Wait(station.begin, station.taking(0, 1, 2), lambda: station.finish(State.ABORTED))
    source = wait.follow(path)
    assert indices_of(source.pieces()) == ([0, 1, 2], list(range(3, SLICES)))
    assert wait.seconds < 0.5
    assert source.remarks()[0].startswith("vase.scan: the scan was stopped")


def test_a_slice_kept_just_before_the_writer_died_is_not_missed(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    station = Station(path)
    station.begin()
    station.taking(0, 1)()
    looked = WriterWatch.gone

    def keeps_one_more_and_dies(watch: WriterWatch) -> bool:
        if station.writer._lock.held:
            station.taking(2)()
            station.die()
            return True
        return looked(watch)

    monkeypatch.setattr(WriterWatch, "gone", keeps_one_more_and_dies)
    came, _ = indices_of(Wait().follow(path).pieces())
    assert came == [0, 1, 2]


def test_one_look_at_a_free_lock_is_not_yet_a_death(path: Path) -> None:
    station, wait = Station(path), Wait()
    station.begin()
    watch = WriterWatch(path, wait.clock)
    assert not watch.gone()
    station.die()
    wait.pause(0.6)
    assert not watch.gone()  # free once
    with ScanFolder.open(path).resume():  # somebody resumed at once
        wait.pause(0.6)
        assert not watch.gone()
    wait.pause(0.6)
    assert not watch.gone()
    wait.pause(0.1)
    assert not watch.gone()  # too soon after the last look to count
    wait.pause(0.6)
    assert watch.gone()


def test_looking_at_a_lock_neither_takes_nor_changes_it(path: Path) -> None:
    station = Station(path)
    station.begin()
    before = (path / ".lock").read_bytes()
    assert is_locked(path)
    assert station.writer._lock.held
    station.die()
    assert not is_locked(path)
    assert (path / ".lock").read_bytes() == before
    (path / ".lock").unlink()  # as in a copy
    assert not is_locked(path)


def test_a_follower_goes_on_without_a_damaged_slice(path: Path) -> None:
    station = Station(path)
    spoilt = lambda: (station.taking(1)(), damage(path, 1))  # noqa: E731
    rest = station.taking(*range(2, SLICES))
    wait = Wait(station.begin, station.taking(0), spoilt, rest, station.finish)
    updates = list(stream(wait.follow(path), Settings()))
    assert isinstance(updates[1], Missed)
    assert updates[1].why.startswith("damaged: damaged archive")
    assert updates[-1].result.metrics["slices_damaged"] == 1


def test_the_lag_is_from_the_files_own_time_to_its_section(path: Path) -> None:
    station, base_s = Station(path), 1_700_000_000.0

    def take(index: int, written_s: float) -> Callable[[], None]:
        def work() -> None:
            station.taking(index)()
            file = ScanFolder(path).file(index)
            os.utime(file, ns=(0, round(written_s * 1e9)))

        return work

    # Ten slices, 1.0 s to 0.1 s before the one instant that `now_s` knows; one from before.
    takes = [take(k, base_s - 1.0 + 0.1 * k) for k in range(1, SLICES)]
    wait = Wait(station.begin, take(0, base_s - 90.0), *takes, station.finish)
    instants = itertools.chain([base_s - 5.0], itertools.repeat(base_s))
    updates = list(stream(wait.follow(path), Settings(), now_s=lambda: next(instants)))
    lags = [update.standing.lag_s for update in updates[:-1]]
    assert lags[0] is None
    assert lags[1:] == pytest.approx([1.0 - 0.1 * k for k in range(1, SLICES)], abs=1e-5)
    told = updates[-1].result.metrics
    assert told["lag_slices"] == SLICES - 1
    assert told["lag_median_s"] == pytest.approx(0.5, abs=1e-5)
    assert told["lag_max_s"] == pytest.approx(0.9, abs=1e-5)
    assert told["slice_period_median_s"] == pytest.approx(0.1, abs=1e-5)


def test_a_replay_has_no_lag(result: Result) -> None:
    assert not LAGS & set(result.metrics)


def test_a_slice_file_that_vanishes_or_is_empty_of_profiles_is_absent(path: Path) -> None:
    write_scan(path, [replace(sweeps()[0], profiles=(), poses=())], State.ABORTED)
    folder = ScanFolder.open(path)
    assert read_piece(folder, 0, folder.record()) == Absent(0, "it holds no profile")
    assert read_piece(folder, 1, folder.record()) == Absent(1)
    assert indices_of(KeptScan(folder).pieces()) == ([], list(range(SLICES)))


@pytest.mark.parametrize("method", ["paper", "fit"])
def test_after_the_warm_up_a_slice_compiles_nothing(method: str) -> None:
    # In a process of its own: in this one other tests have compiled everything.
    code = f"""
import sys
import numpy as np
from numba.core.registry import CPUDispatcher
from loftscan.gathering import Intake, coverage
from loftscan.methods import Method
from loftscan.reconstructing import Settings
from loftscan.scans import Arrival
from loftscan.warming import warm_up
from tests.loftscan.test_following import ring_slice, with_strays

def compiled():
    names = [name for name in sys.modules if name.startswith("reconstruction")]
    values = [value for name in names for value in vars(sys.modules[name]).values()]
    kernels = {{value for value in values if isinstance(value, CPUDispatcher)}}
    return sum(len(kernel.signatures) for kernel in kernels)

settings = Settings(method=Method("{method}"))
warm_up(settings)
before = compiled()
intake, course = Intake(None), settings.course()
for index in range(3):
    piece = intake.take(Arrival(with_strays(ring_slice(index)), np.zeros(6, int)))
    coverage(piece)
    course.draw(piece)
assert sum(intake.gathered().aside.values()) == 6
print(before, compiled())
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    before, after = map(int, ran.stdout.split())
    assert before == after > 5


def with_strays(piece: Slice) -> Slice:
    far = [[90.0, 1.0, piece.index], [-80.0, 9.0, piece.index]]
    return replace(piece, points_mm=np.concatenate([piece.points_mm, far]))
