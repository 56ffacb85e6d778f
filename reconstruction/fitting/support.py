"""Nodes that points support, and the others: put back in line, or left out.

A node by a stray or two would lie anywhere. Lengths along the row are in reaches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.fitting.regression import EXACT

_STEADY = 15  # nodes over which medians are taken
_SUPPORT = 4.0  # points close by, or half as many as usual, with which a node may lie anywhere ...
_SCANT = 6.0  # ... if they are not so many times fewer than usual
_COMPANY = 4.0  # times fewer than usual: strays, at the edge of a gap
_APART = 3.0  # reaches between supported nodes: beyond, nobody knows the way from one to the other
_BULGE = 2.5  # standard deviations: so far a node may lie from where those beside it lead
_LEAD = 4  # supported nodes that lead to one beyond them


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Nodes on a grid along a row, which may repeat after a period."""

    places: FloatArray  # (m, 2)
    sigma: FloatArray  # (m,), deviation of the points across
    close: FloatArray  # (m,), points within a step
    grid: FloatArray  # (m,), ascending
    period: float

    @property
    def closed(self) -> bool:
        """Whether they repeat."""
        return self.period < np.inf

    def steadied(self, values: FloatArray) -> FloatArray:
        """Running medians of values (m,)."""
        filtered = median_filter(values, size=_STEADY, mode="wrap" if self.closed else "nearest")
        return np.asarray(filtered)


def levelled(nodes: Nodes) -> tuple[FloatArray, BoolArray]:
    """Places (m, 2), those that bulge out for a point or two put back; and which are kept.

    At the edge of a gap there is nothing beside a node on one side: it is kept with points enough
    beside it, or if it lies ahead.
    """
    usual = nodes.steadied(nodes.close)
    least = np.maximum(np.minimum(_SUPPORT, usual / 2.0), usual / _SCANT)
    supported = nodes.close >= least
    if supported.mean() < 0.5 or supported.all():
        return nodes.places, np.ones(len(supported), np.bool_)
    at, places = nodes.grid[supported], nodes.places[supported]
    if nodes.closed:
        at = np.concatenate([at - nodes.period, at, at + nodes.period])
        places = np.concatenate([places, places, places])
    inner = _between(nodes.grid, at)
    line = np.stack([np.interp(nodes.grid, at, column) for column in places.T], axis=1)
    bulges = np.linalg.norm(nodes.places - line, axis=1) > _BULGE * nodes.sigma + EXACT
    kept = supported | inner
    kept |= _substantial(~kept, nodes, usual)
    for lost in np.flatnonzero(~kept & (nodes.close >= np.maximum(1.0, usual / _COMPANY))):
        kept[lost] = _lies_ahead(nodes, int(lost), at, places)
    return np.where((bulges & ~supported & inner)[:, None], line, nodes.places), kept


def _between(grid: FloatArray, at: FloatArray) -> BoolArray:
    """Whether there are supported nodes on either side, not too far apart."""
    following = np.searchsorted(at, grid)
    inner = (following > 0) & (following < len(at))
    following = np.clip(following, 1, len(at) - 1)
    return np.asarray(inner & (at[following] - at[following - 1] <= _APART))


def _substantial(lost: BoolArray, nodes: Nodes, usual: FloatArray) -> BoolArray:
    """Which of the lost nodes lie in stretches with points enough not to be of strays."""
    if not lost.any() or lost.all():
        return np.zeros(len(lost), np.bool_)
    first = int(np.argmin(lost)) if nodes.closed else 0  # no stretch over the seam
    lost = np.roll(lost, -first)
    stretch = np.cumsum(np.diff(lost, prepend=False)) * lost
    points, expected, sizes = (
        np.bincount(stretch, np.roll(values, -first))
        for values in (nodes.close, usual, np.ones(len(lost)))
    )
    # A point is close to two nodes.
    held = (points >= 2.0 * _SUPPORT) & (points >= expected / _COMPANY) & (sizes > 1)
    return np.asarray(np.roll(held[stretch] & lost, first))


def _lies_ahead(nodes: Nodes, lost: int, at: FloatArray, supported: FloatArray) -> bool:
    """Whether a node lies where the supported nodes on the nearer side of it lead."""
    place = float(nodes.grid[lost])
    nearest = int(np.argmin(np.abs(at - place)))
    ahead = 1 if place > at[nearest] else -1
    back = nearest - ahead * min(_LEAD, nearest if ahead > 0 else len(at) - 1 - nearest)
    run, beyond = abs(float(at[nearest] - at[back])), abs(place - float(at[nearest]))
    if not 0.0 < run <= 2.0 * _LEAD or beyond > _APART:
        return False
    share = beyond / run
    aim = supported[nearest] + share * (supported[nearest] - supported[back])
    off = float(np.linalg.norm(nodes.places[lost] - aim))
    return off <= _BULGE * float(nodes.sigma[lost]) * (1.0 + share) + EXACT
