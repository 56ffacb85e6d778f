"""From places to runs: the levels of a flood that starts at one end.

Places closer than their reach are neighbours. A flood from a far place climbs one reach a step;
what it enters at one step and hangs together is a slab, and slabs joined to those of the next step
form a graph (after Reeb 1946) that is a path where the band is a run and a cycle where it is a
loop, however thick the band is. ::

    : . : | . : : | : . .         level 0 | 1 | 2   across a band
     :  . | :  .  |  . :

Spurs of one or two slabs are noise at the rim. Reach is tried from small to large, and the first
that gives runs without holes, spurs and breaks to speak of is the scale of the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray

Graph = list[set[int]]  # neighbours of each slab

_SPUR = 2  # slabs: as far as noise at the rim reaches
_HOLE = 6  # slabs around a hole in the band


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Slabs in order, run by run."""

    run_of_place: IntArray  # (m,), -1: of no run
    slot_of_place: IntArray  # (m,), its slab's position in the run
    lengths: IntArray  # (runs,), slabs in each
    closed: tuple[bool, ...]
    flaws: int = 0  # spurs, holes and junctions on the way


def link(places: FloatArray, starts: IntArray, neighbours: IntArray) -> Runs:
    """Find the runs among places (m, 2) of which the neighbours are known."""
    slab_of_place, pairs, levels = _flood(starts, neighbours)
    graph: Graph = [set() for _ in levels]
    for one, other in pairs.tolist():
        graph[one].add(other)
        graph[other].add(one)
    merged = np.arange(len(levels))
    flaws = _close_diamonds(graph, levels, merged)
    while found := _prune_spurs(graph, merged) + _close_holes(graph, merged):
        flaws += found
    flaws += _part_junctions(graph, _middles(places, merged[slab_of_place], len(levels)))
    paths, closed = _walk(graph, merged)
    run_of_slab, slot_of_slab = np.full((2, len(levels)), -1)
    for number, path in enumerate(paths):
        run_of_slab[path], slot_of_slab[path] = number, np.arange(len(path))
    slab = merged[slab_of_place]
    lengths = np.array([len(path) for path in paths], np.int64)
    return Runs(run_of_slab[slab], slot_of_slab[slab], lengths, tuple(closed), flaws)


def neighbours_of(
    places: FloatArray, reach: FloatArray, frames: FloatArray | None = None
) -> tuple[IntArray, IntArray]:
    """Neighbours of place i: ``neighbours[starts[i]:starts[i + 1]]``; both must see each other.

    Places (m, 2) see as far as their reach (m,). Frames (m, 3) hold a direction, and how many times
    as far a place sees along it.
    """
    low = places.min(axis=0)
    sides = places.max(axis=0) - low
    # The usual reach, not the widest: a wide one looks through more buckets.
    if frames is None:
        frames = np.tile([1.0, 0.0, 1.0], (len(places), 1))
    edge = max(float(np.median(reach)), float(sides.max()) / 1000, 1e-300)
    shape = np.floor(sides / edge).astype(np.int64) + 1
    return _neighbours(places, reach, frames, low, edge, int(shape[0]), int(shape[1]))


def apart(
    starts: IntArray, neighbours: IntArray, kind: BoolArray | IntArray
) -> tuple[IntArray, IntArray]:
    """Neighbours of the same kind only."""
    own = np.repeat(np.arange(len(kind)), np.diff(starts))
    kept = kind[neighbours] == kind[own]
    held = np.bincount(own[kept], minlength=len(kind))
    return np.concatenate([[0], held.cumsum()]), neighbours[kept]


