"""How often exact shapes are found where there is one, and claimed where there is none.

    python -m tests.campaigns.recognising [--seeds 100] [--points 20000] [--only TABLE ...]
                                          [--alone]

Tables: "true" parts, cylinders that "deviate" a little, parts that are "near" an exact shape, the
"gaps" of a cylinder, and the "pulls" of its figures and a cone's. With --alone no free surface is
there to judge by, as where a branch's outlines are looked at before one is fitted.

Every seed turns and moves the part at random. A deviation is measured in standard deviations of
its own amplitude, as the best linear estimator that knows its pattern has it: what lies below some
four of them nobody can tell from noise at one false alarm in ten thousand.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.primitives import Cone, Cylinder
from reconstruction.skinning.recognition import recognised
from tests.reconstruction.exact_cases import (
    PATCHES,
    STRIP,
    Ball,
    Board,
    Part,
    Scan,
    Turned,
    scanned,
)

Pattern = Callable[[FloatArray, FloatArray], FloatArray]

SIZES = (3.0, 5.0, 7.0, 10.0)  # standard deviations
TABLES = ("true", "deviate", "near", "gaps", "pulls")


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

_LOBED = 1.0 / (0.5 - math.log2(1.02))  # the exponent whose crests stand out by 2 %


def superformula(angle: FloatArray, _: FloatArray) -> FloatArray:
    """Gielis's formula of six crests, all three exponents alike: 50 .. 51 mm."""
    turn = 1.5 * angle
    sums = np.abs(np.cos(turn)) ** _LOBED + np.abs(np.sin(turn)) ** _LOBED
    return np.asarray(50.0 * sums ** (-1.0 / _LOBED))


def elliptic(angle: FloatArray, _: FloatArray) -> FloatArray:
    """An ellipse of half axes 50.5 and 50 mm."""
    return np.asarray(50.0 * 50.5 / np.hypot(50.0 * np.cos(angle), 50.5 * np.sin(angle)))


def barrel(angle: FloatArray, z: FloatArray) -> FloatArray:
    """A wall whose middle bulges by 0.5 mm."""
    return np.asarray(50.0 + 0.5 * (1.0 - ((z - 50.0) / 50.0) ** 2) + 0.0 * angle)


NEAR: dict[str, tuple[str, Part]] = {
    "superformula, 2 % lobes": ("free", Turned(superformula)),
    "cylinder, 1 % elliptic": ("free", Turned(elliptic)),
    "barrel, 1 % bulge": ("revolution", Turned(barrel)),
}


def shape_of(scan: Scan, *, alone: bool = False) -> Shape | None:
    """What a scan is taken for, beside a free surface or alone."""
    misfit, edf = (None, 0.0) if alone else scan.free()
    return recognised(
        scan.moments, scan.variances_mm2(), free_misfit=misfit, free_edf=edf,
        noise_covariance_mm2=scan.noise_mm2,
    )  # fmt: skip


def claimed(part: Part, points: int, seed: int, *, sigma: float = 0.2, alone: bool = False) -> str:
    """What a scan of the part is taken for, "free" where it is for none."""
    scan = scanned(part, points, seed, sigma=sigma, level_only=isinstance(part, Ball))
    shape = shape_of(scan, alone=alone)
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


def across_gaps(seed: int, *, alone: bool = False) -> tuple[float, float, float] | None:
    """Radial rms outside and inside the gaps, 3 .. 97 mm up, and the seconds it took.

    A cylinder of 100 mm across and 100 mm high, 1 000 000 points of 0.2 mm in the cutting planes, a
    strip and five patches missing.
    """
    gaps = STRIP + PATCHES
    part = Turned(steady(50.0), gaps=gaps, slices=200, columns=400)
    scan = scanned(part, 1_000_000, seed, level_only=True)
    misfit, edf = (None, 0.0) if alone else scan.free()
    variances = scan.variances_mm2()
    start = time.process_time()
    shape = recognised(
        scan.moments, variances, free_misfit=misfit, free_edf=edf,
        noise_covariance_mm2=scan.noise_mm2,
    )  # fmt: skip
    seconds = time.process_time() - start
    if shape is None or shape.kind != "cylinder":
        return None
    angle, z = (grid.ravel() for grid in np.meshgrid(
        np.linspace(0.0, math.tau, 720, endpoint=False), np.linspace(3.0, 97.0, 189)
    ))  # fmt: skip
    places = scan.placed(np.column_stack([50.0 * np.cos(angle), 50.0 * np.sin(angle), z]))
    squares = shape.form.measure(places).distances_mm ** 2
    inside = np.zeros(len(z), np.bool_)
    for start_rad, end_rad, low, high in gaps:
        inside |= (angle > start_rad) & (angle < end_rad) & (z > low) & (z < high)
    outer, inner = math.sqrt(squares[~inside].mean()), math.sqrt(squares[inside].mean())
    return outer, inner, seconds


