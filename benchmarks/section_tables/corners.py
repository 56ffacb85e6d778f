"""Corners that are found, bends that are left round, and noise that is louder on one side."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from reconstruction.fitting.curve import Exact
from reconstruction.fitting.section import resolve_section
from section_tables.outlines import Array, Outline, akin, drawn, evenly, pooled, the_loop

SEEDS = 20
CLOUDS = ((500, 0.1), (2000, 0.1), (2000, 0.5), (20_000, 0.02), (20_000, 0.5))  # points, sigma
LOUD = (2.0, 4.0, 6.0, 10.0)  # times the noise of the other sides


def polygon(corners_mm: Array) -> Outline:
    """A closed outline with straight sides."""
    ends = np.vstack([corners_mm, corners_mm[:1]])
    share = np.linspace(0, len(corners_mm), 4000 * len(corners_mm) + 1)
    ranks = np.arange(len(ends))
    return Outline(np.column_stack([np.interp(share, ranks, axis) for axis in ends.T]))


def regular(count: int, radius_mm: float = 60.0) -> Array:
    """Corners of a regular polygon."""
    turn = np.arange(count) / count * 2 * np.pi
    return radius_mm * np.column_stack([np.cos(turn), np.sin(turn)])


def rounded_square(radius_mm: float) -> Array:
    """100 mm, one of its corners rounded."""
    turn = np.linspace(0, np.pi / 2, 200)
    bend = radius_mm * np.column_stack([np.sin(turn), -np.cos(turn)])
    middle = np.array([100 - radius_mm, radius_mm])
    return np.vstack([[[0.0, 0.0]], middle + bend, [[100.0, 100.0], [0.0, 100.0]]])


def corners_table(shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """How often as many corners are found as there are, exact=never."""
    seeds = seeds or SEEDS
    yield f"Corners: their right number, exact=never, in % of {seeds} seeds, by points and sigma mm"
    yield f"{'':26}{'true':>5}" + "".join(f"{f'{n} {sigma}':>12}" for n, sigma in CLOUDS)
    square = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]])
    cases = {
        "triangle": (polygon(regular(3)), 3),
        "square": (polygon(square), 4),
        "L": (polygon(np.array([[0.0, 0], [80, 0], [80, 30], [30, 30], [30, 80], [0, 80]])), 6),
        "hexagon": (polygon(regular(6)), 6),
        "square, a corner r = 10": (Outline(closed(rounded_square(10.0))), 3),
        "square, a corner r = 3": (Outline(closed(rounded_square(3.0))), 3),
        **{name: (outline, 0) for name, outline in shapes.items()},
    }
    for name, (outline, true) in cases.items():
        right = [
            np.mean([_corners(outline, seed, *cloud) == true for seed in range(seeds)])
            for cloud in CLOUDS
        ]
        yield f"{name:26}{true:5d}" + "".join(f"{100 * share:12.0f}" for share in right)


def closed(corners_mm: Array) -> Array:
    """With its first corner at the end, and the straight sides filled in."""
    ends = np.vstack([corners_mm, corners_mm[:1]])
    steps = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    along = np.concatenate([[0.0], steps.cumsum()])
    fine = np.union1d(along, np.linspace(0, along[-1], 20_000))
    return np.column_stack([np.interp(fine, along, axis) for axis in ends.T])


def _corners(outline: Outline, seed: int, count: int, sigma_mm: float) -> int:
    points, _ = drawn(outline, seed, count=count, sigma_mm=sigma_mm)
    curve = the_loop(resolve_section(points, exact=Exact.NEVER))
    return -1 if curve is None else len(curve.creases)


def noise_table(_shapes: dict[str, Outline], seeds: int | None) -> Iterator[str]:
    """Where one side of four is louder than the others."""
    seeds = seeds or SEEDS
    yield f"Noise: a plate of 400 x 320 mm, 900 points, half of them on the top, {seeds} seeds;"
    yield "  sigma 2 mm, on the top so many times. Length over the true one, and rms to the truth"
    yield "  on the top over sigma there; median and worst; wrong: seeds without a single loop"
    yield (f"{'':12}{'independent: length':>20}{'rms':>13}{'8 akin: length':>18}{'rms':>13}"
           f"{'wrong':>8}")  # fmt: skip
    plate = polygon(np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 320.0], [0.0, 320.0]]))
    for times in LOUD:
        words, wrong = "", []
        for kin in (1, 8):
            rows = np.array([_loud(plate, seed, times, kin) for seed in range(seeds)])
            length, rms = rows[np.isfinite(rows[:, 0])].T
            worst = length[np.abs(length - 1).argmax()], rms.max()
            words += (
                f"{np.median(length):13.3f} {worst[0]:5.3f}{np.median(rms):9.2f} {worst[1]:.2f}"
            )
            wrong.append(str(seeds - len(length)))
        yield f"{f'{times:g} times':12}{words}{' '.join(wrong):>8}"


def _loud(plate: Outline, seed: int, times: float, kin: int) -> tuple[float, float]:
    rng = np.random.default_rng(seed)
    top = (720 / 1440, 1120 / 1440)
    share = np.sort(np.concatenate([rng.random(450), rng.uniform(*top, 450)]))
    sigma = np.where((share > top[0]) & (share < top[1]), 2.0 * times, 2.0)
    points = rng.permutation(plate(share) + sigma[:, None] * akin(len(share), kin, rng))
    found = resolve_section(points, exact=Exact.NEVER)
    curve = the_loop(found)
    if curve is None:
        return float("nan"), float("nan")
    places, _ = evenly(curve)
    steps = np.linalg.norm(np.diff(np.vstack([places, places[:1]]), axis=0), axis=1)
    above = places[(places[:, 1] > 280) & (np.abs(places[:, 0] - 200) < 160)]
    return float(steps.sum() / 1440), pooled(above[:, 1] - 320) / (2.0 * times)
