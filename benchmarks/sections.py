"""One section: our fit beside the best fixed number of control points, the floor and the peers.

    python benchmarks/sections.py [floor] [recognised] [honesty] [speed] [peers] [--seeds N]

Points at arc-uniform random places of the true outline, isotropic Gaussian noise, shuffled. The
chain is crude and told the order: means of the points in a hundred even pieces of the true length.
Each column says what it must not exceed. The paper's method on a circle of 50 mm, band 2 mm, 40
points a mm, leaves 0.167 mm rms (docs/paper). Peers' outlines are read from LOFTSCAN_DATA.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from reconstruction.fitting.bands import factorise, solve
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.preliminary import normal_equations
from reconstruction.fitting.section_fit import fit_chain, fit_ordered

Array = NDArray[np.float64]
DATA = Path(os.environ.get("LOFTSCAN_DATA", Path(__file__).resolve().parents[2] / "shared/data"))
PIECES, SAMPLES = 120, 4000
SWEPT = {"circle": range(5, 16), "ellipse": range(10, 32, 2), "superformula": range(40, 120, 5),
         "blob2": range(24, 100, 4), "simple": range(16, 80, 3)}  # fmt: skip
EVEN = np.arange(SAMPLES) / SAMPLES


class Outline:
    """A closed dense polyline, parametrised by its length."""

    def __init__(self, corners_mm: Array) -> None:
        steps = np.linalg.norm(np.diff(corners_mm, axis=0), axis=1)
        self.corners_mm = corners_mm
        self.shares = np.concatenate([[0.0], steps.cumsum()]) / steps.sum()
        self.centre_mm = corners_mm[:-1].mean(axis=0)
        self._tree = cKDTree(corners_mm[:-1])

    def __call__(self, share: Array) -> Array:
        """Places at shares of the length."""
        return np.column_stack([np.interp(share, self.shares, axis) for axis in self.corners_mm.T])

    def distances_mm(self, places: Array) -> Array:
        """Distances to the two segments beside the nearest corner."""
        _, nearest = self._tree.query(places)
        count = len(self.corners_mm) - 1
        best = np.full(len(places), np.inf)
        for before in (-1, 0):
            a = self.corners_mm[(nearest + before) % count]
            way = self.corners_mm[(nearest + before) % count + 1] - a
            share = ((places - a) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300)
            off = places - a - np.clip(share, 0, 1)[:, None] * way
            best = np.minimum(best, np.linalg.norm(off, axis=1))
        return best


def outlines() -> dict[str, Outline]:
    """The five shapes, as far as the data are there."""
    turn = np.linspace(0, 2 * np.pi, 40_001)
    unit = np.column_stack([np.cos(turn), np.sin(turn)])
    radius = (np.cos(1.25 * turn) ** 6 + np.sin(1.25 * turn) ** 6) ** (-1 / 3)
    radius *= 50 / radius[:-1].mean()
    shapes = {
        "circle": Outline(50 * unit),
        "ellipse": Outline(unit * [60, 30]),
        "superformula": Outline(radius[:, None] * unit),
    }
    for name in ("blob2", "simple"):
        path = DATA / "curves" / f"{name}.npz"
        if path.is_file():
            corners = read_outline(path)
            shapes[name] = Outline(corners * 100 / np.ptp(corners, axis=0).max())
    return shapes


def read_outline(path: Path) -> Array:
    """Read a true outline, counter-clockwise and closed."""
    stored = np.load(path)
    corners = np.concatenate([stored[key] for key in stored if key != "closed"])
    corners = corners[:-1] if np.allclose(corners[0], corners[-1]) else corners
    x, y = corners.T
    left = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) > 0
    corners = corners if left else corners[::-1]
    return np.vstack([corners, corners[:1]])


def akin(count: int, neighbours: int, rng: np.random.Generator) -> Array:
    """Unit noise, a moving mean over so many neighbours in the outline's order."""
    sums = np.vstack([np.zeros(2), rng.normal(size=(count + neighbours - 1, 2))]).cumsum(axis=0)
    return (sums[neighbours:] - sums[:-neighbours]) / np.sqrt(neighbours)


