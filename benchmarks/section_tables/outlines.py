"""True outlines, noisy points of them in no order, and how far a curve lies from the truth."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.section import SectionFit

Array = NDArray[np.float64]
Generator = np.random.Generator

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data"
CURVES = Path(os.environ.get("LOFTSCAN_DATA", _BESIDE)) / "curves"
SIGMA_MM = 0.5
SAMPLES = 4000
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

    def polar_deg(self, places: Array, start_deg: float) -> Array:
        """Polar angle about the centre, counted from a start, in [0, 360)."""
        arms = places - self.centre_mm
        return np.mod(np.degrees(np.arctan2(arms[:, 1], arms[:, 0])) - start_deg, 360)


def polar_outline(radius: Callable[[Array], Array]) -> Outline:
    """An outline by its radius over the polar angle in rad."""
    turn = np.linspace(0, 2 * np.pi, 40_001)
    return Outline(radius(turn)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


def superformula(first: float, others: float, mean_radius_mm: float = 50.0) -> Outline:
    """Five lobes with exponents n1 and n2 = n3 (Gielis 2003)."""

    def radius(turn: Array) -> Array:
        sides = np.abs(np.cos(1.25 * turn)) ** others + np.abs(np.sin(1.25 * turn)) ** others
        form = sides ** (-1 / first)
        return form * mean_radius_mm / form[:-1].mean()

    return polar_outline(radius)


def outlines() -> dict[str, Outline]:
    """The five shapes, as far as the data are there."""
    turn = np.linspace(0, 2 * np.pi, 40_001)
    shapes = {
        "circle": polar_outline(lambda turn: np.full(len(turn), 50.0)),
        "ellipse": Outline(np.column_stack([60 * np.cos(turn), 30 * np.sin(turn)])),
        "superformula": superformula(3, 6),
    }
    for name in ("blob2", "simple"):
        path = CURVES / f"{name}.npz"
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


def drawn(
    outline: Outline, seed: int, *, count: int = 2000, sigma_mm: float = SIGMA_MM
) -> tuple[Array, Array]:
    """Points at random places of the outline, evenly over its length, shuffled; and their shares.

    The shares are for those who are told the order.
    """
    rng = np.random.default_rng(seed)
    share = np.sort(rng.random(count))
    points = outline(share) + rng.normal(0, sigma_mm, (count, 2))
    order = rng.permutation(count)
    return points[order], share[order]


def akin(count: int, neighbours: int, rng: Generator) -> Array:
    """Unit noise, a moving mean over so many neighbours in the outline's order."""
    sums = np.vstack([np.zeros(2), rng.normal(size=(count + neighbours - 1, 2))]).cumsum(axis=0)
    return (sums[neighbours:] - sums[:-neighbours]) / np.sqrt(neighbours)


def evenly(curve: FittedCurve) -> tuple[Array, Array]:
    """Places along a closed curve and the share of the length each stands for."""
    places = curve(EVEN)
    return places, weights_of(places)


def weights_of(places: Array) -> Array:
    """Share of the length that each place of a closed row stands for."""
    steps = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    lengths = steps + np.roll(steps, -1)
    return np.asarray(lengths / lengths.sum())


def rms_mm(curve: FittedCurve, outline: Outline) -> float:
    """Distance to the truth, root mean square over arc length."""
    places, weights = evenly(curve)
    return float(np.sqrt((weights * outline.distances_mm(places) ** 2).sum()))


def the_loop(found: SectionFit) -> FittedCurve | None:
    """The one closed curve of a slice that has one; None if something else was found."""
    one = found.curves[0] if len(found.curves) == 1 else None
    return one if one is not None and one.closed else None


def pooled(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
