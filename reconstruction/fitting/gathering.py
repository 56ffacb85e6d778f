"""Pieces too short to have an order go to the chain that passes them.

A piece lies on a chain if nearly all of it lies within the scatter of the chain's points, or of a
bridge's way; to lie on a bridge it needs the company that a few strays do not have.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.closing import Joined
from reconstruction.fitting.linking import Runs

_FAR = 4.0  # standard deviations: farther off, a place is no chain's
_BENT = 0.1  # of a bridge's length: how far its way may be off
_SHORT = 6.0  # reaches: whatever lies on a bridge as short as this belongs to it
_NEARLY_ALL = 0.8  # of a piece's places
_COMPANY = 4  # points; fewer on a longer bridge are strays
_SPARSE = 1 / 8  # of the chain's points on a length; fewer on a longer bridge are strays


def gather(
    joined: list[Joined],
    runs: Runs,
    places: FloatArray,
    counts: IntArray,
    chain_of_run: IntArray,
    loose: BoolArray,
) -> IntArray:
    """The chain of each run, loose ones on a chain's way included; else as it was."""
    found = chain_of_run.copy()
    if not loose.any() or not joined:
        return found
    loose = np.flatnonzero(np.append(loose, False)[runs.run_of_place])
    ways = _Ways(joined, _densities(joined, runs, counts, chain_of_run))
    way, away, along = _nearest(places[loose], ways.start, ways.arm)
    near = away <= _FAR * ways.sigma[way] + _BENT * ways.bridge[way]
    run = runs.run_of_place[loose]
    order = np.argsort(run, kind="stable")
    for mine in np.split(order, np.flatnonzero(np.diff(run[order])) + 1):
        chain = int(np.bincount(ways.chain[way[mine]]).argmax())
        of = mine[(ways.chain[way[mine]] == chain) & near[mine]]
        if len(of) >= _NEARLY_ALL * len(mine) and ways.hold(way[of], along[of], counts[loose[of]]):
            found[run[mine[0]]] = chain
    return found


def _densities(
    joined: list[Joined], runs: Runs, counts: IntArray, chain_of_run: IntArray
) -> FloatArray:
    """Points on a length of each chain, bridges not counted."""
    chain = np.append(chain_of_run, -1)[runs.run_of_place]
    points = np.bincount(chain[chain >= 0], counts[chain >= 0], len(joined))
    lengths = [max(_lengths(one)[one.bridge == 0.0].sum(), 1e-300) for one in joined]
    return np.asarray(points / lengths)


def _lengths(one: Joined) -> FloatArray:
    """Of the ways from node to node; that after an open row's last is none."""
    arms = np.roll(one.row.nodes, -1, axis=0) - one.row.nodes
    lengths = np.linalg.norm(arms, axis=1)
    if not one.row.closed:
        lengths[-1] = 0.0
    return np.asarray(lengths)


class _Ways:
    """From node to node of all chains."""

    def __init__(self, joined: list[Joined], density: FloatArray) -> None:
        rows = [one.row for one in joined]
        self.start = np.concatenate([row.nodes for row in rows])
        self.arm = np.concatenate([np.roll(row.nodes, -1, axis=0) - row.nodes for row in rows])
        last = np.cumsum([len(row.nodes) for row in rows]) - 1
        self.arm[[at for at, row in zip(last, rows, strict=True) if not row.closed]] = 0.0
        self.sigma = np.concatenate([row.sigma for row in rows])
        self.reach = np.concatenate([row.reach for row in rows])
        self.bridge = np.concatenate([one.bridge for one in joined])
        self.chain = np.repeat(np.arange(len(rows)), [len(row.nodes) for row in rows])
        self.up = np.concatenate([_lengths(one).cumsum() - _lengths(one) for one in joined])
        self.density = density

    def hold(self, way: IntArray, along: FloatArray, counts: IntArray) -> bool:
        """Whether places that lie on a chain's ways are of it, and no strays on a bridge."""
        bridge, reach = float(self.bridge[way].max()), float(self.reach[way].max())
        if bridge <= _SHORT * reach:
            return True
        points = float(counts.sum())
        length = float(np.ptp(self.up[way] + along)) + reach
        return points >= max(_COMPANY, _SPARSE * self.density[self.chain[way[0]]] * length)


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(
    places: FloatArray, starts: FloatArray, arms: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Nearest way of each place, how far off it is, and how far along the way its foot lies."""
    way = np.zeros(len(places), np.int64)
    away, along = np.empty(len(places)), np.empty(len(places))
    for n in range(len(places)):
        best = np.inf
        for k in range(len(starts)):
            x, y = places[n, 0] - starts[k, 0], places[n, 1] - starts[k, 1]
            square = arms[k, 0] * arms[k, 0] + arms[k, 1] * arms[k, 1]
            share = (x * arms[k, 0] + y * arms[k, 1]) / max(square, 1e-300)
            share = min(max(share, 0.0), 1.0)
            x, y = x - share * arms[k, 0], y - share * arms[k, 1]
            if x * x + y * y < best:
                best, way[n], along[n] = x * x + y * y, k, share * math.sqrt(square)
        away[n] = math.sqrt(best)
    return way, away, along
