"""Adaptive slicing beside uniform spacing: how many slices until a part is known well enough.

    python -m tests.campaigns.adaptive [--seeds 3] [MODEL.obj]

What chooses is the program (`loftscan.advising`, on slices cut from the true part with noise). What
judges knows nothing of it: this module cuts the true triangles itself, measures distances to the
cuts by brute force, interpolates them by cubic splines along the height (scipy), and asks that at
points all over the true surface. So the figure is what the choice of heights leaves open, without
noise:

    98 % of the part's surface above the lowest slice lies within the tolerance

Uniform spacing is given twice: over the same range of the stage, of which nobody knows where in it
the part ends; and from end to end of the part, as if an oracle had said where these are. Of both
the smallest number of slices is told that reaches the tolerance, by good luck or not.

It exits 1 when the tolerance is not reached, or with more than 60 % of the slices that uniform
spacing needs over the same range.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from loftscan.advising import answer
from reconstruction.adaptive import Level, level_of
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.slices import Frame, Slice
from sim.judging import Surface
from sim.parts import vase
from sim.solids import Part, read_mesh

Floats = NDArray[np.float64]

GRID_MM = 0.1
FOOT_MM = 0.05  # a sheet at the plate itself meets nothing
HEADROOM = 1.1  # the operator knows the part's height within so much
SIGMA_MM = 0.02
POINTS = 3000  # of a slice
PLACES = 4000  # of the surface that are judged
SHARE = 98.0
MOST = 1500
MOST_SHARE = 0.6
AROUND = 5  # slices below and above a place that its surface is interpolated from


@dataclass(frozen=True)
class Task:
    """A part and what is to be known of it."""

    part: Part
    tolerance_mm: float
    coarse: int

    @property
    def height_mm(self) -> float:
        return float(self.part.vertices_mm[:, 2].max())

    @property
    def last(self) -> int:
        """The last place on the grid."""
        return round((HEADROOM * self.height_mm - FOOT_MM) / GRID_MM)


def upright(model: Path, height_mm: float) -> Part:
    """A model whose file has y up, on the table, so high."""
    part = read_mesh(model)
    x, y, z = part.vertices_mm.T
    turned = np.column_stack([x, -z, y])
    low, high = turned.min(axis=0), turned.max(axis=0)
    foot = np.array([*(low[:2] + high[:2]) / 2.0, low[2]])
    return Part(model.stem, (turned - foot) * (height_mm / (high[2] - low[2])), part.faces)


class Truth:
    """The true part, cut and measured by brute force."""

    def __init__(self, part: Part) -> None:
        self._corners = part.vertices_mm[part.faces]
        self._low = self._corners[:, :, 2].min(axis=1)
        self._high = self._corners[:, :, 2].max(axis=1)
        places = Surface(part.vertices_mm, part.faces).sample(PLACES, 1)
        self.places_mm = places[places[:, 2] > FOOT_MM]
        self._cuts: dict[float, Floats] = {}
        self._away: dict[float, Floats] = {}

    def cut(self, height_mm: float) -> Floats:
        """Segments (n, 2, 2) of the contours at a height."""
        if height_mm in self._cuts:
            return self._cuts[height_mm]
        faces = self._corners[(self._low < height_mm) & (self._high > height_mm)]
        ends = []
        for one, other in ((0, 1), (1, 2), (2, 0)):
            a, b = faces[:, one], faces[:, other]
            rise = b[:, 2] - a[:, 2]
            share = (height_mm - a[:, 2]) / np.where(rise == 0.0, np.nan, rise)
            inside = (share >= 0.0) & (share < 1.0)
            at = a[:, :2] + share[:, None] * (b - a)[:, :2]
            ends.append(np.where(inside[:, None], at, np.nan))
        places = np.stack(ends, axis=1)
        there = np.isfinite(places[:, :, 0])
        two = there.sum(axis=1) == 2
        self._cuts[height_mm] = places[two][there[two]].reshape(-1, 2, 2)
        return self._cuts[height_mm]

    def away_mm(self, height_mm: float, chosen: NDArray[np.intp]) -> Floats:
        """Signed distance of places from the contours at a height, in the plane; nan: no part."""
        known = self._away.setdefault(height_mm, np.full(len(self.places_mm), np.inf))
        new = chosen[np.isposinf(known[chosen])]
        if len(new):
            known[new] = away_from(self.places_mm[new, :2], self.cut(height_mm))
        return known[chosen]


def away_from(places_mm: Floats, segments_mm: Floats) -> Floats:
    """Distances (n,) of places from segments (m, 2, 2), negative where a ray crosses oddly many."""
    if not len(segments_mm):
        return np.full(len(places_mm), np.nan)
    a, b = segments_mm[:, 0], segments_mm[:, 1]
    way = b - a
    arms = places_mm[:, None] - a
    along = np.einsum("nmk,mk->nm", arms, way) / np.maximum((way**2).sum(axis=1), 1e-300)
    feet = a + np.clip(along, 0.0, 1.0)[..., None] * way
    nearest = np.sqrt(((places_mm[:, None] - feet) ** 2).sum(axis=2).min(axis=1))
    x, y = places_mm[:, :1], places_mm[:, 1:]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    at = a[:, 0] + (y - a[:, 1]) / np.where(way[:, 1] == 0.0, 1.0, way[:, 1]) * way[:, 0]
    odd = (crosses & (at > x)).sum(axis=1) % 2 == 1
    return np.where(odd, -nearest, nearest)


def errors_mm(truth: Truth, heights_mm: Sequence[float]) -> Floats:
    """How far each place of the true surface lies from what slices at these heights leave."""
    heights = np.array([each for each in heights_mm if len(truth.cut(each))])
    off = np.full(len(truth.places_mm), np.inf)
    if len(heights) < 2:
        return off
    z = truth.places_mm[:, 2]
    above = np.searchsorted(heights, z)
    for span in range(len(heights) + 1):
        here = np.flatnonzero(above == span)
        if not len(here):
            continue
        if span in (0, len(heights)):
            end = heights[0 if span == 0 else -1]
            aside = np.maximum(truth.away_mm(float(end), here), 0.0)
            off[here] = np.hypot(aside, z[here] - end)
            continue
        nodes = heights[max(0, span - AROUND) : span + AROUND]
        seen = np.stack([truth.away_mm(float(each), here) for each in nodes])
        off[here] = _between(nodes, seen, z[here])
    return off


def _between(nodes_mm: Floats, seen_mm: Floats, z_mm: Floats) -> Floats:
    """First-order distance of places from the surface where the interpolated distance is 0."""
    if len(nodes_mm) == 2:
        rise = nodes_mm[1] - nodes_mm[0]
        lean = (seen_mm[1] - seen_mm[0]) / rise
        at = seen_mm[0] + lean * (z_mm - nodes_mm[0])
    else:
        curve = CubicSpline(nodes_mm, seen_mm, axis=0)
        at = np.array([curve(z)[k] for k, z in enumerate(z_mm)])
        lean = np.array([curve(z, nu=1)[k] for k, z in enumerate(z_mm)])
    # It passes through the contours, so it is no farther away than the nearest of these.
    bound = np.hypot(seen_mm, z_mm - nodes_mm[:, None]).min(axis=0)
    return np.minimum(np.abs(at) / np.hypot(1.0, lean), bound)


def reached(truth: Truth, heights_mm: Sequence[float]) -> float:
    """The error that 98 % of the surface are within."""
    return float(np.percentile(errors_mm(truth, heights_mm), SHARE))


def noisy_slice(truth: Truth, index: int, height_mm: float, seed: int) -> Slice:
    """Points evenly along the contours at a height, with noise across them."""
    segments = truth.cut(height_mm)
    frame = Frame(np.array([0.0, 0.0, height_mm]), np.eye(3))
    if not len(segments):
        return Slice(index, np.empty((0, 3)), frame)
    rng = np.random.default_rng([seed, index])
    way = segments[:, 1] - segments[:, 0]
    length = np.linalg.norm(way, axis=1)
    chosen = rng.choice(len(length), POINTS, p=length / length.sum())
    places = segments[chosen, 0] + rng.random(POINTS)[:, None] * way[chosen]
    across = np.column_stack([way[:, 1], -way[:, 0]]) / np.maximum(length, 1e-12)[:, None]
    places += rng.normal(0.0, SIGMA_MM, POINTS)[:, None] * across[chosen]
    return Slice(index, np.column_stack([places, np.full(POINTS, height_mm)]), frame)


def height_of(index: int) -> float:
    """Of a place on the grid."""
    return round(FOOT_MM + index * GRID_MM, 6)


def adaptive(task: Task, truth: Truth, seed: int) -> tuple[tuple[int, ...], str]:
    """The places that the program chooses, and why it ends."""
    plane = Frame(np.zeros(3), np.eye(3))
    levels: dict[int, Level] = {}
    wanted = [round(task.last * k / (task.coarse - 1)) for k in range(task.coarse)]
    while len(levels) < MOST:
        for index in wanted:
            piece = noisy_slice(truth, index, height_of(index), seed)
            drawn = draw_outlines(piece, exact=Exact.NEVER)
            levels[index] = level_of(drawn, plane, height_of(index))
        asked = answer(levels, tuple(sorted(levels)), task.tolerance_mm)
        if asked.index is None:
            return asked.seen, asked.why
        wanted = [asked.index]
    return tuple(sorted(levels)), "never"


def uniform(task: Task, truth: Truth, top_mm: float) -> int | None:
    """The least number of evenly spaced slices up to a height that reach the tolerance."""
    count = 3
    while count <= MOST:
        heights = np.linspace(FOOT_MM, top_mm, count)
        if reached(truth, [float(each) for each in heights]) <= task.tolerance_mm:
            return count
        count += max(1, count // 40)
    return None


def tasks(model: Path | None) -> list[Task]:
    """The vase, and a model from a file, 100 mm high, at two tolerances."""
    found = [Task(vase(), 0.1, 8)]
    if model is not None:
        part = upright(model, 100.0)
        found += [Task(part, tolerance_mm, 12) for tolerance_mm in (0.5, 0.25)]
    return found


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="adaptive")
    parser.add_argument("model", type=Path, nargs="?", help="a mesh file, y up")
    parser.add_argument("--seeds", type=int, default=3)
    wanted = parser.parse_args(words)
    failed = False
    for task in tasks(wanted.model):
        truth = Truth(task.part)
        tell(f"{task.part.name}, 98 % within {task.tolerance_mm:g} mm")
        evenly = uniform(task, truth, HEADROOM * task.height_mm)
        oracle = uniform(task, truth, task.height_mm - FOOT_MM / 10.0)
        tell(f"  uniform: {evenly or f'over {MOST}'}; with an oracle {oracle}")
        for seed in range(wanted.seeds):
            places, why = adaptive(task, truth, seed)
            error_mm = reached(truth, [height_of(place) for place in places])
            share = len(places) / (evenly or MOST)
            tell(
                f"  adaptive, seed {seed}: {len(places)} slices, {share:.0%}"
                f" ({len(places) / (oracle or MOST):.0%} of the oracle's);"
                f" {error_mm:.3f} mm; it said: {why}"
            )
            failed |= error_mm > task.tolerance_mm or share > MOST_SHARE
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
