"""A scan as it streams in: seconds from the last slice to the mesh, and the most memory.

    python benchmarks/streaming.py [--slices N] [--points N] [--shapes NAME ...] [--exact E]

Every slice of a part has 360 profiles of 1280 points in no order. The parts: a circle, an ellipse,
and five lobes that grow with the height (a superformula's, as in `benchmarks/sections.py`). Slices
are fed to the course of ``--method fit`` as fast as it takes them; the kernels are warm, as they
are at the station. What is told is wall time; processor time of the whole process stands beside it,
for a machine that is busy.

Honest about the points: the angles and the noise of all slices come from one table of random
numbers, turned by another offset for each slice (independent draws would take longer than the
fitting). Each slice sees its own noise at each place, but after some hundred slices combinations
of angle and noise come near to ones that were there before.

"After the last slice" is everything from the return of the last `draw` to the mesh, without the
cleanup by pymeshlab and without writing files. Memory is the process's VmHWM above what was
resident after the imports; the table of random numbers and the slice itself (21 MB together) are
in it, as a station's buffers would be.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loftscan.reconstructing import Method, Settings
from loftscan.warming import warm_up
from reconstruction import fit_pipeline
from reconstruction.cleanup import CleanupSettings
from reconstruction.course import OF_A_CLOUD
from reconstruction.fitting.curve import Exact
from reconstruction.nurbs import Surface, evaluate_surface_at
from reconstruction.skinning import skin, surfacing, tensor_fit
from reconstruction.slices import Frame, Slice

Array = NDArray[np.float64]

SLICES, POINTS = 500, 360 * 1280
RADIUS_MM, HEIGHT_MM, SIGMA_MM = 50.0, 100.0, 0.2
FIRST, OTHERS = 3.0, 6.0  # exponents of the superformula

# What is timed apart: where it is called, and under what name it is told.
PARTS = (
    (surfacing, "find_branches", "branches"),
    (skin, "align", "align"),
    (skin, "lay_net", "lay"),
    (tensor_fit, "do_round", "rounds"),
    (surfacing, "closed_mesh", "tessellate"),
    (surfacing, "join_solids", "join"),
    (fit_pipeline, "clean", "cleanup"),
)


def circle(turn: Array) -> tuple[Array, Array]:
    """Radius at the bottom, and what is added up to the top; shares of the mean radius."""
    return np.ones_like(turn), np.zeros_like(turn)


def ellipse(turn: Array) -> tuple[Array, Array]:
    """Twice as long as wide, growing by a tenth."""
    radius = 1.0 / np.hypot(np.cos(turn) / 1.2, np.sin(turn) / 0.6)
    return radius, 0.1 * radius


def lobes(turn: Array) -> tuple[Array, Array]:
    """A circle at the bottom, the five lobes of a superformula at the top."""
    sides = np.abs(np.cos(1.25 * turn)) ** OTHERS + np.abs(np.sin(1.25 * turn)) ** OTHERS
    form = sides ** (-1.0 / FIRST)
    return np.ones_like(turn), form / form.mean() - 1.0


SHAPES: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "circle": circle,
    "ellipse": ellipse,
    "lobes": lobes,
}


def slices_of(name: str, slices: int, points: int) -> Iterator[Slice]:
    """Slices of a part, one after the other."""
    rng = np.random.default_rng(0)
    turn = rng.uniform(0.0, math.tau, points)
    bottom, added = SHAPES[name](turn)
    ways = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    noise = rng.normal(0.0, SIGMA_MM, points)
    for index in range(slices):
        share = index / max(slices - 1, 1)
        height = HEIGHT_MM * share
        radius = RADIUS_MM * (bottom + share * added)
        places = np.empty((points, 3))
        offset = int(rng.integers(points))
        for d in range(2):
            np.multiply(radius, ways[:, d], out=places[:, d])
            places[:, d] += np.roll(noise, offset * (d + 1))
        places[:, 2] = height
        yield Slice(index, places, Frame(np.array([0.0, 0.0, height]), np.eye(3)))


class Watch:
    """Adds up the wall time of functions where they are called."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)

    def over(self, home: ModuleType, name: str, part: str) -> None:
        """Put a timed function in a function's place."""
        inner = getattr(home, name)

        def timed(*args: Any, **options: Any) -> Any:  # noqa: ANN401 (of any function)
            begun = time.perf_counter()
            try:
                return inner(*args, **options)
            finally:
                self.seconds[part] += time.perf_counter() - begun
                self.calls[part] += 1

        setattr(home, name, timed)


