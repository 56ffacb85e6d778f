"""Profile points per second of the simulated optics, two rays a point, on 100 000 faces.

Counted are measured points only: beams that met the part, were in range and bright enough, and
whose second ray reached the camera. Quantisation is always on, noise and outliers where it says so.
Process time counts every thread. The last two lines are what a live station asks for: one profile
at a time, in another pose each time. Run: python benchmarks/optics.py [rings]
"""

from __future__ import annotations

import math
import statistics
import sys
import time

import numpy as np

from sim import Flaws, OpticalBench, OpticsSettings, SeedKey, Sensor
from sim.parts import vase

RUNS = 7
PROFILES = 360
TARGET = 3.0e6
LOOKS = 200
LOOK_POINTS = 800
LOOK_TARGET_S = 0.6e-3


def bench(cloud_width_mm: float, points: int = 1280) -> OpticalBench:
    """A vase that fills the field of view."""
    flaws = Flaws(cloud_width_mm=cloud_width_mm, outlier_rate=1e-3 if cloud_width_mm else 0.0)
    sensor = Sensor(width_mm=45.0, points=points)
    return OpticalBench(vase(), OpticsSettings(sensor=sensor, flaws=flaws))


def rate(subject: OpticalBench, rings: int) -> tuple[float, float]:
    """Measured points and beams, each per second of process time."""
    turn_rad = np.arange(PROFILES) * (math.tau / PROFILES)
    measured = beams = 0
    seconds = 0.0
    for ring in range(rings):
        keys = [SeedKey(ring, number) for number in range(PROFILES)]
        begun_s = time.process_time()
        profiles = subject.profiles(turn_rad, 10.0 + 80.0 * ring / rings, keys)
        seconds += time.process_time() - begun_s
        measured += sum(int(profile.seen.sum()) for profile in profiles)
        beams += PROFILES * subject.settings.sensor.points
    return measured / seconds, beams / seconds


def look_s(subject: OpticalBench, lift_mm: float) -> float:
    """Process time of one profile after the table, and perhaps the stage, has moved."""
    begun_s = time.process_time()
    for number in range(LOOKS):
        subject.profile(0.1 * number, 20.0 + lift_mm * number, SeedKey(0, number))
    return (time.process_time() - begun_s) / LOOKS


def main() -> None:
    """Print the medians."""
    rings = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    print(f"vase, {len(vase().faces)} faces, {rings} rings of {PROFILES} profiles, {RUNS} runs")
    for name, width_mm in (("faultless", 0.0), ("noise and outliers", 0.1)):
        subject = bench(width_mm)
        rate(subject, 1)
        runs = [rate(subject, rings) for _ in range(RUNS)]
        measured, beams = (statistics.median(column) for column in zip(*runs, strict=True))
        best = max(run[0] for run in runs)
        verdict = "reached" if measured >= TARGET else "MISSED"
        print(
            f"{name:20s} {measured / 1e6:5.2f} M measured points/s ({beams / 1e6:5.2f} M beams/s),"
            f" best {best / 1e6:.2f} M;"
            f" {TARGET / 1e6:g} M {verdict}"
        )
    subject = bench(0.1, LOOK_POINTS)
    for name, lift_mm in (("one, table turned", 0.0), ("one, stage lifted", 0.3)):
        seconds = statistics.median(look_s(subject, lift_mm) for _ in range(RUNS))
        verdict = "reached" if seconds <= LOOK_TARGET_S else "MISSED"
        print(
            f"{name:20s} {seconds * 1e3:5.3f} ms a profile of {LOOK_POINTS} points;"
            f" {LOOK_TARGET_S * 1e3:g} ms {verdict}"
        )


if __name__ == "__main__":
    main()
