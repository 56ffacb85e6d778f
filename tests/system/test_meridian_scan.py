"""Meridians and stripes from the wire to the surface, as a person types it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from acquisition.plan import read_plan
from loftscan import simulate
from sim.judging import Surface, judge
from sim.parts import find_part
from tests.system.command_cases import complaint, run, succeeded

SEED = 11


# Noise of 0.025 mm over thousands of points; a side that is seen at a graze is worse.
@pytest.mark.parametrize(
    ("cut", "slices", "within_mm"), [("meridians", 24, 0.02), ("stripes", 30, 0.1)]
)
def test_a_plan_of_other_slices_is_scanned_and_becomes_the_part(
    cut: str, slices: int, within_mm: float, place: Path
) -> None:
    del place
    with simulate(
        "cylinder", cut=cut, seed=SEED, scale=30.0, outliers=0.0, rings=slices
    ) as station:
        assert read_plan(station.plan).count == slices
        told = succeeded(run("scan", station, station.plan, "--out", "part.scan", "--json")).stdout
        listed = succeeded(run("scans", "list", ".")).stdout
    done = [json.loads(line) for line in told.splitlines()][-1]
    assert (done["event"], done["slices"], done["lost_profiles"]) == ("done", slices, 0)
    assert f"{slices} {cut} from" in listed
    refused = run("reconstruct", "part.scan", "--out", "paper", "--method", "paper")
    assert f"are {cut}, and the paper's method joins rings only" in complaint(refused, 2)
    succeeded(run("reconstruct", "part.scan", "--out", "result", "--formats", "stl"))
    numbers = json.loads(Path("result/metrics.json").read_text())
    assert numbers["watertight"] is (cut == "meridians")
    part = find_part("cylinder")
    mesh = trimesh.load_mesh("result/mesh.stl")
    judged = judge(Surface(part.vertices_mm, part.faces), mesh, samples=8_000)
    assert judged.rms_mm < within_mm
