"""What was lost between a profiler and the program: counted at the scan's end, and marked.

For every family: a scan over a bad wire is, point by point, the scan over a sound one, but for
points that are marked as lost; and no point is missing without a reason.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition.plan import Plan, StepAndShoot, ring, write_plan
from acquisition.poses import Sweep
from acquisition.scanfile import ScanFolder
from acquisition.station import read_station
from drivers.profiler import Reason
from loftscan import simulate
from tests.system.command_cases import run, succeeded

# Each fifth datagram, and each N-th answer on a serial line. What a RIFTEK drops before the
# profile that is taken is another one that nobody wanted; a Modbus TCP has no bad line here.
FAULTS = {
    "baumer_ox": "drop-blocks=5",
    "riftek": "drop-blocks=5",
    "registers": "",
    "hokuyo": "garbage=11",
    "sick": "garbage=25",  # each costs 2 s, until the sensor has forgotten the question
}
COUNTED = {"baumer_ox": "torn_frames", "hokuyo": "bad_frames", "sick": "bad_frames"}
RINGS, STOPS = 2, 4
# A scanner that turns 10 times a second is asked for each profile; 20 times as fast, an exposure
# is 25 ms of this machine, and one damaged answer costs more.
SCALES = {"hokuyo": 5.0}


def scanned(profiler: str, faults: str, out: str) -> tuple[list[Sweep], dict[str, object]]:
    """The sweeps, and the event of the end."""
    rings = ring(10.0, 12.0, 2.0, STOPS).ring
    plan = Plan(ring=rings, step_and_shoot=StepAndShoot(settle_s=0.0))
    Path("plan.toml").write_text(write_plan(plan))
    scale = SCALES.get(profiler, 20.0)
    with simulate(seed=3, scale=scale, profiler=profiler, faults=faults) as station:
        words = ("scan", station, "plan.toml", "--attended", "--out", f"{out}.scan", "--json")
        ran = succeeded(run(*words))
        points = read_station(station.station).profiler.points_per_profile
    folder = ScanFolder.open(Path(f"{out}.scan"))
    sweeps = [folder.read(index) for index in folder.indices()]
    for sweep in sweeps:
        assert len(sweep.profiles) == STOPS
        for profile in sweep.profiles:
            assert len(profile.reasons) <= points
            assert set(profile.reasons.tolist()) <= set(Reason)
            assert len(profile.points_mm) == np.count_nonzero(profile.reasons == Reason.MEASURED)
            # Where it measured there is something: no missing point passes for a measured one.
            assert np.all(profile.counts[profile.reasons == Reason.MEASURED].any(axis=1))
    return sweeps, json.loads(ran.stdout.splitlines()[-1])


@pytest.mark.parametrize("profiler", list(FAULTS))
def test_what_a_profilers_wire_loses_is_counted_and_marked(profiler: str, place: Path) -> None:
    whole, end = scanned(profiler, "", "sound")
    assert end["event"] == "done"
    names = ("dropped_frames", "torn_frames", "bad_frames", "lost_profiles", "lost_points")
    assert [end[name] for name in names] == [0, 0, 0, 0, 0]
    missing = sum(np.count_nonzero(p.reasons) for sweep in whole for p in sweep.profiles)
    assert missing > 0  # the vase does not fill the field of view
    if not FAULTS[profiler]:
        return
    sweeps, end = scanned(profiler, FAULTS[profiler], "bad")
    lost = 0
    for one, other in zip(sweeps, whole, strict=True):
        for mine, due in zip(one.profiles, other.profiles, strict=True):
            there = mine.reasons != Reason.LOST
            lost += int(np.count_nonzero(~there))
            np.testing.assert_array_equal(mine.reasons[there], due.reasons[there])
            np.testing.assert_array_equal(mine.counts[there], due.counts[there])
    assert end["lost_points"] == lost
    if profiler in COUNTED:
        assert end[COUNTED[profiler]] > 0  # type: ignore[operator]
