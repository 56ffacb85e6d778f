"""Two views of a part that was turned over, registered: errors of the motion against their sd.

    python -m tests.campaigns.turned_over [--seeds 20] [--part lump, spun or lobed]

A lump without symmetry is scanned by rings, turned over as a person would (by about half a turn
about a horizontal axis, then anyhow on the plate, within a few mm of the middle), and scanned
again, with other noise. Known is how it was turned: so the registered motion has errors that are
known, in a rotation vector about the middle and a shift. Told are rms of the errors, their squares
in units of the reported covariance (chi^2 of 6 freedoms, 6 in the mean), pulls, seconds. A part of
revolution, or of three lobes alike, must be refused: told are the refusals.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotRegistered
from reconstruction.registration import Registration, View, register_views
from sim import Flaws, Mounting, SeedKey, Sensor
from sim.optics import OpticalBench, OpticsSettings
from sim.solids import Part, radial_solid

HEIGHT_MM, STEP_MM, STOPS = 60.0, 1.5, 24
WIDTH_MM = 0.1  # of the cloud, 4 sigma
SENSOR = Sensor(points=320, width_mm=100.0)
STANDOFF_MM = 225.0


def lump() -> Part:
    """A body without any symmetry; its ends are flat."""

    def law(angle: FloatArray, z: FloatArray) -> FloatArray:
        share = z / HEIGHT_MM
        waves = 0.10 * np.cos(angle + 0.4 + 2.0 * share) + 0.08 * np.cos(2.0 * angle - 1.1)
        waves = waves + 0.06 * np.cos(3.0 * angle + 0.9 - 1.5 * share)
        return 24.0 * (1.0 + waves) * (1.0 + 0.22 * np.sin(3.3 * share + 0.3) - 0.18 * share)

    return radial_solid("lump", law, np.linspace(0.0, HEIGHT_MM, 121), 480)


def spun() -> Part:
    """Of revolution: a turn about its axis changes nothing."""

    def law(angle: FloatArray, z: FloatArray) -> FloatArray:
        return 22.0 + 6.0 * np.sin(z / 14.0) + 0.0 * angle

    return radial_solid("spun", law, np.linspace(0.0, HEIGHT_MM, 121), 480)


def lobed() -> Part:
    """Three lobes alike: three ways fit."""

    def law(angle: FloatArray, z: FloatArray) -> FloatArray:
        return (24.0 + 3.0 * np.cos(3.0 * angle)) * (1.0 + 0.2 * np.sin(z / 16.0))

    return radial_solid("lobed", law, np.linspace(0.0, HEIGHT_MM, 121), 480)


def turned_over(part: Part, rng: np.random.Generator) -> tuple[Part, FloatArray]:
    """The part as it stands then, and the motion (4, 4) that leads from there back to the first."""
    about = rng.uniform(0.0, math.tau)
    over = _rotation(np.array([math.cos(about), math.sin(about), 0.0]), math.pi)
    spin = _rotation(np.array([0.0, 0.0, 1.0]), rng.uniform(0.0, math.tau))
    lean = _rotation(rng.normal(size=3), rng.normal(0.0, math.radians(1.5)))
    turn = lean @ spin @ over
    vertices = part.vertices_mm @ turn.T
    shift = np.array([*rng.uniform(-3.0, 3.0, 2), -vertices[:, 2].min()])
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, -turn.T @ shift
    return replace(part, vertices_mm=vertices + shift, radius_mm=None), back


def scanned(part: Part, seed: int) -> View:
    """Rings over the part, by the simulator's optics; the sensor's place is known to a scan."""
    mounting = Mounting(standoff_mm=STANDOFF_MM)
    flaws = Flaws(cloud_width_mm=WIDTH_MM, outlier_rate=0.001, speckle_points=4, seed=seed)
    bench = OpticalBench(part, OpticsSettings(mounting=mounting, sensor=SENSOR, flaws=flaws))
    angles = np.arange(STOPS) * (math.tau / STOPS)
    points, towards = [], []
    heights = np.arange(STEP_MM / 2.0, float(part.vertices_mm[:, 2].max()), STEP_MM)
    for index, z in enumerate(heights):
        keys = [SeedKey(index, stop) for stop in range(STOPS)]
        for angle, seen in zip(angles, bench.profiles(angles, float(z), keys), strict=True):
            counts = seen.counts[seen.seen]
            x, depth = counts[:, 0] * SENSOR.x_mm_per_count, counts[:, 1] * SENSOR.z_mm_per_count
            facing = np.column_stack([STANDOFF_MM - depth, x, np.full(len(x), z)])
            back = _rotation(np.array([0.0, 0.0, 1.0]), -angle)
            points.append(facing @ back.T)
            ways = np.array([STANDOFF_MM, 0.0, z]) - facing
            towards.append((ways / np.linalg.norm(ways, axis=1, keepdims=True)) @ back.T)
    return View(np.concatenate(points), np.concatenate(towards))


def errors_of(found: Registration, true: FloatArray) -> FloatArray:
    """(6,): rotation vector about the middle, and shift there, from the truth to what was found."""
    apart = found.transform @ np.linalg.inv(true)
    turn = apart[:3, :3]
    vector = 0.5 * np.array(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
    )  # small angles
    shift = apart[:3, :3] @ found.middle_mm + apart[:3, 3] - found.middle_mm
    return np.concatenate([vector, shift])


def refusals(part: Part, seeds: int) -> int:
    """Tell of each seed why it was refused; the exit code is 1 where one was not."""
    missed = 0
    for seed in range(seeds):
        other, _ = turned_over(part, np.random.default_rng([7, seed]))
        try:
            found = register_views(scanned(part, 2 * seed + 1), scanned(other, 2 * seed + 2))
            said, missed = f"NOT refused, sd {found.sd}", missed + 1
        except NotRegistered as why:
            said = str(why)
        sys.stdout.write(f"seed {seed}: {said}\n")
        sys.stdout.flush()
    sys.stdout.write(f"{seeds} seeds, {missed} not refused\n")
    return int(missed > 0)


def _rotation(axis: FloatArray, angle: float) -> FloatArray:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--part", choices=("lump", "spun", "lobed"), default="lump")
    given = parser.parse_args(arguments)
    if given.part != "lump":
        return refusals(spun() if given.part == "spun" else lobed(), given.seeds)
    part = lump()
    errors, pulls, squares, seconds = [], [], [], []
    for seed in range(given.seeds):
        other, back = turned_over(part, np.random.default_rng([7, seed]))
        first, second = scanned(part, 2 * seed + 1), scanned(other, 2 * seed + 2)
        begun = time.process_time()
        found = register_views(first, second)
        seconds.append(time.process_time() - begun)
        errors.append(errors_of(found, back))
        pulls.append(errors[-1] / found.sd)
        squares.append(float(errors[-1] @ np.linalg.solve(found.covariance, errors[-1])))
        sys.stdout.write(
            f"seed {seed}: {np.degrees(np.linalg.norm(errors[-1][:3])):.5f} deg,"
            f" {1e3 * np.linalg.norm(errors[-1][3:]):.2f} um, chi2 {squares[-1]:.2f}, rms"
            f" {1e3 * found.rms_mm:.1f} um, overlap {found.overlap[0]:.2f} {found.overlap[1]:.2f},"
            f" {len(found.sites_mm)} sites of {found.radius_mm:.2f} mm, {seconds[-1]:.1f} s\n"
        )
        sys.stdout.flush()
    table = np.array(errors)
    turned = np.degrees(np.sqrt((table[:, :3] ** 2).sum(axis=1).mean()))
    shifted = np.sqrt((table[:, 3:] ** 2).sum(axis=1).mean())
    pulled = np.array(pulls)
    sys.stdout.write(
        f"{given.seeds} seeds: turn {turned:.5f} deg rms, shift {1e3 * shifted:.2f} um rms;"
        f" chi2/6 {np.mean(squares) / 6.0:.2f}; pulls: mean square {np.mean(pulled**2):.2f} (each"
        f" {np.round(np.mean(pulled**2, axis=0), 2).tolist()}), mean"
        f" {np.round(pulled.mean(axis=0), 2).tolist()}, beyond 3 sd:"
        f" {np.mean(np.abs(pulled) > 3):.1%};"
        f" {np.median(seconds):.1f} s\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
