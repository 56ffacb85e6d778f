r"""Ends are joined where they face each other; what the points cannot tell is called ambiguous.

A bridge from end to end is judged by its length d and by the turn it needs: with the angles a from
the tangent at its start to its chord, and b from its chord to the tangent at its end, the bending
energy of its cubic is 4 (a^2 - ab + b^2) / d. ::

          a _____ b
     ----> /     \ ---->      a = b: an arc, turning by 2 a
                              a = -b: an S, which counts as one of 3.5 a
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.fitting.thinning import Row

_TANGENT = 5.0  # reaches: the stretch of a run that tells the direction of its end
_CRUMB = 2.5  # reaches: shorter rows have no direction
_TOUCHING = 2.0  # reaches: so near, the way from end to end has no direction either
_STIFF = 1.0  # how much a turn of one radian adds to a bridge's cost, in its lengths
_STRAIGHT = math.radians(90.0)  # turn up to which a row is carried on beyond its own length
_FACING = math.radians(158.0)  # turn up to which two ends face each other
_DOUBTFUL = math.radians(168.0)  # turn from which a closed loop stays in doubt
_HOPELESS = math.radians(270.0)  # turn from which no gap explains two ends
_UNSEEN = 20.0  # standard deviations: a gap this wide has room for a turn that nobody saw
_RIVAL = 2.0  # times a bridge's cost: another one is no better than that, or leaves a doubt
_LEAST_LOOP = 6.0  # bridges: a row this long is a loop if its ends touch
# A gap's share of its loop: from here on the points leave in doubt whether it is a loop, ...
_WIDE = 0.10
_LIKELY = 0.20  # ... up to here a loop is likelier even if the ends do not face each other, ...
_OPEN = 0.36  # ... and from here on nothing speaks for one.


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Rows joined to one."""

    row: Row
    members: tuple[int, ...]  # which rows
    ambiguous: bool  # the points cannot tell whether it is closed


@dataclass(frozen=True, slots=True)
class _Bridge:
    cost: float
    one: int  # an end: 2 * row, + 1 for its last node
    other: int
    length: float
    turn: float
    touching: bool


def join(rows: list[Row]) -> list[Joined]:
    """Join open rows, and close them, over gaps: the cheapest bridge first.

    Crumbs, too short to have a direction, are added to the row that passes by, or to none.
    """
    longest = max((row.length for row in rows), default=0.0)
    whole = [
        number
        for number, row in enumerate(rows)
        if row.closed or row.length > min(_CRUMB * float(row.reach.max()), longest / 4)
    ]
    joined = _bridged([rows[number] for number in whole])
    members = [[whole[number] for number in one.members] for one in joined]
    for crumb in sorted(set(range(len(rows))) - set(whole)):
        for one, those in zip(joined, members, strict=True):
            if _passes(one.row, rows[crumb]):
                those.append(crumb)
                break
    return [
        Joined(one.row, tuple(m), one.ambiguous) for one, m in zip(joined, members, strict=True)
    ]


