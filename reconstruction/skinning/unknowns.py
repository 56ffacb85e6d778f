"""Unknowns of a net: in which direction each control point may move, and where it is numbered.

Every control point moves along one direction, the surface's normal beside it, so that the
parametrisation, which the data do not determine, is not asked for. A control point on an end that
must stay in a plane moves inside that plane. An apex moves freely: three unknowns for its row.

Lines of the net follow one another in the system: rows along u, or columns along v, whichever costs
less to eliminate; folded (0, -1, 1, -2 ..) in a direction that closes, so that what is coupled lies
near together::

    rows      three apart at most, six where v closes;  a block is as wide as the net around
    columns   six apart, as u closes;                   a block is as wide as the net along
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, IntArray, frozen
from reconstruction.skinning.edges import joined
from reconstruction.skinning.net import Net, derivatives_at, greville, unit_normals

APEX = 3  # unknowns of an apex: it moves freely
_REACH = 3  # rows apart that two coupled unknowns may be
_FOLDED_REACH = 6
_BEFORE = 1e-6  # a crease, where the face before it is meant


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Directions in which the control points may move, and where they stand in the system."""

    directions: FloatArray  # (nu, nv, 3), unit; zero in the row of an apex
    numbers: IntArray  # (nu, nv); an apex has the first three of its row
    width: int  # unknowns a line
    reach: int  # lines apart that coupled ones may be

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", frozen(self.directions))
        object.__setattr__(self, "numbers", frozen(self.numbers, np.int64))

    @property
    def lines(self) -> int:
        """How many lines there are."""
        return int(self.numbers.size // self.width)

    @property
    def count(self) -> int:
        """Places in the system, those that an apex leaves unused too."""
        return int(self.numbers.size)


def unknowns_of(net: Net, level: tuple[FloatArray | None, FloatArray | None]) -> Unknowns:
    """Directions from the surface's normals at the control points' Greville abscissae.

    Parameters
    ----------
    level
        For the first and the last row: the normal (3,) of the plane it stays in, or None.
    """
    count_u, count_v = net.control_mm.shape[:2]
    u, v = grevilles(net)
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
    for first, last in net.walls:  # they go where their edges do: nothing else holds them
        directions[first : last + 1] = 0.0
    return Unknowns(directions, *_numbered(net))


def _numbered(net: Net) -> tuple[IntArray, int, int]:
    """Numbers of the control points, the width of a line, and how far lines reach."""
    count_u, count_v = net.control_mm.shape[:2]
    place_u, reach_u = _placed(count_u, closed=net.closed_u)
    place_v, reach_v = _placed(count_v, closed=net.closed_v)
    # An apex is a neighbour of its whole row: there lines have to be rows.
    if not net.apex.any() and _cost(count_u, count_v, reach_u) < _cost(count_v, count_u, reach_v):
        return place_u[:, None] * count_v + np.arange(count_v), count_v, reach_u
    return place_v * count_u + np.arange(count_u)[:, None], count_u, reach_v


def _placed(count: int, *, closed: bool) -> tuple[IntArray, int]:
    """The place of each line in the system's order, and how far apart coupled ones may be."""
    order = np.arange(count)
    if not closed:
        return order, _REACH
    # 0, 1, 2 .. and -1, -2 .. in turn: what meets across the seam lies together.
    folded = np.where(order < (count + 1) // 2, 2 * order, 2 * (count - 1 - order) + 1)
    return folded, _FOLDED_REACH


def _cost(lines: int, width: int, reach: int) -> int:
    """Of a factorisation, about."""
    return lines * width**3 * (reach + 1) ** 2


def grevilles(net: Net) -> tuple[FloatArray, FloatArray]:
    """Greville abscissae inside the domain, of both directions."""
    count_u, count_v = net.control_mm.shape[:2]
    u, v = greville(net.knots_u, count_u), greville(net.knots_v, count_v)
    end_u, end_v = net.spans
    u[net.crease_columns[:, 0]] -= _BEFORE
    u = np.mod(u, end_u) if net.closed_u else u
    v = np.mod(v, end_v) if net.closed_v else v
    # Beside an apex the normal is looked for a little inside.
    margin = 0.05
    low = margin if net.apex[0] else 0.0
    high = end_v - (margin if net.apex[-1] else 0.0)
    return u, (v if net.closed_v else np.clip(v, low, high))


def applied(net: Net, unknowns: Unknowns, moves: FloatArray) -> FloatArray:
    """Control points (nu, nv, 3) after moves of the unknowns, flat."""
    control = net.control_mm + moves[unknowns.numbers][:, :, None] * unknowns.directions
    for j in np.flatnonzero(net.apex):
        control[:, j] = net.control_mm[:, j] + moves[unknowns.numbers[:APEX, j]]
    if len(net.creases):
        return joined(net, control, moves[unknowns.numbers], unknowns.directions)
    return np.asarray(control)


def free_unknowns(net: Net) -> int:
    """How many unknowns a net has."""
    count_u, count_v = net.control_mm.shape[:2]
    apexes = int(net.apex.sum())
    return int(count_u * (count_v - apexes) + APEX * apexes)
