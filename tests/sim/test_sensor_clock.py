"""A sensor that measures by itself: each period once, at its own time, stamped by its own clock."""

from __future__ import annotations

import numpy as np
import pytest

from sim.sensor_clock import FreeRun, SensorClock


def test_whoever_looks_now_and_then_is_told_of_every_period_once() -> None:
    rng = np.random.default_rng(1)
    run, now_s, told = FreeRun(SensorClock(latency_s=0.002)), 10.0, []
    while now_s < 12.0:
        now_s += rng.uniform(0.0, 0.01)
        told += run.due(now_s, 400.0)
        assert not told or told[-1] <= now_s - 0.002
    np.testing.assert_allclose(np.diff(told), 1.0 / 400.0)


def test_what_is_long_ago_is_not_made_up_for() -> None:
    run = FreeRun(SensorClock())
    run.due(1.0, 400.0)
    assert len(run.due(2.0, 400.0)) == 5  # 12.5 ms
    run = FreeRun(SensorClock())
    run.due(1.0, 100.0)
    assert len(run.due(2.0, 100.0)) == 1


def test_a_stamp_is_late_by_the_latency_and_drifts() -> None:
    clock = SensorClock(latency_s=0.002, drift_ppm=50.0, started_s=7.0)
    assert clock.stamp_s(100.0) == pytest.approx(7.0 + 100.002 * (1.0 + 50e-6), abs=1e-12)


def test_without_a_clock_it_measures_when_it_is_looked_at_once_a_period() -> None:
    run = FreeRun(None)
    assert [list(run.due(now_s, 100.0)) for now_s in (1.003, 1.007, 1.013)] == [
        [1.003],
        [],
        [1.013],
    ]
    assert run.stamp_s(1.013) == 1.013


@pytest.mark.parametrize("wrong", [{"latency_s": -0.1}, {"latency_s": 2.0}, {"drift_ppm": 2e5}])
def test_an_impossible_clock_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="sensor clock: a"):
        SensorClock(**wrong)
