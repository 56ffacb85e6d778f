"""Pieces too short to have an order go to the chain that passes them.

A piece lies on a chain if nearly all of it lies within the scatter of the chain's points, or of a
bridge's way; on a long bridge there must be more than the strays of the slice explain. A piece that
lies straight ahead of an open end, and not far, is where the chain goes on after a hole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.fitting.bridging import outward
from reconstruction.fitting.closing import Joined
from reconstruction.fitting.crossing import ways_along
from reconstruction.fitting.nearness import nearest_way
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
    joined, found = _on_the_way(joined, order, places, chain_of_run)
    for number, one in enumerate(joined):
        for side in () if one.row.closed or one.row.exact else (0, 1):
            joined[number] = one = _carried_on(one, side, number, order, places, found)
    return joined, found


def _on_the_way(
    joined: list[Joined], order: Order, places: Places, chain_of_run: IntArray
) -> tuple[list[Joined], IntArray]:
    """Give pieces to the chains on whose rows and bridges they lie."""
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


def _carried_on(
    one: Joined, side: int, number: int, order: Order, places: Places, chain_of_run: IntArray
) -> Joined:
    """A chain with the loose pieces ahead of its first end, 0, or last, 1; they become its own."""
    row, runs = one.row, order.runs
    loose = (chain_of_run < 0) & ~order.patches
    free = np.flatnonzero(np.append(loose, False)[runs.run_of_place])
    tangent, reach = outward(row, side), float(row.reach[-side])
    arms = places.at[free] - row.nodes[-side]
    ahead, aside = arms @ tangent, np.abs(arms @ np.array([-tangent[1], tangent[0]]))
    near = (ahead > 0.0) & (ahead <= _SHORT * reach)
    near &= aside <= _FAR * row.sigma[-side] + _BENT * ahead
    run, of = np.unique(runs.run_of_place[free], return_inverse=True)
    taken = np.bincount(of, near, len(run)) >= _NEARLY_ALL * np.bincount(of, minlength=len(run))
    taken &= np.bincount(of, places.counts[free], len(run)) >= _COMPANY
    if not taken.any():
        return one
    chain_of_run[run[taken]] = number
    far = float(ahead[near & taken[of]].max())
    return _with_tip(one, side, row.nodes[-side] + far * tangent)


def _with_tip(one: Joined, side: int, tip: FloatArray) -> Joined:
    """A chain with one more node (2,) before its first, 0, or after its last, 1."""
    row, every = one.row, np.arange(len(one.row.nodes))
    like = np.append(every, every[-1:]) if side else np.append(every[:1], every)
    nodes, bridge = row.nodes[like], one.bridge[like]
    nodes[-side] = tip
    bridge[-2 if side else 0] = 0.0
    gaps = tuple(gap + 1 - side for gap in row.gaps)
    row = replace(row, nodes=nodes, sigma=row.sigma[like], reach=row.reach[like], gaps=gaps)
    return replace(one, row=row, bridge=bridge, put_together=True)


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
