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
from reconstruction.fitting.crossing import crossings, ways_along
from reconstruction.fitting.thinning import Row

_TANGENT = 5.0  # reaches: the stretch of a run that tells the direction of its end
_TOUCHING = 2.0  # reaches: so near, the way from end to end has no direction either
_IN_LINE = 3.0  # standard deviations aside that ends which touch may be, and lie in line
_TIP = math.radians(90.0)  # what the turn in a tip counts as
_AHEAD_OF = math.cos(math.radians(30.0))  # a tip lies ahead of the other end, ...
_ALIKE = math.cos(math.radians(45.0))  # ... which leads the same way, ...
_BACK = 1.5  # ... and passes the tip's row not farther back than so many times their distance, ...
_BESIDE = 7.5  # ... at most so many standard deviations beside it
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
    tip: bool  # back from a tip in which two runs were too near each other to be told apart

    @property
    def touching(self) -> bool:
        """Whether it is too short to have a direction."""
        return self.length <= self.near


def ends_of(rows: list[Row]) -> Ends:
    """The ends of all open rows."""
    sides = [(n, side) for n, row in enumerate(rows) if not row.closed for side in (0, 1)]
    return Ends(
        np.array([2 * n + side for n, side in sides], np.int64),
        np.array([rows[n].nodes[-side] for n, side in sides]).reshape(-1, 2),
        np.array([outward(rows[n], side) for n, side in sides]).reshape(-1, 2),
        np.array([rows[n].reach[-side] for n, side in sides]),
        np.array([rows[n].sigma[-side] for n, side in sides]),
    )


def bridges_between(rows: list[Row], ends: Ends) -> list[Bridge]:
    """The cheapest few bridges of every end that are not hopeless, the cheapest first."""
    arms = ends.places[None] - ends.places[:, None]
    lengths = np.hypot(arms[..., 0], arms[..., 1])
    near = _TOUCHING * np.maximum(ends.reach[:, None], ends.reach[None])
    sigma = np.maximum(ends.sigma[:, None], ends.sigma[None])
    one, other = ends.outward[:, None], ends.outward[None]
    abreast = _abreast(one, arms, other, lengths, _IN_LINE * sigma)
    turns = np.where(lengths <= near, abreast, _turns(one, arms, other))
    tips = _tips(rows, ends, arms, lengths)
    turns[tips] = _TIP
    costs = np.where(turns <= _HOPELESS, lengths * (1.0 + _STIFF * turns**2), np.inf)
    found = []
    for i, j in _cheapest(costs):
        cost, length, turn = float(costs[i, j]), float(lengths[i, j]), float(turns[i, j])
        far, close, tip = float(sigma[i, j]), float(near[i, j]), bool(tips[i, j])
        numbers = int(ends.numbers[i]), int(ends.numbers[j])
        found.append(Bridge(*numbers, cost, length, turn, far, close, tip))
    return sorted(found, key=lambda bridge: (bridge.cost, bridge.one, bridge.other))


def _cheapest(costs: FloatArray) -> IntArray:
    """Pairs (k, 2) that are among the cheapest few of one of the two."""
    costs = costs.copy()
    np.fill_diagonal(costs, np.inf)
    dearest = np.sort(costs, axis=1)[:, :_CHOICE].max(axis=1, initial=0.0)
    chosen = np.isfinite(costs) & (costs <= np.maximum(dearest[:, None], dearest[None]))
    return np.argwhere(np.triu(chosen))


def _abreast(
    one: FloatArray, arm: FloatArray, other: FloatArray, lengths: FloatArray, within: FloatArray
) -> FloatArray:
    """The turn between ends that touch: their own, and what it takes to get in line.

    An end that lies aside of the other by no more than that does lie in line, also a bit behind it.
    """
    a, b = (
        np.sign(aside) * np.arcsin(np.clip((np.abs(aside) - within) / far, 0.0, 1.0))
        for far in (np.maximum(lengths, 1e-300),)
        for aside in (_aside(one, arm), _aside(arm, -other))
    )
    return np.maximum(np.abs(_angles(one, -other)), _bent(a, b))


