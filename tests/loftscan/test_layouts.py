"""Scans of meridians and stripes become surfaces: the plan says the layout, the truth is sim's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from acquisition.errors import NotAsKept
from acquisition.frames import Kind, Kinematics
from acquisition.loop_closure import comparable, compare, must_agree
from acquisition.patterns import Meridian, SliceKind, Stripe
from acquisition.plan import Plan, StepAndShoot, targets
from acquisition.poses import Pose, Sweep
from acquisition.scan_record import ScanRecord, State
from acquisition.scanfile import ScanFolder
from loftscan import reconstruct, reconstruct_stream
from loftscan.calibrating.errors import CalibrationRefused
from loftscan.calibrating.joint import must_be_level
from loftscan.kept_scans import plan_in_words
from loftscan.result import Result
from loftscan.scans import GivenSweeps, slice_of
from loftscan.updates import Finished, Fitted
from sim import Flaws, Mounting, SeedKey
from sim.crooked import CrookedBench
from sim.cuts import Cut, standing
from sim.judging import Surface
from sim.optics import OpticsSettings
from sim.parts import vase
from tests.acquisition.scan_cases import STATION
from tests.loftscan.made_scans import KINEMATICS, PART, SENSOR, _profile, write_scan

WIDTH_MM = 0.12  # of the cloud, 4 sigma: noise of 0.03 mm
SHOOT = StepAndShoot()
MERIDIANS = Plan(
    meridian=Meridian(per_turn=36, first_mm=12.5, last_mm=37.5, step_mm=25.0), step_and_shoot=SHOOT
)
HALF_ROUND = Plan(
    # 14 a lobe: half as many leave the surface beside its two free borders undetermined.
    meridian=Meridian(per_turn=72, first_mm=25.0, last_deg=120.0),
    step_and_shoot=SHOOT,
)
STRIPES = Plan(stripe=Stripe(first_mm=70.0, last_mm=90.0, step_mm=1.0), step_and_shoot=SHOOT)
UPRIGHT = replace(KINEMATICS, kind=Kind.SIMULATED, height_mm=0.0, roll_deg=90.0)
SLIDING = replace(UPRIGHT, height_mm=25.0, side_mm=80.0, stage_y_mm=1.0, stage_z_mm=0.0)


@cache
def truth() -> Surface:
    part = vase(**PART)
    return Surface(part.vertices_mm, part.faces)


@cache
def sweeps(cut: Cut, plan: Plan = MERIDIANS, first_key: int = 0) -> tuple[Sweep, ...]:
    """As the simulator's optics see the vase where the plan stops; no part is turned otherwise."""
    standing_so = SLIDING if cut is Cut.STRIPES else UPRIGHT
    mounting = Mounting(
        standoff_mm=standing_so.standoff_mm, height_mm=standing_so.height_mm,
        side_mm=standing_so.side_mm,
    )  # fmt: skip
    flaws = Flaws(cloud_width_mm=WIDTH_MM, outlier_rate=0.002, seed=5)
    off = standing(cut, None)
    assert off is not None
    bench = CrookedBench(
        vase(**PART), OpticsSettings(mounting=mounting, sensor=SENSOR, flaws=flaws), off
    )
    return tuple(
        Sweep(
            target.index,
            tuple(
                _profile(bench.profile(turn_rad, at_mm, SeedKey(target.index, key)), key)
                for key, (at_mm, turn_rad) in enumerate(target.stops, first_key)
            ),
            tuple(Pose(turn_rad, at_mm, 0.1 * k) for k, (at_mm, turn_rad) in
                  enumerate(target.stops)),
        )
        for target in targets(plan)
    )  # fmt: skip


def keep(path: Path, plan: Plan, kinematics: Kinematics, taken: Sequence[Sweep]) -> Path:
    record = ScanRecord(
        station=replace(STATION, kinematics=kinematics), plan=plan, calibration=kinematics,
        software="loftscan 0.0.0", created="2026-01-02T03:04:05+00:00",
    )  # fmt: skip
    writer = ScanFolder.create(path, record)
    for each in taken:
        writer.append(each)
    writer.mark(State.COMPLETE)
    writer.close()
    return path


def rms_mm(result: Result) -> float:
    """Of the mesh from the true part, away from its ends."""
    places_mm = result.mesh.vertices_mm
    inside = (places_mm[:, 2] > 3.0) & (places_mm[:, 2] < 47.0)
    return float(np.sqrt(np.mean(truth().signed_distances_mm(places_mm[inside]) ** 2)))


@pytest.fixture(scope="module")
def meridian_scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("meridians")
    return keep(place / "vase.scan", MERIDIANS, UPRIGHT, sweeps(Cut.MERIDIANS))


