"""Ends are joined where they face each other; what the points cannot tell is called ambiguous.

The cheapest bridge is built first, and none that would cross a row or a bridge that stands: an
outline does not cross itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.fitting.bridging import (
    Bridge,
    bridges_between,
    ends_of,
    walls,
    way_of,
)
from reconstruction.fitting.thinning import Row

_CRUMB = 1.5  # reaches: shorter rows have no direction
_STRAIGHT = math.radians(90.0)  # turn up to which a row is carried on beyond its own length
_FACING = math.radians(158.0)  # turn up to which two ends face each other
_DOUBTFUL = math.radians(158.0)  # turn from which a closed loop stays in doubt
_UNSEEN = 20.0  # standard deviations: a gap this wide has room for a turn that nobody saw
_RIVAL = 2.0  # times a bridge's cost: another one is no better than that, or leaves a doubt
_LEAST_LOOP = 6.0  # bridges: a row this long is a loop if its ends touch
# A gap's share of its loop: from here on the points leave in doubt whether it is a loop, ...
_WIDE = 0.10
_SMALL = 0.03  # ... up to here a loop is likelier even if ...
_LIKELY = 0.20  # ... up to here a loop is likelier even if the ends do not face each other, ...
_OPEN = 0.36  # ... and from here on nothing speaks for one.


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """Rows joined to one."""

    row: Row
    members: tuple[int, ...]  # which rows
    bridge: FloatArray  # (m,), length of the bridge that the way after a node is of; 0: of none
    ambiguous: bool  # the points cannot tell whether it is closed
    put_together: bool  # of several rows, or closed over a gap


def join(rows: list[Row]) -> list[Joined]:
    """Join open rows, and close them, over gaps: the cheapest bridge first.

    Crumbs, too short to have a direction, are left out.
    """
    longest = max((row.length for row in rows), default=0.0)
    whole = [
        number
        for number, row in enumerate(rows)
        if row.closed or row.length > min(_CRUMB * float(row.reach.max()), longest / 4)
    ]
    return [
        replace(one, members=tuple(whole[number] for number in one.members))
        for one in _Site([rows[number] for number in whole]).joined()
    ]


class _Site:
    """Rows and the bridges that stand between them."""

    def __init__(self, rows: list[Row]) -> None:
        self.rows = rows
        self.ends = ends_of(rows)
        self.walls = walls(rows)
        self.partner: dict[int, Bridge] = {}
        self.bridges = bridges_between(rows, self.ends)
        for bridge in self.bridges:
            if bridge.one not in self.partner and bridge.other not in self.partner:
                self._build(bridge)
        for bridge in self.bridges:
            if self.partner.get(bridge.one) is bridge and self._is_bold(bridge):
                del self.partner[bridge.one], self.partner[bridge.other]

    def joined(self) -> list[Joined]:
        """Rows end to end, and whether anything else would do for them."""
        doubtful = {
            end // 2
            for bridge in self.bridges
            for end in (bridge.one, bridge.other)
            if self._might(bridge)
        }
        seen: set[int] = set()
        found = []
        free = [end for end in range(2 * len(self.rows)) if end not in self.partner]
        for end in [*free, *range(2 * len(self.rows))]:
            if end // 2 not in seen:
                way = self._follow(end)
                seen.update(passed // 2 for passed in way)
                one = self._assembled(way)
                doubt = one.ambiguous or not doubtful.isdisjoint(one.members)
                found.append(replace(one, ambiguous=doubt))
        return found

    def _build(self, bridge: Bridge) -> None:
        way = self._follow(bridge.one)
        closes = way[-1] == bridge.other
        if (self._closes(way, bridge) if closes else self._reaches(bridge)) and self._free(bridge):
            self.walls = self.walls.with_way(way_of(self.ends, bridge))
            self.partner[bridge.one] = self.partner[bridge.other] = bridge

    def _free(self, bridge: Bridge) -> bool:
        """Whether a bridge crosses nothing."""
        way, ends = way_of(self.ends, bridge), (bridge.one, bridge.other)
        near = 2.0 * bridge.length if bridge.tip else self._near(*ends)
        return not self.walls.crossed_by(way, ends, near)

    def _is_bold(self, bridge: Bridge) -> bool:
        """Whether a bridge is carried too far to be taken before another that is nearly as good.

        It is longer than a row it carries on, and a shorter one, hardly dearer, leads to an end
        that is left over: nobody knows which of the two it is.
        """
        known = min(self.rows[end // 2].length for end in (bridge.one, bridge.other))
        if bridge.touching or bridge.length <= known:
            return False
        return any(
            rival.length < bridge.length and rival.cost < _RIVAL * bridge.cost and self._free(rival)
            for rival in self.bridges
            if len(left := {rival.one, rival.other} - {bridge.one, bridge.other}) == 1
            and left.isdisjoint(self.partner)
        )

    def _near(self, *ends: int) -> float:
        """So near their ends rows may be crossed: there nobody knows where they run."""
        return max(float(self.rows[end // 2].reach.max()) for end in ends)

    def _follow(self, end: int) -> list[int]:
        """Ends passed from `end` on, row by row over bridges, to a free end or once around."""
        way = [end, end ^ 1]
        while way[-1] in self.partner:
            bridge = self.partner[way[-1]]
            onward = bridge.other if bridge.one == way[-1] else bridge.one
            if onward == end:
                break
            way += [onward, onward ^ 1]
        return way

    def _might(self, bridge: Bridge) -> bool:
        """Whether a bridge that was not built leaves in doubt what ends there.

        It is short beside both rows, an end of it is free, and the other one is as well or has
        found nothing much better over its gap.
        """
        ends = (bridge.one, bridge.other)
        taken = [self.partner[end] for end in ends if end in self.partner]
        length = sum(self.rows[end // 2].length for end in ends) + bridge.length
        if len(taken) == 2 or bridge.length > _OPEN * length or not self._free(bridge):
            return False
        if not taken and self._follow(bridge.one)[-1] == bridge.other:
            return False  # the two ends of one chain: see _may_close
        return not taken or (not taken[0].touching and bridge.cost < _RIVAL * taken[0].cost)

    def _reaches(self, bridge: Bridge) -> bool:
        """Whether two rows are known well enough to be carried on that far."""
        if bridge.touching:
            return bridge.turn <= _FACING
        known = min(self.rows[bridge.one // 2].length, self.rows[bridge.other // 2].length)
        far = (3.0 if bridge.turn <= _STRAIGHT else 1.0) * known
        return bridge.turn <= _FACING and bridge.length <= far + bridge.near

    def _closes(self, way: list[int], bridge: Bridge) -> bool:
        """Whether a bridge between the ends of its own chain makes a likely loop."""
        length = sum(self.rows[end // 2].length for end in way[::2])
        if bridge.touching and bridge.turn <= _FACING and length > _LEAST_LOOP * bridge.length:
            return True
        share = bridge.length / max(length + bridge.length, 1e-300)
        unseen = bridge.length > _UNSEEN * bridge.sigma and share <= _LIKELY
        unseen |= share <= _SMALL
        return (bridge.turn <= _FACING or unseen) and share <= _OPEN

    def _may_close(self, way: list[int]) -> bool:
        """Whether an open chain might be a loop all the same."""
        bridge = next((b for b in self.bridges if {b.one, b.other} == {way[0], way[-1]}), None)
        if bridge is None:
            return self._may_turn(way)
        length = sum(self.rows[end // 2].length for end in way[::2])
        share = bridge.length / max(length + bridge.length, 1e-300)
        return share <= _OPEN and self._free(bridge)

    def _may_turn(self, way: list[int]) -> bool:
        """Whether the gap between ends that face away has room for a turn that nobody saw."""
        i, j = np.searchsorted(self.ends.numbers, [way[0], way[-1]])
        arm = self.ends.places[j] - self.ends.places[i]
        gap = math.hypot(*arm)
        length = sum(self.rows[end // 2].length for end in way[::2]) + gap
        sigma = float(max(self.ends.sigma[i], self.ends.sigma[j]))
        away = self.ends.outward[i] @ arm < 0.0 < self.ends.outward[j] @ arm
        room = gap > _WIDE * length or (gap > _UNSEEN * sigma and not away)
        straight = self.ends.places[[i, j]]
        ends = way[0], way[-1]
        barred = self.walls.crossed_by(straight, ends, self._near(*ends))
        return room and gap <= _OPEN * length and not barred

    def _assembled(self, way: list[int]) -> Joined:
        members = tuple(end // 2 for end in way[::2])
        row, bridge = self._end_to_end(way)
        bridges = [self.partner[end] for end in way[1::2] if end in self.partner]
        length = sum(self.rows[n].length for n in members) + sum(b.length for b in bridges)
        widest = max((bridge.length for bridge in bridges), default=0.0)
        if way[-1] not in self.partner:
            doubt = not row.closed and (widest > _WIDE * length or self._may_close(way))
            return Joined(row, members, bridge, doubt, put_together=len(members) > 1)
        forced = any(bridge.turn > _DOUBTFUL and not bridge.touching for bridge in bridges)
        return Joined(row, members, bridge, widest > _WIDE * length or forced, put_together=True)

    def _end_to_end(self, way: list[int]) -> tuple[Row, FloatArray]:
        """Rows one after the other, the ways of the bridges between them, and which are theirs."""
        if len(way) == 2 and way[-1] not in self.partner:
            row = self.rows[way[0] // 2]
            return row, np.zeros(len(row.nodes))
        pieces = []
        for start, finish in zip(way[::2], way[1::2], strict=True):
            piece = _columns(self._trimmed(start // 2), backwards=start % 2 == 1)
            pieces.append(piece)
            if finish in self.partner:
                bridge = self.partner[finish]
                path = way_of(self.ends, bridge)[1:-1]
                path = path if bridge.one == finish else path[::-1]
                like_last = np.repeat(piece[-1:, 2:4], len(path), axis=0)
                spanned = np.full((len(path), 1), bridge.length)
                piece[-1, 4] = bridge.length
                pieces.append(np.hstack([path, like_last, spanned]))
        columns = np.concatenate(pieces)
        closed = way[-1] in self.partner
        exact = all(self.rows[end // 2].exact for end in way)
        row = Row(columns[:, :2], columns[:, 2], columns[:, 3], closed=closed, exact=exact)
        return row, columns[:, 4]

    def _trimmed(self, number: int) -> Row:
        """A row without its ends that touch others: seen from one side, they are not worth much."""
        row = self.rows[number]
        start, end = (
            e in self.partner and self.partner[e].touching for e in (2 * number, 2 * number + 1)
        )
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(row.nodes, axis=0), axis=1).cumsum()])
        low = min(row.reach[0], along[-1] / 3) if start else -np.inf
        high = along[-1] - min(row.reach[-1], along[-1] / 3) if end else np.inf
        kept = (along >= low) & (along <= high)
        if kept.sum() < 2:
            return row
        return Row(row.nodes[kept], row.sigma[kept], row.reach[kept], row.closed)


def _columns(row: Row, *, backwards: bool) -> FloatArray:
    columns = np.column_stack([row.nodes, row.sigma, row.reach, np.zeros(len(row.nodes))])
    return columns[::-1].copy() if backwards else columns
