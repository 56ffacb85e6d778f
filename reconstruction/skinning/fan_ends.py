"""How a surface through meridians ends at the top and the bottom: in a pole, or at a level brim.

::

      __.--o  a pole: the sections reach the axis        |       |  a brim: they end before it,
    .'     :  (or head for it, level: the rest           |       |  steeply; a flat cap closes it
    |      :   is filled)                                '-------'

A pole is smooth where the sections reach it level, a tip where they do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.ends import Apex, Brim
from reconstruction.skinning.spreading import Spread
from reconstruction.slices import Frame

_REACHED = 0.03  # of the greatest distance from the axis: sections that end nearer have reached it
_SLOPE_OVER = 0.06  # of the stations, over which the slope at an end is told
_LEVEL = math.tan(math.radians(20.0))  # slopes below it are level
_MOST_STEPS = 8.0  # stations that a section may be carried on to a brim


@dataclass(frozen=True, slots=True, eq=False)
class FanEnd:
    """One end."""

    end: Brim | Apex
    seen: bool  # the sections reach the pole
    replaces: bool  # its row stands for the sections' last one

    @property
    def height_mm(self) -> float:
        """Of a brim, along the axis; of a pole, which no brim needs, nothing that matters."""
        return self.end.height_mm if isinstance(self.end, Brim) else math.nan

    def row_mm(self, edge_mm: FloatArray) -> FloatArray:
        """The end's own row, from the sections' last one (k, 3)."""
        if isinstance(self.end, Apex):
            return np.repeat(self.end.point_mm[None], len(edge_mm), axis=0)
        row = np.array(edge_mm)
        self.end.press(row)
        return row


def end_of(found: Spread, frame: Frame, *, last: bool) -> FanEnd:
    """Tell how the surface ends before the first row of stations, or after the last."""
    places = found.places_mm[:, ::-1] if last else found.places_mm
    measured = found.measured[:, ::-1] if last else found.measured
    over = max(int(_SLOPE_OVER * places.shape[1]), 2)
    # Of the sections that go so far: where others end early, neighbours have said what is missing.
    whole = measured[:, :2].any(axis=1) & measured[:, over]
    places = places[whole] if whole.any() else places
    edge = np.median(places[:, 0], axis=0)
    inner = np.median(places[:, over], axis=0)
    run, rise = edge - inner  # away from the axis, and up, as the section comes to its end
    slope = rise / run if abs(run) > 0.0 else math.copysign(math.inf, rise)
    reached = edge[0] < _REACHED * float(places[..., 0].max())
    inwards = run < 0.0
    if reached or (inwards and abs(slope) < _LEVEL):
        sharp = abs(slope) >= _LEVEL
        height = edge[1] - (edge[0] * slope if sharp else 0.0)
        apex = Apex(frame.origin_mm + height * frame.axes[2], sharp)
        return FanEnd(apex, seen=bool(reached), replaces=bool(reached))
    height = float(edge[1] + frame.origin_mm @ frame.axes[2])
    return FanEnd(Brim(height, frame.axes[2]), seen=False, replaces=True)


def between_levels(found: Spread, frame: Frame, low: FanEnd, high: FanEnd) -> Spread:
    """The same stations, but that they begin and end at the levels of brims."""
    places = np.array(found.places_mm)
    ground = float(frame.origin_mm @ frame.axes[2])
    columns = np.arange(float(places.shape[1]))
    for row in places:
        start, stop = columns[0], columns[-1]
        if isinstance(low.end, Brim):
            start = _crossing(row[:, 1], low.end.height_mm - ground)
        if isinstance(high.end, Brim):
            stop = columns[-1] - _crossing(-row[::-1, 1], ground - high.end.height_mm)
        if start < stop:
            row[:] = _carried_on(row, np.linspace(start, stop, len(columns)))
    return Spread(found.positions, places, found.measured)


def _crossing(heights: FloatArray, level: float) -> float:
    """Where rising heights first pass a level, in steps; below 0 if they begin above it."""
    above = np.flatnonzero(heights > level)
    first = int(above[0]) if len(above) else len(heights) - 1
    before = max(first - 1, 0)
    rise = float(heights[before + 1] - heights[before])
    if not rise > 0.0:
        return 0.0
    return float(np.clip(before + (level - heights[before]) / rise, -_MOST_STEPS, first))


def _carried_on(row: FloatArray, at: FloatArray) -> FloatArray:
    """Places between the stations (m, 2) of a row, straight on beyond its ends."""
    steps = np.arange(float(len(row)))
    first, last = row[0] - row[1], row[-1] - row[-2]
    inside = np.stack([np.interp(at, steps, x) for x in row.T], axis=1)
    inside += np.maximum(-at, 0.0)[:, None] * first
    return np.asarray(inside + np.maximum(at - steps[-1], 0.0)[:, None] * last)