def test_meridians_become_a_closed_solid_on_the_part(meridian_scan: Path) -> None:
    result = reconstruct(meridian_scan)
    assert result.metrics["watertight"]
    assert len(result.surface) == 1
    assert result.provenance["settings"]["layout"] == "auto"  # nobody had to say it
    # 36 meridians 3 mm apart over lobes, noise of 0.03 mm over 10 000 points: a third of it.
    # A sense, hand or height that is wrong is millimetres.
    assert rms_mm(result) < 0.02


def test_meridians_over_part_of_a_turn_are_an_open_sheet(tmp_path: Path) -> None:
    taken = sweeps(Cut.MERIDIANS, HALF_ROUND)
    result = reconstruct(keep(tmp_path / "some.scan", HALF_ROUND, UPRIGHT, taken))
    assert not result.metrics["watertight"]
    assert result.metrics["volume_mm3"] is None
    assert rms_mm(result) < 0.02


def test_stripes_become_an_open_sheet_on_the_part(tmp_path: Path) -> None:
    taken = sweeps(Cut.STRIPES, STRIPES)
    result = reconstruct(keep(tmp_path / "side.scan", STRIPES, SLIDING, taken))
    assert not result.metrics["watertight"]
    assert len(result.surface) == 1
    assert rms_mm(result) < 0.03


def test_the_surface_grows_while_meridians_come(meridian_scan: Path) -> None:
    del meridian_scan
    coming = GivenSweeps(sweeps(Cut.MERIDIANS), UPRIGHT, kind=SliceKind.MERIDIAN)

    class Taken:
        kinematics, total, kind = UPRIGHT, coming.total, coming.kind

        def __iter__(self):
            return iter(sweeps(Cut.MERIDIANS))

    updates = list(reconstruct_stream(Taken()))
    assert isinstance(updates[-1], Finished)
    assert updates[-1].result.metrics["watertight"]
    some = updates[20]
    assert isinstance(some, Fitted)
    assert some.mesh() is not None


def test_sweeps_without_a_plan_are_laid_out_as_asked() -> None:
    *_, last = reconstruct_stream(sweeps(Cut.MERIDIANS), kinematics=UPRIGHT, layout="meridians")
    assert isinstance(last, Finished)
    assert last.result.metrics["watertight"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"method": "paper"},
            "--method paper: the slices of vase.scan are meridians, and the paper's method joins"
            " rings only; choose --method fit",
        ),
        (
            {"layout": "rings"},
            "--layout rings: the slices of vase.scan are meridians, as its plan says; leave the"
            " option out",
        ),
    ],
)
def test_what_meridians_do_not_take_is_refused_in_one_line(
    options: dict[str, str], said: str, meridian_scan: Path
) -> None:
    with pytest.raises(ValueError, match=said):
        reconstruct(meridian_scan, **options)  # type: ignore[arg-type]


def test_slices_about_an_axis_are_refused_by_the_papers_method_with_the_remedy() -> None:
    slices = [slice_of(each, UPRIGHT, SliceKind.MERIDIAN) for each in sweeps(Cut.MERIDIANS)]
    with pytest.raises(Exception, match=r"are meridians, .* rings only; choose --method fit"):
        reconstruct(iter(slices), method="paper")


def test_rings_may_still_be_called_stripes(tmp_path: Path) -> None:
    """Of a part that a ring sees from one side only, nobody knows better than the operator."""
    scan = write_scan(tmp_path / "rings.scan")
    assert reconstruct(scan, layout="rings").metrics["watertight"]


def test_a_meridian_that_is_taken_again_is_compared_although_it_is_few_profiles() -> None:
    kept, again = sweeps(Cut.MERIDIANS)[7], sweeps(Cut.MERIDIANS, first_key=50)[7]
    assert comparable(kept)
    assert compare(kept, again, UPRIGHT).agrees
    # The table stands a hundredth of a degree beside: the same sheet, for all that is seen.
    beside = replace(again, poses=tuple(replace(p, table_rad=p.table_rad + 2e-4)
                                        for p in again.poses))  # fmt: skip
    assert compare(kept, beside, UPRIGHT).agrees
    other = replace(sweeps(Cut.MERIDIANS)[11], index=7)
    with pytest.raises(NotAsKept, match="slice 7, taken again"):
        must_agree(compare(kept, replace(other, poses=kept.poses), UPRIGHT))


def test_a_list_of_scans_tells_what_the_slices_are() -> None:
    assert plan_in_words(MERIDIANS) == "36 meridians from 0 deg by 10 deg, 2 stops"
    assert plan_in_words(STRIPES) == "21 stripes from 70 mm by 1 mm"


def test_calibrating_an_upright_sheet_is_refused_by_name() -> None:
    with pytest.raises(CalibrationRefused, match=r"sheet stands upright \(roll_deg = 90\)"):
        must_be_level(UPRIGHT)
    must_be_level(replace(UPRIGHT, roll_deg=math.degrees(0.02)))
