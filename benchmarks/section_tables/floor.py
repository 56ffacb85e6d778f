"""How near our curve comes to what the data allow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from reconstruction.fitting.curve import Exact
from reconstruction.fitting.section import resolve_section
from reconstruction.fitting.section_fit import fit_chain
from section_tables.outlines import (
    SIGMA_MM,
    Array,
    Outline,
    drawn,
    polar_outline,
    pooled,
    rms_mm,
    superformula,
    the_loop,
)
from section_tables.rivals import oracle_mm, paper_mm, told_chain

SEEDS = 30
LOBED_SEEDS = 200
PAPER_SEEDS = 50
SWEPT = {"circle": range(5, 16), "ellipse": range(10, 32, 2), "superformula": range(40, 120, 5),
         "blob2": range(24, 100, 4), "simple": range(16, 80, 3)}  # fmt: skip


def floor_table(shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """Automatic beside the best fixed number of control points."""
    seeds = seeds or SEEDS
    yield f"Floor: N = 2000 shuffled, sigma = {SIGMA_MM} mm, {seeds} seeds, exact=never; rms in mm"
    yield "  best: least squares at the true arc length with the best fixed number P of control"
    yield "  points; told: our fit, but told the order; wrong: no single loop found, not in the rms"
    yield (
        f"{'':14}{'best P':>7}{'best':>8}{'ours':>8}{'told':>8}{'paper':>8}"
        f"{'ratio':>8}{'median':>8}{'worst':>7}{'wrong':>7}"
    )
    for name, outline in shapes.items():
        yield _floor_row(name, outline, seeds)
    yield "bounds: ratio 1.08 (blob2 1.15), median 1.06, worst 1.30, wrong 0"


def _floor_row(name: str, outline: Outline, seeds: int) -> str:
    clouds = [drawn(outline, seed) for seed in range(seeds)]
    swept = {
        count: np.array([oracle_mm(*cloud, count, outline) for cloud in clouds])
        for count in SWEPT[name]
    }
    count = min(swept, key=lambda key: pooled(swept[key]))
    best = swept[count]
    ours = np.array([_free_mm(points, outline) for points, _ in clouds])
    told = [
        rms_mm(fit_chain(points, told_chain(points, share, SIGMA_MM), exact=Exact.NEVER), outline)
        for points, share in clouds
    ]
    paper = np.array([paper_mm(points, outline) for points, _ in clouds])
    right = np.isfinite(ours)
    ratios = ours[right] / best[right]
    return (
        f"{name:14}{count:7d}{pooled(best):8.4f}{pooled(ours[right]):8.4f}"
        f"{pooled(np.array(told)):8.4f}{pooled(paper[np.isfinite(paper)]):8.4f}"
        f"{pooled(ours[right]) / pooled(best[right]):8.3f}{np.median(ratios):8.3f}"
        f"{ratios.max():7.3f}{(~right).sum():7d}"
    )


def _free_mm(points: Array, outline: Outline) -> float:
    curve = the_loop(resolve_section(points, exact=Exact.NEVER))
    return np.nan if curve is None else rms_mm(curve, outline)


def recognised_table(shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """Exact shapes at their own floor, and claims of what is none."""
    some = seeds or SEEDS
    yield f"Recognised: N = 2000 shuffled, sigma = {SIGMA_MM} mm, {some} seeds; rms in mm"
    yield f"{'':14}{'found':>8}{'floor':>8}{'ours':>8}{'free':>8}{'paper':>8}{'ratio':>8}  bound"
    for name, freedom in (("circle", 3), ("ellipse", 5)):
        clouds = [drawn(shapes[name], seed)[0] for seed in range(some)]
        curves = [the_loop(resolve_section(points)) for points in clouds]
        ours = pooled(np.array([np.nan if c is None else rms_mm(c, shapes[name]) for c in curves]))
        free = pooled(np.array([_free_mm(points, shapes[name]) for points in clouds]))
        paper = pooled(np.array([paper_mm(points, shapes[name]) for points in clouds]))
        found = sum(curve is not None and curve.kind == name for curve in curves)
        least = SIGMA_MM * np.sqrt(freedom / 2000)
        yield (
            f"{name:14}{f'{found}/{some}':>8}{least:8.4f}{ours:8.4f}{free:8.4f}{paper:8.4f}"
            f"{ours / least:8.3f}  1.10"
        )
    many = seeds or LOBED_SEEDS
    lobed = {
        "superformula n1 = 70, n2 = n3 = 6: the greatest radius is 2 % over the least": (
            superformula(70, 6)
        ),
        "50 mm (1 + 0.02 cos 5 phi)": polar_outline(
            lambda turn: 50 * (1 + 0.02 * np.cos(5 * turn))
        ),
    }
    yield f"Claimed exact though it is not: N = 2000, sigma = 0.1 mm, {many} seeds (at most 1 %)"
    for name, outline in lobed.items():
        found = [resolve_section(drawn(outline, seed, sigma_mm=0.1)[0]) for seed in range(many)]
        claimed = sum(any(curve.kind != "free" for curve in each.curves) for each in found)
        yield f"  {name}: {claimed}/{many}"


def paper_table(_shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """The paper's own case: a circle of 100 mm, a band of 2 mm, 40 points a mm."""
    seeds = seeds or PAPER_SEEDS
    count = round(40 * 100 * np.pi)
    yield (f"The paper's case: circle of 100 mm, uniform band of 2 mm, {count} points shuffled,"
           f" {seeds} seeds; rms in mm")  # fmt: skip
    truth = polar_outline(lambda turn: np.full(len(turn), 50.0))
    rows = np.array([_paper_row(seed, count, truth) for seed in range(seeds)])
    exact, free, paper = (pooled(column) for column in rows.T)
    floor = 2 / np.sqrt(12) * np.sqrt(3 / count)
    yield (f"recognised {exact:.4f}, free {free:.4f}, paper at its 4 mm {paper:.4f},"
           f" floor of a circle {floor:.4f}")  # fmt: skip
    yield f"paper over free {paper / free:.1f}, over recognised {paper / exact:.1f}"


def _paper_row(seed: int, count: int, truth: Outline) -> list[float]:
    rng = np.random.default_rng(seed)
    turn, radius = rng.uniform(0, 2 * np.pi, count), 50 + rng.uniform(-1, 1, count)
    points = radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    exact = the_loop(resolve_section(points))
    rms = np.nan if exact is None else rms_mm(exact, truth)
    return [rms, _free_mm(points, truth), paper_mm(points, truth, cell_mm=4.0)]
