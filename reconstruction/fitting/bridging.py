r"""Ways over gaps: how far, how hard they turn, where they would run, and what they would cross.

A bridge from end to end is judged by its length d and by the turn it needs: with the angles a from
the tangent at its start to its chord, and b from its chord to the tangent at its end, the bending
energy of its cubic is 4 (a^2 - ab + b^2) / d. ::

          a _____ b
     ----> /     \ ---->      a = b: an arc, turning by 2 a
                              a = -b: an S, which counts as one of 3.5 a
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.thinning import Row

_TANGENT = 5.0  # reaches: the stretch of a run that tells the direction of its end
_TOUCHING = 2.0  # reaches: so near, the way from end to end has no direction either
_STIFF = 1.0  # how much a turn of one radian adds to a bridge's cost, in its lengths
_HOPELESS = math.radians(270.0)  # turn from which no gap explains two ends
_PIECES = 12  # of a bridge's way
_CHOICE = 8  # bridges that are thought of at each end


@dataclass(frozen=True, slots=True, eq=False)
class Ends:
    """Where open rows end; end 2 n is the first node of row n, end 2 n + 1 its last."""

    numbers: IntArray  # (e,)
    places: FloatArray  # (e, 2)
    outward: FloatArray  # (e, 2), unit tangents
    reach: FloatArray  # (e,)
    sigma: FloatArray  # (e,)


@dataclass(frozen=True, slots=True, eq=False)
class Bridge:
    """A way from one end to another."""

    one: int
    other: int
    cost: float
    length: float
    turn: float
    sigma: float  # of the end where the points scatter more
    near: float  # so near, ends touch: the way from one to the other has no direction

    @property
    def touching(self) -> bool:
        return self.length <= self.near


def ends_of(rows: list[Row]) -> Ends:
    """The ends of all open rows."""
    sides = [(n, side) for n, row in enumerate(rows) if not row.closed for side in (0, 1)]
    return Ends(
        np.array([2 * n + side for n, side in sides], np.int64),
        np.array([rows[n].nodes[-side] for n, side in sides]).reshape(-1, 2),
        np.array([_outward(rows[n], side) for n, side in sides]).reshape(-1, 2),
        np.array([rows[n].reach[-side] for n, side in sides]),
        np.array([rows[n].sigma[-side] for n, side in sides]),
    )


def bridges_between(ends: Ends) -> list[Bridge]:
    """The cheapest few bridges of every end that are not hopeless, the cheapest first."""
    arms = ends.places[None] - ends.places[:, None]
    lengths = np.hypot(arms[..., 0], arms[..., 1])
    near = _TOUCHING * np.maximum(ends.reach[:, None], ends.reach[None])
    sigma = np.maximum(ends.sigma[:, None], ends.sigma[None])
    touching = lengths <= near
    one, other = ends.outward[:, None], ends.outward[None]
    turns = np.where(touching, np.abs(_angles(one, -other)), turns_of(one, arms, other))
    costs = np.where(turns <= _HOPELESS, lengths * (1.0 + _STIFF * turns**2), np.inf)
    np.fill_diagonal(costs, np.inf)
    dearest = np.sort(costs, axis=1)[:, : _CHOICE][:, -1:] if len(costs) else costs
    wanted = np.triu((costs <= dearest) | (costs <= dearest.T)) & np.isfinite(costs)
    found = [
        Bridge(int(ends.numbers[i]), int(ends.numbers[j]), float(costs[i, j]),
               float(lengths[i, j]), float(turns[i, j]), float(sigma[i, j]), float(near[i, j]))
        for i, j in np.argwhere(wanted)
    ]  # fmt: skip
    return sorted(found, key=lambda bridge: (bridge.cost, bridge.one, bridge.other))


def turns_of(one: FloatArray, arm: FloatArray, other: FloatArray) -> FloatArray:
    """How hard bridges turn that leave along `one` and arrive against `other`; (..., 2) -> (...)"""
    a, b = _angles(one, arm), _angles(arm, -other)
    return np.asarray(2.0 * np.sqrt(np.maximum(a * a - a * b + b * b, 0.0)))


def _angles(one: FloatArray, other: FloatArray) -> FloatArray:
    turned = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return np.arctan2(turned, one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1])


def way_of(ends: Ends, bridge: Bridge) -> FloatArray:
    """Hermite's cubic from end to end (k, 2), its tangents as long as the chord."""
    i, j = np.searchsorted(ends.numbers, [bridge.one, bridge.other])
    one, other = ends.places[i], ends.places[j]
    if bridge.touching:
        return np.stack([one, other])
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    start = one + bridge.length / 3.0 * ends.outward[i]
    finish = other + bridge.length / 3.0 * ends.outward[j]
    s = 1.0 - t
    way = s**3 * one + 3 * s**2 * t * start + 3 * s * t**2 * finish + t**3 * other
    return np.asarray(way)


def _outward(row: Row, side: int) -> FloatArray:
    """Unit tangent out of an end, 0 the first: of a parabola through the last few reaches."""
    nodes = row.nodes if side == 0 else row.nodes[::-1]
    back = np.concatenate([[0.0], np.linalg.norm(np.diff(nodes, axis=0), axis=1).cumsum()])
    far = max(_TANGENT * float(row.reach[-side]), float(back[min(2, len(back) - 1)]), 1e-300)
    used = back <= far * (1 + 1e-9)
    if not back[used][-1] > 0.0:
        return np.zeros(2)
    degree = 2 if used.sum() >= 6 else 1
    powers = np.vander(back[used] / far, degree + 1, increasing=True)
    slope = -np.linalg.lstsq(powers, nodes[used] - nodes[0])[0][1]
    return np.asarray(slope / max(float(np.linalg.norm(slope)), 1e-300))


def walls(rows: list[Row]) -> FloatArray:
    """The ways from node to node, which no bridge may cross: (m, 2, 2)."""
    pieces = [ways_along(row.nodes, closed=row.closed) for row in rows]
    return np.concatenate(pieces) if pieces else np.empty((0, 2, 2))


def ways_along(nodes: FloatArray, *, closed: bool) -> FloatArray:
    """From node to node: (m, 2) -> (m - 1 or m, 2, 2)."""
    ring = np.vstack([nodes, nodes[:1]]) if closed else nodes
    return np.stack([ring[:-1], ring[1:]], axis=1)


def cross(way: FloatArray, ways: FloatArray, *, but_near: float) -> bool:
    """Whether a polyline (k, 2) crosses any of the ways (m, 2, 2) but for those near its ends."""
    apart = np.ones(len(ways), np.bool_)
    for end in (way[0], way[-1]):
        apart &= (np.linalg.norm(ways - end, axis=2) > but_near).all(axis=1)
    return bool(crossings(ways_along(way, closed=False), ways[apart]).any())


def crossings(ways: FloatArray, others: FloatArray) -> BoolArray:
    """Which ways cross which others; (k, 2, 2), (m, 2, 2) -> (k, m)."""
    a, b = ways[:, None, 0], ways[:, None, 1]
    c, d = others[None, :, 0], others[None, :, 1]
    apart = (_side(a, b, c) * _side(a, b, d) < 0.0) & (_side(c, d, a) * _side(c, d, b) < 0.0)
    return np.asarray(apart)


def _side(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """Positive to the left of the way from p to q."""
    arm = q - p
    return arm[..., 0] * (r[..., 1] - p[..., 1]) - arm[..., 1] * (r[..., 0] - p[..., 0])