def crude_chain(points: Array, share: Array, sigma: float) -> Chain:
    """Means of even pieces of the true length; empty pieces are gaps."""
    at = np.minimum((share * PIECES).astype(np.int64), PIECES - 1)
    filled = np.unique(at)
    nodes = np.array([points[at == piece].mean(axis=0) for piece in filled])
    gaps = np.flatnonzero(np.diff(filled, append=filled[0] + PIECES) > 1)
    sigmas = np.full(len(nodes), sigma)
    return Chain(nodes, sigmas, closed=True, gaps=tuple(int(i) for i in gaps))


def evenly(curve: FittedCurve) -> tuple[Array, Array]:
    """Places along a curve and the length each stands for, over the whole."""
    places = curve(EVEN)
    steps = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    lengths = steps + np.roll(steps, -1)
    return places, lengths / lengths.sum()


def rms_mm(curve: FittedCurve, outline: Outline) -> float:
    """Distance to the truth, root mean square over arc length."""
    places, lengths = evenly(curve)
    return float(np.sqrt((lengths * outline.distances_mm(places) ** 2).sum()))


def drawn(outline: Outline, seed: int, *, count: int = 2000, sigma: float = 0.5) -> tuple:
    """Points in order and their shares."""
    rng = np.random.default_rng(seed)
    share = np.sort(rng.random(count))
    return outline(share) + rng.normal(0, sigma, (count, 2)), share, rng


def oracle_mm(points: Array, share: Array, count: int, outline: Outline) -> float:
    """Periodic least squares with `count` control points at the true arc length."""
    band, right = normal_equations(share * count, points, count, closed=True)
    control = solve(*factorise(band), right)
    spline = BSpline(np.arange(-3.0, count + 4), np.vstack([control, control[:3]]), 3)
    places = spline(EVEN * count)
    steps = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    lengths = steps + np.roll(steps, -1)
    return float(np.sqrt((lengths * outline.distances_mm(places) ** 2).sum() / lengths.sum()))


def floor_table(shapes: dict[str, Outline], seeds: int) -> Iterator[str]:
    """Automatic beside the best fixed number of control points."""
    yield f"Floor: N = 2000, sigma = 0.5 mm, {seeds} seeds, exact=never; rms in mm"
    yield f"{'':14}{'best P':>7}{'best':>8}{'ours':>8}{'ratio':>7}{'median':>8}{'worst':>7}  bounds"
    for name, outline in shapes.items():
        clouds = [drawn(outline, seed) for seed in range(seeds)]
        swept = {
            count: np.array([oracle_mm(p, s, count, outline) for p, s, _ in clouds])
            for count in SWEPT[name]
        }
        count = min(swept, key=lambda key: float((swept[key] ** 2).sum()))
        best = swept[count]
        curves = [
            fit_chain(rng.permutation(points), crude_chain(points, share, 0.5), exact=Exact.NEVER)
            for points, share, rng in clouds
        ]
        ours = np.array([rms_mm(curve, outline) for curve in curves])
        ratio = np.sqrt((ours**2).sum() / (best**2).sum())
        bound = "1.15" if name == "blob2" else "1.08"
        yield (
            f"{name:14}{count:7d}{np.sqrt((best**2).mean()):8.4f}{np.sqrt((ours**2).mean()):8.4f}"
            f"{ratio:7.3f}{np.median(ours / best):8.3f}{(ours / best).max():7.3f}"
            f"  {bound} 1.06 1.30"
        )


