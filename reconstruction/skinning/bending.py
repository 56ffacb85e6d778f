"""What the stiffness penalises: changes of the normal curvature from span to span, in rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.skinning.net import Net, basis_of_spans
from reconstruction.skinning.unknowns import Unknowns, grevilles

_ENTRIES = 7  # of a row: four control points, or three and an apex
_NOTHING = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Sparse rows of the stiffness: a value that should be zero, and how it depends on moves."""

    numbers: IntArray  # (r, 7), of unknowns; -1 for none
    slopes: FloatArray  # (r, 7)
    values_mm: FloatArray  # (r,), now
    u: FloatArray  # (r,), where on the surface
    v: FloatArray


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
    spans = int(net.spans[0] if along_u else net.spans[1])
    basis = basis_of_spans(knots)
    numbers, slopes, values = _changes(
        net.control_mm, unknowns.directions, unknowns.numbers, net.apex, basis.first, basis.values,
        along_u=along_u,
    )  # fmt: skip
    u, v = grevilles(net)
    middles = np.arange(spans, dtype=np.float64) + 0.5
    at_u, at_v = np.meshgrid(middles, v, indexing="ij") if along_u else np.meshgrid(
        u, middles, indexing="ij"
    )  # fmt: skip
    return Rows(numbers, slopes, values, at_u.ravel(), at_v.ravel())


@njit(cache=True, nogil=True, error_model="numpy")
def _changes(
    control: FloatArray, directions: FloatArray, number: IntArray, apex: BoolArray,
    firsts: IntArray, bases: FloatArray, *, along_u: bool,
) -> tuple[IntArray, FloatArray, FloatArray]:  # fmt: skip
    count_u, count_v = control.shape[:2]
    count, others = (count_u, count_v) if along_u else (count_v, count_u)
    spans = len(firsts) // 2
    numbers = np.full((spans * others, _ENTRIES), -1, np.int64)
    slopes, values = np.zeros((spans * others, _ENTRIES)), np.zeros(spans * others)
    bends, speeds = np.zeros(2 * spans), np.zeros(2 * spans)
    parts, tips = np.zeros((2 * spans, 4)), np.zeros((2 * spans, 4, 3))
    line, ways = np.empty((4, 3)), np.empty((4, 3))
    for other in range(others):
        if along_u and apex[other]:
            continue
        for t in range(2 * spans):
            for k in range(4):
                at = (firsts[t] + k) % count
                i, j = (at, other) if along_u else (other, at)
                line[k], ways[k] = control[i, j], directions[i, j]
            bends[t], speeds[t] = _bend(line, ways, bases[t], parts[t], tips[t])
        typical = speeds.mean()
        for span in range(spans):
            row = span * others + other if along_u else other * spans + span
            scale = typical * 0.5 * (speeds[2 * span] + speeds[2 * span + 1])
            values[row] = scale * (bends[2 * span + 1] - bends[2 * span])
            for end in range(2):
                sign = scale if end else -scale
                t = 2 * span + end
                for k in range(4):
                    at = (firsts[t] + k) % count
                    i, j = (at, other) if along_u else (other, at)
                    if apex[j]:
                        for d in range(3):
                            numbers[row, 4 + d] = number[d, j]
                            slopes[row, 4 + d] += sign * tips[t, k, d]
                    else:
                        numbers[row, k] = number[i, j]
                        slopes[row, k] += sign * parts[t, k]
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


def row_values(rows: Rows, moves: FloatArray) -> FloatArray:
    """Change of each row's value under moves of the unknowns, flat; (r,)."""
    held = np.where(rows.numbers >= 0, moves[rows.numbers], 0.0)
    return np.asarray((held * rows.slopes).sum(axis=1))