def _bridged(rows: list[Row]) -> list[Joined]:
    partner: dict[int, _Bridge] = {}
    bridges = _bridges(rows)
    for bridge in bridges:
        if bridge.one in partner or bridge.other in partner:
            continue
        way = _follow(partner, bridge.one)
        if _closes(rows, way, bridge) if way[-1] == bridge.other else _reaches(rows, bridge):
            partner[bridge.one] = partner[bridge.other] = bridge
    doubtful = {
        end // 2
        for bridge in bridges
        for end in (bridge.one, bridge.other)
        if _might(rows, partner, bridge)
    }
    seen: set[int] = set()
    found = []
    free = [end for end in range(2 * len(rows)) if end not in partner]
    for end in [*free, *range(2 * len(rows))]:
        if end // 2 not in seen:
            way = _follow(partner, end)
            seen.update(passed // 2 for passed in way)
            one = _assembled(rows, partner, way)
            doubt = one.ambiguous or not doubtful.isdisjoint(one.members)
            found.append(replace(one, ambiguous=doubt))
    return found


def _bridges(rows: list[Row]) -> list[_Bridge]:
    """All bridges that are not hopeless, the cheapest first."""
    ends = [2 * n + side for n, row in enumerate(rows) if not row.closed for side in (0, 1)]
    tangents = [_outward(rows[end // 2], end % 2) for end in ends]
    found = []
    for position, one in enumerate(ends):
        for other, tangent in zip(ends[position + 1 :], tangents[position + 1 :], strict=True):
            arm = _place(rows, other) - _place(rows, one)
            length = math.hypot(*arm)
            touching = length <= _TOUCHING * max(_reach(rows, one), _reach(rows, other))
            turn = (
                abs(_angle(tangents[position], -tangent))
                if touching
                else _turn(tangents[position], arm, tangent)
            )
            if turn <= _HOPELESS:
                cost = length * (1.0 + _STIFF * turn**2)
                found.append(_Bridge(cost, one, other, length, turn, touching))
    return sorted(found, key=lambda bridge: (bridge.cost, bridge.one, bridge.other))


def _place(rows: list[Row], end: int) -> FloatArray:
    return np.asarray(rows[end // 2].nodes[-(end % 2)])


def _reach(rows: list[Row], end: int) -> float:
    return float(rows[end // 2].reach[-(end % 2)])


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


def _turn(one: FloatArray, arm: FloatArray, other: FloatArray) -> float:
    """How hard a bridge turns that leaves along `one` and arrives against `other`."""
    a, b = _angle(one, arm), _angle(arm, -other)
    return 2.0 * math.sqrt(max(a * a - a * b + b * b, 0.0))


def _angle(one: FloatArray, other: FloatArray) -> float:
    return math.atan2(one[0] * other[1] - one[1] * other[0], one[0] * other[0] + one[1] * other[1])


def _follow(partner: dict[int, _Bridge], end: int) -> list[int]:
    """Ends passed from `end` on, row by row over the bridges, to a free end or once around."""
    way = [end, end ^ 1]
    while way[-1] in partner:
        bridge = partner[way[-1]]
        onward = bridge.other if bridge.one == way[-1] else bridge.one
        if onward == end:
            break
        way += [onward, onward ^ 1]
    return way


def _might(rows: list[Row], partner: dict[int, _Bridge], bridge: _Bridge) -> bool:
    """Whether a bridge that was not built leaves in doubt what ends there.

    It is short beside both rows, an end of it is free, and the other one is as well or has found
    nothing much better over its gap.
    """
    taken = [partner[end] for end in (bridge.one, bridge.other) if end in partner]
    length = sum(rows[end // 2].length for end in (bridge.one, bridge.other)) + bridge.length
    if len(taken) == 2 or bridge.length > _OPEN * length:
        return False
    if not taken and _follow(partner, bridge.one)[-1] == bridge.other:
        return False  # the two ends of one chain: see _may_close
    return not taken or (not taken[0].touching and bridge.cost < _RIVAL * taken[0].cost)


def _reaches(rows: list[Row], bridge: _Bridge) -> bool:
    """Whether two rows are known well enough to be carried on that far."""
    if bridge.touching:
        return True
    known = min(rows[bridge.one // 2].length, rows[bridge.other // 2].length)
    far = (3.0 if bridge.turn <= _STRAIGHT else 1.0) * known
    slack = _TOUCHING * max(_reach(rows, bridge.one), _reach(rows, bridge.other))
    return bridge.turn <= _FACING and bridge.length <= far + slack


def _closes(rows: list[Row], way: list[int], bridge: _Bridge) -> bool:
    """Whether a bridge between the ends of its own chain makes a likely loop."""
    length = sum(rows[end // 2].length for end in way[::2])
    if bridge.touching and length > _LEAST_LOOP * bridge.length:
        return True
    share = bridge.length / max(length + bridge.length, 1e-300)
    sigma = max(float(rows[end // 2].sigma[-(end % 2)]) for end in (bridge.one, bridge.other))
    unseen = bridge.length > _UNSEEN * sigma and share <= _LIKELY
    facing = bridge.turn <= _FACING or unseen
    return facing and share <= _OPEN and not _crosses(_end_to_end(rows, way[::2]))


def _crosses(row: Row) -> bool:
    """Whether the straight way between a row's ends crosses it, except close to either."""
    start, end = row.nodes[0], row.nodes[-1]
    arms, chord = row.nodes - start, end - start
    apart = np.minimum(np.linalg.norm(arms, axis=1), np.linalg.norm(row.nodes - end, axis=1))
    side = chord[0] * arms[:, 1] - chord[1] * arms[:, 0]
    along = arms @ chord / max(float(chord @ chord), 1e-300)
    between = (along > 0.0) & (along < 1.0) & (apart > float(row.reach.max()))
    return bool((between[1:] & between[:-1] & (side[1:] * side[:-1] < 0.0)).any())


def _end_to_end(rows: list[Row], entered: list[int]) -> Row:
    """Rows one after the other, each from the end at which it is entered, as one open row."""
    columns = [
        np.concatenate([getattr(rows[end // 2], name)[:: -1 if end % 2 else 1] for end in entered])
        for name in ("nodes", "sigma", "reach")
    ]
    return Row(columns[0], columns[1], columns[2], closed=False)


def _assembled(rows: list[Row], partner: dict[int, _Bridge], way: list[int]) -> Joined:
    members = tuple(end // 2 for end in way[::2])
    alone = rows[members[0]]
    if alone.closed:
        return Joined(alone, members, ambiguous=False)
    if len(members) == 1 and way[-1] not in partner:
        return Joined(alone, members, _may_close(alone))
    # What touches is seen from one side only at its ends: that is not worth much.
    trimmed = [
        _trimmed(rows[n], *(e in partner and partner[e].touching for e in (2 * n, 2 * n + 1)))
        for n in members
    ]
    entered = [2 * position + end % 2 for position, end in enumerate(way[::2])]
    row = _end_to_end(trimmed, entered)
    bridges = [partner[end] for end in way[1::2] if end in partner]
    if way[-1] not in partner:
        return Joined(row, members, _may_close(_end_to_end(rows, way[::2])))
    length = sum(rows[n].length for n in members) + sum(bridge.length for bridge in bridges)
    widest = max(bridge.length for bridge in bridges)
    forced = bridges[-1].turn > _DOUBTFUL and not bridges[-1].touching
    loop = Row(row.nodes, row.sigma, row.reach, closed=True)
    return Joined(loop, members, widest > _WIDE * length or forced)


def _trimmed(row: Row, start: bool, end: bool) -> Row:  # noqa: FBT001 (a mask of its two ends)
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(row.nodes, axis=0), axis=1).cumsum()])
    low = min(row.reach[0], along[-1] / 3) if start else -np.inf
    high = along[-1] - min(row.reach[-1], along[-1] / 3) if end else np.inf
    kept = (along >= low) & (along <= high)
    if kept.sum() < 2:
        return row
    return Row(row.nodes[kept], row.sigma[kept], row.reach[kept], row.closed)


def _may_close(row: Row) -> bool:
    """Whether an open row might be a loop all the same."""
    arm = row.nodes[0] - row.nodes[-1]
    share = math.hypot(*arm) / max(row.length + math.hypot(*arm), 1e-300)
    hopeful = _turn(_outward(row, 1), arm, _outward(row, 0)) <= _HOPELESS
    unseen = math.hypot(*arm) > _UNSEEN * max(row.sigma[0], row.sigma[-1])
    return (hopeful or unseen or share > _WIDE) and share <= _OPEN and not _crosses(row)


def _passes(row: Row, crumb: Row) -> bool:
    """Whether a row runs, bridges included, within a reach of a crumb's middle."""
    middle = crumb.nodes.mean(axis=0)
    ring = np.vstack([row.nodes, row.nodes[:1]]) if row.closed else row.nodes
    arms = np.diff(ring, axis=0)
    squares = np.maximum((arms**2).sum(axis=1), 1e-300)
    share = np.clip(((middle - ring[:-1]) * arms).sum(axis=1) / squares, 0.0, 1.0)
    away = np.linalg.norm(ring[:-1] + share[:, None] * arms - middle, axis=1)
    return bool(away.min() <= max(crumb.reach.max(), row.reach.max()))
