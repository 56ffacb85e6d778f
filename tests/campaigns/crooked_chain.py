"""A crooked station calibrated by the program, then what it measures: gauges, and the vase.

    python -m tests.campaigns.crooked_chain [--out DIR]

Everything but the wires: the simulator's crooked bench (axis tilted 1 degree and 2 mm aside, table
3 % off, sheet yawed 1 degree, noise 10 um with the speckle and strays of a real sensor), the
calibration, and `reconstruct`. Beside each figure stands that of the same station perfectly known.
It exits 1 when a gauge is off by more than 5 um beyond three standard deviations of its own noise,
or the vase's rms is more than 1.3 times that of the known station.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.frames import Kind, Kinematics, Lifting, Turning, part_points
from acquisition.poses import Pose, Sweep
from drivers.profiler import Profile, Reason
from loftscan import compare, reconstruct
from loftscan.calibrating.artefact import parse_artefact
from loftscan.calibrating.joint import calibrate, seen_in
from sim import SeedKey
from sim.artefacts import ball_plate, ball_plate_toml, gauge_cylinder, step_gauge
from sim.crooked import CrookedBench, Crookedness
from sim.parts import vase
from sim.solids import Part
from sim.stations import Layout, truth_ply

_END_MM = 1.0
CLOUD_MM = 0.04  # 4 sigma of 10 um
NOMINAL = Kinematics(
    kind=Kind.NOMINAL,
    table_sense=Turning.COUNTER_CLOCKWISE,
    stage_sense=Lifting.UP,
    height_mm=-3.0,
    standoff_mm=225.0,
)


def known(off: Crookedness) -> Kinematics:
    """The kinematics of a crooked station, seen from its axis: by vectors, not by the program."""
    sheet = _z(off.yaw_rad) @ _y(off.pitch_rad) @ _x(off.roll_rad)
    beam, right = -sheet[:, 0], sheet[:, 1]
    axis = (_z(off.axis_towards_rad) @ _y(off.axis_tilt_rad))[:, 2]
    x = -(beam - (beam @ axis) * axis)
    x /= np.linalg.norm(x)
    y = np.cross(axis, x)
    away = np.array([225.0, 0.0, -3.0]) - [*off.pivot_mm, 0.0]
    pitch = math.asin(beam @ axis)
    lift = np.array(off.lift)
    # Where the part has its zero angle follows from how the axis leans: a turn of the part.
    return replace(
        NOMINAL,
        standoff_mm=float(away @ x), side_mm=float(-(away @ y)), pitch_deg=math.degrees(pitch),
        roll_deg=math.degrees(math.atan2(right @ axis / math.cos(pitch), right @ y)),
        table_deg_per_deg=off.table_scale, stage_x_mm=float(lift @ x),
        stage_y_mm=float(lift @ y), stage_z_mm=float(lift @ axis),
        x_mm_per_mm=off.x_scale, z_mm_per_mm=off.z_scale,
    )  # fmt: skip


def taken(
    part: Part, off: Crookedness, stages_mm: Iterable[float], stops: int, *, seed: int = 1
) -> Iterator[Sweep]:
    """Sweeps of a part on a crooked station."""
    layout = Layout(seed=seed, cloud_width_mm=CLOUD_MM, outlier_rate=0.0)
    bench = CrookedBench(part, layout.optics, off)
    sensor = layout.sensor
    for index, stage_mm in enumerate(stages_mm):
        profiles, poses = [], []
        for stop in range(stops):
            turn_rad = math.tau * stop / stops
            seen = bench.profile(turn_rad, float(stage_mm), SeedKey(index, stop))
            reasons = np.where(seen.seen, Reason.MEASURED, Reason.NO_RETURN)
            profiles.append(
                Profile(
                    seen.counts,
                    (sensor.x_mm_per_count, sensor.z_mm_per_count),
                    (sensor.x_offset_mm, sensor.z_offset_mm),
                    reasons,
                    seen.intensity,
                    0.0,
                    0,
                    stop,
                )
            )
            poses.append(Pose(turn_rad, float(stage_mm), 0.0))
        yield Sweep(index, tuple(profiles), tuple(poses))


def calibrated(off: Crookedness) -> Kinematics:
    """Calibrate on the ball plate."""
    sweeps = tuple(taken(ball_plate(), off, np.arange(12.0, 76.0, 3.0), 24))
    found = calibrate(seen_in([sweeps]), NOMINAL, parse_artefact(ball_plate_toml()))
    assert found.verdict.observable
    assert all(each.sound for each in found.checks)
    return found.kinematics


def radius_mm(points_mm: np.ndarray) -> tuple[float, float]:
    """Radius of an upright circle and its standard deviation, algebraically and once refined."""
    x, y = points_mm[:, 0], points_mm[:, 1]
    a = np.column_stack([2 * x, 2 * y, np.ones(len(x))])
    cx, cy, _c = np.linalg.lstsq(a, x * x + y * y, rcond=None)[0]
    for _ in range(3):
        away = np.hypot(x - cx, y - cy)
        radius = away.mean()
        jac = np.column_stack([(x - cx) / away, (y - cy) / away, np.ones(len(x))])
        dx, dy, _ = np.linalg.lstsq(jac, away - radius, rcond=None)[0]
        cx, cy = cx + dx, cy + dy
    left = np.hypot(x - cx, y - cy) - radius
    # Four neighbours share a speckle: a quarter as many points are independent, at most.
    return float(radius), float(left.std() / math.sqrt(len(x) / 4.0))


def gauges(found: Kinematics, off: Crookedness) -> list[tuple[str, float, float]]:
    """Errors of the reference cylinder's and the steps' radii in mm, and their noise."""
    rows = []
    ring = [part_points(s, found) for s in taken(gauge_cylinder(), off, (15.0, 30.0, 45.0), 24)]
    radius, sd = radius_mm(np.concatenate(ring))
    rows.append(("cylinder, radius 20", radius - 20.0, sd))
    steps = []
    for sweep, true_mm in zip(
        taken(step_gauge(), off, (13.0, 33.0, 53.0), 24), (30.0, 24.0, 18.0), strict=True
    ):
        radius, sd = radius_mm(part_points(sweep, found))
        steps.append((radius, true_mm, sd))
        rows.append((f"step, radius {true_mm:g}", radius - true_mm, sd))
    for (one, true_one, sd), (two, true_two, sd_two) in itertools.pairwise(steps):
        off_mm = (one - two) - (true_one - true_two)
        rows.append((f"step {true_one:g} to {true_two:g}", off_mm, math.hypot(sd, sd_two)))
    return rows


def vase_rms_mm(sweeps: tuple[Sweep, ...], kinematics: Kinematics, folder: Path) -> float:
    """Root mean square distance of the reconstructed vase's wall from the true one, best fit.

    The wall, without the flat caps: where the outermost rings lie is the plan's affair.
    """
    truth = folder / "truth.ply"
    truth.write_bytes(truth_ply(vase()))
    mesh = reconstruct(_Given(sweeps, kinematics)).mesh
    z_mm = mesh.vertices_mm[:, 2]
    inside = (z_mm > z_mm.min() + _END_MM) & (z_mm < z_mm.max() - _END_MM)
    told = compare(mesh.vertices_mm[inside], truth, align="best-fit")
    rms_mm = told.metrics["rms_mm"]
    assert isinstance(rms_mm, float)
    return rms_mm


class _Given:
    """Sweeps with their kinematics, as `scan` gives them."""

    def __init__(self, sweeps: tuple[Sweep, ...], kinematics: Kinematics) -> None:
        self.kinematics, self.total, self._sweeps = kinematics, len(sweeps), sweeps

    def __iter__(self) -> Iterator[Sweep]:
        return iter(self._sweeps)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="crooked_chain")
    parser.add_argument("--out", type=Path)
    wanted = parser.parse_args(words)
    off = Crookedness()
    found, true = calibrated(off), known(off)
    broken = False
    for (name, off_mm, sd), (_, known_mm, _) in zip(
        gauges(found, off), gauges(true, off), strict=True
    ):
        allowed = 0.005 + 3.0 * sd
        broken |= abs(off_mm) > allowed
        sys.stdout.write(
            f"{name:20s} {1e3 * off_mm:+6.1f} um (known station {1e3 * known_mm:+.1f}),"
            f" allowed {1e3 * allowed:.1f}\n"
        )
    sweeps = tuple(taken(vase(), off, np.arange(4.0, 102.0, 2.5), 24))
    with tempfile.TemporaryDirectory() as own:
        folder = wanted.out or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        ours, theirs = (vase_rms_mm(sweeps, each, folder) for each in (found, true))
        level = Crookedness(
            yaw_rad=0.0, pitch_rad=0.0, roll_rad=0.0, axis_tilt_rad=0.0, pivot_mm=(0.0, 0.0),
            table_scale=1.0, lift=(0.0, 0.0, 1.0), x_scale=1.0, z_scale=1.0,
        )  # fmt: skip
        straight = tuple(taken(vase(), level, np.arange(4.0, 102.0, 2.5), 24))
        best = vase_rms_mm(straight, known(level), folder)
    sys.stdout.write(
        f"vase on a station that stands straight and is known: rms {1e3 * best:.2f} um\n"
        f"vase: rms {1e3 * ours:.2f} um calibrated, {1e3 * theirs:.2f} um known: ratio"
        f" {ours / theirs:.3f}\n"
    )
    return int(broken or ours > 1.3 * theirs)


def _x(a: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])


def _y(a: float) -> np.ndarray:
    return np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])


def _z(a: float) -> np.ndarray:
    return np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])


if __name__ == "__main__":
    sys.exit(main())
