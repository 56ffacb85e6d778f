"""Unknowns of a net, and the rows that data and stiffness add to its system.

Every control point moves along one direction, the surface's normal beside it, so that the
parametrisation, which the data do not determine, is not asked for. A control point on an end that
must stay in a plane moves inside that plane. An apex moves freely: three unknowns for its row.

Unknown i of row j is number ``place[j] * width + i``: rows are laid one after the other, folded
where the net closes in v, so that what is coupled lies in the same or in neighbouring blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.skinning.blocks import Blocks
from reconstruction.skinning.net import Basis, Net, basis_at, derivatives_at, greville, unit_normals

_OPEN_ROWS = 3  # net rows a block
_FOLDED_ROWS = 6
_ENTRIES = 7  # of a row of the stiffness: four control points, or three and an apex
_APEX = 3  # unknowns of an apex: it moves freely
_FIRM = 1e3
_NOTHING = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Directions in which the control points may move, and where they stand in the system."""

    directions: FloatArray  # (nu, nv, 3), unit; zero in the row of an apex
    place: IntArray  # (nv,), of each net row in the system's order
    rows_a_block: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", frozen(self.directions))
        object.__setattr__(self, "place", frozen(self.place, np.int64))

    @property
    def width(self) -> int:
        """Unknowns a net row."""
        return int(self.directions.shape[0])

    @property
    def size(self) -> int:
        """Unknowns a block."""
        return self.width * self.rows_a_block

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-len(self.place) // self.rows_a_block)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Sparse rows of the stiffness: a value that should be zero, and how it depends on moves."""

    numbers: IntArray  # (r, 7), of unknowns; -1 for none
    slopes: FloatArray  # (r, 7)
    values_mm: FloatArray  # (r,), now
    u: FloatArray  # (r,), where on the surface
    v: FloatArray