def _tips(rows: list[Row], ends: Ends, arms: FloatArray, lengths: FloatArray) -> BoolArray:
    """Which pairs of ends are a tip, and where the one run came too near the other for it.

    Both lead to the tip, and beside the end that lies behind runs the other's row. ::

        ------ one __
        -------------`====== other
    """
    ahead = (arms * ends.outward[:, None]).sum(axis=2) > _AHEAD_OF * lengths
    alike = ends.outward @ ends.outward.T > _ALIKE
    tips = np.zeros(lengths.shape, np.bool_)
    for i, j in np.argwhere(ahead & alike & (lengths > 0.0)):
        row = rows[ends.numbers[j] // 2]
        nodes = row.nodes if ends.numbers[j] % 2 else row.nodes[::-1]
        back = np.linalg.norm(np.diff(nodes, axis=0), axis=1)[::-1].cumsum()
        tail = nodes[::-1][1:][back <= _BACK * lengths[i, j]]
        beside = np.linalg.norm(tail - ends.places[i], axis=1).min(initial=np.inf)
        tips[i, j] = tips[j, i] = beside <= _BESIDE * ends.sigma[i]
    return tips


def _aside(one: FloatArray, other: FloatArray) -> FloatArray:
    """How far one arm leads aside of the other, a unit vector; counter-clockwise is positive."""
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def _turns(one: FloatArray, arm: FloatArray, other: FloatArray) -> FloatArray:
    """How hard bridges turn that leave along `one` and arrive against `other`."""
    return _bent(_angles(one, arm), _angles(arm, -other))


def _bent(a: FloatArray, b: FloatArray) -> FloatArray:
    """The turn of a cubic with such angles to its chord."""
    return np.asarray(2.0 * np.sqrt(np.maximum(a * a - a * b + b * b, 0.0)))


def _angles(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.arctan2(_aside(one, other), one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1])


def way_of(ends: Ends, bridge: Bridge) -> FloatArray:
    """Hermite's cubic from end to end (k, 2), its tangents as long as the chord."""
    i, j = np.searchsorted(ends.numbers, [bridge.one, bridge.other])
    one, other = ends.places[i], ends.places[j]
    if bridge.touching or bridge.tip:
        return np.stack([one, other])
    t = np.linspace(0.0, 1.0, _PIECES + 1)[:, None]
    start = one + bridge.length / 3.0 * ends.outward[i]
    finish = other + bridge.length / 3.0 * ends.outward[j]
    s = 1.0 - t
    way = s**3 * one + 3 * s**2 * t * start + 3 * s * t**2 * finish + t**3 * other
    return np.asarray(way)


def outward(row: Row, side: int) -> FloatArray:
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


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """Ways from node to node that no bridge may cross."""

    ways: FloatArray  # (m, 2, 2)
    ends: IntArray  # (m,), the nearer end of the open row a way is of; -1 for others
    back: FloatArray  # (m,), how far it is from there

    def with_way(self, way: FloatArray) -> Walls:
        """These and a polyline (k, 2)."""
        more = ways_along(way, closed=False)
        return Walls(
            np.concatenate([self.ways, more]),
            np.concatenate([self.ends, np.full(len(more), -1)]),
            np.concatenate([self.back, np.zeros(len(more))]),
        )

    def crossed_by(self, way: FloatArray, ends: tuple[int, int], near: float) -> bool:
        """Whether a polyline (k, 2) between two ends crosses any, but for those near its ends."""
        apart = ~np.isin(self.ends, ends) | (self.back > near)
        return bool(crossings(ways_along(way, closed=False), self.ways[apart]).any())


def walls(rows: list[Row]) -> Walls:
    """The ways of all rows."""
    ways, ends, back = [np.empty((0, 2, 2))], [np.empty(0, np.int64)], [np.empty(0)]
    for number, row in enumerate(rows):
        ways.append(ways_along(row.nodes, closed=row.closed))
        lengths = np.linalg.norm(ways[-1][:, 1] - ways[-1][:, 0], axis=1)
        up = lengths.cumsum() - lengths
        down = up[-1] + lengths[-1] - up - lengths
        ends.append(np.where(up <= down, 2 * number, 2 * number + 1) if not row.closed
                    else np.full(len(up), -1))  # fmt: skip
        back.append(np.minimum(up, down))
    return Walls(np.concatenate(ways), np.concatenate(ends), np.concatenate(back))
