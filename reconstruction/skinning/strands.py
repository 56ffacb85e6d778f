"""Open sections as strands: what runs across the surface in one plane, in coordinates they share.

A slice gives one strand, of one run or more where the light lost the part. A plane through the
axis that sees both sides of it gives two, half a turn apart::

    stripes     (along x, along y of the planes), at the height of the plane
    meridians   (distance from the axis, height along it), at the angle of the half plane
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, frozen
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.layout import Fan
from reconstruction.skinning.outlines import Outline
from reconstruction.slices import Frame

_PLACES = 257  # of a run
_BEYOND = 0.1  # of how far a plane reaches on one side of the axis: less beyond it is noise
_FEWEST = 2  # places


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """One open section."""

    slice_index: int
    position: float  # height of the plane in mm, or angle in rad
    runs_mm: tuple[FloatArray, ...]  # (n, 2) each

    @property
    def length_mm(self) -> float:
        """Of all its runs."""
        return sum(length_mm(run) for run in self.runs_mm)


def length_mm(run: FloatArray) -> float:
    """Of a polyline (n, 2)."""
    return float(np.linalg.norm(np.diff(run, axis=0), axis=1).sum())


def stripes_of(stack: Sequence[SliceOutlines]) -> tuple[Strand, ...]:
    """A strand of every slice that has open runs; slices in parallel planes, by height."""
    axes = stack[0].frame.axes
    return tuple(
        Strand(piece.index, piece.height_mm, runs)
        for piece in stack
        if (runs := tuple(_placed(run, piece.frame) @ axes[:2].T for run in piece.runs))
    )


def meridians_of(stack: Sequence[SliceOutlines], fan: Fan) -> tuple[Strand, ...]:
    """One or two strands of every slice through the axis, by angle."""
    found = [strand for piece in stack for strand in _sides(piece, fan)]
    return tuple(sorted(found, key=lambda each: each.position))


def _sides(piece: SliceOutlines, fan: Fan) -> list[Strand]:
    runs = [fan.places_of(_placed(run, piece.frame), piece.frame) for run in piece.runs]
    if not runs:
        return []
    ahead = max(float(run[:, 0].max()) for run in runs)
    behind = -min(float(run[:, 0].min()) for run in runs)
    angle = fan.angle_of(piece.frame)
    found = []
    for sign, reach, other in ((1.0, ahead, behind), (-1.0, behind, ahead)):
        if not reach > max(_BEYOND * other, 0.0):
            continue
        turned = [run * np.array([sign, 1.0]) for run in runs]
        own = tuple(part for run in turned for part in _ahead(run))
        if own:
            position = (angle + (math.pi if sign < 0.0 else 0.0)) % math.tau
            found.append(Strand(piece.index, position, own))
    return found


def _ahead(run: FloatArray) -> list[FloatArray]:
    """The parts of a run (n, 2) on this side of the axis."""
    on_this_side = run[:, 0] >= 0.0
    if on_this_side.all():
        return [run]
    parts = np.split(np.arange(len(run)), np.flatnonzero(np.diff(on_this_side)) + 1)
    return [run[part] for part in parts if on_this_side[part[0]] and len(part) >= _FEWEST]


def _placed(run: Outline, frame: Frame) -> FloatArray:
    """Places (n, 3) along a run in the part frame."""
    return frozen(frame.to_part(run.polygon_mm(_PLACES)))
