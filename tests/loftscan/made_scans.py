"""Small .scan folders, made from the simulator's optics straight: no devices, no wires, seeded."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from acquisition.frames import Kind, Kinematics, Lifting, Turning
from acquisition.plan import ring
from acquisition.poses import Pose, Sweep
from acquisition.scan_record import ScanRecord, State
from acquisition.scanfile import ScanFolder
from drivers.profiler import Profile, Reason
from sim import Flaws, Mounting, SeedKey, Sensor, SimProfile
from sim.optics import OpticalBench, OpticsSettings
from sim.parts import vase
from sim.sensor import Lifting as SimLifting
from tests.acquisition.scan_cases import STATION

SLICES, STOPS, STEP_MM, FIRST_MM = 10, 60, 4.0, 6.0
HEIGHT_MM = 50.0  # of the vase: every slice meets it
WIDTH_MM = 0.12  # of the cloud, 4 sigma
OUTLIERS = 0.002
SENSOR = Sensor(points=160, width_mm=80.0)
PART = {"radius_mm": 18.0, "height_mm": HEIGHT_MM, "around": 240, "levels": 40}
KINEMATICS = Kinematics(
    kind=Kind.NOMINAL,
    table_sense=Turning.COUNTER_CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=1.5,
    standoff_mm=225.0,
)


def record(kinematics: Kinematics = KINEMATICS, slices: int = SLICES) -> ScanRecord:
    return ScanRecord(
        station=replace(STATION, kinematics=kinematics),
        plan=ring(FIRST_MM, FIRST_MM + STEP_MM * (slices - 1), STEP_MM, STOPS),
        calibration=kinematics,
        software="loftscan 0.0.0",
        created="2026-01-02T03:04:05+00:00",
    )


def sweeps(kinematics: Kinematics = KINEMATICS, slices: int = SLICES) -> tuple[Sweep, ...]:
    """The sweeps of a scan, as a station that stands so would take them."""
    return _sweeps(kinematics, slices)


def write_scan(
    path: Path, kept: Iterable[Sweep] | None = None, state: State = State.COMPLETE
) -> Path:
    """A .scan folder of some sweeps; left as "scanning" it is that of a program that died."""
    writer = ScanFolder.create(path, record())
    for each in sweeps() if kept is None else kept:
        writer.append(each)
    writer.mark(state)
    writer.close()
    return path


def damage(path: Path, index: int) -> None:
    file = ScanFolder(path).file(index)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(bytes(data))


@cache
def _sweeps(kinematics: Kinematics, slices: int) -> tuple[Sweep, ...]:
    mounting = Mounting(
        standoff_mm=kinematics.standoff_mm,
        height_mm=kinematics.height_mm,
        lifting=SimLifting.UP if kinematics.stage_sign > 0 else SimLifting.DOWN,
    )
    flaws = Flaws(cloud_width_mm=WIDTH_MM, outlier_rate=OUTLIERS, seed=5)
    settings = OpticsSettings(mounting=mounting, sensor=SENSOR, flaws=flaws)
    bench = OpticalBench(vase(**PART), settings)
    return tuple(_taken(bench, slices))


def _taken(bench: OpticalBench, slices: int) -> Iterator[Sweep]:
    angles = np.arange(STOPS) * (math.tau / STOPS)
    for index in range(slices):
        stage_mm = FIRST_MM + STEP_MM * index
        seen = bench.profiles(angles, stage_mm, [SeedKey(index, k) for k in range(STOPS)])
        poses = tuple(Pose(float(angle), stage_mm, 0.01 * k) for k, angle in enumerate(angles))
        yield Sweep(index, tuple(_profile(each, k) for k, each in enumerate(seen)), poses)


def _profile(seen: SimProfile, frame: int) -> Profile:
    return Profile(
        counts=seen.counts,
        scale_mm=(SENSOR.x_mm_per_count, SENSOR.z_mm_per_count),
        offset_mm=(SENSOR.x_offset_mm, SENSOR.z_offset_mm),
        reasons=np.where(seen.seen, Reason.MEASURED, Reason.NO_RETURN).astype(np.uint8),
        intensity=seen.intensity,
        sensor_time_s=frame / 100.0,
        encoder=0,
        frame=frame,
    )