def status_mb(field: str) -> float:
    """A line of the process's status."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field + ":"))


def run(name: str, slices: int, points: int, exact: Exact) -> dict[str, Any]:
    """Stream one part; to be called in a fresh process."""
    resident = status_mb("VmRSS")
    warm_up(Settings(method=Method.FIT))
    course = fit_pipeline.FitCourse(exact, CleanupSettings())
    begun = time.perf_counter()
    for piece in slices_of(name, slices, points):
        course.draw(piece)
    drawn = time.perf_counter() - begun
    while_drawing = status_mb("VmHWM") - resident
    watch = Watch()
    for part in PARTS:
        watch.over(*part)
    begun, cpu = time.perf_counter(), time.process_time()
    made = course.finish([], OF_A_CLOUD)
    cleanup = watch.seconds.pop("cleanup")
    rounds = watch.calls["rounds"]
    return {
        "slices": slices,
        "drawn_s": drawn,
        "after_s": time.perf_counter() - begun - cleanup,
        "after_cpu_s": time.process_time() - cpu,
        "parts_s": dict(watch.seconds),
        "rounds": rounds,
        "nets": [list(each.surface.control_points_mm.shape[:2]) for each in made.skinned.skins],
        "edf": [
            each.fit.edf if isinstance(each, skin.Skin) else each.shape.freedom
            for each in made.skinned.skins
        ],
        "off_mm": off_mm(name, made.skinned.skins[0].surface),
        "while_drawing_mb": while_drawing,
        "above_imports_mb": status_mb("VmHWM") - resident,
    }


def off_mm(name: str, surface: Surface) -> float:
    """Root mean square distance, along radii, of the surface from the truth."""
    ends = [
        (knots[degree], knots[-1 - degree])
        for knots, degree in (
            (surface.knots_u, surface.degree_u),
            (surface.knots_v, surface.degree_v),
        )
    ]
    shares = np.meshgrid(np.arange(400) / 400, np.linspace(0.02, 0.98, 200))
    u, v = (
        low + (high - low) * each.ravel() for each, (low, high) in zip(shares, ends, strict=True)
    )
    x, y, z = evaluate_surface_at(surface, u, v).T
    turn = np.arctan2(y, x)
    fine = np.linspace(-math.pi, math.pi, 40_001)
    bottom, added = (np.interp(turn, fine, each) for each in SHAPES[name](fine))
    truth = RADIUS_MM * (bottom + z / HEIGHT_MM * added)
    return float(np.sqrt(np.mean((np.hypot(x, y) - truth) ** 2)))


def told(name: str, found: dict[str, Any]) -> Iterator[str]:
    """A run in words."""
    parts = " ".join(f"{part} {seconds:.2f}" for part, seconds in found["parts_s"].items())
    nets = ", ".join(f"{a} x {b}" for a, b in found["nets"])
    yield (
        f"{name:9} {found['slices']:4} slices drawn in {found['drawn_s']:6.1f} s; "
        f"after the last {found['after_s']:5.2f} s ({found['after_cpu_s']:.2f} s of the processor)"
    )
    yield f"{'':10}{parts}; {found['rounds']} rounds, net {nets}, {sum(found['edf']):.0f} freedoms"
    yield (
        f"{'':10}{found['off_mm']:.4f} mm off; {found['while_drawing_mb']:.0f} MB above imports "
        f"while slices came, {found['above_imports_mb']:.0f} MB in all"
    )


def main() -> None:
    """Run what was asked for, each part in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slices", type=int, default=SLICES)
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--shapes", nargs="+", choices=list(SHAPES), default=list(SHAPES))
    parser.add_argument("--exact", choices=[each.value for each in Exact], default="auto")
    parser.add_argument("--json", action="store_true", help="of one shape, in this process")
    asked = parser.parse_args()
    if asked.json:
        print(json.dumps(run(asked.shapes[0], asked.slices, asked.points, Exact(asked.exact))))
        return
    # Kernels are compiled in another process: that takes more memory than anything here.
    rehearsal = [sys.executable, __file__, "--json", "--shapes", "lobes", "--slices", "12",
                 "--points", "20000"]  # fmt: skip
    subprocess.run(rehearsal, capture_output=True, check=True)
    print("bounds: 2 s after the last slice, 400 MB above imports")
    for name in asked.shapes:
        command = [sys.executable, __file__, "--json", "--shapes", name, "--exact", asked.exact,
                   "--slices", str(asked.slices), "--points", str(asked.points)]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{name}: failed: {done.stderr.strip().splitlines()[-1]}")
            continue
        for line in told(name, json.loads(done.stdout.splitlines()[-1])):
            print(line, flush=True)


if __name__ == "__main__":
    main()
