"""Profile points per second of the simulated optics, two rays a point, on 100 000 faces.

Counted are measured points only: beams that met the part, were in range and bright enough, and
whose second ray reached the camera. Noise, outliers and quantisation are on. Process time counts
every thread. Run: python benchmarks/optics.py [rings]
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


def bench(cloud_width_mm: float) -> OpticalBench:
    """A vase that fills the field of view."""
    flaws = Flaws(cloud_width_mm=cloud_width_mm, outlier_rate=1e-3 if cloud_width_mm else 0.0)
    return OpticalBench(vase(), OpticsSettings(sensor=Sensor(width_mm=45.0), flaws=flaws))


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


if __name__ == "__main__":
    main()
