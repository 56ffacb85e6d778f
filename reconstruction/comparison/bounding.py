"""A tree of boxes over triangles, for nearest-triangle queries.

Built top down with the surface area heuristic on 16 bins (Wald 2007,
doi:10.1109/RT.2007.4342588). Long triangles get several small boxes instead of one big one, after
the early split clipping of Ernst and Greiner 2007 (doi:10.1109/RT.2007.4342594): in the fan of an
end cap the plain boxes of hundreds of needles overlap at every point, and a tree cannot tell them
apart. Here a triangle is cut into slices across its longest edge.

Each inner node k keeps the boxes of its two children, so that a child is looked at only when it
can matter::

    boxes[k, side]    lowest xyz, highest xyz
    children[k, side] >= 0: an inner node;  < 0: a leaf that starts at item -(child + 1)
    counts[k, side]   items in that leaf
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray

LEAF_SIZE = 4
_BINS = 16
_DEEP = 40  # below this depth halves are equal, which bounds the whole depth by about 40 + 30
STACK_SIZE = 96


@dataclass(frozen=True, slots=True, eq=False)
class BoxTree:
    """The tree; `triangle_of_item` may name a long triangle several times."""

    boxes: FloatArray  # (k, 2, 6)
    children: IntArray  # (k, 2)
    counts: IntArray  # (k, 2)
    triangle_of_item: IntArray  # (items,), in leaf order


def box_tree(corners_mm: FloatArray) -> BoxTree:
    """Build the tree over triangles of shape (m, 3, 3), m > 0."""
    lows, highs, owners = _piece_boxes(corners_mm)
    order = np.arange(len(owners))
    boxes = np.empty((max(len(owners), 1), 2, 6))
    children = np.zeros((len(boxes), 2), dtype=np.int64)
    counts = np.zeros((len(boxes), 2), dtype=np.int64)
    nodes = _build(lows, highs, order, boxes, children, counts)
    return BoxTree(boxes[:nodes], children[:nodes], counts[:nodes], owners[order])


def _piece_boxes(corners_mm: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Boxes of the triangles, the long ones in slices; lows (p, 3), highs (p, 3), owners (p,).

    ::

                 c           a triangle of longest edge ab in slices: each slice is held by its
               / | `.        four corners on ab and on the way a-c-b, and by c if c lies in it.
              /|_|___|`.     The slices are three mean lengths long, so that there are at most
             a-+-----+--b    a third more boxes than triangles, and one for each.
    """
    edges = np.roll(corners_mm, -1, axis=1) - corners_mm
    squares = np.einsum("ijk,ijk->ij", edges, edges)
    longest = squares.argmax(axis=1)
    lengths = np.sqrt(squares.max(axis=1))
    slices = np.ceil(lengths / max(3.0 * float(lengths.mean()), 1e-300)).astype(np.int64)
    whole = np.flatnonzero(slices <= 1)
    long = np.flatnonzero(slices > 1)
    a, b, c = (corners_mm[long, (longest[long] + k) % 3] for k in range(3))
    lows, highs, owners = _slice_boxes(a, b, c, slices[long])
    return (
        np.concatenate([corners_mm[whole].min(axis=1), lows]),
        np.concatenate([corners_mm[whole].max(axis=1), highs]),
        np.concatenate([whole, long[owners]]),
    )


