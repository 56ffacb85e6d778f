"""A table that turns steadily beside one that stops for every profile: how true, and how fast.

    python -m tests.campaigns.turning_table [--seeds 10] [--first 1] [--profiler riftek]

The whole chain on virtual wires: the simulated station, its drivers, the scan. The table turns by
60 deg/s, the sensor measures 400 times a second and stamps 2 ms late by a clock of its own that
drifts; one datagram of ten is lost (of a riftek a whole profile, of a baumer_ox half of one); none
of that is told to the program. Beside it the same slice step and shoot, with as many stops as
profiles came. Judges are the simulator's mesh and its witness.

For each seed: rms of the measured points from the true surface, rms of the fitted section's curve
from it (where noise averages out, and what is left is the angles), rms of the angles from the true
ones, and the station's seconds a slice. It exits 1 when, over all seeds, either rms is more than
1.2 times that of step and shoot, or a slice is not ten times as fast.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.continuous import Continuous
from acquisition.frames import part_points
from acquisition.plan import Plan, Ring, StepAndShoot
from acquisition.poses import Sweep
from acquisition.scan import StopRequest, scan
from drivers.profiler import Reason
from loftscan import fit_section
from sim.judging import Surface
from sim.parts import vase
from sim.profilers import ProfilerFamily
from sim.sensor import Sensor
from sim.sensor_clock import SensorClock
from sim.stations import Layout
from tests.acquisition.virtual_station import VirtualStation, virtual_station

RATE_HZ, A_TURN = 400.0, 2400  # 60 deg/s
LATENCY_S, LOST = 0.002, 0.1
AT_MM, BESIDE_MM = 48.0, 15.0
_JUDGED = 20_000  # points, drawn
_TIMES, _FASTER = 1.2, 10.0


@dataclass(frozen=True)
class Taken:
    """What one slice came to."""

    profiles: int
    seconds: float
    points_rms_mm: float
    section_rms_mm: float
    angle_rms_deg: float
    latency_s: float = math.nan


def layout(seed: int, family: ProfilerFamily) -> Layout:
    rng = np.random.default_rng(seed)
    clock = SensorClock(
        latency_s=LATENCY_S, drift_ppm=rng.uniform(-100, 100), started_s=rng.uniform(0, 1e5)
    )
    return Layout(
        seed=seed,
        rate_hz=RATE_HZ,
        profiler_family=family,
        sensor=Sensor(points=320),
        sensor_clock=clock,
        outlier_rate=0.0,
    )


def rings(first_mm: float, last_mm: float, profiles_per_turn: int) -> Ring:
    return Ring(
        first_mm=first_mm, last_mm=last_mm, step_mm=BESIDE_MM, profiles_per_turn=profiles_per_turn
    )


def turned(seed: int, family: ProfilerFamily, truth: Surface) -> tuple[Taken, Taken]:
    """The first slice, seen both ways round, and the second, seen once."""
    plan = Plan(ring=rings(AT_MM - BESIDE_MM, AT_MM, A_TURN), continuous=Continuous())
    with virtual_station(layout(seed, family), vase(), lost=LOST) as at:
        first, second = taken(at, plan, truth)
    return first, second


def stopped(seed: int, family: ProfilerFamily, stops: int, truth: Surface) -> Taken:
    """The second slice, step and shoot."""
    plan = Plan(ring=rings(AT_MM, AT_MM, stops), step_and_shoot=StepAndShoot(settle_s=0.0))
    with virtual_station(layout(seed, family), vase()) as at:
        (only,) = taken(at, plan, truth)
    return only


def taken(at: VirtualStation, plan: Plan, truth: Surface) -> list[Taken]:
    """Every slice of a plan; the time of homing is nobody's."""
    found = []
    at.station.table.home(at.station.sleep)
    at.station.stage.home(at.station.sleep)
    begun_s = at.room.now_s
    for sweep in scan(at.station, plan, stop=StopRequest()):
        found.append(judged(sweep, at, at.room.now_s - begun_s, truth))
        begun_s = at.room.now_s
    return found


