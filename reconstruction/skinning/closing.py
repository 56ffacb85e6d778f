"""The mesh of one branch: rings of its surface joined by bands, ends closed by flat caps.

::

    cap        flat, in the plane of a brim; or none at an apex, where a ring is one point
    rings      u lines of the surface, at parameters dense enough for the chordal tolerance
    cap        a branch that turned over is closed by a band from its last ring to its first

An open surface has lines instead of rings, and no caps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.caps import triangulate_polygon
from reconstruction.meshing import Mesh
from reconstruction.nurbs import evaluate_surface
from reconstruction.nurbs.flatness import flatness
from reconstruction.nurbs.grid_lines import place_lines
from reconstruction.skinning.branching import is_ring_ended
from reconstruction.skinning.ends import Apex
from reconstruction.skinning.exact_skins import AnySkin, ExactSkin
from reconstruction.skinning.net import Net
from reconstruction.skinning.ring_caps import triangulate_ring
from reconstruction.skinning.skin import Skin

_MOST_A_SPAN = 16
_MOST_FACES = 250_000  # of a branch
_A_SLICE = 2  # rings of an exact surface, to show which slices are missing
_SAMPLED = 4  # of a span, to look how far chords lie off


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Parameters of the rings and columns of a mesh."""

    u: FloatArray
    v: FloatArray


def choose_lines(net: Net, tolerance_mm: float) -> Lines:
    """As many lines in every span as keep chords within the tolerance of the surface."""
    end_u, end_v = net.spans
    fine_u = np.linspace(0.0, end_u, _SAMPLED * int(end_u) + 1)
    fine_v = np.linspace(0.0, end_v, _SAMPLED * int(end_v) + 1)
    places = evaluate_surface(net.surface(), fine_u, fine_v)
    # Half of the tolerance in either direction: their errors add up.
    u = _spread(_bows(places), 0.5 * tolerance_mm)
    v = _spread(_bows(places.swapaxes(0, 1)), 0.5 * tolerance_mm)
    return Lines(u[:-1] if net.closed_u else u, v[:-1] if net.closed_v else v)


def exact_lines(skin: ExactSkin, tolerance_mm: float) -> Lines:
    """As few lines as the tolerance allows, and what shows where nothing was measured."""
    surface, boxes = skin.surface, list(skin.support.shape)
    if len(skin.unseen):
        boxes[1] = max(boxes[1], _A_SLICE * len(skin.branch.outlines))
    also = (
        np.linspace(*domain, count + 1) for domain, count in zip(surface.domain, boxes, strict=True)
    )
    also_u, also_v = also
    u, v = place_lines(flatness(surface), tolerance_mm=tolerance_mm, also_u=also_u, also_v=also_v)
    return Lines(u[:-1] if surface.periodic_u else u, v[:-1] if surface.periodic_v else v)


def affordable_mm(skin: AnySkin, tolerance_mm: float) -> float:
    """The tolerance, or a wider one where a free surface would get too many faces by it."""
    if isinstance(skin, ExactSkin):
        return tolerance_mm
    lines = choose_lines(skin.fit.net, tolerance_mm)
    faces = 2 * len(lines.u) * len(lines.v)  # about inversely as the tolerance
    return tolerance_mm * max(faces / _MOST_FACES, 1.0)


def _bows(places: FloatArray) -> FloatArray:
    """How far the surface bows over the chord of each span of the first direction, (spans,)."""
    spans = (len(places) - 1) // _SAMPLED
    starts, ends = places[:-1:_SAMPLED], places[_SAMPLED::_SAMPLED]
    bow = np.zeros(spans)
    for k in range(1, _SAMPLED):
        share = k / _SAMPLED
        chord = (1.0 - share) * starts + share * ends
        off = np.linalg.norm(places[k:-1:_SAMPLED] - chord, axis=2)
        bow = np.maximum(bow, off.max(axis=1))
    return bow


def _spread(bows: FloatArray, tolerance_mm: float) -> FloatArray:
    """Parameters that cut each span evenly; the bow of a piece falls with its square."""
    pieces = np.ceil(np.sqrt(bows / max(tolerance_mm, 1e-300)))
    pieces = np.clip(pieces, 1, _MOST_A_SPAN).astype(np.int64)
    parts = [span + np.arange(count) / count for span, count in enumerate(pieces)]
    return np.append(np.concatenate(parts), float(len(bows)))


