"""Unknowns of a net: in which direction each control point may move, and where it is numbered.

Every control point moves along one direction, the surface's normal beside it, so that the
parametrisation, which the data do not determine, is not asked for. A control point on an end that
must stay in a plane moves inside that plane. An apex moves freely: three unknowns for its row.

Unknown i of row j is number ``place[j] * width + i``: rows are laid one after the other, folded
where the net closes in v, so that what is coupled lies near together.
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
    place: IntArray  # (nv,), of each net row in the system's order
    reach: int  # places apart that coupled rows may be

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", frozen(self.directions))
        object.__setattr__(self, "place", frozen(self.place, np.int64))

    @property
    def width(self) -> int:
        """Unknowns a net row."""
        return int(self.directions.shape[0])

    @property
    def count(self) -> int:
        """Places in the system, those that an apex leaves unused too."""
        return self.width * len(self.place)


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
    if not net.closed_v:
        return Unknowns(directions, np.arange(count_v), _REACH)
    # 0, 1, 2 .. and -1, -2 .. in turn: what meets across the seam lies together.
    order = np.arange(count_v)
    place = np.where(order < (count_v + 1) // 2, 2 * order, 2 * (count_v - 1 - order) + 1)
    return Unknowns(directions, place, _FOLDED_REACH)


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
    width, count_v = unknowns.width, len(unknowns.place)
    numbers = unknowns.place[None, :] * width + np.arange(width)[:, None]
    control = net.control_mm + moves[numbers][:, :, None] * unknowns.directions
    for j in range(count_v):
        if net.apex[j]:
            start = unknowns.place[j] * width
            control[:, j] = net.control_mm[:, j] + moves[start : start + APEX]
    if len(net.creases):
        return joined(net, control, moves[numbers], unknowns.directions)
    return np.asarray(control)


def free_unknowns(net: Net) -> int:
    """How many unknowns a net has."""
    count_u, count_v = net.control_mm.shape[:2]
    apexes = int(net.apex.sum())
    return int(count_u * (count_v - apexes) + APEX * apexes)
