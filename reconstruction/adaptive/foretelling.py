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
from dataclasses import dataclass
from enum import Enum

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.distances import polygon_distances
from reconstruction.fitting.curve import FittedCurve
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.slices import Frame

_CORNERS = 360  # of the polygon that stands for a contour
_PLACES = 400  # of a section that are foretold
_SHARE = 98.0  # percent: a section's error is what so many of its places are within
_SIGMAS = 2.33  # so far from 0 lie 98 % of a normal distribution's places
_EDGE_NODES = 2  # sections to either side: a cubic where there are so many


class Kind(Enum):
    """What a slice shows of the part."""

    SECTION = "a section"
    UNCLEAR = "points in no contour"  # such as a slice along a level top
    NOTHING = "nothing"


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One slice as far as it matters for the choice of the next."""

    height_mm: float
    kind: Kind
    loops_mm: tuple[FloatArray, ...]  # (m, 2) each, material on the left
    places_mm: FloatArray  # (n, 2) evenly along them, where points were measured
    noise_mm: float  # one standard deviation of the contours
    holes: int
    gap_share: float  # of the contours' length

    def __post_init__(self) -> None:
        object.__setattr__(self, "loops_mm", tuple(frozen(each) for each in self.loops_mm))
        object.__setattr__(self, "places_mm", frozen(self.places_mm))

    @property
    def topology(self) -> tuple[int, int]:
        """How many contours around material there are, and how many around holes."""
        return len(self.loops_mm) - self.holes, self.holes


def level_of(drawn: SliceOutlines, plane: Frame) -> Level:
    """What one slice says, its contours laid into a plane that all slices share."""
    height_mm = float((drawn.frame.origin_mm - plane.origin_mm) @ plane.axes[2])
    if not drawn.outlines:
        kind = Kind.UNCLEAR if drawn.unresolved else Kind.NOTHING
        return Level(height_mm, kind, (), np.empty((0, 2)), 0.0, 0, 0.0)
    loops, places, variances, gaps = [], [], [], []
    for each in drawn.outlines:
        u, weights = _evenly(each.fitted)
        loops.append(_laid(each.fitted(np.linspace(0.0, 1.0, _CORNERS, endpoint=False)), drawn, plane))
        measured = ~_in_gaps(each.fitted, u)
        places.append(_laid(each.fitted(u[measured]), drawn, plane))
        variances.append(each.fitted.deviation_mm(u[measured]) ** 2)
        gaps.append(1.0 - measured.mean())
    noise_mm = math.sqrt(float(np.median(np.concatenate(variances)))) if sum(map(len, variances)) else 0.0
    holes = sum(each.hole for each in drawn.outlines)
    return Level(
        height_mm, Kind.SECTION, tuple(loops), np.concatenate(places), noise_mm, holes,
        float(np.mean(gaps)),
    )  # fmt: skip


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
    return np.array(
        [
            np.prod((height_mm - np.delete(nodes, k)) / (node - np.delete(nodes, k)))
            for k, node in enumerate(nodes)
        ]
    )


def reach(height_mm: float, nodes_mm: Sequence[float]) -> float:
    """Product of a height's distances from nodes: what the error of a polynomial grows with."""
    return float(np.prod(np.abs(height_mm - np.asarray(nodes_mm))))


@dataclass(frozen=True, slots=True)
class Miss:
    """How far a measured section lies from what its neighbours foretell of it."""

    linear_mm: float  # by the two beside it
    cubic_mm: float  # by two on either side, where there are so many
    noise_mm: float  # of the comparison
    nodes_mm: tuple[float, ...]  # heights that the cubic came from


def missed(levels: Sequence[Level], at: int) -> Miss:
    """Foretell section `at` from its neighbours, which must be sections, too."""
    here = levels[at]
    around = [k for k in range(at - _EDGE_NODES, at + _EDGE_NODES + 1) if 0 <= k < len(levels)]
    nodes = [k for k in around if k != at]
    seen = {k: signed_distances(here.places_mm, levels[k]) for k in nodes}
    low, high = levels[at - 1], levels[at + 1]
    lean = (seen[at + 1] - seen[at - 1]) / (high.height_mm - low.height_mm)
    across = np.sqrt(1.0 + lean**2)

    def error_mm(chosen: Sequence[int]) -> tuple[float, float]:
        weights = weights_at(here.height_mm, [levels[k].height_mm for k in chosen])
        foretold = sum(w * seen[k] for w, k in zip(weights, chosen, strict=True))
        apart = float(np.percentile(np.abs(foretold) / across, _SHARE))
        noise = math.hypot(here.noise_mm, *(w * levels[k].noise_mm for w, k in zip(weights, chosen, strict=True)))
        return math.sqrt(max(0.0, apart**2 - (_SIGMAS * noise) ** 2)), noise

    linear, noise = error_mm([at - 1, at + 1])
    cubic, _ = error_mm(nodes)
    return Miss(linear, cubic, noise, tuple(levels[k].height_mm for k in nodes))


def jump_mm(low: Level, high: Level) -> float:
    """How far two sections lie from each other at most, in space: less than their distance."""
    rise = high.height_mm - low.height_mm
    both = [signed_distances(low.places_mm, high), signed_distances(high.places_mm, low)]
    apart = np.abs(np.concatenate(both))
    return float(np.percentile(apart * rise / np.hypot(apart, rise), _SHARE)) if len(apart) else rise


def _laid(points_mm: FloatArray, drawn: SliceOutlines, plane: Frame) -> FloatArray:
    return np.ascontiguousarray(plane.to_plane(drawn.frame.to_part(points_mm))[:, :2])


def _evenly(fitted: FittedCurve) -> tuple[FloatArray, FloatArray]:
    fine = np.linspace(0.0, 1.0, 4 * _PLACES + 1)
    steps = np.linalg.norm(np.diff(fitted(fine), axis=0), axis=1)
    length = np.concatenate([[0.0], steps.cumsum()])
    at = np.linspace(0.0, length[-1], _PLACES, endpoint=False)
    return np.interp(at, length, fine), length


def _in_gaps(fitted: FittedCurve, u: FloatArray) -> FloatArray:
    inside = np.zeros(len(u), bool)
    for start, end in fitted.gap_intervals:
        inside |= ((u >= start) & (u <= end)) | (u + 1.0 <= end)
    return inside