def _slice_boxes(
    a: FloatArray, b: FloatArray, c: FloatArray, slices: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Boxes of triangles cut into `slices` parts along ab; lows, highs and the rows they are of."""
    owners = np.repeat(np.arange(len(a)), slices)
    number = np.arange(len(owners)) - np.repeat(np.cumsum(slices) - slices, slices)
    a, b, c = a[owners], b[owners], c[owners]
    apex = np.einsum("ij,ij->i", c - a, b - a) / np.einsum("ij,ij->i", b - a, b - a)
    cuts = np.stack([number, number + 1]) / slices[owners]
    on_base = a + cuts[..., None] * (b - a)
    rising = cuts / np.where(apex > 0, apex, 1.0)
    falling = (cuts - apex) / np.where(apex < 1, 1.0 - apex, 1.0)
    on_sides = np.where(
        (cuts <= apex)[..., None], a + rising[..., None] * (c - a), c + falling[..., None] * (b - c)
    )
    has_apex = (cuts[0] <= apex) & (apex <= cuts[1])
    tip = np.where(has_apex[:, None], c, on_base[0])
    held = np.concatenate([on_base, on_sides, tip[None]])
    # A cut point is rounded; a millionth of a millionth of the part is far above that.
    margin = 1e-12 * np.abs(held).max() if len(held[0]) else 0.0
    return held.min(axis=0) - margin, held.max(axis=0) + margin, owners


@njit(cache=True)
def _build(
    lows: FloatArray,
    highs: FloatArray,
    order: IntArray,
    boxes: FloatArray,
    children: IntArray,
    counts: IntArray,
) -> int:
    """Fill the tree, permute `order` into leaf order, return the number of inner nodes."""
    todo = np.empty((STACK_SIZE, 4), dtype=np.int64)  # node, start, stop, depth
    todo[0, 0], todo[0, 1], todo[0, 2], todo[0, 3] = 0, 0, len(order), 0
    waiting, nodes = 1, 1
    while waiting > 0:
        waiting -= 1
        node, start, stop, depth = todo[waiting]
        middle = _partition(lows, highs, order, start, stop, depth)
        for side in range(2):
            first, last = (start, middle) if side == 0 else (middle, stop)
            _enclose(lows, highs, order, first, last, boxes[node, side])
            if last - first <= LEAF_SIZE:
                children[node, side], counts[node, side] = -(first + 1), last - first
            else:
                children[node, side] = nodes
                todo[waiting, 0], todo[waiting, 1] = nodes, first
                todo[waiting, 2], todo[waiting, 3] = last, depth + 1
                waiting, nodes = waiting + 1, nodes + 1
    return nodes


@njit(cache=True)
def _enclose(
    lows: FloatArray, highs: FloatArray, order: IntArray, start: int, stop: int, box: FloatArray
) -> None:
    """Write the box of items start .. stop; an empty one is infinitely far away."""
    for axis in range(3):
        box[axis], box[3 + axis] = np.inf, -np.inf
        for item in order[start:stop]:
            box[axis] = min(box[axis], lows[item, axis])
            box[3 + axis] = max(box[3 + axis], highs[item, axis])
        if stop == start:
            box[3 + axis] = np.inf


@njit(cache=True)
def _partition(
    lows: FloatArray, highs: FloatArray, order: IntArray, start: int, stop: int, depth: int
) -> int:
    """Split items start .. stop in place, return where the second part begins."""
    if stop - start <= LEAF_SIZE:
        return stop
    axis, low, width = _widest(lows, highs, order, start, stop)
    halfway = (start + stop) // 2
    if width <= 0.0:
        return halfway
    cut = -1 if depth > _DEEP else _cheapest_cut(lows, highs, order[start:stop], axis, low, width)
    if cut < 0:
        return halfway
    first, last = start, stop - 1
    while first <= last:
        if _bin(lows, highs, order[first], axis, low, width) <= cut:
            first += 1
        else:
            order[first], order[last] = order[last], order[first]
            last -= 1
    return first


@njit(cache=True)
def _widest(
    lows: FloatArray, highs: FloatArray, order: IntArray, start: int, stop: int
) -> tuple[int, float, float]:
    """Find the axis along which twice the box centres spread most: axis, lowest, spread."""
    best, best_low, best_width = 0, 0.0, -1.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for item in order[start:stop]:
            middle = lows[item, axis] + highs[item, axis]
            low, high = min(low, middle), max(high, middle)
        if high - low > best_width:
            best, best_low, best_width = axis, low, high - low
    return best, best_low, best_width


@njit(cache=True)
def _bin(
    lows: FloatArray, highs: FloatArray, item: int, axis: int, low: float, width: float
) -> int:
    share = (lows[item, axis] + highs[item, axis] - low) / width
    return min(_BINS - 1, int(share * _BINS))


@njit(cache=True)
def _cheapest_cut(
    lows: FloatArray, highs: FloatArray, items: IntArray, axis: int, low: float, width: float
) -> int:
    """Find the last bin of the first part, by area times count of both parts; -1: no cut."""
    counts, boxes = np.zeros(_BINS), np.empty((_BINS, 6))
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for item in items:
        k = _bin(lows, highs, item, axis, low, width)
        counts[k] += 1
        for j in range(3):
            boxes[k, j] = min(boxes[k, j], lows[item, j])
            boxes[k, 3 + j] = max(boxes[k, 3 + j], highs[item, j])
    after = np.zeros(_BINS)
    _sweep(counts[::-1], boxes[::-1], after[::-1])
    before = np.zeros(_BINS)
    _sweep(counts, boxes, before)
    best, best_cost = -1, np.inf
    for k in range(_BINS - 1):
        cost = before[k] + after[k + 1]
        if before[k] > 0 and after[k + 1] > 0 and cost < best_cost:
            best, best_cost = k, cost
    return best


@njit(cache=True)
def _sweep(counts: FloatArray, boxes: FloatArray, costs: FloatArray) -> None:
    """Write count times box area of everything up to each bin."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    total = 0.0
    for k in range(len(counts)):
        total += counts[k]
        for j in range(3):
            low[j], high[j] = min(low[j], boxes[k, j]), max(high[j], boxes[k, 3 + j])
        if total > 0:
            x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
            # A flat box has no area along two axes; its girth keeps the costs apart.
            costs[k] = total * (x * y + y * z + z * x + 1e-12 * (x + y + z) ** 2 + 1e-300)
