"""No chain crosses itself or another: an outline does not.

Where one does, a short loop between the two ways is noise, or a heap that was threaded, and is left
out; else the way that no point supports, or the longer one, is cut, and what is left is in doubt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.thinning import Row

_KNOT = 0.1  # of a row's length: a loop this short is no part of the outline
_ROUNDS = 200  # each leaves out nodes or cuts a way


@dataclass(frozen=True, slots=True, eq=False)
class Strand:
    """A row, the chain it is of, and whether its end is in doubt."""

    row: Row
    chain: int
    ambiguous: bool


def uncross(strands: list[Strand]) -> list[Strand]:
    """The same without crossings, knots untied and ways cut."""
    strands = list(strands)
    for _ in range(_ROUNDS):
        ways, owner, first = _ways(strands)
        one, other = _first_crossing(ways)
        if one < 0:
            break
        here, there = int(owner[one]), int(owner[other])
        cuts = [(here, int(one - first[here])), (there, int(other - first[there]))]
        if here == there and (untied := _untied(strands[here].row, cuts[0][1], cuts[1][1])):
            strands[here] = replace(strands[here], row=untied)
            continue
        number, way = max(cuts, key=lambda cut: _worth(strands[cut[0]].row, cut[1]))
        for each in {here, there}:
            strands[each] = replace(strands[each], ambiguous=True)
        strands[number : number + 1] = [
            replace(strands[number], row=row) for row in _cut(strands[number].row, way)
        ]
    return strands


def _ways(strands: list[Strand]) -> tuple[FloatArray, IntArray, IntArray]:
    """All ways (m, 2, 2), the strand of each, and where each strand's begin."""
    pieces = [ways_along(each.row.nodes, closed=each.row.closed) for each in strands]
    counts = np.array([len(piece) for piece in pieces], np.int64)
    ways = np.concatenate([np.empty((0, 2, 2)), *pieces])
    return ways, np.repeat(np.arange(len(pieces)), counts), counts.cumsum() - counts


def _worth(row: Row, way: int) -> tuple[bool, float]:
    """How well a way may be missed: those without points before others, the longest first."""
    return way in row.gaps, float(
        np.linalg.norm(row.nodes[(way + 1) % len(row.nodes)] - row.nodes[way])
    )


def _untied(row: Row, one: int, other: int) -> Row | None:
    """A row without the loop between two of its ways, if that is short."""
    lengths = np.linalg.norm(np.diff(row.nodes, axis=0, append=row.nodes[:1]), axis=1)
    inside = np.zeros(len(lengths), np.bool_)
    inside[one + 1 : other + 1] = True
    whole = float(lengths[: len(lengths) if row.closed else -1].sum())
    within = float(lengths[one + 1 : other].sum())
    if row.closed and within > whole / 2:
        inside, within = ~inside, whole - within
    if within > _KNOT * whole or (~inside).sum() < (3 if row.closed else 2):
        return None
    return _of_nodes(row, ~inside, closed=row.closed)


def _cut(row: Row, way: int) -> list[Row]:
    """A row without one of its ways: an open one, or two."""
    count = len(row.nodes)
    if row.closed:
        turned = np.roll(np.arange(count), -way - 1)
        gaps = tuple(sorted((gap - way - 1) % count for gap in row.gaps if gap != way))
        return [
            Row(row.nodes[turned], row.sigma[turned], row.reach[turned], closed=False, gaps=gaps)
        ]
    before = np.arange(count) <= way
    return [_of_nodes(row, kept, closed=False) for kept in (before, ~before) if kept.sum() >= 2]


def _of_nodes(row: Row, kept: BoolArray, *, closed: bool) -> Row:
    """Some of a row's nodes; a gap follows the last kept one before it."""
    place, count = np.cumsum(kept) - 1, int(kept.sum())
    gaps = {int(place[gap]) % count if closed else int(place[gap]) for gap in row.gaps}
    gaps = {gap for gap in gaps if 0 <= gap < (count if closed else count - 1)}
    return Row(row.nodes[kept], row.sigma[kept], row.reach[kept], closed, tuple(sorted(gaps)))


def ways_along(nodes: FloatArray, *, closed: bool) -> FloatArray:
    """Ways from node to node; (m, 2) -> (m - 1 or m, 2, 2)."""
    ring = np.vstack([nodes, nodes[:1]]) if closed else nodes
    return np.stack([ring[:-1], ring[1:]], axis=1)


def crossings(ways: FloatArray, others: FloatArray) -> BoolArray:
    """Which ways cross which others; (k, 2, 2), (m, 2, 2) -> (k, m)."""
    found = np.empty((len(ways), len(others)), np.bool_)
    _cross(ways, others, found)
    return found


@njit(cache=True, nogil=True)
def _cross(ways: FloatArray, others: FloatArray, found: BoolArray) -> None:
    for n in range(len(ways)):
        for m in range(len(others)):
            found[n, m] = _meet(ways[n], others[m])


@njit(cache=True, nogil=True)
def _first_crossing(ways: FloatArray) -> tuple[int, int]:
    """Two ways that cross, or -1, -1."""
    for n in range(len(ways)):
        for m in range(n + 1, len(ways)):
            if _meet(ways[n], ways[m]):
                return n, m
    return -1, -1


@njit(cache=True, nogil=True, inline="always")
def _meet(one: FloatArray, other: FloatArray) -> bool:
    """Whether two ways cross; what only touches does not."""
    for axis in range(2):
        if max(one[0, axis], one[1, axis]) < min(other[0, axis], other[1, axis]):
            return False
        if max(other[0, axis], other[1, axis]) < min(one[0, axis], one[1, axis]):
            return False
    return bool(
        _side(one[0], one[1], other[0]) * _side(one[0], one[1], other[1]) < 0.0
        and _side(other[0], other[1], one[0]) * _side(other[0], other[1], one[1]) < 0.0
    )


@njit(cache=True, nogil=True, inline="always")
def _side(p: FloatArray, q: FloatArray, r: FloatArray) -> float:
    """Positive to the left of the way from p to q."""
    return float((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]))
