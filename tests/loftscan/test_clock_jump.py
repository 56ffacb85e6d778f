"""The wall clock is set back amid a scan: nothing lasts a negative time."""

from __future__ import annotations

import io
import json
import time

import pytest

from loftscan.metrics import lag
from loftscan.scan_progress import Manner, ScanTeller
from tests.acquisition.scan_cases import KINEMATICS
from tests.acquisition.test_scan import PLAN, rig


def test_a_scan_tells_no_negative_duration(monkeypatch: pytest.MonkeyPatch) -> None:
    told, at = io.StringIO(), rig()
    begun_s, jumps = time.time(), iter(range(10**6))
    # Each look at the wall clock finds it an hour further back.
    monkeypatch.setattr(time, "time", lambda: begun_s - 3600.0 * next(jumps))
    monkeypatch.setattr(time, "time_ns", lambda: int(1e9 * (begun_s - 3600.0 * next(jumps))))
    teller = ScanTeller(told, Manner.JSON, KINEMATICS, at.stop)
    sweeps = at.take(PLAN, progress=teller.stopped_at)
    for sweep in sweeps:
        teller.kept(sweep)
    events = [json.loads(line) for line in told.getvalue().splitlines()]
    assert len(events) == len(sweeps) == 3
    seconds = [event["seconds"] for event in events]
    assert seconds == sorted(seconds)
    assert min(min(seconds), *(event["left_s"] for event in events)) >= 0.0
    times_s = [pose.time_s for sweep in sweeps for pose in sweep.poses]
    assert times_s == sorted(times_s)


def test_slices_whose_files_are_dated_backwards_have_no_negative_period() -> None:
    found = lag([0.0, 0.2, 0.1], [1000.0, 997.0, 1001.0])
    assert all(value >= 0.0 for value in found.values() if isinstance(value, int | float))
    assert found["slice_period_median_s"] == pytest.approx(2.0)