def closed_mesh(skin: AnySkin, tolerance_mm: float) -> Mesh:
    """Mesh a branch, closed, faces outwards; of a cavity they look into the material."""
    surface = skin.surface
    if isinstance(skin, ExactSkin):
        lines = exact_lines(skin, tolerance_mm)
    else:
        lines = choose_lines(skin.fit.net, tolerance_mm)
    rings = evaluate_surface(surface, lines.u, lines.v).swapaxes(0, 1)
    marks = skin.synthetic(*np.meshgrid(lines.u, lines.v, indexing="ij")).T
    pointed = [isinstance(brim, Apex) for brim in skin.brims or ()]
    numbers, vertices, synthetic = _numbered(rings, marks, pointed or [False, False])
    faces = [_band(numbers[k], numbers[k + 1]) for k in range(len(numbers) - 1)]
    if surface.periodic_v:
        faces.append(_band(numbers[-1], numbers[0]))
    elif is_ring_ended(skin.branch):
        faces.append(_ring(rings, numbers, skin.branch.axes[:2]))
    else:
        assert skin.brims is not None, "an open surface has brims"
        axes = skin.branch.axes[:2]
        low, high = skin.brims
        if not isinstance(low, Apex):
            faces.append(numbers[0][triangulate_polygon(rings[0] @ axes.T)][:, ::-1])
        if not isinstance(high, Apex):
            faces.append(numbers[-1][triangulate_polygon(rings[-1] @ axes.T)])
    found = np.concatenate(faces)
    found = found[_whole(found)]
    mesh = Mesh(vertices, found, synthetic)
    return mesh if _volume(mesh) > 0.0 else Mesh(vertices, found[:, ::-1], synthetic)


def open_mesh(skin: Skin, tolerance_mm: float) -> Mesh:
    """Mesh an open surface; most of its faces look up along the part axis that it faces most."""
    net = skin.fit.net
    lines = choose_lines(net, tolerance_mm)
    rows = evaluate_surface(skin.surface, lines.u, lines.v).swapaxes(0, 1)
    marks = skin.synthetic(*np.meshgrid(lines.u, lines.v, indexing="ij")).T
    pointed = [isinstance(brim, Apex) for brim in skin.brims or ()]
    numbers, vertices, synthetic = _numbered(rows, marks, pointed or [False, False])
    bands = [_band(low, high) for low, high in pairwise(numbers)]
    if not net.closed_u:  # the last triangles of either kind lead back to the first column
        count = len(numbers[0])
        bands = [np.delete(band, [count - 1, 2 * count - 1], axis=0) for band in bands]
    found = np.concatenate(bands)
    found = found[_whole(found)]
    mesh = Mesh(vertices, found, synthetic)
    a, b, c = (vertices[found[:, k]] for k in range(3))
    facing = np.cross(b - a, c - a).sum(axis=0)
    upward = facing[np.argmax(np.abs(facing))] > 0.0
    return mesh if upward else Mesh(vertices, found[:, ::-1], synthetic)


def _whole(faces: IntArray) -> BoolArray:
    """Which triangles (m, 3) have three corners."""
    a, b, c = faces.T
    return np.asarray((a != b) & (b != c) & (c != a))


def _numbered(
    rings: FloatArray, marks: BoolArray, pointed: Sequence[bool]
) -> tuple[list[IntArray], FloatArray, BoolArray]:
    """Vertex numbers of every ring; a ring that is one point is one vertex."""
    numbers, vertices, synthetic = [], [], []
    count = 0
    for k, ring in enumerate(rings):
        if (k == 0 and pointed[0]) or (k == len(rings) - 1 and pointed[-1]):
            numbers.append(np.full(len(ring), count))
            vertices.append(ring[:1])
            synthetic.append(marks[k][:1])
            count += 1
        else:
            numbers.append(count + np.arange(len(ring)))
            vertices.append(ring)
            synthetic.append(marks[k])
            count += len(ring)
    return numbers, np.concatenate(vertices), np.concatenate(synthetic)


def _ring(rings: FloatArray, numbers: list[IntArray], axes: FloatArray) -> IntArray:
    """The level ring between the first and the last row of a surface that turned over."""
    flat = [rings[k] @ axes.T for k in (0, -1)]
    ends = [numbers[0], numbers[-1]]
    if _area(flat[0]) < _area(flat[1]):
        flat, ends = flat[::-1], ends[::-1]
    found = np.concatenate(ends)[triangulate_ring(flat[0], flat[1])]
    # The band leaves the last row's edges backwards, so the ring takes them forwards.
    edges = np.concatenate([found[:, [0, 1]], found[:, [1, 2]], found[:, [2, 0]]])
    forwards = (edges == numbers[-1][:2]).all(axis=1).any()
    return np.asarray(found if forwards else found[:, ::-1])


def _area(flat: FloatArray) -> float:
    x, y = flat.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _band(lower: IntArray, upper: IntArray) -> IntArray:
    """Triangles between two rings of equal count, counter-clockwise seen from outside."""
    lower_next, upper_next = np.roll(lower, -1), np.roll(upper, -1)
    first = np.stack([lower, lower_next, upper_next], axis=1)
    second = np.stack([lower, upper_next, upper], axis=1)
    return np.concatenate([first, second])


def _volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    return math.fsum((a * np.cross(b, c)).sum(axis=1).tolist()) / 6.0