def pulls(
    scan: Scan, radius_at: Callable[[float], float], slope: float, *, alone: bool = False
) -> FloatArray | None:
    """Errors over deviations: offsets, tilts, radius, and a cone's half angle, (5,) or (6,).

    None where the scan is taken for something else.

    The true axis is sought in the found form's frame, by plain geometry.

    Parameters
    ----------
    radius_at
        The true radius at a height.
    slope
        Its rise, 0 for a cylinder.
    """
    shape = shape_of(scan, alone=alone)
    if shape is None or not isinstance(shape.form, Cone if slope else Cylinder):
        return None
    form, frame = shape.form, shape.form.frame
    axis = scan.turn[:, 2]
    up = float(axis @ frame.axes[2])
    origin = frame.axes @ (scan.shift_mm - frame.origin_mm)
    way = frame.axes @ axis / up
    offset = origin - origin[2] * way
    height = float((frame.origin_mm - scan.shift_mm) @ axis)
    true = [*offset[:2], *way[:2], radius_at(height) - form.radius_mm]
    if isinstance(form, Cone):
        true.append(math.atan(math.copysign(slope, up * slope)) - form.half_angle_rad)
    return np.asarray(np.array(true) / shape.deviations)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--only", nargs="+", choices=TABLES, default=TABLES)
    options = parser.parse_args()
    tables = {"true": _true, "deviate": _deviate, "near": _near, "gaps": _gaps, "pulls": _pulls}
    for name in options.only:
        tables[name](options.seeds, options.points, options.alone)


def _true(seeds: int, points: int, alone: bool) -> None:  # noqa: FBT001
    _say(f"\n{seeds} seeds of {points} points, sigma 0.2 mm")
    for name, (kind, part) in TRUE.items():
        _say_claims(
            name, kind, Counter(claimed(part, points, seed, alone=alone) for seed in range(seeds))
        )


def _deviate(seeds: int, points: int, alone: bool) -> None:  # noqa: FBT001
    _say(f"\na cylinder that deviates, claimed as one, at standard deviations of {SIZES}")
    for name, pattern in PATTERNS.items():
        counts = []
        for size in SIZES:
            part = deviating(pattern, size, points)
            kinds = [claimed(part, points, seed, alone=alone) for seed in range(seeds)]
            counts.append(kinds.count("cylinder"))
        _say(f"{name:20s}" + "".join(f"{count:6d}" for count in counts))


def _near(seeds: int, points: int, alone: bool) -> None:  # noqa: FBT001
    _say(f"\nno cylinder, {seeds} seeds of {points} points")
    for name, (kind, part) in NEAR.items():
        for sigma in (0.1, 0.15, 0.2):
            kinds = Counter(
                claimed(part, points, seed, sigma=sigma, alone=alone) for seed in range(seeds)
            )
            _say_claims(f"{name}, sigma {sigma:g}", kind, kinds)


def _gaps(seeds: int, _: int, alone: bool) -> None:  # noqa: FBT001
    _say("\na cylinder of 1 000 000 points with gaps: rms outside, inside, seconds")
    rows = [across_gaps(seed, alone=alone) for seed in range(min(seeds, 10))]
    found = np.array([row for row in rows if row is not None])
    _say(f"found {len(found)} of {len(rows)}")
    for name, row in (("median", np.median(found, axis=0)), ("worst", found.max(axis=0))):
        _say(f"{name:8s} {row[0]:.5f} mm   {row[1]:.5f} mm   {row[2]:.2f} s")


def _pulls(seeds: int, points: int, alone: bool) -> None:  # noqa: FBT001
    _say("\nmean square of error over deviation, share beyond 3, by figure")
    for name, slope, radius in (("cylinder", 0.0, 50.0), ("cone", 0.3, 20.0)):

        def radius_at(z: float, slope: float = slope, radius: float = radius) -> float:
            return radius + slope * z

        part = Turned(steady(radius) if name == "cylinder" else tapered(slope))
        rows = [
            pulls(scanned(part, points, seed), radius_at, slope, alone=alone)
            for seed in range(seeds)
        ]
        found = np.array([row for row in rows if row is not None])
        squares = "".join(f"{square:6.2f}" for square in (found**2).mean(axis=0))
        overall, beyond = float((found**2).mean()), float((np.abs(found) > 3.0).mean())
        _say(f"{name:10s} {len(found):4d} found{squares}   all {overall:.3f}   {beyond:.4f}")


def _say_claims(name: str, kind: str, found: Counter[str]) -> None:
    others = {other: count for other, count in found.items() if other != kind}
    _say(f"{name:38s} {kind:10s} {found[kind]:4d}   else {others or ''}")


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
