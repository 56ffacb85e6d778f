"""What a crease does when the faces beside it have moved, each along its own normals.

Both columns of control points that end in a crease go where the two moved faces meet. Seen from
either face that is a move along its normal and one along itself; the latter is handed on to all
columns of the face, so that the first of them are not overrun.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.skinning.net import Net, greville

_RIDGE = 0.02  # keeps the edge of faces that hardly bend; what it holds back comes a round later
_NOTHING = 1e-300


def joined(
    net: Net, control_mm: FloatArray, moves_mm: FloatArray, directions: FloatArray
) -> FloatArray:
    """Control points (nu, nv, 3) that have moved from the net's, with the creases closed again.

    Parameters
    ----------
    moves_mm, directions
        (nu, nv) and (nu, nv, 3), how far and where each has moved.
    """
    control, shifts = np.array(control_mm), []
    for before, behind in net.crease_columns:
        pair = directions[[before, behind]]
        joint = _joint(moves_mm[[before, behind]], pair)
        joint[net.apex] = 0.0
        shifts.append(joint - moves_mm[[before, behind]][..., None] * pair)
    moved = np.array(shifts)  # (c, 2, nv, 3), along the face before it and the one behind
    still = np.zeros(control.shape[1:])
    if net.closed_u:  # the last face goes on to the first crease
        borders = [*net.crease_columns, net.crease_columns[0] + len(control)]
        starts, ends = [*moved[:, 1]], [*np.roll(moved, -1, axis=0)[:, 0]]
    else:  # the first and the last face end in a border
        borders = [(-1, 0), *net.crease_columns, (len(control) - 1, len(control))]
        starts, ends = [still, *moved[:, 1]], [*moved[:, 0], still]
    for ((_, first), (last, _)), start, end in zip(pairwise(borders), starts, ends, strict=True):
        _stretch(net, control, np.arange(first, last + 1), start, end)
    if net.closed_u:
        for before, behind in net.crease_columns:  # but for rounding they are one already
            control[behind] = control[before]
    abscissae = greville(net.knots_u, len(control))
    for first, last in net.walls:  # straight from edge to edge
        low, high = control[first - 1], control[last + 1]
        at = abscissae[first : last + 1]
        share = ((at - at[0]) / (at[-1] - at[0]))[:, None, None]
        control[first : last + 1] = (1.0 - share) * low + share * high
    return control


def _joint(moves_mm: FloatArray, directions: FloatArray) -> FloatArray:
    """The move (nv, 3) that is (2, nv) along both directions (2, nv, 3), in their plane."""
    one, other = directions
    cosines = (one * other).sum(axis=1)
    firm = 1.0 + _RIDGE
    shares = np.stack([firm * moves_mm[0] - cosines * moves_mm[1],
                       firm * moves_mm[1] - cosines * moves_mm[0]])  # fmt: skip
    shares /= firm**2 - cosines**2
    return np.asarray((shares[..., None] * directions).sum(axis=0))


def _stretch(
    net: Net, control: FloatArray, columns: IntArray, start_mm: FloatArray, end_mm: FloatArray
) -> None:
    """Shift the columns of a face along it, as its first and last are to go (nv, 3), in place."""
    count = len(control)
    face = net.control_mm[columns % count]  # (k, nv, 3)
    ways = np.gradient(face, axis=0)
    ways /= np.maximum(np.linalg.norm(ways, axis=2, keepdims=True), _NOTHING)
    abscissae = greville(net.knots_u, count)
    at = abscissae[columns % count] + net.spans[0] * (columns // count)
    share = ((at - at[0]) / max(at[-1] - at[0], _NOTHING))[:, None]
    far = (1.0 - share) * (start_mm * ways[0]).sum(axis=1) + share * (end_mm * ways[-1]).sum(axis=1)
    shift = far[..., None] * ways
    shift[0], shift[-1] = start_mm, end_mm
    shift[:, net.apex] = 0.0
    control[columns % count] += shift