def unknowns_of(net: Net, level: tuple[FloatArray | None, FloatArray | None]) -> Unknowns:
    """Directions from the surface's normals at the control points' Greville abscissae.

    Parameters
    ----------
    level
        For the first and the last row: the normal (3,) of the plane it stays in, or None.
    """
    count_u, count_v = net.control_mm.shape[:2]
    u, v = _grevilles(net)
    grid_u, grid_v = (each.ravel() for each in np.meshgrid(u, v, indexing="ij"))
    frames = derivatives_at(net, grid_u, grid_v)
    normals = unit_normals(frames[:, 1], frames[:, 2]).reshape(count_u, count_v, 3)
    directions = np.array(normals)
    for row, plane in zip((0, -1), level, strict=True):
        if plane is not None:
            flat = normals[:, row] - (normals[:, row] @ plane)[:, None] * plane
            lengths = np.linalg.norm(flat, axis=1, keepdims=True)
            directions[:, row] = flat / np.maximum(lengths, 1e-300)
    directions[:, net.apex] = 0.0
    if not net.closed_v:
        return Unknowns(directions, np.arange(count_v), _OPEN_ROWS)
    # 0, 1, 2 .. and -1, -2 .. in turn: what meets across the seam lies together.
    order = np.arange(count_v)
    place = np.where(order < (count_v + 1) // 2, 2 * order, 2 * (count_v - 1 - order) + 1)
    return Unknowns(directions, place, _FOLDED_ROWS)


def _grevilles(net: Net) -> tuple[FloatArray, FloatArray]:
    """Greville abscissae inside the domain, of both directions."""
    count_u, count_v = net.control_mm.shape[:2]
    u, v = greville(net.knots_u, count_u), greville(net.knots_v, count_v)
    end_u, end_v = net.spans
    u = np.mod(u, end_u) if net.closed_u else u
    v = np.mod(v, end_v) if net.closed_v else v
    # Beside an apex the normal is looked for a little inside.
    margin = 0.05
    low = margin if net.apex[0] else 0.0
    high = end_v - (margin if net.apex[-1] else 0.0)
    return u, (v if net.closed_v else np.clip(v, low, high))


def stiffness_rows(net: Net, unknowns: Unknowns) -> tuple[Rows, Rows]:
    """Changes of the normal curvature over each span, along u and along v, as lengths.

    Curvature, not a difference of control points: what the parametrisation does is free. A change
    is told in mm, times the typical and the own length of the span, so that it stays small where
    lines crowd towards an apex.
    """
    return (
        _rows_along(net, unknowns, net.knots_u, along_u=True),
        _rows_along(net, unknowns, net.knots_v, along_u=False),
    )


def _rows_along(net: Net, unknowns: Unknowns, knots: FloatArray, *, along_u: bool) -> Rows:
    """A row for every span in one direction and every control point of the other."""
    closed = net.closed_u if along_u else net.closed_v
    spans = int(net.spans[0] if along_u else net.spans[1])
    at_knots = np.arange(spans + 1, dtype=np.float64)
    basis = basis_at(np.mod(at_knots, spans) if closed else at_knots, knots, 2, closed=closed)
    numbers, slopes, values = _changes(
        net.control_mm, unknowns.directions, unknowns.place, net.apex, basis.first, basis.values,
        along_u=along_u,
    )  # fmt: skip
    u, v = _grevilles(net)
    middles = np.arange(spans, dtype=np.float64) + 0.5
    at_u, at_v = np.meshgrid(middles, v, indexing="ij") if along_u else np.meshgrid(
        u, middles, indexing="ij"
    )  # fmt: skip
    return Rows(numbers, slopes, values, at_u.ravel(), at_v.ravel())


@njit(cache=True, nogil=True, error_model="numpy")
def _changes(
    control: FloatArray, directions: FloatArray, place: IntArray, apex: BoolArray,
    firsts: IntArray, bases: FloatArray, *, along_u: bool,
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    count_u, count_v = control.shape[:2]
    count, others = (count_u, count_v) if along_u else (count_v, count_u)
    spans = len(firsts) - 1
    numbers = np.full((spans * others, _ENTRIES), -1, np.int64)
    slopes, values = np.zeros((spans * others, _ENTRIES)), np.zeros(spans * others)
    bends, speeds = np.zeros(spans + 1), np.zeros(spans + 1)
    parts, tips = np.zeros((spans + 1, 4)), np.zeros((spans + 1, 4, 3))
    line, ways = np.empty((4, 3)), np.empty((4, 3))
    for other in range(others):
        if along_u and apex[other]:
            continue
        for t in range(spans + 1):
            for k in range(4):
                at = (firsts[t] + k) % count
                i, j = (at, other) if along_u else (other, at)
                line[k], ways[k] = control[i, j], directions[i, j]
            bends[t], speeds[t] = _bend(line, ways, bases[t], parts[t], tips[t])
        typical = speeds.mean()
        for span in range(spans):
            row = span * others + other if along_u else other * spans + span
            scale = typical * 0.5 * (speeds[span] + speeds[span + 1])
            values[row] = scale * (bends[span + 1] - bends[span])
            for end in range(2):
                sign = scale if end else -scale
                t = span + end
                for k in range(4):
                    place_in = (firsts[t] - firsts[span]) % count + k
                    at = (firsts[t] + k) % count
                    i, j = (at, other) if along_u else (other, at)
                    if apex[j]:
                        for d in range(3):
                            numbers[row, 4 + d] = place[j] * count_u + d
                            slopes[row, 4 + d] += sign * tips[t, k, d]
                    elif place_in < 4:
                        numbers[row, place_in] = place[j] * count_u + i
                        slopes[row, place_in] += sign * parts[t, k]
    return numbers, slopes, values


@njit(cache=True, nogil=True, error_model="numpy")
def _bend(
    line: FloatArray, ways: FloatArray, basis: FloatArray, parts: FloatArray, tips: FloatArray
) -> tuple[float, float]:
    """Normal curvature of a line at a knot, its speed, and how control points' moves change it.

    `parts` (4,) get the changes for moves along the control points' ways, `tips` (4, 3) those for
    free moves, as an apex makes them.
    """
    normal, first, second = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(4):
        for d in range(3):
            normal[d] += basis[0, k] * ways[k, d]
            first[d] += basis[1, k] * line[k, d]
            second[d] += basis[2, k] * line[k, d]
    if not (normal**2).sum() > 0.0:  # at an apex: as beside it
        normal[:] = ways[2] if basis[0, 3] > 0.5 else ways[1]
    square = max((first**2).sum(), _NOTHING)
    normal -= (normal * first).sum() / square * first  # of the line itself
    length = max(np.sqrt((normal**2).sum()), _NOTHING)
    bend = skew = 0.0
    for d in range(3):
        normal[d] /= length
        bend += normal[d] * second[d]
        skew += first[d] * second[d]
    bend, skew = bend / square, skew / square
    for k in range(4):
        parts[k] = 0.0
        turned = basis[2, k] - skew * basis[1, k]
        for d in range(3):
            tips[k, d] = (turned * normal[d] - 2.0 * bend * basis[1, k] * first[d]) / square
            parts[k] += tips[k, d] * ways[k, d]
    return bend, np.sqrt(square)


def empty_system(unknowns: Unknowns) -> tuple[Blocks, FloatArray]:
    """A zero matrix and right side."""
    size, blocks = unknowns.size, unknowns.blocks
    matrix = Blocks(np.zeros((blocks, size, size)), np.zeros((max(blocks - 1, 0), size, size)))
    return matrix, np.zeros((blocks, size))


def add_data(
    system: tuple[Blocks, FloatArray],
    net: Net,
    unknowns: Unknowns,
    at: tuple[Basis, Basis],
    normals: FloatArray,
    distances_mm: FloatArray,
    weights: FloatArray,
) -> None:
    """Add cells: normal distances (m,) that moves of the control points should take up."""
    matrix, right = system
    at_u, at_v = at
    _add_data(
        matrix.diagonal, matrix.lower, right.reshape(-1), unknowns.directions, unknowns.place,
        net.apex, at_u.first, at_u.values[:, 0], at_v.first, at_v.values[:, 0], normals,
        distances_mm, weights,
    )  # fmt: skip


@njit(cache=True, nogil=True, inline="always")
def _enter(
    diagonal: FloatArray, lower: FloatArray, size: int, p: int, q: int, value: float
) -> None:
    """Add to the lower triangle of the block matrix."""
    if p < q:
        p, q = q, p
    block_p, block_q = p // size, q // size
    if block_p == block_q:
        diagonal[block_p, p - block_p * size, q - block_q * size] += value
    else:
        lower[block_q, p - block_p * size, q - block_q * size] += value


@njit(cache=True, nogil=True, error_model="numpy")
def _row_at(
    directions: FloatArray, place: IntArray, apex: BoolArray, first_u: int, values_u: FloatArray,
    first_v: int, values_v: FloatArray, normal: FloatArray, numbers: IntArray, slopes: FloatArray,
) -> int:  # fmt: skip
    """How the surface moves along a normal with each unknown; returns how many take part."""
    count_u, count_v = directions.shape[:2]
    held = 0
    for b in range(4):
        j = (first_v + b) % count_v
        if apex[j]:
            for d in range(3):
                numbers[held], slopes[held] = place[j] * count_u + d, values_v[b] * normal[d]
                held += 1
            continue
        for a in range(4):
            i = (first_u + a) % count_u
            along = 0.0
            for d in range(3):
                along += directions[i, j, d] * normal[d]
            numbers[held] = place[j] * count_u + i
            slopes[held] = values_u[a] * values_v[b] * along
            held += 1
    return held


@njit(cache=True, nogil=True, error_model="numpy")
def _add_data(
    diagonal: FloatArray, lower: FloatArray, right: FloatArray, directions: FloatArray,
    place: IntArray, apex: BoolArray, first_u: IntArray, values_u: FloatArray, first_v: IntArray,
    values_v: FloatArray, normals: FloatArray, distances: FloatArray, weights: FloatArray,
) -> None:  # fmt: skip
    size = diagonal.shape[1]
    numbers, slopes = np.empty(16, np.int64), np.empty(16)
    for m in range(len(distances)):
        if not weights[m] > 0.0:
            continue
        held = _row_at(
            directions, place, apex, first_u[m], values_u[m], first_v[m], values_v[m],
            normals[m], numbers, slopes,
        )  # fmt: skip
        for p in range(held):
            scaled = weights[m] * slopes[p]
            right[numbers[p]] += scaled * distances[m]
            for q in range(p + 1):
                _enter(diagonal, lower, size, numbers[p], numbers[q], scaled * slopes[q])


def add_stiffness(system: tuple[Blocks, FloatArray], rows: Rows, stiffness: FloatArray) -> None:
    """Add rows, each with its stiffness (r,)."""
    matrix, right = system
    _add_rows(
        matrix.diagonal, matrix.lower, right.reshape(-1), rows.numbers, rows.slopes,
        rows.values_mm, stiffness,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _add_rows(
    diagonal: FloatArray, lower: FloatArray, right: FloatArray, numbers: IntArray,
    slopes: FloatArray, values: FloatArray, stiffness: FloatArray,
) -> None:  # fmt: skip
    size = diagonal.shape[1]
    for r in range(len(values)):
        for p in range(_ENTRIES):
            if numbers[r, p] < 0:
                continue
            scaled = stiffness[r] * slopes[r, p]
            right[numbers[r, p]] -= scaled * values[r]
            for q in range(p + 1):
                if numbers[r, q] >= 0:
                    _enter(
                        diagonal, lower, size, numbers[r, p], numbers[r, q], scaled * slopes[r, q]
                    )


def add_tangency(
    system: tuple[Blocks, FloatArray], net: Net, unknowns: Unknowns, *, last: bool
) -> None:
    """Tie the row beside an apex into one plane with it, so that the surface is smooth there.

    The plane is free to tilt: what is tied are the heights of the row's points above the apex, but
    for what a tilt explains. The tie is a thousand times firmer than anything else there.
    """
    row, ring = (len(unknowns.place) - 1, -2) if last else (0, 1)
    beside = row - 1 if last else 1
    width = unknowns.width
    arms = net.control_mm[:, ring] - net.control_mm[:, row]
    normal = unit_normals(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    flat = arms - (arms @ normal)[:, None] * normal
    tilts = np.linalg.svd(flat, full_matrices=False)[0][:, :2]
    rest = np.eye(width) - tilts @ tilts.T
    slopes = np.zeros((width, width + _APEX))
    slopes[:, :width] = np.diag(unknowns.directions[:, ring] @ normal)
    slopes[:, width:] = -normal
    numbers = np.concatenate(
        [unknowns.place[beside] * width + np.arange(width),
         unknowns.place[row] * width + np.arange(_APEX)]
    )  # fmt: skip
    matrix, right = system
    size = unknowns.size
    own = matrix.diagonal.reshape(len(matrix.diagonal), -1)[:, :: size + 1].reshape(-1)
    firm = _FIRM * float(own[numbers].max())
    _enter_all(matrix.diagonal, matrix.lower, numbers, firm * slopes.T @ rest @ slopes)
    right.reshape(-1)[numbers] -= firm * slopes.T @ (rest @ (arms @ normal))


@njit(cache=True, nogil=True)
def _enter_all(
    diagonal: FloatArray, lower: FloatArray, numbers: IntArray, values: FloatArray
) -> None:
    size = diagonal.shape[1]
    for p in range(len(numbers)):
        for q in range(p + 1):
            _enter(diagonal, lower, size, numbers[p], numbers[q], values[p, q])


def row_variances(rows: Rows, inverse: Blocks) -> FloatArray:
    """Variance of each row's value under the inverse of the system, (r,)."""
    return np.asarray(_variances(inverse.diagonal, inverse.lower, rows.numbers, rows.slopes))


def row_values(rows: Rows, moves: FloatArray) -> FloatArray:
    """Change of each row's value under moves of the unknowns, flat; (r,)."""
    held = np.where(rows.numbers >= 0, moves[rows.numbers], 0.0)
    return np.asarray((held * rows.slopes).sum(axis=1))


@njit(cache=True, nogil=True, inline="always")
def _read(diagonal: FloatArray, lower: FloatArray, size: int, p: int, q: int) -> float:
    if p < q:
        p, q = q, p
    block_p, block_q = p // size, q // size
    if block_p == block_q:
        return float(diagonal[block_p, p - block_p * size, q - block_q * size])
    return float(lower[block_q, p - block_p * size, q - block_q * size])


@njit(cache=True, nogil=True)
def _variances(
    diagonal: FloatArray, lower: FloatArray, numbers: IntArray, slopes: FloatArray
) -> FloatArray:
    size = diagonal.shape[1]
    out = np.zeros(len(numbers))
    for r in range(len(numbers)):
        for p in range(numbers.shape[1]):
            if numbers[r, p] < 0:
                continue
            for q in range(p + 1):
                if numbers[r, q] < 0:
                    continue
                twice = 1.0 if p == q else 2.0
                out[r] += (
                    twice * slopes[r, p] * slopes[r, q]
                    * _read(diagonal, lower, size, numbers[r, p], numbers[r, q])
                )  # fmt: skip
    return out


def variances_across(
    inverse: Blocks,
    net: Net,
    unknowns: Unknowns,
    at: tuple[Basis, Basis],
    normals: FloatArray,
) -> FloatArray:
    """Variance of the surface along normals (m, 3) at parameters, (m,)."""
    at_u, at_v = at
    # In the order of the net: neighbours read the same part of an inverse that no cache holds.
    order = np.argsort(at_v.first * len(unknowns.directions) + at_u.first)
    return np.asarray(
        _variances_at(
            inverse.diagonal, inverse.lower, unknowns.directions, unknowns.place, net.apex,
            at_u.first, at_u.values[:, 0], at_v.first, at_v.values[:, 0], normals, order,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _variances_at(
    diagonal: FloatArray, lower: FloatArray, directions: FloatArray, place: IntArray,
    apex: BoolArray, first_u: IntArray, values_u: FloatArray, first_v: IntArray,
    values_v: FloatArray, normals: FloatArray, order: IntArray,
) -> FloatArray:  # fmt: skip
    size = diagonal.shape[1]
    numbers, slopes = np.empty(16, np.int64), np.empty(16)
    blocks, within = np.empty(16, np.int64), np.empty(16, np.int64)
    out = np.zeros(len(normals))
    for m in order:
        held = _row_at(
            directions, place, apex, first_u[m], values_u[m], first_v[m], values_v[m],
            normals[m], numbers, slopes,
        )  # fmt: skip
        total = 0.0
        for p in range(held):
            # Divided once a number, not once a pair: 16 times for 136 reads.
            blocks[p] = numbers[p] // size
            within[p] = numbers[p] - blocks[p] * size
            part = 0.5 * slopes[p] * diagonal[blocks[p], within[p], within[p]]
            for q in range(p):
                if blocks[p] == blocks[q]:
                    part += slopes[q] * diagonal[blocks[p], within[p], within[q]]
                elif blocks[p] > blocks[q]:
                    part += slopes[q] * lower[blocks[q], within[p], within[q]]
                else:
                    part += slopes[q] * lower[blocks[p], within[q], within[p]]
            total += 2.0 * slopes[p] * part
        out[m] = max(total, 0.0)
    return out


def applied(net: Net, unknowns: Unknowns, moves: FloatArray) -> FloatArray:
    """Control points (nu, nv, 3) after moves of the unknowns, flat."""
    width, count_v = unknowns.width, len(unknowns.place)
    numbers = unknowns.place[None, :] * width + np.arange(width)[:, None]
    control = net.control_mm + moves[numbers][:, :, None] * unknowns.directions
    for j in range(count_v):
        if net.apex[j]:
            start = unknowns.place[j] * width
            control[:, j] = net.control_mm[:, j] + moves[start : start + _APEX]
    return np.asarray(control)
