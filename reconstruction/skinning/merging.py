"""Cells of neighbouring places as one, where there are more than a net can use.

A net's spans see no more of the points than a few cells in each of them tell; a cell's covariance
keeps what the surface's slope and bend over it must be told (`feet`). Single points stay alone:
whether they belong to the surface is decided one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.net import Net
from reconstruction.skinning.outlines import Moments

_A_SPAN = 3  # cells, in either direction
_LEAST = 128  # cells in either direction: over wider ones a bend looks like noise
_FAR_TOO_MANY = 1.5  # times as many cells: then they are merged


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """All cells of a branch, in parts, and where on the net each belongs, roughly."""

    parts: tuple[Moments, ...]
    u: FloatArray  # (cells of all parts,)
    v: FloatArray

    @property
    def total(self) -> int:
        """How many points the cells hold."""
        return sum(part.total for part in self.parts)


@dataclass(frozen=True, slots=True, eq=False)
class Merged:
    """The cells that a net is fitted to."""

    moments: Moments
    u: FloatArray  # (m,)
    v: FloatArray
    groups: IntArray | None  # of each of all cells, the cell it is in; None: they are the same


def merged_for(net: Net, cells: Cells) -> Merged:
    """As many cells in a span as it can use, if there are far more."""
    # A whole number in each span: at a crease, a knot, no cell belongs to both faces.
    columns, rows = (int(end * max(_A_SPAN, np.ceil(_LEAST / end))) for end in net.spans)
    if len(cells.u) <= _FAR_TOO_MANY * columns * rows:
        return Merged(Moments.together(cells.parts), cells.u, cells.v, None)
    column, row = (
        np.minimum((t * (count / end)).astype(np.int64), count - 1)
        for t, count, end in zip((cells.u, cells.v), (columns, rows), net.spans, strict=True)
    )
    groups = column * rows + row
    counts = np.concatenate([part.counts for part in cells.parts])
    single = np.flatnonzero(counts == 1.0)
    groups[single] = columns * rows + np.arange(len(single))
    used = np.bincount(groups, minlength=columns * rows) > 0
    groups = (np.cumsum(used) - 1)[groups]
    count = int(used.sum())
    held = np.asarray(np.bincount(groups, counts, count), dtype=np.float64)
    u, v = (np.bincount(groups, counts * t, count) / held for t in (cells.u, cells.v))
    return Merged(_moments(cells.parts, groups, held), u, v, groups)


def moved_along(cells: Cells, merged: Merged, u: FloatArray, v: FloatArray, net: Net) -> Cells:
    """All cells after those that they were merged into have moved to (u, v)."""
    if merged.groups is None:
        return Cells(cells.parts, u, v)
    moved = []
    for own, before, after, end, closed in (
        (cells.u, merged.u, u, net.spans[0], net.closed_u),
        (cells.v, merged.v, v, net.spans[1], net.closed_v),
    ):
        step = after - before
        if closed:
            step -= end * np.round(step / end)
        there = own + step[merged.groups]
        moved.append(np.mod(there, end) if closed else np.clip(there, 0.0, end))
    return Cells(cells.parts, moved[0], moved[1])


def _moments(parts: Sequence[Moments], groups: IntArray, held: FloatArray) -> Moments:
    """Cells of equal group as one, exactly."""
    means, spread = np.zeros((len(held), 3)), np.zeros((len(held), 3, 3))
    bounds = np.cumsum([0, *(len(part) for part in parts)])
    for part, start, end in zip(parts, bounds[:-1], bounds[1:], strict=True):
        _add_means(part.counts, part.means_mm, groups[start:end], held, means)
    for part, start, end in zip(parts, bounds[:-1], bounds[1:], strict=True):
        _add_spread(
            part.counts, part.means_mm, part.covariances_mm2, groups[start:end], held, means, spread
        )
    return Moments(held, means, spread)


@njit(cache=True, nogil=True)
def _add_means(
    counts: FloatArray, means: FloatArray, groups: IntArray, held: FloatArray, out: FloatArray
) -> None:
    for m in range(len(counts)):
        share = counts[m] / held[groups[m]]
        for d in range(3):
            out[groups[m], d] += share * means[m, d]


@njit(cache=True, nogil=True)
def _add_spread(
    counts: FloatArray, means: FloatArray, covariances: FloatArray, groups: IntArray,
    held: FloatArray, middles: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    for m in range(len(counts)):
        g = groups[m]
        share = counts[m] / held[g]
        for d in range(3):
            for e in range(3):
                arms = (means[m, d] - middles[g, d]) * (means[m, e] - middles[g, e])
                out[g, d, e] += share * (covariances[m, d, e] + arms)
