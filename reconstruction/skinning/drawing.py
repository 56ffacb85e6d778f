"""A slice's points to its outlines, each with the moments of its points where they truly lie.

slice -> in the plane, heights apart -> curves (`fitting.section`) -> outlines, holes among them
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.errors import TooFewPoints
from reconstruction.fitting.curve import Exact
from reconstruction.fitting.section import SectionFit, resolve_section
from reconstruction.skinning.outlines import Outline, outline_of
from reconstruction.slices import Frame, Slice


@dataclass(frozen=True, slots=True, eq=False)
class SliceOutlines:
    """What became of one slice."""

    index: int
    frame: Frame
    outlines: tuple[Outline, ...]  # closed ones, by area, the largest first
    runs: tuple[Outline, ...]  # open ones, by length, the longest first
    strays: int  # points set aside
    unordered: int  # points that hang together without a curve
    notes: tuple[str, ...]  # what is not certain

    @property
    def unresolved(self) -> bool:
        """Whether points hang together in no closed outline, but in open runs or heaps."""
        return bool(self.runs or self.unordered)

    @property
    def height_mm(self) -> float:
        """Of the cutting plane along its normal."""
        return float(self.frame.origin_mm @ self.frame.axes[2])


def draw_outlines(piece: Slice, *, exact: Exact = Exact.AUTO) -> SliceOutlines:
    """Fit the contours of a slice; without any, the value says so and is no error."""
    try:
        planar = piece.frame.to_plane(piece.points_mm)
        found = resolve_section(
            np.ascontiguousarray(planar[:, :2]),
            exact=exact,
            heights_mm=np.ascontiguousarray(planar[:, 2]),
            solid=True,
        )
    except TooFewPoints as few:
        return SliceOutlines(piece.index, piece.frame, (), (), len(piece.points_mm), 0, (str(few),))
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
        _notes(found),
    )


def _notes(found: SectionFit) -> tuple[str, ...]:
    notes = [f"a chain gave no curve: {why}" for why in found.failures]
    for curve, chain in zip(found.curves, found.chains, strict=True):
        if curve.ambiguous:
            taken = "closed" if curve.closed else "open"
            notes.append(f"a contour {chain.length_mm:.3g} mm long may be closed or open: {taken}")
    return tuple(notes)