def recognised_table(shapes: dict[str, Outline], seeds: int) -> Iterator[str]:
    """Exact shapes at their own floor."""
    yield f"Recognised: N = 2000, sigma = 0.5 mm, {seeds} seeds; bound 1.10 of the floor"
    for name, freedom in (("circle", 3), ("ellipse", 5)):
        curves = []
        for seed in range(seeds):
            points, share, rng = drawn(shapes[name], seed)
            curves.append(fit_chain(rng.permutation(points), crude_chain(points, share, 0.5)))
        rms = np.sqrt(np.mean([rms_mm(curve, shapes[name]) ** 2 for curve in curves]))
        least = 0.5 * np.sqrt(freedom / 2000)
        found = sum(curve.kind == name for curve in curves)
        yield f"{name:14}{found}/{seeds} recognised, rms {rms:.4f}, over floor {rms / least:.3f}"
    claimed = 0
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        share = np.sort(rng.random(2000))
        radius = 50 * (1 + 0.02 * np.cos(10 * np.pi * share))
        turn = 2 * np.pi * share
        places = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        points = places + rng.normal(0, 0.1, (2000, 2))
        claimed += fit_chain(points, crude_chain(points, share, 0.1)).kind != "free"
    yield f"2 % lobes at 0.1 mm claimed exact: {claimed}/{seeds} (at most 1 in 100)"


def honesty_table(shapes: dict[str, Outline], seeds: int) -> Iterator[str]:
    """How often the 95 % band covers the truth."""
    yield f"Honesty: {seeds} seeds, exact=never; % of curve points covered by the 95 % band"
    yield f"{'':14}{'white':>8}{'gap 20':>8}{'in gap':>8}{'half/rms':>9}{'akin 10':>9}"
    rows = []
    for name, outline in shapes.items():
        white = np.mean([coverage(outline, seed)[0] for seed in range(seeds)])
        gapped = np.array([coverage(outline, seed, gap_deg=20) for seed in range(seeds)])
        kin = np.mean([coverage(outline, seed, neighbours=10)[0] for seed in range(seeds)])
        away, inside, half, off = gapped.mean(axis=0)
        row = [100 * white, 100 * away, 100 * inside, np.sqrt(half / off), 100 * kin]
        rows.append(row)
        yield f"{name:14}" + "".join(f"{value:8.2f} " for value in row)
    yield f"{'pooled':14}" + "".join(f"{value:8.2f} " for value in np.mean(rows, axis=0))
    yield "bounds: 93..97 pooled, 91..97 each; in gap >= 90 pooled, half/rms <= 4; akin 90..97"


def coverage(
    outline: Outline, seed: int, *, gap_deg: float = 0.0, neighbours: int = 1
) -> tuple[float, float, float, float]:
    """Return shares covered away from and inside the gap, mean squares of half width and error."""
    rng = np.random.default_rng(1000 + seed)
    share = np.sort(rng.random(2000))
    points = outline(share) + 0.5 * akin(2000, neighbours, rng)
    start = rng.uniform(0, 360)

    def polar(places: Array) -> Array:
        arms = places - outline.centre_mm
        return np.mod(np.degrees(np.arctan2(arms[:, 1], arms[:, 0])) - start, 360)

    kept = polar(outline(share)) >= gap_deg
    points, share = points[kept], share[kept]
    chain = crude_chain(points, share, 0.5)
    curve = fit_chain(rng.permutation(points), chain, exact=Exact.NEVER)
    places, lengths = evenly(curve)
    off, half = outline.distances_mm(places), 1.96 * curve.deviation_mm(EVEN)
    sector = polar(places)
    inside = sector < gap_deg
    away = (sector > gap_deg + 3) & (sector < 357) if gap_deg else ~inside
    covered = np.average(off[away] <= half[away], weights=lengths[away])
    if not inside.any():
        return float(covered), np.nan, np.nan, np.nan
    within = np.average(off[inside] <= half[inside], weights=lengths[inside])
    return float(covered), float(within), float((half[inside] ** 2).mean()), float(
        (off[inside] ** 2).mean()
    )  # fmt: skip


