"""Outlines, and clouds of noisy points around them that know where nothing was seen."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.arrays import BoolArray, FloatArray, IntArray

STEP_MM = 0.05  # between the points of an outline
DATA = Path(os.environ.get("LOFTSCAN_DATA", Path(__file__).resolve().parents[3] / "shared/data"))


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """A true outline as a dense polyline, a step from point to point."""

    points_mm: FloatArray  # (m, 2)
    closed: bool = True
    tree: cKDTree = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "tree", cKDTree(self.points_mm))

    @property
    def length_mm(self) -> float:
        return STEP_MM * (len(self.points_mm) - (not self.closed))

    @property
    def centre_mm(self) -> FloatArray:
        return self.points_mm.mean(axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Shuffled points, and the truth about them."""

    points_mm: FloatArray  # (n, 2)
    outlines: tuple[Outline, ...]
    seen: tuple[BoolArray, ...]  # of each outline's points: not in a gap
    outline_of_point: IntArray  # (n,), -1: an outlier
    band_mm: float
    per_mm: float

    @property
    def blur_mm(self) -> float:
        """Along an outline, what nobody can tell: some bands, and some steps from point to point.

        Among a thousand points at random places the widest way is about seven mean ones.
        """
        return 3.0 * self.band_mm + 10.0 / self.per_mm

    def seen_of(self, outline: Outline) -> BoolArray:
        return self.seen[self.outlines.index(outline)]


@dataclass(frozen=True, slots=True)
class Uneven:
    """How a scanner's points are uneven, by the share of the outline's length, from anywhere."""

    sparsest: float = 1.0  # share of the points that is left where they are fewest
    stepped: bool = False  # half of it so sparse, instead of smoothly changing
    narrowest: float = 1.0  # share of the band where it is thinnest
    dropouts: int = 0  # stretches without a point
    dropout_mm: float = 0.0  # how long the longest is

    def density(self, share: FloatArray) -> FloatArray:
        wave = 0.5 - 0.5 * np.cos(math.tau * share)
        wave = (share < 0.5).astype(np.float64) if self.stepped else wave
        return self.sparsest + (1.0 - self.sparsest) * wave

    def width(self, share: FloatArray) -> FloatArray:
        return self.narrowest + (1.0 - self.narrowest) * (0.5 - 0.5 * np.sin(math.tau * share))

    def seen(self, outline: Outline, rng: np.random.Generator) -> BoolArray:
        seen = np.ones(len(outline.points_mm), np.bool_)
        for _ in range(self.dropouts):
            start = rng.integers(0, len(seen))
            length = round(rng.uniform(0.0, self.dropout_mm) / STEP_MM)
            seen[np.arange(start, start + length) % len(seen)] = False
        return seen


EVEN = Uneven()


def evenly(points: FloatArray, *, closed: bool = True) -> Outline:
    """The polyline at equal arc lengths of a step."""
    ring = np.vstack([points, points[:1]]) if closed else points
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(ring, axis=0), axis=1).cumsum()])
    wanted = np.linspace(0.0, along[-1], round(along[-1] / STEP_MM), endpoint=not closed)
    return Outline(
        np.stack([np.interp(wanted, along, column) for column in ring.T], axis=1), closed
    )


def polar(radius: FloatArray, turns: float = 1.0, *, closed: bool = True) -> Outline:
    """The outline whose radius is given at even angles."""
    angle = np.linspace(0.0, turns * math.tau, len(radius), endpoint=not closed)
    return evenly(radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=closed)


def ellipse(x_mm: float, y_mm: float, centre: tuple[float, float] = (0.0, 0.0)) -> Outline:
    angle = np.linspace(0.0, math.tau, 8000, endpoint=False)
    return evenly(np.stack([x_mm * np.cos(angle), y_mm * np.sin(angle)], axis=1) + centre)


def superformula() -> Outline:
    """Five lobes, exponents 3, 6, 6, mean radius 50 mm."""
    angle = np.linspace(0.0, math.tau, 8000, endpoint=False)
    powers = np.abs(np.cos(5 * angle / 4)) ** 6 + np.abs(np.sin(5 * angle / 4)) ** 6
    radius = powers ** (-1 / 3)
    return polar(radius * 50.0 / radius.mean())