@njit(cache=True, nogil=True, error_model="numpy")
def _neighbours(
    places: FloatArray,
    reach: FloatArray,
    frames: FloatArray,
    low: FloatArray,
    edge: float,
    nx: int,
    ny: int,
) -> tuple[IntArray, IntArray]:
    count = len(places)
    first = np.full(nx * ny, -1, np.int64)
    following = np.empty(count, np.int64)
    columns, rows = np.empty(count, np.int64), np.empty(count, np.int64)
    for n in range(count):
        columns[n] = min(int((places[n, 0] - low[0]) / edge), nx - 1)
        rows[n] = min(int((places[n, 1] - low[1]) / edge), ny - 1)
        box = columns[n] * ny + rows[n]
        following[n] = first[box]
        first[box] = n
    starts = np.zeros(count + 1, np.int64)
    found = np.empty(16 * count + 16, np.int64)
    held = 0
    for n in range(count):
        x, y, far = places[n, 0], places[n, 1], reach[n]
        c, s, a = frames[n, 0], frames[n, 1], frames[n, 2]
        wide = int(far * a / edge) + 1
        for i in range(max(columns[n] - wide, 0), min(columns[n] + wide, nx - 1) + 1):
            for j in range(max(rows[n] - wide, 0), min(rows[n] + wide, ny - 1) + 1):
                other = first[i * ny + j]
                while other >= 0:
                    dx, dy = places[other, 0] - x, places[other, 1] - y
                    u, v = (c * dx + s * dy) / a, c * dy - s * dx
                    seen = u * u + v * v <= far * far
                    if seen:
                        oc, os, oa = frames[other, 0], frames[other, 1], frames[other, 2]
                        u, v = (oc * dx + os * dy) / oa, oc * dy - os * dx
                        seen = u * u + v * v <= reach[other] * reach[other]
                    if seen and other != n:
                        if held == len(found):
                            found = np.concatenate((found, np.empty_like(found)))
                        found[held] = other
                        held += 1
                    other = following[other]
        starts[n + 1] = held
    return starts, found[:held].copy()


