"""Pieces too short to have an order go to the chain that passes them.

A piece lies on a chain if nearly all of it lies within the scatter of the chain's points, or of a
bridge's way; on a long bridge there must be more than the strays of the slice explain.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fitting.closing import Joined
from reconstruction.fitting.crossing import ways_along
from reconstruction.fitting.places import Places
from reconstruction.fitting.scale import Order
from reconstruction.fitting.thinning import Row

_FAR = 4.0  # standard deviations: farther off, a place is no chain's
_BENT = 0.1  # of a bridge's length: how far its way may be off
_SHORT = 6.0  # reaches: whatever lies on a bridge as short as this belongs to it
_NEARLY_ALL = 0.8  # of a piece's places
_COMPANY = 4  # points on a longer bridge, and ...
_SURPRISE = 3.0  # ... times what strays would be there: no strays


def gather(
    joined: list[Joined], order: Order, places: Places, chain_of_run: IntArray
) -> tuple[list[Joined], IntArray]:
    """Give loose pieces to the chains; the chain of each run is the same or that which got it."""
    found, runs, counts = chain_of_run.copy(), order.runs, places.counts
    loose = (chain_of_run < 0) & ~order.patches
    if not loose.any() or not joined:
        return joined, found
    free = np.flatnonzero(np.append(loose, False)[runs.run_of_place])
    ways = _Ways(joined)
    way, away = nearest_way(places.at[free], ways.start, ways.arm)
    near = away <= ways.tolerance[way]
    run, number = np.unique(runs.run_of_place[free], return_inverse=True)
    sizes, on = np.bincount(number), np.bincount(number, near)
    candidate = on >= _NEARLY_ALL * sizes
    # A piece on two bridges, or chains, is of that which holds more of it.
    of = np.array([
        np.bincount(ways.bridge[way[near & (number == piece)]]).argmax() if candidate[piece] else -1
        for piece in range(len(run))
    ])  # fmt: skip
    points = np.bincount(number, counts[free])
    stray = float(points[~candidate].sum()) / max(float(np.prod(np.ptp(places.at, axis=0))), 1e-300)
    for bridge in np.unique(of[candidate]):
        pieces = candidate & (of == bridge)
        expected = _SURPRISE * stray * ways.tube[bridge]
        if ways.short[bridge] or points[pieces].sum() >= _COMPANY + expected:
            found[run[pieces]] = ways.chain[bridge]
    grown = np.unique(found[found != chain_of_run])
    joined = [
        replace(one, put_together=one.put_together or number in grown)
        for number, one in enumerate(joined)
    ]
    return joined, found


def nearest_row(places: FloatArray, rows: list[Row]) -> IntArray:
    """Which row lies nearest to each place."""
    if len(rows) < 2 or not len(places):
        return np.zeros(len(places), np.int64)
    ways = [ways_along(row.nodes, closed=row.closed) for row in rows]
    whole = np.concatenate(ways)
    nearest = nearest_way(places, whole[:, 0].copy(), whole[:, 1] - whole[:, 0])[0]
    return np.repeat(np.arange(len(rows)), [len(each) for each in ways])[nearest]


class _Ways:
    """From node to node of all chains; each chain's own, and those of each of its bridges."""

    def __init__(self, joined: list[Joined]) -> None:
        rows = [one.row for one in joined]
        self.start = np.concatenate([row.nodes for row in rows])
        self.arm = np.concatenate([np.roll(row.nodes, -1, axis=0) - row.nodes for row in rows])
        last = np.cumsum([len(row.nodes) for row in rows]) - 1
        self.arm[[at for at, row in zip(last, rows, strict=True) if not row.closed]] = 0.0
        length = np.concatenate([one.bridge for one in joined])
        chain = np.repeat(np.arange(len(rows)), [len(row.nodes) for row in rows])
        sigma, reach = (
            np.concatenate([getattr(row, name) for row in rows]) for name in ("sigma", "reach")
        )
        self.tolerance = _FAR * sigma + _BENT * length
        kinds, first, self.bridge = np.unique(
            np.column_stack([chain, length]), axis=0, return_index=True, return_inverse=True
        )
        self.bridge = self.bridge.ravel()
        self.chain = kinds[:, 0].astype(np.int64)
        self.short = kinds[:, 1] <= _SHORT * reach[first]
        self.tube = 2.0 * self.tolerance[first] * kinds[:, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_way(
    places: FloatArray, starts: FloatArray, arms: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Nearest way of each place, and how far off it is."""
    way, away = np.zeros(len(places), np.int64), np.empty(len(places))
    for n in range(len(places)):
        best = np.inf
        for k in range(len(starts)):
            x, y = places[n, 0] - starts[k, 0], places[n, 1] - starts[k, 1]
            square = arms[k, 0] * arms[k, 0] + arms[k, 1] * arms[k, 1]
            share = (x * arms[k, 0] + y * arms[k, 1]) / max(square, 1e-300)
            share = min(max(share, 0.0), 1.0)
            x, y = x - share * arms[k, 0], y - share * arms[k, 1]
            if x * x + y * y < best:
                best, way[n] = x * x + y * y, k
        away[n] = math.sqrt(best)
    return way, away
