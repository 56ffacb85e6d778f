"""Stations, plans, records and sweeps that several tests share; noise is seeded."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition.frames import Kind, Kinematics, Lifting, Turning
from acquisition.plan import ring
from acquisition.poses import Pose, Sweep
from acquisition.scan_record import ScanRecord
from acquisition.station import (
    BaumerOx,
    GrblTable,
    LeadshineStage,
    RelayFamily,
    RelayLaser,
    Station,
)
from drivers.profiler import Profile

REPOSITORY = Path(__file__).resolve().parents[2]

KINEMATICS = Kinematics(
    kind=Kind.SIMULATED,  # what these tests scan with are fakes: there is nothing to calibrate
    table_sense=Turning.COUNTER_CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=12.5,
    standoff_mm=150.0,
)

STATION = Station(
    name='bench "3"',
    table=GrblTable(
        address="serial:///dev/ttyUSB0?baud=115200",
        steps_per_deg=88.9,
        speed_deg_s=90.0,
        lowest_deg=-10.0,
        highest_deg=370.0,
    ),
    stage=LeadshineStage(
        address="serial:///dev/ttyUSB1?baud=115200",
        pulses_per_turn=10_000,
        screw_lead_mm=5.0,
        speed_mm_s=20.0,
        lowest_mm=0.0,
        highest_mm=300.0,
    ),
    profiler=BaumerOx(
        address="tcp://192.0.2.7:502",
        profiles="udp://:1234",
        rate_hz=100.0,
        points_per_profile=600,
        x_mm_per_count=0.01,
        z_mm_per_count=0.005,
    ),
    laser=RelayLaser(family=RelayFamily.TURCK, address="tcp://192.0.2.8:502", watchdog_s=0.25),
    kinematics=KINEMATICS,
)


def record(slices: int = 5) -> ScanRecord:
    return ScanRecord(
        station=STATION,
        plan=ring(10.0, 10.0 + slices - 1, 1.0, 12),
        calibration=KINEMATICS,
        software="loftscan 0.0.0",
        created="2026-01-02T03:04:05+00:00",
    )


def sweep(index: int, profiles: int = 3, points: int = 8) -> Sweep:
    rng = np.random.default_rng(index)
    return Sweep(
        index,
        tuple(profile(rng, points + k, frame=10 * index + k) for k in range(profiles)),
        tuple(
            Pose(table_rad=0.1 * k, stage_mm=float(index), time_s=index + 0.01 * k)
            for k in range(profiles)
        ),
    )


def profile(rng: np.random.Generator, points: int, frame: int) -> Profile:
    return Profile(
        counts=rng.integers(-3000, 3000, (points, 2)).astype(np.int32),
        scale_mm=(0.01, 0.005),
        offset_mm=(0.0, 80.0),
        reasons=(rng.random(points) < 0.2).astype(np.uint8),
        intensity=rng.integers(0, 65536, points).astype(np.uint16),
        sensor_time_s=frame / 7.0,
        encoder=frame % 65536,
        frame=frame,
    )


def assert_same_sweep(left: Sweep, right: Sweep) -> None:
    assert (left.index, left.poses) == (right.index, right.poses)
    assert len(left.profiles) == len(right.profiles)
    for one, other in zip(left.profiles, right.profiles, strict=True):
        for name in ("counts", "reasons", "intensity"):
            a, b = getattr(one, name), getattr(other, name)
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        for name in ("scale_mm", "offset_mm", "sensor_time_s", "encoder", "frame"):
            assert getattr(one, name) == getattr(other, name), name