def speed_table(shapes: dict[str, Outline], _seeds: int) -> Iterator[str]:
    """Times on one core after warm-up, processor time, best of several."""
    yield "Speed: processor time of one core after warm-up, best of 15, ms"
    outline = shapes["superformula"]
    points, share, rng = drawn(outline, 0, count=10_000, sigma=0.5)

    wrap = csr_array(np.vstack([np.eye(80), np.eye(80)[:3]]))

    def scipys() -> object:
        design = BSpline.design_matrix(share * 80, np.arange(-3.0, 84.0), 3) @ wrap
        return np.linalg.solve((design.T @ design).toarray(), design.T @ points)

    def ours() -> object:
        band, right = normal_equations(share * 80, points, 80, closed=True)
        return solve(*factorise(band), right)

    yield f"one solve, 10 000 points, 80 control points {best_ms(ours):8.2f}  (bound 1.5)"
    yield f"  the same by scipy's design_matrix         {best_ms(scipys):8.2f}"
    ordered = best_ms(lambda: fit_ordered(points, share, spans=80, closed=True, sigma_mm=0.5))
    yield f"full fit, order given, 80 control points    {ordered:8.2f}  (bound 5)"
    for count in (10_000, 460_800):
        points, share, rng = drawn(outline, 1, count=count)
        chain, cloud = crude_chain(points, share, 0.5), rng.permutation(points)
        whole = best_ms(lambda chain=chain, cloud=cloud: fit_chain(cloud, chain))
        yield f"chain and {count} shuffled points to curve {whole:10.2f}  (with its chain: 65)"


def best_ms(work: Callable[[], object], repeats: int = 15) -> float:
    """Least processor time of several runs."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        times.append(time.process_time() - begun)
    return 1e3 * min(times)


def peers_table(_shapes: dict[str, Outline], _seeds: int) -> Iterator[str]:
    """Published point sets; StretchDenoise and FitConnect by their own programs."""
    if not (DATA / "curves").is_dir():
        yield "Peers: no data; set LOFTSCAN_DATA"
        return
    yield "Peers: rms to the truth; the order is told, see above"
    turn = np.linspace(0, 2 * np.pi, 40_001)
    unit = Outline(np.column_stack([np.cos(turn), np.sin(turn)]))
    for extent, bounds, theirs in (
        ("0.10", ".006 .008", ".011 .020"),
        ("0.50", ".026 .042", ".073 .053"),
    ):
        points = np.loadtxt(DATA / "curves" / f"circle_n{extent}.txt")
        share = np.mod(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi), 1.0)
        chain = crude_chain(points, share, float(np.std(np.hypot(*points.T))))
        rms = [rms_mm(fit_chain(points, chain, exact=exact), unit) for exact in Exact]
        yield (f"circle, noise {extent}: exact {rms[0]:.4f}, free {rms[1]:.4f} (bounds {bounds};"
               f" StretchDenoise and FitConnect {theirs})")  # fmt: skip
    truth = Outline(read_outline(DATA / "curves" / "bunny.npz"))
    for spacing, bound, theirs in (("0.4", 4.5, 5.68), ("0.2", 3.0, 3.53)):
        points = np.loadtxt(DATA / "curves" / f"bunny_eps{spacing}.txt")
        curve = fit_chain(points, Chain(points, np.full(len(points), 4.0), closed=True))
        between, arc = between_mm(curve, points, truth), rms_mm(curve, truth)
        yield (
            f"bunny {spacing}: equal samples between points {between:.3f}"
            f" (bound {bound}; StretchDenoise {theirs}), arc-uniform {arc:.3f}"
        )


def between_mm(curve: FittedCurve, points: Array, truth: Outline) -> float:
    """Rms of equally many samples of the curve between neighbouring input points."""
    grid = np.arange(20_000) / 20_000
    feet = grid[cKDTree(curve(grid)).query(points)[1]]
    steps = np.mod(np.roll(feet, -1) - feet + 0.5, 1.0) - 0.5
    places = curve(np.mod(feet[:, None] + steps[:, None] * np.arange(20) / 20, 1.0).ravel())
    return float(np.sqrt(np.mean(truth.distances_mm(places) ** 2)))


TABLES = {"floor": floor_table, "recognised": recognised_table, "honesty": honesty_table,
          "speed": speed_table, "peers": peers_table}  # fmt: skip


def main() -> None:
    """Print the tables asked for, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tables", nargs="*", choices=[*TABLES, []], default=list(TABLES))
    parser.add_argument("--seeds", type=int, default=30)
    asked = parser.parse_args()
    shapes = outlines()
    for name in asked.tables:
        for line in TABLES[name](shapes, asked.seeds):
            print(line, flush=True)
        print()


if __name__ == "__main__":
    main()
