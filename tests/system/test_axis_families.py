"""Whole scans over axes of every family, on lines of their own and on one that both share.

The part is the blade: no angle of it looks like another, so that a table that turned wrongly, or
whose angle was told wrongly, shows in millimetres. Ground truth is the simulator's mesh.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from acquisition.frames import part_points
from acquisition.plan import ring, write_plan
from acquisition.station import read_station
from loftscan import Station, scan, simulate
from loftscan.simulation import Simulated

SEED, STOPS = 11, 12
FIRST_MM, LAST_MM, STEP_MM = 38.0, 58.0, 20.0
# Sampled 0.2 mm apart, noise of 0.02 mm, edges seen in pixels: half a degree of the table is 0.3 mm
# at the blade's tip, and one of its stops is 30 degrees.
WITHIN_MM = 0.25


def truth(station: Simulated) -> cKDTree:
    mesh = trimesh.load(station.truth, process=False)
    points_mm, _ = trimesh.sample.sample_surface(mesh, 400_000, seed=1)
    return cKDTree(points_mm)


def commanded(station: Simulated, axis: str) -> list[dict[str, float]]:
    events = map(json.loads, station.witness.read_text().splitlines())
    return [each for each in events if each["what"] == "move" and each["axis"] == axis]


@pytest.mark.parametrize(
    ("table", "stage", "shared"),
    [
        ("grbl", "leadshine", False),
        ("grblhal", "zaber", False),
        ("zaber", "leadshine", False),
        ("zaber", "zaber", True),
        ("oriental", "leadshine", True),
        ("oriental", "oriental", True),
    ],
)
def test_a_scan_over_these_axes_lies_on_the_part(table, stage, shared, tmp_path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(write_plan(ring(FIRST_MM, LAST_MM, STEP_MM, STOPS)))
    with simulate(
        "blade", seed=SEED, scale=20.0, cloud_width_mm=0.02, outliers=0.0, table=table, stage=stage
    ) as station:
        told = read_station(station.station)
        assert (told.table.address == told.stage.address) is shared
        with Station.open(station) as opened:
            sweeps = scan(opened, plan)
            taken = list(sweeps)
            state = opened.stand()
        tree, turns = truth(station), commanded(station, "table")
    assert [len(sweep.profiles) for sweep in taken] == [STOPS, STOPS]
    assert (state.table.homed, state.stage.homed) == (True, True)
    for sweep, stage_mm in zip(taken, (FIRST_MM, LAST_MM), strict=True):
        points_mm = part_points(sweep, sweeps.kinematics)
        assert len(points_mm) > 500
        off_mm, _ = tree.query(points_mm)
        assert np.percentile(off_mm, 99) < WITHIN_MM
        assert all(abs(pose.stage_mm - stage_mm) < 0.021 for pose in sweep.poses)
        asked_rad = np.arange(STOPS) * np.radians(360.0 / STOPS)
        turned_rad = np.array([pose.table_rad for pose in sweep.poses])
        assert np.abs(turned_rad - asked_rad).max() < np.radians(0.051)
    if table == "oriental":  # by the shorter way: from the last stop on to the first, never back
        last = turns[-1]
        assert abs(last["target"] - last["start"]) < np.radians(31.0)


@pytest.mark.parametrize(
    ("table", "stage"), [("zaber", "zaber"), ("oriental", "leadshine"), ("oriental", "oriental")]
)
def test_a_line_that_garbles_every_eleventh_answer_costs_retries_and_no_scan(
    table, stage, tmp_path
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(write_plan(ring(FIRST_MM, FIRST_MM, STEP_MM, 6)))
    with simulate(
        "blade", seed=SEED, scale=20.0, cloud_width_mm=0.02, outliers=0.0, table=table,
        stage=stage, faults="garbage=11",
    ) as station:  # fmt: skip
        with Station.open(station) as opened:
            (sweep,) = scan(opened, plan)
        tree, kinematics = truth(station), read_station(station.station).kinematics
        turned = len(commanded(station, "table"))
    off_mm, _ = tree.query(part_points(sweep, kinematics))
    assert np.percentile(off_mm, 99) < WITHIN_MM
    assert turned <= 3 + 6 + 1  # homing, the stops, back to 0: nothing was sent twice


def test_the_command_names_the_families_in_its_help() -> None:
    told = subprocess.run(
        [sys.executable, "-m", "sim", "--help"], capture_output=True, text=True, check=True,
        cwd=Path(__file__).resolve().parents[2],
    ).stdout  # fmt: skip
    assert "{grbl,grblhal,zaber,oriental}" in told
    assert "{leadshine,zaber,oriental}" in told


def test_a_counted_tables_switch_is_looked_at_and_others_need_it_not() -> None:
    with (
        simulate(seed=SEED, scale=20.0) as station,
        Station.open(station) as opened,
    ):
        opened.home()
        opened.jog(table_deg=200.0)
        for turns in (0, 1):
            off_deg = opened.check_table(turns=turns)
            assert off_deg is not None
            assert abs(off_deg) <= 0.05
        assert opened.stand().table.homed
    with (
        simulate(seed=SEED, scale=20.0, table="zaber") as station,
        Station.open(station) as opened,
    ):
        assert opened.check_table() is None
        before = opened.stand()
        after = opened.jog_by(table_deg=0.5, stage_mm=0.5)  # nothing is homed
        assert after.stage_mm - before.stage_mm == pytest.approx(0.5, abs=0.02)
        assert after.table_deg - before.table_deg == pytest.approx(0.5, abs=0.02)