def judged(sweep: Sweep, at: VirtualStation, seconds: float, truth: Surface) -> Taken:
    points = part_points(sweep, at.settings.kinematics)
    rng = np.random.default_rng(0)
    drawn = points[rng.choice(len(points), min(_JUDGED, len(points)), replace=False)]
    return Taken(
        profiles=sum(bool((each.reasons != Reason.LOST).any()) for each in sweep.profiles),
        seconds=seconds,
        points_rms_mm=_rms(truth.signed_distances_mm(drawn)),
        section_rms_mm=_rms(truth.signed_distances_mm(section(points))),
        angle_rms_deg=math.degrees(angles_off(sweep, at)),
        latency_s=math.nan if sweep.timing is None else sweep.timing.latency_s,
    )


def section(points_mm: FloatArray) -> FloatArray:
    """Points of the fitted curve at the slice's height, (n, 3)."""
    (curve,) = fit_section(points_mm[:, :2], exact="never")
    low, high = curve.domain
    flat = np.asarray(curve(np.linspace(low, high, 4000, endpoint=False)))
    return np.column_stack([flat, np.full(len(flat), points_mm[:, 2].mean())])


def angles_off(sweep: Sweep, at: VirtualStation) -> float:
    """Rms in rad of the kept angles from those that the witness saw."""
    true = {
        event["frame"]: event["table_rad"]
        for event in at.witness.events
        if event["what"] == "profile"
    }
    off = [
        pose.table_rad - float(true[profile.frame])  # type: ignore[arg-type]
        for profile, pose in zip(sweep.profiles, sweep.poses, strict=True)
        if profile.frame in true
    ]
    return _rms(np.array(off))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def main(words: Sequence[str] | None = None) -> int:
    """Run it; 1 when a bound was broken."""
    parser = argparse.ArgumentParser(prog="turning_table", description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    families = [ProfilerFamily.RIFTEK.value, ProfilerFamily.BAUMER_OX.value]
    parser.add_argument("--profiler", choices=families, default=families[0])
    wanted = parser.parse_args(words)
    family = ProfilerFamily(wanted.profiler)
    part = vase()
    truth = Surface(part.vertices_mm, part.faces)
    rows = []
    for seed in range(wanted.first, wanted.first + wanted.seeds):
        first, once = turned(seed, family, truth)
        still = stopped(seed, family, once.profiles, truth)
        rows.append((first, once, still))
        for name, each in (("both ways", first), ("once", once), ("stopped", still)):
            sys.stdout.write(
                f"seed {seed:2d} {name:9s} {each.profiles:5d} profiles {each.seconds:6.1f} s"
                f"  points {1e3 * each.points_rms_mm:6.2f} um  section"
                f" {1e3 * each.section_rms_mm:5.2f} um  angles {each.angle_rms_deg:.4f} deg"
                f"  latency {1e3 * each.latency_s:.3f} ms\n"
            )
            sys.stdout.flush()
    return verdict(rows)


def verdict(rows: Sequence[tuple[Taken, Taken, Taken]]) -> int:
    """Over all seeds, of the slice that was seen once."""
    broken = 0
    for name in ("points_rms_mm", "section_rms_mm"):
        ours, theirs = (
            math.sqrt(float(np.mean([getattr(row[k], name) ** 2 for row in rows]))) for k in (1, 2)
        )
        broken += ours > _TIMES * theirs
        sys.stdout.write(
            f"{name}: {1e3 * ours:.2f} um turning, {1e3 * theirs:.2f} um step and shoot, ratio"
            f" {ours / theirs:.3f} (at most {_TIMES})\n"
        )
    faster = [still.seconds / once.seconds for _, once, still in rows]
    broken += min(faster) < _FASTER
    sys.stdout.write(
        f"{len(rows)} seeds; a slice is {min(faster):.1f} to {max(faster):.1f} times as fast (at"
        f" least {_FASTER:g})\n"
    )
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
