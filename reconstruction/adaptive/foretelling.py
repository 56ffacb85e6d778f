"""A section foretold by its neighbours, and how far what was measured lies from that.

What is interpolated between sections is their signed distance: a number at every place of the
plane, whatever the count of contours and however they run::

    height        d(x, y) < 0 in the material
      h3   d3 |
      h2 . . .|. . . . a measured place p of section 2 has d2(p) = 0; its neighbours foretell
      h1   d1 |        d(p) = sum of Lagrange's weights at h2 times d1(p), d3(p)

The foretold distance lies in the plane. What matters is the one across the surface: of a wall that
leans so that d changes by s with every millimetre of height it is smaller by sqrt(1 + s^2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, frozen
from reconstruction.distances import polygon_distances
from reconstruction.fitting.curve import FittedCurve
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.slices import Frame

SHARE = 98.0  # percent of the places are within what is called an error
QUANTILES = 50  # stand for the errors of a section's places
_SIGMAS = 2.33  # of a normal distribution 98 % lie within so many
_CORNERS = 360  # of the polygon that stands for a contour
_PLACES = 400  # of a contour that are foretold
_FINE = 1600  # steps by which a contour's length is told
_NODES = 2  # sections to either side: a cubic where there are so many


class Kind(Enum):
    """What a slice shows of the part."""

    SECTION = "contours"
    UNCLEAR = "points in no contour"  # such as a slice along a level top
    NOTHING = "nothing"
    UNREAD = "its file is damaged"


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One slice as far as it matters for the choice of the next."""

    height_mm: float
    kind: Kind
    loops_mm: tuple[FloatArray, ...] = ()  # (m, 2) each, material on the left
    # (n, 2) evenly along them, where points were measured
    places_mm: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    noise_mm: float = 0.0  # one standard deviation of the contours
    holes: int = 0  # of the contours
    gap_share: float = 0.0  # of their places, where nothing was measured
    length_mm: float = 0.0  # of the contours
    area_mm2: float = 0.0  # of the material inside

    def __post_init__(self) -> None:
        object.__setattr__(self, "loops_mm", tuple(frozen(each) for each in self.loops_mm))
        object.__setattr__(self, "places_mm", frozen(self.places_mm))

    @property
    def topology(self) -> tuple[int, int]:
        """How many contours there are around material, and how many around holes."""
        return len(self.loops_mm) - self.holes, self.holes


@dataclass(frozen=True, slots=True, eq=False)
class Miss:
    """How far a measured section lies from what its neighbours foretell, place by place, sorted.

    What noise makes of that is taken off.
    """

    height_mm: float
    linear_mm: FloatArray  # (QUANTILES,) by the two beside it
    cubic_mm: FloatArray  # (QUANTILES,) by two on either side, where there are so many
    beside_mm: tuple[float, float]  # heights of the two
    nodes_mm: tuple[float, ...]  # and of all


def level_of(drawn: SliceOutlines, plane: Frame, height_mm: float) -> Level:
    """What one slice says, its contours laid into the plane that all slices share.

    Parameters
    ----------
    height_mm
        Along the plane's normal; slices without a point have none of their own.
    """
    if not drawn.outlines:
        return Level(height_mm, Kind.UNCLEAR if drawn.unresolved else Kind.NOTHING)
    loops, places, variances, missing = [], [], [], []
    length_mm = area_mm2 = 0.0
    for each in drawn.outlines:
        corners = each.fitted(np.linspace(*each.fitted.domain, _CORNERS, endpoint=False))
        loops.append(_laid(corners, drawn.frame, plane))
        length_mm += float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).sum())
        area_mm2 += (-1.0 if each.hole else 1.0) * _area_mm2(corners)
        u = _evenly(each.fitted)
        gap = _in_gaps(each.fitted, u)
        places.append(_laid(each.fitted(u[~gap]), drawn.frame, plane))
        variances.append(each.fitted.deviation_mm(u[~gap]) ** 2)
        missing.append(gap)
    known = np.concatenate(variances)
    return Level(
        height_mm,
        Kind.SECTION,
        tuple(loops),
        np.concatenate(places),
        math.sqrt(float(np.median(known))) if len(known) else 0.0,
        sum(each.hole for each in drawn.outlines),
        float(np.concatenate(missing).mean()),
        length_mm,
        max(area_mm2, 0.0),
    )


