"""Few points, hardly noisier than they are far apart: the points themselves in order.

The shortest tree that spans the points of one well sampled run is a path but for twigs of a point
or two; the twigs are put where they lengthen the path least, and crossings undone (2-opt). Longer
branches are runs of their own. Where the noise is wider than the spacing the tree is bushy and this
gives up: bands are for `linking`.
"""

from __future__ import annotations

from statistics import median

import numpy as np
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from reconstruction.arrays import FloatArray, IntArray

_LONG = 5.0  # times the edges beside it on either side: such an edge spans a gap
_BUSHY = 0.15  # share of the points on twigs from which there is no path to speak of
_TWIG = 2  # points
_LEAST = 5  # points of a path; fewer are strays
_SMOOTH = 5  # points whose mean replaces the middle one ...
_ZIGZAG = 1.25  # ... and how much longer the path may be than one through those means


def span(places: FloatArray) -> list[IntArray] | None:
    """Return the points (m, 2) of each run in order, or None if they are no single file."""
    parents, edges = spanning_tree(places)
    runs = []
    twigs = 0
    parts = _parts(places, parents, edges)
    while parts:
        members, tree = parts.pop()
        if len(members) < _LEAST:
            twigs += len(members)
            continue
        path, off, branches = _path_of(places[members], tree)
        parts += [(members[branch], bush) for branch, bush in branches]
        if off <= _BUSHY * len(members) and _detour(places[members[path]]) <= _ZIGZAG:
            runs.append(members[path])
        else:
            twigs += len(members)
    return runs if runs and twigs <= _BUSHY * len(places) else None


@njit(cache=True, nogil=True)
def spanning_tree(places: FloatArray) -> tuple[IntArray, FloatArray]:
    """Parent of every place and the length of the way there (Prim 1957); -1 and 0 for the root."""
    count = len(places)
    parents = np.full(count, -1, np.int64)
    nearest = np.full(count, np.inf)
    inside = np.zeros(count, np.bool_)
    here = 0
    nearest[0] = 0.0
    for _ in range(count):
        inside[here] = True
        following = -1
        for n in range(count):
            if inside[n]:
                continue
            dx, dy = places[n, 0] - places[here, 0], places[n, 1] - places[here, 1]
            square = dx * dx + dy * dy
            if square < nearest[n]:
                nearest[n], parents[n] = square, here
            if following < 0 or nearest[n] < nearest[following]:
                following = n
        here = following
    return parents, np.sqrt(nearest)


def _parts(
    places: FloatArray, parents: IntArray, edges: FloatArray
) -> list[tuple[IntArray, list[list[int]]]]:
    """Cut the tree at edges much longer than those beside them on either side."""
    children = np.flatnonzero(parents >= 0)
    around: list[list[float]] = [[] for _ in places]  # edges at each place ...
    beside: list[list[int]] = [[] for _ in places]  # ... and the places they lead to
    for child in children.tolist():
        parent, edge = int(parents[child]), float(edges[child])
        for one, other in ((child, parent), (parent, child)):
            around[one].append(edge)
            beside[one].append(other)
    usual = [
        median(around[place] + [edge for other in beside[place] for edge in around[other]])
        for place in range(len(places))
    ]  # at a place and at those one step on
    kept = np.array(
        [c for c in children if edges[c] <= _LONG * max(usual[c], usual[parents[c]])], np.int64
    )
    graph = coo_array((np.ones(len(kept)), (kept, parents[kept])), (len(places),) * 2)
    label = connected_components(graph, directed=False)[1]
    parts = []
    for number in range(int(label.max()) + 1):
        members = np.flatnonzero(label == number)
        position = {int(member): k for k, member in enumerate(members)}
        tree: list[list[int]] = [[] for _ in members]
        for child in kept[label[kept] == number].tolist():
            one, other = position[child], position[int(parents[child])]
            tree[one].append(other)
            tree[other].append(one)
        parts.append((members, tree))
    return parts


