"""An adaptive scan of a simulated station over its wires, with and without reconstruction."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from acquisition.adaptive_plan import Adaptive
from acquisition.choices import ChosenBy, choices_in
from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder
from acquisition.slice_request import decode_request, request_file
from loftscan import simulate
from loftscan.simulation import Simulated
from sim.judging import Surface
from sim.parts import vase
from tests.system.command_cases import run, start

PATIENCE_S = 200.0
# A vase of 100 mm whose foot the sheet meets at stage 3; the operator thinks it may be 110 mm high.
PLAN = Plan(
    ring=ring(4.0, 113.0, 0.5, 8).ring,
    step_and_shoot=StepAndShoot(settle_s=0.0),
    adaptive=Adaptive(tolerance_mm=0.6, coarse_step_mm=22.0, most_slices=24, answer_within_s=60.0),
)


@pytest.fixture(scope="module")
def station() -> Iterator[Simulated]:
    with simulate(part="vase", scale=40.0) as live:
        yield live


def ended(child: subprocess.Popen[str]) -> tuple[int, str, str]:
    stdout, stderr = child.communicate(timeout=PATIENCE_S)
    return child.returncode, stdout, stderr


def test_it_takes_slices_where_they_are_worth_most_and_ends_within_tolerance(
    place: Path, station: Simulated
) -> None:
    Path("plan.toml").write_text(write_plan(PLAN))
    following = start(
        "reconstruct", "vase.scan", "--follow", "--out", "vase", "--formats", "ply", "--json"
    )
    code, said, stderr = ended(start("scan", station, "plan.toml", "--out", "vase.scan"))
    assert (code, stderr) == (0, "")
    folder = ScanFolder.open(Path("vase.scan"))
    *chosen, last = choices_in(folder.path)
    assert folder.record().state is State.COMPLETE
    assert {each.by for each in chosen} == {ChosenBy.RECONSTRUCTION.value}
    assert last.index is None
    assert "98 % of the surface is expected within" in last.why
    assert "no more slices: 98 %" in said
    assert decode_request(request_file(folder.path).read_bytes()).seen == folder.indices()
    # The top, at stage 103, is found by bisection, from coarse slices 22 mm apart.
    tops = [each.index for each in chosen if each.index is not None and 190 <= each.index <= 206]
    assert len(tops) >= 4
    # Slices of a cut 0.5 mm finer everywhere would be 219.
    assert len(folder.indices()) <= 24

    code, told, _ = ended(following)
    assert code == 0
    sections = [json.loads(line) for line in told.splitlines() if '"section"' in line]
    heights = [each["index"] for each in sections if each["event"] == "section"]
    assert heights == sorted(heights)
    # Held against the simulator's part, by its own distances: the walls, without their ends.
    corners = np.asarray(trimesh.load_mesh("vase/mesh.ply").vertices)
    walls = corners[(corners[:, 2] > 2.0) & (corners[:, 2] < 99.0)]
    away = Surface(vase().vertices_mm, vase().faces).signed_distances_mm(walls[::20])
    assert np.percentile(np.abs(away), 98.0) < 0.6

    assert run("scans", "list").stdout.count("whole") == 1
    assert "at most 24 rings chosen from 4 to 113 mm for 0.6 mm" in run("scans", "list").stdout


def test_when_reconstruction_dies_the_scan_goes_on_by_halves_and_can_be_resumed(
    place: Path, station: Simulated
) -> None:
    adaptive = Adaptive(tolerance_mm=0.6, coarse_step_mm=40.0, most_slices=7, answer_within_s=0.5)
    Path("plan.toml").write_text(write_plan(replace(PLAN, adaptive=adaptive)))
    child = start("scan", station, "plan.toml", "--out", "part.scan", "--json")
    assert child.stdout is not None
    while '"slices_done": 2,' not in child.stdout.readline():
        pass
    child.send_signal(signal.SIGINT)
    code, _, stderr = ended(child)
    assert code == 3
    assert "of at most 7 slices are kept" in stderr
    folder = ScanFolder.open(Path("part.scan"))
    assert folder.record().state is State.ABORTED
    left = 7 - len(folder.indices())

    again = start("scan", station, "plan.toml", "--out", "part.scan", "--resume")
    code, said, stderr = ended(again)
    assert (code, stderr) == (0, "")
    assert said.count("reconstruction did not answer within 0.5 s") == 1
    assert "most_slices is 7" in said
    assert f"slice {left} of {left}," in said
    assert len(folder.indices()) == 7
    assert {each.by for each in choices_in(folder.path)[:-1]} == {ChosenBy.WIDEST.value}
    assert folder.record().state is State.COMPLETE


def test_from_python_it_needs_a_folder(place: Path, station: Simulated) -> None:
    from loftscan import Station, scan

    with Station.open(station) as live, pytest.raises(ValueError, match=r"\.scan folder; give out"):
        scan(live, PLAN)