def missed(levels: Sequence[Level], at: int) -> Miss:
    """Foretell section `at` from those around it, each of the same contours."""
    here = levels[at]
    around = [k for k in range(at - _NODES, at + _NODES + 1) if 0 <= k < len(levels) and k != at]
    seen = {k: signed_distances(here.places_mm, levels[k]) for k in around}
    lean = (seen[at + 1] - seen[at - 1]) / (levels[at + 1].height_mm - levels[at - 1].height_mm)
    across = np.sqrt(1.0 + lean**2)

    def errors_mm(chosen: Sequence[int]) -> FloatArray:
        weights = weights_at(here.height_mm, [levels[k].height_mm for k in chosen])
        foretold = weights @ np.stack([seen[k] for k in chosen])
        noises = [w * levels[k].noise_mm for w, k in zip(weights, chosen, strict=True)]
        noise_mm = _SIGMAS * math.hypot(here.noise_mm, *noises)
        apart = np.abs(foretold) / across
        whole_mm = max(float(np.percentile(apart, SHARE)), 1e-300)
        return quantiles(apart) * (math.sqrt(max(0.0, whole_mm**2 - noise_mm**2)) / whole_mm)

    beside = (levels[at - 1].height_mm, levels[at + 1].height_mm)
    nodes = tuple(levels[k].height_mm for k in around)
    if not len(here.places_mm):
        return Miss(here.height_mm, np.zeros(QUANTILES), np.zeros(QUANTILES), beside, nodes)
    return Miss(here.height_mm, errors_mm([at - 1, at + 1]), errors_mm(around), beside, nodes)


def jumps_mm(low: Level, high: Level) -> FloatArray:
    """How far two sections lie from each other, in space: never farther than their heights.

    (QUANTILES,), sorted.
    """
    rise = high.height_mm - low.height_mm
    both = [signed_distances(low.places_mm, high), signed_distances(high.places_mm, low)]
    apart = np.abs(np.concatenate(both))
    return quantiles(apart * rise / np.hypot(apart, rise) if len(apart) else np.array([rise]))


def quantiles(values: FloatArray) -> FloatArray:
    """So many that each stands for the same share of the values."""
    return np.quantile(values, (np.arange(QUANTILES) + 0.5) / QUANTILES)


def signed_distances(places_mm: FloatArray, level: Level) -> FloatArray:
    """Distance of places (n, 2) from the nearest contour of a section, negative in material."""
    nearest = np.full(len(places_mm), np.inf)
    for loop in level.loops_mm:
        found = polygon_distances(places_mm, loop)
        nearest = np.where(np.abs(found) < np.abs(nearest), found, nearest)
    return nearest


def weights_at(height_mm: float, nodes_mm: Sequence[float]) -> FloatArray:
    """Lagrange's weights (k,) of nodes at a height."""
    nodes = np.asarray(nodes_mm, np.float64)
    others = [np.delete(nodes, k) for k in range(len(nodes))]
    ratios = [(height_mm - rest) / (at - rest) for at, rest in zip(nodes, others, strict=True)]
    return np.array([np.prod(each) for each in ratios])


def reach(height_mm: float, nodes_mm: Sequence[float]) -> float:
    """Product of a height's distances from nodes: what a polynomial's error grows with."""
    return float(np.prod(np.abs(height_mm - np.asarray(nodes_mm))))


def _area_mm2(corners: FloatArray) -> float:
    x, y = corners.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _laid(points_mm: FloatArray, own: Frame, plane: Frame) -> FloatArray:
    return np.ascontiguousarray(plane.to_plane(own.to_part(points_mm))[:, :2])


def _evenly(fitted: FittedCurve) -> FloatArray:
    """Parameters (n,) of a closed curve at equal steps along it."""
    fine = np.linspace(*fitted.domain, _FINE + 1)
    steps = np.linalg.norm(np.diff(fitted(fine), axis=0), axis=1)
    length = np.concatenate([[0.0], steps.cumsum()])
    return np.interp(np.linspace(0.0, length[-1], _PLACES, endpoint=False), length, fine)


def _in_gaps(fitted: FittedCurve, u: FloatArray) -> BoolArray:
    start, end = fitted.domain
    inside = np.zeros(len(u), np.bool_)
    for low, high in fitted.gap_intervals:
        inside |= ((u >= low) & (u <= high)) | (u + end - start <= high)
    return inside
