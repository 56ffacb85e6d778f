"""What the whole chain, from a cloud to the surface, makes of exact and of nearly exact parts.

    python -m tests.campaigns.exact_chain [--seeds 10] [--only TABLE ...]

Tables::

    cylinder    D 100 mm, H 100 mm, 1 000 000 points, sigma 0.2 mm, a fifth of the side missing:
                radial rms of the mesh outside the gaps and inside, mm
    apex        a cone of 0.3 rad, 100 mm high, 100 000 points even over its area, sigma 0.2 mm in
                every direction: error of the tip over its reported standard deviation, and that
                over the least one possible (Cramer-Rao, six figures, all points)
    rows        the same cone in 100 rows of 1000 points, sigma 0.05 mm in their planes: there the
                slices themselves reach the tip, and a free surface runs out in it, too
    wrong       parts that are nearly a cylinder, 200 000 points: how many are claimed to be one

Each with exact shapes and with `--exact never` where that differs.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import Counter

import numpy as np

from benchmarks.surface.cases import cylinder
from benchmarks.surface.measures import mesh_of, side_errors_of
from loftscan import reconstruct
from loftscan.result import Result
from reconstruction.arrays import FloatArray
from tests.campaigns.recognising import NEAR, Pattern
from tests.reconstruction.exact_cases import Turned

TABLES = ("cylinder", "apex", "rows", "wrong")
SIGMA, ROW_SIGMA = 0.2, 0.05
HALF_ANGLE, HEIGHT = 0.3, 100.0
CONE_POINTS = 100_000
WRONG_POINTS = 200_000


def dented(depth: float, width: float) -> Pattern:
    """A cylinder with one round dent."""
    return lambda angle, z: (
        50.0
        - depth
        * np.exp(
            -((50.0 * (np.mod(angle, math.tau) - 3.0)) ** 2 + (z - 40.0) ** 2) / (2 * width**2)
        )
    )


def lobed(share: float, lobes: int) -> Pattern:
    """A cylinder whose radius waves around by a share of it, up and down together."""
    return lambda angle, z: 50.0 * (1.0 + 0.5 * share * np.cos(lobes * angle)) + 0.0 * z


WRONG: dict[str, Turned] = {
    **{name: part for name, (kind, part) in NEAR.items() if kind == "free"},
    "two lobes of 2 %": Turned(lobed(0.02, 2)),
    "seven lobes of 2 %": Turned(lobed(0.02, 7)),
    "three lobes of 0.2 %": Turned(lobed(0.002, 3)),
    "a dent of 1 mm, 10 mm wide": Turned(dented(1.0, 5.0)),
    "a dent of 0.3 mm, 20 mm wide": Turned(dented(0.3, 10.0)),
}


def cone_cloud(seed: int, *, rows: bool) -> tuple[FloatArray, FloatArray]:
    """Points of a cone with noise, shifted at random, and its apex."""
    rng = np.random.default_rng(seed)
    shift = rng.normal(0.0, 20.0, 3)
    clean = _cone_points(rng, rows=rows)
    noise = rng.normal(0.0, SIGMA, clean.shape)
    if rows:
        noise *= [ROW_SIGMA / SIGMA, ROW_SIGMA / SIGMA, 0.0]
    return clean + noise + shift, shift + np.array([0.0, 0.0, HEIGHT])


def _cone_points(rng: np.random.Generator, *, rows: bool) -> FloatArray:
    down = HEIGHT * np.sqrt(rng.random(CONE_POINTS))
    if rows:
        down = HEIGHT - np.repeat(np.arange(HEIGHT), CONE_POINTS // round(HEIGHT))
    angle = math.tau * rng.random(CONE_POINTS)
    radius = down * math.tan(HALF_ANGLE)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), HEIGHT - down])


def least_deviations(*, rows: bool) -> FloatArray:
    """The least standard deviations of the apex, (3,), that any unbiased fit of a cone can have."""
    points = _cone_points(np.random.default_rng(0), rows=rows)
    arms = points - [0.0, 0.0, HEIGHT]
    angle = np.arctan2(points[:, 1], points[:, 0])
    c, s = math.cos(HALF_ANGLE), math.sin(HALF_ANGLE)
    normals = np.column_stack([c * np.cos(angle), c * np.sin(angle), np.full(len(points), s)])
    lengths = np.linalg.norm(arms, axis=1)
    # The apex, a turn about x and about y through it, the half angle.
    slopes = np.column_stack([normals, np.cross(arms, normals)[:, :2], lengths])
    across = ROW_SIGMA * c if rows else SIGMA  # of noise in the rows, less points across the wall
    covariance = across**2 * np.linalg.inv(slopes.T @ slopes)
    return np.asarray(np.sqrt(covariance.diagonal()[:3]))


def apex_of(result: Result) -> tuple[FloatArray, FloatArray] | None:
    """The upper tip as metrics.json says it, and its standard deviations."""
    apexes = result.metrics["apexes"]
    assert isinstance(apexes, list)
    if len(apexes) != 1:
        return None
    return np.array(apexes[0]["point_mm"]), np.array(apexes[0]["point_sd_mm"])


def _cylinder(seeds: int) -> None:
    _say("\ncylinder: seed, kind, rms outside, inside, faces, seconds of processor")
    for exact in ("auto", "never"):
        rows = []
        for seed in range(seeds):
            case = cylinder(np.random.default_rng(seed))
            start = time.process_time()
            result = reconstruct(case.points_mm, method="fit", exact=exact)  # type: ignore[arg-type]
            seconds = time.process_time() - start
            mesh = mesh_of(result.mesh.vertices_mm, result.mesh.faces)
            errors = side_errors_of(mesh, case.gaps, seed=seed)
            rows.append((errors.outside_rms_mm, errors.inside_rms_mm, seconds))
            kind = result.shapes[0].kind if result.shapes[0] else "free"
            _say(
                f"{exact:6s} {seed:3d} {kind:9s} {rows[-1][0]:.5f} {rows[-1][1]:.5f} mm "
                f"{len(mesh.faces):6d} {seconds:.2f} s"
            )
        middle, worst = np.median(rows, axis=0), np.max(rows, axis=0)
        _say(f"{exact:6s} median {middle[0]:.5f} {middle[1]:.5f} mm {middle[2]:.2f} s")
        _say(f"{exact:6s} worst  {worst[0]:.5f} {worst[1]:.5f} mm {worst[2]:.2f} s")


def _apex(seeds: int, *, rows: bool = False) -> None:
    least = least_deviations(rows=rows)
    _say(f"\n{'rows' if rows else 'apex'}: least deviations possible {least.round(5)} mm")
    for exact in ("auto", "never"):
        pulls, shares = [], []
        for seed in range(seeds):
            points, true = cone_cloud(seed, rows=rows)
            result = reconstruct(points, method="fit", exact=exact)  # type: ignore[arg-type]
            kind = result.shapes[0].kind if result.shapes[0] else "free"
            found = apex_of(result)
            if found is None:
                _say(f"{exact:6s} {seed:3d} {kind:9s} no tip: {result.metrics['apexes']}")
                continue
            pulls.append((found[0] - true) / found[1])
            shares.append(found[1] / least)
            _say(
                f"{exact:6s} {seed:3d} {kind:9s} error {(found[0] - true).round(4)} mm, over "
                f"deviation {pulls[-1].round(2)}, deviation over least {shares[-1].round(2)}"
            )
        if pulls:
            rms = math.sqrt(float(np.mean(np.square(pulls))))
            _say(
                f"{exact:6s} {len(pulls)} of {seeds} with a tip: greatest error "
                f"{np.abs(pulls).max():.2f} deviations, rms {rms:.2f}"
                f"; greatest deviation {np.max(shares):.2f} of the least, median "
                f"{np.median(shares):.2f}"
            )


def _rows(seeds: int) -> None:
    _apex(seeds, rows=True)


def _wrong(seeds: int) -> None:
    _say(f"\nnearly a cylinder, {seeds} seeds of {WRONG_POINTS} points, sigma {SIGMA:g} mm")
    for name, part in WRONG.items():
        kinds: Counter[str] = Counter()
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            clean = part.drawn(rng, WRONG_POINTS)
            result = reconstruct(clean + rng.normal(0.0, SIGMA, clean.shape), method="fit")
            kinds.update(shape.kind if shape else "free" for shape in result.shapes)
        _say(f"{name:32s} {dict(kinds)}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="+", choices=TABLES, default=TABLES)
    options = parser.parse_args()
    tables = {"cylinder": _cylinder, "apex": _apex, "rows": _rows, "wrong": _wrong}
    for name in options.only:
        tables[name](options.seeds)


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