def _path_of(
    places: FloatArray, tree: list[list[int]]
) -> tuple[IntArray, int, list[tuple[IntArray, list[list[int]]]]]:
    """The longest path of a tree, its twigs put in, and long branches as trees of their own.

    Between the two, how many points are of twigs longer than they should be.
    """
    far = _farthest(places, tree, 0)[-1]
    path = _farthest(places, tree, far)
    on_path = set(path)
    off = 0
    branches = []
    for place in list(path):
        for root in tree[place]:
            if root in on_path:
                continue
            twig = _beyond(tree, root, place)
            if len(twig) >= _LEAST:
                branches.append(_subtree(tree, twig))
                continue
            off += len(twig) if len(twig) > _TWIG else 0
            for one in twig:
                _insert(places, path, one)
    order = np.array(path)
    _uncross(places, order)
    return order, off, branches


def _beyond(tree: list[list[int]], root: int, back: int) -> list[int]:
    """What hangs on a root, itself included, away from where it hangs."""
    found, stack = [], [(root, back)]
    while stack:
        here, before = stack.pop()
        found.append(here)
        stack += [(other, here) for other in tree[here] if other != before]
    return found


def _subtree(tree: list[list[int]], members: list[int]) -> tuple[IntArray, list[list[int]]]:
    """Some members of a tree as a tree of its own."""
    position = {member: k for k, member in enumerate(members)}
    bush = [[position[other] for other in tree[m] if other in position] for m in members]
    return np.array(members), bush


def _farthest(places: FloatArray, tree: list[list[int]], start: int) -> list[int]:
    """Path from `start` to the place that lies farthest from it along the tree."""
    back, length = {start: -1}, {start: 0.0}
    stack = [start]
    while stack:
        here = stack.pop()
        for other in tree[here]:
            if other not in back:
                back[other] = here
                length[other] = length[here] + float(np.hypot(*(places[other] - places[here])))
                stack.append(other)
    path = [max(length, key=lambda place: (length[place], place))]
    while back[path[-1]] >= 0:
        path.append(back[path[-1]])
    return path[::-1]


def _insert(places: FloatArray, path: list[int], one: int) -> None:
    """Put a place where it lengthens the path least."""
    row = places[path]
    away = np.linalg.norm(row - places[one], axis=1)
    between = np.linalg.norm(np.diff(row, axis=0), axis=1)
    detours = np.concatenate([away[:1], away[1:] + away[:-1] - between, away[-1:]])
    path.insert(int(np.argmin(detours)), one)


@njit(cache=True, nogil=True)
def _uncross(places: FloatArray, order: IntArray) -> None:
    """Turn stretches around while that shortens the way."""
    count = len(order)
    for _ in range(50):
        better = False
        for i in range(count - 1):
            for j in range(i + 2, count):
                gain = _away(places, order, i, i + 1) - _away(places, order, i, j)
                if j + 1 < count:
                    gain += _away(places, order, j, j + 1) - _away(places, order, i + 1, j + 1)
                if gain > 1e-12:
                    order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1].copy()
                    better = True
        if not better:
            break


@njit(cache=True, nogil=True, inline="always")
def _away(places: FloatArray, order: IntArray, i: int, j: int) -> float:
    dx = places[order[i], 0] - places[order[j], 0]
    dy = places[order[i], 1] - places[order[j], 1]
    return float(np.sqrt(dx * dx + dy * dy))


def _detour(row: FloatArray) -> float:
    """How much longer the way along the points is than that along their running means."""
    if len(row) < 2 * _SMOOTH:
        return 1.0
    window = np.ones(_SMOOTH) / _SMOOTH
    means = np.stack([np.convolve(column, window, "valid") for column in row.T], axis=1)
    half = _SMOOTH // 2
    lengths = [
        float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
        for way in (row[half:-half], means)
    ]
    return lengths[0] / max(lengths[1], 1e-300)
