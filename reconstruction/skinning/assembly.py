"""The system of a net: what data and stiffness add to its matrix and right side."""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.bending import Rows
from reconstruction.skinning.blocks import Blocks, empty_blocks
from reconstruction.skinning.net import Basis, Net, unit_normals
from reconstruction.skinning.unknowns import APEX, Unknowns

_FIRM = 1e3


def empty_system(unknowns: Unknowns) -> tuple[Blocks, FloatArray]:
    """A zero matrix and right side."""
    lines, size = unknowns.lines, unknowns.width
    return empty_blocks(lines, size, unknowns.reach), np.zeros((lines, size))


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
        matrix.panels, right.reshape(-1), unknowns.directions, unknowns.numbers,
        net.apex, at_u.first, at_u.values[:, 0], at_v.first, at_v.values[:, 0], normals,
        distances_mm, weights, _by_span(at_u.first, at_v.first, unknowns.directions.shape[:2]),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _by_span(first_u: IntArray, first_v: IntArray, counts: tuple[int, int]) -> IntArray:
    """The order of cells (m,) that brings those of a span together; else they keep theirs."""
    starts = np.zeros(counts[0] * counts[1] + 1, np.int64)
    for m in range(len(first_u)):
        starts[first_u[m] * counts[1] + first_v[m] + 1] += 1
    for span in range(1, len(starts)):
        starts[span] += starts[span - 1]
    order = np.empty(len(first_u), np.int64)
    for m in range(len(first_u)):
        span = first_u[m] * counts[1] + first_v[m]
        order[starts[span]] = m
        starts[span] += 1
    return order


@njit(cache=True, nogil=True, inline="always")
def _enter(panels: FloatArray, size: int, p: int, q: int, value: float) -> None:
    """Add to the lower half of the matrix."""
    if p < q:
        p, q = q, p
    block = q // size
    panels[block, q - block * size, p - block * size] += value


@njit(cache=True, nogil=True, error_model="numpy")
def row_at(
    directions: FloatArray, number: IntArray, apex: BoolArray, first_u: int, values_u: FloatArray,
    first_v: int, values_v: FloatArray, normal: FloatArray, numbers: IntArray, slopes: FloatArray,
) -> int:  # fmt: skip
    """How the surface moves along a normal with each unknown; returns how many take part."""
    count_u, count_v = directions.shape[:2]
    held = 0
    for b in range(4):
        j = (first_v + b) % count_v
        if apex[j]:
            for d in range(3):
                numbers[held], slopes[held] = number[d, j], values_v[b] * normal[d]
                held += 1
            continue
        for a in range(4):
            i = (first_u + a) % count_u
            along = 0.0
            for d in range(3):
                along += directions[i, j, d] * normal[d]
            numbers[held] = number[i, j]
            slopes[held] = values_u[a] * values_v[b] * along
            held += 1
    return held


@njit(cache=True, nogil=True, error_model="numpy")
def _add_data(
    panels: FloatArray, right: FloatArray, directions: FloatArray,
    number: IntArray, apex: BoolArray, first_u: IntArray, values_u: FloatArray, first_v: IntArray,
    values_v: FloatArray, normals: FloatArray, distances: FloatArray, weights: FloatArray,
    order: IntArray,
) -> None:  # fmt: skip
    """Add cells in an order that brings those of a span together: they meet the same unknowns.

    Their products are summed in a square that the cache holds, and entered once a span.
    """
    size = panels.shape[1]
    numbers, slopes = np.empty(16, np.int64), np.empty(16)
    square, side = np.zeros((16, 16)), np.zeros(16)
    held = 0
    for position in range(len(order)):
        m = order[position]
        if weights[m] > 0.0:
            held = row_at(
                directions, number, apex, first_u[m], values_u[m], first_v[m], values_v[m],
                normals[m], numbers, slopes,
            )  # fmt: skip
            for p in range(held):
                scaled = weights[m] * slopes[p]
                side[p] += scaled * distances[m]
                for q in range(held):
                    square[p, q] += scaled * slopes[q]
        following = order[position + 1] if position + 1 < len(order) else -1
        if following >= 0 and (
            first_u[following] == first_u[m] and first_v[following] == first_v[m]
        ):
            continue
        for p in range(held):
            right[numbers[p]] += side[p]
            block = numbers[p] // size
            start = block * size
            for q in range(held):  # each pair once: into the panel of the lower number
                if numbers[q] >= numbers[p]:
                    panels[block, numbers[p] - start, numbers[q] - start] += square[p, q]
        square[:] = 0.0
        side[:] = 0.0
        held = 0


def add_stiffness(system: tuple[Blocks, FloatArray], rows: Rows, stiffness: FloatArray) -> None:
    """Add rows, each with its stiffness (r,)."""
    matrix, right = system
    _add_rows(
        matrix.panels, right.reshape(-1), rows.numbers, rows.slopes,
        rows.values_mm, stiffness,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _add_rows(
    panels: FloatArray, right: FloatArray, numbers: IntArray,
    slopes: FloatArray, values: FloatArray, stiffness: FloatArray,
) -> None:  # fmt: skip
    size = panels.shape[1]
    for r in range(len(values)):
        for p in range(numbers.shape[1]):
            if numbers[r, p] < 0:
                continue
            scaled = stiffness[r] * slopes[r, p]
            right[numbers[r, p]] -= scaled * values[r]
            for q in range(p + 1):
                if numbers[r, q] >= 0:
                    _enter(panels, size, numbers[r, p], numbers[r, q], scaled * slopes[r, q])


def add_tangency(
    system: tuple[Blocks, FloatArray], net: Net, unknowns: Unknowns, *, last: bool
) -> None:
    """Tie the row beside an apex into one plane with it, so that the surface is smooth there.

    The plane is free to tilt: what is tied are the heights of the row's points above the apex, but
    for what a tilt explains. The tie is a thousand times firmer than anything else there.
    """
    row, ring = (-1, -2) if last else (0, 1)
    width = len(unknowns.numbers)
    arms = net.control_mm[:, ring] - net.control_mm[:, row]
    normal = unit_normals(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    flat = arms - (arms @ normal)[:, None] * normal
    tilts = np.linalg.svd(flat, full_matrices=False)[0][:, :2]
    rest = np.eye(width) - tilts @ tilts.T
    slopes = np.zeros((width, width + APEX))
    slopes[:, :width] = np.diag(unknowns.directions[:, ring] @ normal)
    slopes[:, width:] = -normal
    numbers = np.concatenate([unknowns.numbers[:, ring], unknowns.numbers[:APEX, row]])
    matrix, right = system
    firm = _FIRM * float(matrix.diagonal.reshape(-1)[numbers].max())
    _enter_all(matrix.panels, numbers, firm * slopes.T @ rest @ slopes)
    right.reshape(-1)[numbers] -= firm * slopes.T @ (rest @ (arms @ normal))


@njit(cache=True, nogil=True)
def _enter_all(panels: FloatArray, numbers: IntArray, values: FloatArray) -> None:
    size = panels.shape[1]
    for p in range(len(numbers)):
        for q in range(p + 1):
            _enter(panels, size, numbers[p], numbers[q], values[p, q])
