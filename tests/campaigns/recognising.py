"""How often exact shapes are found where there is one, and claimed where there is none.

    python -m tests.campaigns.recognising [--seeds 100] [--points 20000]

Every seed turns and moves the part at random. A deviation is measured in standard deviations of
its own amplitude, as the best linear estimator that knows its pattern has it: what lies below some
four of them nobody can tell from noise at one false alarm in ten thousand.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Callable

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.recognition import recognised
from tests.reconstruction.exact_cases import PATCHES, STRIP, Ball, Board, Part, Turned, scanned

Pattern = Callable[[FloatArray, FloatArray], FloatArray]

SIZES = (3.0, 5.0, 7.0, 10.0)  # standard deviations


def steady(radius: float) -> Pattern:
    """A cylinder's radius."""
    return lambda angle, _: np.full_like(angle, radius)


def vase(angle: FloatArray, z: FloatArray) -> FloatArray:
    """A wall with a belly and a neck."""
    return np.asarray(40.0 + 8.0 * np.sin(z / 18.0) + 0.0 * angle)


def tapered(slope: float) -> Pattern:
    """A cone's radius."""
    return lambda _, z: 20.0 + slope * z


TRUE: dict[str, tuple[str, Part]] = {
    "cylinder": ("cylinder", Turned(steady(50.0))),
    "cylinder, strip and patches missing": (
        "cylinder",
        Turned(steady(50.0), gaps=STRIP + PATCHES),
    ),
    "cylinder, 120 deg": ("cylinder", Turned(steady(50.0), turn=math.tau / 3)),
    "cylinder, 8 mm high": ("cylinder", Turned(steady(50.0), height=8.0, slices=8)),
    "cylinder, radius 3": ("cylinder", Turned(steady(3.0), height=20.0, columns=24)),
    "cone": ("cone", Turned(tapered(0.3))),
    "cone, 120 deg": ("cone", Turned(tapered(0.3), turn=math.tau / 3)),
    "cone, 10 mm high": ("cone", Turned(tapered(0.3), height=10.0, slices=10)),
    "cone with its apex": (
        "cone",
        Turned(lambda _, z: 0.3 * (100.0 - z), by_area=True, slices=50),
    ),
    "sphere": ("sphere", Ball()),
    "sphere, upper third": ("sphere", Ball(low=0.3)),
    "plane": ("plane", Board()),
    "vase": ("revolution", Turned(vase, slices=50)),
    "vase, 120 deg": ("revolution", Turned(vase, turn=math.tau / 3, slices=50)),
}

PATTERNS: dict[str, Pattern] = {
    "oval": lambda angle, _: np.cos(2 * angle),
    "oval that turns": lambda angle, z: np.cos(2 * angle) * (z - 50.0) / 50.0,
    "three lobes": lambda angle, _: np.cos(3 * angle),
    "seven lobes": lambda angle, _: np.cos(7 * angle),
    "bent": lambda angle, z: np.cos(angle) * ((z - 50.0) / 50.0) ** 2,
    "barrel": lambda _, z: ((z - 50.0) / 50.0) ** 2,
    "dent of 15 mm": lambda angle, z: np.exp(
        -(((50.0 * (angle - 3.0)) ** 2 + (z - 40.0) ** 2) / 112.5)
    ),
}


def claimed(part: Part, points: int, seed: int) -> str:
    """What a scan of the part is taken for, "free" where it is for none."""
    scan = scanned(part, points, seed, level_only=isinstance(part, Ball))
    misfit, edf = scan.free()
    shape = recognised(
        scan.moments, scan.variances_mm2(), free_misfit=misfit, free_edf=edf,
        noise_covariance_mm2=scan.noise_mm2,
    )  # fmt: skip
    return "free" if shape is None else shape.kind


def deviating(pattern: Pattern, size: float, points: int, *, sigma: float = 0.2) -> Turned:
    """A cylinder whose radius deviates by so many standard deviations of the amplitude."""
    rng = np.random.default_rng(0)
    angle, z = math.tau * rng.random(20_000), 100.0 * rng.random(20_000)
    lean = (z - 50.0) / 50.0
    own = np.column_stack(
        [np.ones(len(z)), np.cos(angle), np.sin(angle), lean * np.cos(angle), lean * np.sin(angle)]
    )
    values = pattern(angle, z)
    left = values - own @ np.linalg.lstsq(own, values, rcond=None)[0]
    amplitude = size * sigma / math.sqrt(points * float((left**2).mean()))
    return Turned(lambda at, level: 50.0 + amplitude * pattern(np.mod(at, math.tau), level))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--points", type=int, default=20_000)
    options = parser.parse_args()
    _say(f"{options.seeds} seeds of {options.points} points, sigma 0.2 mm")
    for name, (kind, part) in TRUE.items():
        found = Counter(claimed(part, options.points, seed) for seed in range(options.seeds))
        others = {other: count for other, count in found.items() if other != kind}
        _say(f"{name:38s} found {found[kind]:4d}   else {others or ''}")
    _say(f"\na cylinder that deviates, claimed as one, at standard deviations of {SIZES}")
    for name, pattern in PATTERNS.items():
        counts = []
        for size in SIZES:
            part = deviating(pattern, size, options.points)
            kinds = [claimed(part, options.points, seed) for seed in range(options.seeds)]
            counts.append(kinds.count("cylinder"))
        _say(f"{name:20s}" + "".join(f"{count:6d}" for count in counts))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
