"""A slice's points to its outlines, each with the moments of its points where they truly lie.

slice -> in the plane, heights apart -> curves (`fitting.section`) -> outlines, holes among them
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.errors import TooFewPoints
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import SectionFit, resolve_section
from reconstruction.reduction import bounding_box, reduce_points
from reconstruction.skinning.outlines import Outline, outline_of
from reconstruction.slices import Frame, Slice

_MOST_GRAINS = 1_500  # points kept one by one; of more, those that share a box are one
_WIDE = 2.0  # standard deviations: a box, ...
_ACROSS = 400.0  # ... but no less than the slice's size over that
_LEAST_MM = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Grains:
    """Points of a slice, near ones as one."""

    points_mm: FloatArray  # (n, 3), part frame
    counts: FloatArray  # (n,)


EMPTY = Grains(np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class SliceOutlines:
    """What became of one slice."""

    index: int
    frame: Frame
    outlines: tuple[Outline, ...]  # closed ones, by area, the largest first
    runs: tuple[Outline, ...]  # open ones, by length, the longest first
    strays: int  # points set aside
    unordered: int  # points that hang together without a curve
    notes: tuple[str, ...]  # what gave no curve
    undecided: tuple[str, ...] = ()  # contours that may be closed or open
    grains: Grains = EMPTY  # all its points, whatever became of them

    @property
    def unresolved(self) -> bool:
        """Whether points hang together in no closed outline, but in open runs or heaps."""
        return bool(self.runs or self.unordered)

    @property
    def height_mm(self) -> float:
        """Of the cutting plane along its normal."""
        return float(self.frame.origin_mm @ self.frame.axes[2])


def draw_outlines(piece: Slice, *, exact: Exact = Exact.AUTO, solid: bool = True) -> SliceOutlines:
    """Fit the contours of a slice; without any, the value says so and is no error.

    Parameters
    ----------
    solid
        As in `fitted_sections.draw_fitted_section`.
    """
    try:
        planar = piece.frame.to_plane(piece.points_mm)
        found = resolve_section(
            np.ascontiguousarray(planar[:, :2]),
            exact=exact,
            heights_mm=np.ascontiguousarray(planar[:, 2]),
            solid=solid,
        )
    except TooFewPoints as few:
        lost = len(piece.points_mm)
        return SliceOutlines(
            piece.index,
            piece.frame,
            (),
            (),
            lost,
            0,
            (str(few),),
            grains=_grains(piece.points_mm, ()),
        )
    drawn = [
        outline_of(piece.index, piece.frame, curve, hole=curve.closed and depth % 2 == 1)
        for curve, depth in zip(found.curves, found.depths, strict=True)
    ]
    return SliceOutlines(
        piece.index,
        piece.frame,
        tuple(each for each in drawn if each.fitted.closed),
        tuple(each for each in drawn if not each.fitted.closed),
        len(found.strays),
        len(found.unordered),
        tuple(f"a chain gave no curve: {why}" for why in found.failures),
        _undecided(found),
        _grains(piece.points_mm, found.curves),
    )


def _grains(points_mm: FloatArray, curves: Sequence[FittedCurve]) -> Grains:
    """Points (n, 3), those in one box about as wide as their scatter as one."""
    if len(points_mm) <= _MOST_GRAINS:
        return Grains(points_mm, np.ones(len(points_mm)))
    around = bounding_box(points_mm)
    size_mm = float(around.sides_mm.max())
    sigmas = [each.sigma_mm for each in curves]
    box_mm = max(_WIDE * float(np.median(sigmas)) if sigmas else 0.0, size_mm / _ACROSS, _LEAST_MM)
    cells = reduce_points(points_mm, size_mm=(box_mm, box_mm, box_mm), within=around)
    return Grains(cells.centres_mm, cells.counts.astype(np.float64))


def _undecided(found: SectionFit) -> tuple[str, ...]:
    return tuple(
        f"a contour {chain.length_mm:.3g} mm long may be closed or open:"
        f" {'closed' if curve.closed else 'open'}"
        for curve, chain in zip(found.curves, found.chains, strict=True)
        if curve.ambiguous
    )
