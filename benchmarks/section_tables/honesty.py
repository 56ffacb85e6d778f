"""How often the 95 % band covers the truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import resolve_section
from section_tables.outlines import EVEN, SIGMA_MM, Array, Outline, akin, evenly, the_loop

SEEDS = 300
GAP_DEG = 20.0
KIN = 10
_MARGIN_DEG = 3.0  # beside a gap: neither away from it nor inside


def honesty_table(shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """Coverage with white noise, about and inside a gap, and with noise akin among neighbours."""
    seeds = seeds or SEEDS
    yield (f"Honesty: N = 2000 shuffled, sigma = {SIGMA_MM} mm, {seeds} seeds, exact=never;"
           " % of curve points that the 95 % band covers")  # fmt: skip
    yield "  wrong: seeds without a single loop, counted as not covered; half/rms: width of the"
    yield f"  band inside the gap over the error there; akin: noise is a moving mean of {KIN}"
    yield (f"{'':14}{'white':>8}{'gap: away':>10}{'inside':>8}{'half/rms':>9}{'akin':>8}"
           f"{'wrong':>12}")  # fmt: skip
    rows = []
    for name, outline in shapes.items():
        white = _covered(outline, seeds)
        gapped = _covered(outline, seeds, gap_deg=GAP_DEG)
        kin = _covered(outline, seeds, neighbours=KIN)
        shares = [100 * np.nan_to_num(case[:, :2]).mean(axis=0) for case in (white, gapped, kin)]
        ratio = np.sqrt(np.nanmean(gapped[:, 2]) / np.nanmean(gapped[:, 3]))
        rows.append([shares[0][0], *shares[1], ratio, shares[2][0]])
        wrong = " ".join(str(int(np.isnan(case[:, 0]).sum())) for case in (white, gapped, kin))
        yield _row(name, rows[-1]) + f"{wrong:>12}"
    yield _row("pooled", list(np.mean(rows, axis=0)))
    yield "bounds: white and away 93..97 pooled, 91..97 each; inside >= 90 pooled; half/rms <= 4;"
    yield "  akin 90..97. The paper and the peers give no uncertainty."


def _row(name: str, values: list[float]) -> str:
    white, away, inside, ratio, kin = values
    return f"{name:14}{white:8.2f}{away:10.2f}{inside:8.2f}{ratio:9.2f}{kin:8.2f}"


def _covered(outline: Outline, seeds: int, **case: float) -> Array:
    """Rows (seeds, 4) of `coverage`; nan where no single loop was found."""
    return np.array([coverage(outline, seed, **case) for seed in range(seeds)])


def coverage(
    outline: Outline, seed: int, *, gap_deg: float = 0.0, neighbours: float = 1
) -> tuple[float, float, float, float]:
    """Return shares covered away from and inside the gap, mean squares of half width and error."""
    rng = np.random.default_rng(1000 + seed)
    share = np.sort(rng.random(2000))
    points = outline(share) + SIGMA_MM * akin(2000, int(neighbours), rng)
    start = rng.uniform(0, 360)
    kept = outline.polar_deg(outline(share), start) >= gap_deg
    curve = the_loop(resolve_section(rng.permutation(points[kept]), exact=Exact.NEVER))
    if curve is None:
        return np.nan, np.nan, np.nan, np.nan
    return _measured(curve, outline, start, gap_deg)


def _measured(
    curve: FittedCurve, outline: Outline, start_deg: float, gap_deg: float
) -> tuple[float, float, float, float]:
    places, weights = evenly(curve)
    off, half = outline.distances_mm(places), 1.96 * curve.deviation_mm(EVEN)
    sector = outline.polar_deg(places, start_deg)
    inside = sector < gap_deg
    beside = (sector < gap_deg + _MARGIN_DEG) | (sector > 360 - _MARGIN_DEG)
    away = ~beside if gap_deg else ~inside
    covered = float(np.average(off[away] <= half[away], weights=weights[away]))
    if not inside.any():
        return covered, np.nan, np.nan, np.nan
    within = float(np.average(off[inside] <= half[inside], weights=weights[inside]))
    return covered, within, float((half[inside] ** 2).mean()), float((off[inside] ** 2).mean())