@njit(cache=True, nogil=True)
def _flood(starts: IntArray, neighbours: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Slab of each place; pairs (k, 2) of slabs that touch; level of each slab."""
    count = len(starts) - 1
    level = np.full(count, -1, np.int64)
    queue = np.empty(count, np.int64)
    scratch = np.full(count, -1, np.int64)
    for n in range(count):
        if level[n] < 0:
            # From anywhere to the farthest place, and back from there: an end, if there is one.
            last = _climb(starts, neighbours, n, scratch, queue)
            _climb(starts, neighbours, last, level, queue)
    slab = np.full(count, -1, np.int64)
    levels = np.empty(count, np.int64)
    slabs = 0
    for n in range(count):
        if slab[n] >= 0:
            continue
        slab[n], levels[slabs] = slabs, level[n]
        queue[0] = n
        head, tail = 0, 1
        while head < tail:
            for e in range(starts[queue[head]], starts[queue[head] + 1]):
                other = neighbours[e]
                if slab[other] < 0 and level[other] == level[n]:
                    slab[other] = slabs
                    queue[tail] = other
                    tail += 1
            head += 1
        slabs += 1
    return slab, _touching(starts, neighbours, slab, slabs), levels[:slabs].copy()


@njit(cache=True, nogil=True)
def _climb(
    starts: IntArray, neighbours: IntArray, seed: int, level: IntArray, queue: IntArray
) -> int:
    """Steps from the seed, into level; the place reached last."""
    level[seed] = 0
    queue[0] = seed
    head, tail = 0, 1
    while head < tail:
        here = queue[head]
        for e in range(starts[here], starts[here + 1]):
            other = neighbours[e]
            if level[other] < 0:
                level[other] = level[here] + 1
                queue[tail] = other
                tail += 1
        head += 1
    return int(queue[tail - 1])


@njit(cache=True, nogil=True)
def _touching(starts: IntArray, neighbours: IntArray, slab: IntArray, slabs: int) -> IntArray:
    pairs = np.empty((4 * slabs + 16, 2), np.int64)
    first = np.full(slabs, -1, np.int64)  # of the pairs known of each slab: a linked list
    following = np.empty(len(pairs), np.int64)
    held = 0
    for n in range(len(slab)):
        for e in range(starts[n], starts[n + 1]):
            one, other = slab[n], slab[neighbours[e]]
            if one >= other:
                continue
            known = first[one]
            while known >= 0 and pairs[known, 1] != other:
                known = following[known]
            if known >= 0:
                continue
            if held == len(pairs):
                pairs = np.concatenate((pairs, np.empty_like(pairs)))
                following = np.concatenate((following, np.empty_like(following)))
            pairs[held, 0], pairs[held, 1] = one, other
            following[held], first[one] = first[one], held
            held += 1
    return pairs[:held].copy()


def _merge(graph: Graph, merged: IntArray, into: int, gone: int) -> None:
    for other in graph[gone]:
        graph[other].discard(gone)
        if other != into:
            graph[other].add(into)
            graph[into].add(other)
    graph[gone] = set()
    graph[into].discard(into)
    merged[merged == gone] = into


def _close_diamonds(graph: Graph, levels: IntArray, merged: IntArray) -> int:
    """Merge slabs of one level that part below and meet above: a hole no longer than they are."""
    found = 0
    for slab in range(len(graph)):
        upper = [other for other in graph[slab] if levels[other] > levels[slab]]
        for position, one in enumerate(upper):
            for other in upper[position + 1 :]:
                if any(levels[n] > levels[one] for n in graph[one] & graph[other]):
                    _merge(graph, merged, one, other)
                    found += 1
    return found


def _prune_spurs(graph: Graph, merged: IntArray) -> int:
    """Give short dead ends to the slab they hang on, if ways go on there; the shortest first."""
    found = 0
    for length in range(1, _SPUR + 1):
        for leaf in range(len(graph)):
            path = [leaf]
            while len(path) <= length and len(graph[path[-1]]) == 1 + (len(path) > 1):
                path.append(next(other for other in graph[path[-1]] if other not in path))
            if len(path) == length + 1 and len(graph[path[-1]]) > 2:
                for slab in reversed(path[:-1]):
                    _merge(graph, merged, path[-1], slab)
                found += 1
    return found


def _close_holes(graph: Graph, merged: IntArray) -> int:
    """Contract short cycles that hang on a junction: holes in a band, not loops."""
    for slab in range(len(graph)):
        if len(graph[slab]) > 2:
            cycle = _short_cycle(graph, slab)
            if cycle:
                for other in cycle[1:]:
                    _merge(graph, merged, cycle[0], other)
                return 1
    return 0


def _short_cycle(graph: Graph, start: int) -> list[int]:
    """Return a cycle of at most `_HOLE` slabs through `start`, if there is one."""
    branch = {other: other for other in graph[start]}  # by which neighbour a slab was reached
    back = dict.fromkeys(graph[start], start)
    front = list(graph[start])
    for _ in range(_HOLE // 2):
        following = []
        for here in front:
            for other in graph[here] - {start, back[here]}:
                if other in branch and branch[other] != branch[here]:
                    cycle = [start, *_way_back(back, here, start), *_way_back(back, other, start)]
                    if len(cycle) <= _HOLE:
                        return cycle
                elif other not in branch:
                    branch[other], back[other] = branch[here], here
                    following.append(other)
        front = following
    return []


def _way_back(back: dict[int, int], here: int, start: int) -> list[int]:
    way = []
    while here != start:
        way.append(here)
        here = back[here]
    return way


def _middles(places: FloatArray, slab_of_place: IntArray, slabs: int) -> FloatArray:
    counts = np.maximum(np.bincount(slab_of_place, minlength=slabs), 1)
    sums = [np.bincount(slab_of_place, weights=column, minlength=slabs) for column in places.T]
    return np.stack(sums, axis=1) / counts[:, None]


def _part_junctions(graph: Graph, middles: FloatArray) -> int:
    """Where three ways meet the two that go on straightest stay together."""
    found = 0
    for slab in range(len(graph)):
        if len(graph[slab]) <= 2:
            continue
        others = sorted(graph[slab])
        arms = middles[others] - middles[slab]
        arms /= np.maximum(np.linalg.norm(arms, axis=1, keepdims=True), 1e-300)
        bends = arms @ arms.T
        one, other = np.unravel_index(np.argmin(bends), bends.shape)
        for position, gone in enumerate(others):
            if position not in (one, other):
                graph[slab].discard(gone)
                graph[gone].discard(slab)
                found += 1
    return found


def _walk(graph: Graph, merged: IntArray) -> tuple[list[list[int]], list[bool]]:
    """Paths from end to end, then the cycles that are left."""
    runs: list[list[int]] = []
    closed: list[bool] = []
    alive = [slab for slab in range(len(graph)) if merged[slab] == slab]
    seen: set[int] = set()
    for starts, loop in (([s for s in alive if len(graph[s]) < 2], False), (alive, True)):
        for start in starts:
            if start in seen:
                continue
            run = [start]
            seen.add(start)
            while onward := [other for other in sorted(graph[run[-1]]) if other not in seen]:
                run.append(onward[0])
                seen.add(onward[0])
            runs.append(run)
            closed.append(loop)
    return runs, closed
