"""Rows of points into a closed triangle mesh.

Every row is a closed ring, numbered from the reference line. Rows of equal count are joined by
quadrilaterals cut along their shorter diagonal; others by pairs (`correspondence`); the first and
the last row are closed by flat caps. Each edge then has exactly two faces, by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.caps import triangulate_polygon
from reconstruction.correspondence import connect_pairs


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in the part frame.

    Faces are counter-clockwise seen from outside. `synthetic` marks the vertices that stand on no
    measured point: gaps that were bridged.
    """

    vertices_mm: FloatArray  # (n, 3)
    faces: IntArray  # (m, 3), indices into vertices_mm
    synthetic: BoolArray  # (n,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_mm", frozen(self.vertices_mm))
        object.__setattr__(self, "faces", frozen(self.faces, np.int64))
        object.__setattr__(self, "synthetic", frozen(self.synthetic, np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """A closed ring of points, counter-clockwise seen against the stacking axis."""

    points_mm: FloatArray  # (n, 3)
    synthetic: BoolArray  # (n,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points_mm", frozen(self.points_mm))
        object.__setattr__(self, "synthetic", frozen(self.synthetic, np.bool_))


def mesh_rows(rows: Sequence[Row], plane_axes: FloatArray) -> Mesh:
    """Join consecutive rows by bands and close both ends.

    Parameters
    ----------
    rows : at least two, from the lowest up
    plane_axes : (2, 3)
        The x and y axes of the cutting planes, in which the caps are triangulated.

    Returns
    -------
    Mesh
        Closed and oriented outwards; its vertices are the rows' points in order.
    """
    starts = np.concatenate([[0], np.cumsum([len(row.points_mm) for row in rows])])
    faces = [_cap(rows[0], plane_axes)[:, ::-1]]
    for k, (lower, upper) in enumerate(pairwise(rows)):
        faces.append(_band(lower.points_mm, upper.points_mm, int(starts[k]), int(starts[k + 1])))
    faces.append(_cap(rows[-1], plane_axes) + starts[-2])
    return Mesh(
        np.concatenate([row.points_mm for row in rows]),
        np.concatenate(faces),
        np.concatenate([row.synthetic for row in rows]),
    )


def _cap(row: Row, plane_axes: FloatArray) -> IntArray:
    return triangulate_polygon(row.points_mm @ plane_axes.T)


def _band(lower: FloatArray, upper: FloatArray, start: int, upper_start: int) -> IntArray:
    """Triangles between two rings whose vertices begin at the two given numbers."""
    if len(lower) >= len(upper):
        groups = connect_pairs(lower, len(upper))
        triangles = _band_onto(lower, upper, groups)
        return triangles + np.where(triangles < len(lower), start, upper_start - len(lower))
    groups = connect_pairs(upper, len(lower))
    # Seen from the bigger ring, which is the upper one now, every triangle is turned over.
    triangles = _band_onto(upper, lower, groups)[:, ::-1]
    return triangles + np.where(triangles < len(upper), upper_start, start - len(upper))


def _band_onto(bigger: FloatArray, smaller: FloatArray, groups: IntArray) -> IntArray:
    r"""Connect a ring onto one of fewer points.

    Vertices of the bigger are 0..n-1, of the smaller n..n+m-1. Group g begins at bigger point
    ``groups[g]``::

        smaller     s ----------- s'
                    | \          |
        bigger      b --- e ----- b'      b..e are one group: one point (b = e) or a pair
    """
    count = len(bigger)
    s = np.arange(len(smaller)) + count
    s_next = np.roll(s, -1)
    begin, begin_next = groups, np.roll(groups, -1)
    end = (begin_next - 1) % count
    paired = begin != end
    short = _square(bigger[end], smaller[s_next - count]) < _square(
        bigger[begin_next], smaller[s - count]
    )
    within = np.stack([begin, end, s], axis=1)[paired]
    first = np.where(short[:, None], _stack(end, s_next, s), _stack(end, begin_next, s))
    second = np.where(
        short[:, None], _stack(end, begin_next, s_next), _stack(begin_next, s_next, s)
    )
    return np.concatenate([within, first, second])


def _square(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(((a - b) ** 2).sum(axis=1))


def _stack(a: IntArray, b: IntArray, c: IntArray) -> IntArray:
    return np.stack([a, b, c], axis=1)