def published(name: str) -> Outline | None:
    """An outline of the curve data scaled to 100 mm; None without the data."""
    path = DATA / "curves" / f"{name}.npz"
    if not path.is_file():
        return None
    stored = np.load(path)
    corners = np.concatenate([stored[key] for key in stored if key != "closed"])
    return evenly(corners * 100.0 / np.ptp(corners, axis=0).max())


def arc(radius_mm: float, degrees: float) -> Outline:
    angle = np.linspace(0.0, math.radians(degrees), 4000)
    return evenly(radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=False)


def letter_s(radius_mm: float, degrees: float = 270.0) -> Outline:
    """Two bows that meet in the middle."""
    angle = np.linspace(0.0, math.radians(degrees), 2000) - math.pi / 2
    bow = radius_mm * np.stack([np.cos(angle), 1.0 + np.sin(angle)], axis=1)
    return evenly(np.vstack([-bow[::-1], bow[1:]]), closed=False)


def overlapping(pitch_mm: float, turns: float = 1.06) -> Outline:
    """A spiral of a little more than a turn: its ends run past each other, a pitch apart."""
    return polar(40.0 + pitch_mm * np.linspace(0.0, turns, 6000), turns, closed=False)


def corner() -> Outline:
    return evenly(np.array([[60.0, 0.0], [0.0, 0.0], [0.0, 45.0]]), closed=False)


def normals(outline: Outline) -> FloatArray:
    points = outline.points_mm
    steps = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    if not outline.closed:
        steps = np.gradient(points, axis=0)
    steps = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return np.stack([-steps[:, 1], steps[:, 0]], axis=1)


def scene(
    outlines: Outline | Sequence[Outline],
    rng: np.random.Generator,
    *,
    per_mm: float,
    band_mm: float,
    gap_degrees: float = 0.0,
    outliers: float = 0.0,
    uneven: Uneven = EVEN,
) -> Scene:
    """Points at random places of outlines, noise uniform across them over the full band.

    Nothing is seen of any outline within the gap, a polar angle about its centre. Outliers lie
    anywhere in twice the bounding box.
    """
    outlines = (outlines,) if isinstance(outlines, Outline) else tuple(outlines)
    points, owner, seen = [], [], []
    for number, outline in enumerate(outlines):
        arms = outline.points_mm - outline.centre_mm
        angle = np.arctan2(arms[:, 1], arms[:, 0]) - rng.uniform(0.0, math.tau)
        seen.append(np.mod(angle, math.tau) >= math.radians(gap_degrees))
        seen[-1] &= uneven.seen(outline, rng)
        chosen = rng.integers(0, len(arms), round(per_mm * outline.length_mm))
        turn = rng.uniform()
        share = np.mod(chosen / len(arms) + turn, 1.0)
        chosen = chosen[seen[-1][chosen] & (rng.uniform(size=len(chosen)) < uneven.density(share))]
        half = band_mm / 2 * uneven.width(np.mod(chosen / len(arms) + turn, 1.0))
        across = half * rng.uniform(-1.0, 1.0, len(chosen))
        points.append(outline.points_mm[chosen] + across[:, None] * normals(outline)[chosen])
        owner.append(np.full(len(chosen), number))
    whole = np.vstack(points)
    low, high = whole.min(axis=0), whole.max(axis=0)
    margin = (high - low) / 2
    points.append(rng.uniform(low - margin, high + margin, (round(outliers * len(whole)), 2)))
    owner.append(np.full(len(points[-1]), -1))
    mixed = rng.permutation(len(whole) + len(points[-1]))
    return Scene(np.vstack(points)[mixed], outlines, tuple(seen), np.concatenate(owner)[mixed],
                 band_mm, per_mm * uneven.sparsest)  # fmt: skip


@cache
def campaign_shapes() -> dict[str, Outline]:
    """The five outlines of the campaign, as far as the data are there."""
    shapes = {
        "circle": ellipse(50, 50),
        "ellipse": ellipse(60, 30),
        "superformula": superformula(),
        "blob2": published("blob2"),
        "simple": published("simple"),
    }
    return {name: outline for name, outline in shapes.items() if outline is not None}
