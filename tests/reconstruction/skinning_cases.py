"""Solids as formulas, cut into exact contours; and a plain surface that stands in for a fitted one.

A solid is negative inside: f(x, y, z). Its Euler number is known from what it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import contourpy
import numpy as np

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.caps import triangulate_polygon
from reconstruction.fitting.curve import FittedCurve
from reconstruction.fitting.moments import cells_of_points
from reconstruction.meshing import Mesh
from reconstruction.nurbs import Curve
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.branching import is_ring_ended
from reconstruction.skinning.outlines import Outline, lifted
from reconstruction.skinning.ring_caps import triangulate_ring
from reconstruction.slices import Frame

Solid = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

UP = Frame(np.zeros(3), np.eye(3))


# -- outlines ------------------------------------------------------------------------------------


def outline(
    corners_mm: FloatArray,
    height_mm: float,
    *,
    index: int = 0,
    hole: bool = False,
    axes: FloatArray | None = None,
    sigma_mm: float = 0.0,
) -> Outline:
    """A closed polygon (n, 2) as a section of degree 1, each corner a cell of one point."""
    corners = np.asarray(corners_mm, dtype=np.float64)
    if (signed_area(corners) < 0.0) != hole:
        corners = corners[::-1]
    count = len(corners)
    curve = Curve(1, np.arange(-1.0, count + 2.0) / count, corners, np.ones(count), periodic=True)
    cells, u = cells_of_points(corners, np.zeros(count)), np.arange(count) / count
    fitted = FittedCurve(
        curve=curve,
        kind="free",
        sigma_mm=sigma_mm,
        edf=1.0,
        inflation=1.0,
        residual_rms_mm=sigma_mm,
        residual_max_mm=sigma_mm,
        points_used=count,
        outliers=0,
        deviations_mm=np.zeros(2),
        gaps=(),
        creases=(),
        ambiguous=False,
        cells=cells,
        u=u,
    )
    rows = np.eye(3) if axes is None else axes
    frame = Frame(height_mm * rows[2], rows)
    return Outline(index, frame, fitted, hole, lifted(cells, frame), u)


def signed_area(corners: FloatArray) -> float:
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0


def ring(
    radius_mm: float, centre: tuple[float, float] = (0.0, 0.0), count: int = 120
) -> FloatArray:
    angle = np.arange(count) * (math.tau / count)
    return radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=1) + centre


def cut(
    solid: Solid, heights_mm: FloatArray, *, half_mm: float = 30.0, cells: int = 240
) -> list[list[Outline]]:
    """Contours of a solid at heights, in a square of twice `half_mm`."""
    axis = np.linspace(-half_mm, half_mm, cells) + 0.0137  # no corner on a symmetry
    x, y = np.meshgrid(axis, axis)
    slices = []
    for index, height in enumerate(heights_mm):
        values = solid(x, y, np.full_like(x, height))
        lines = contourpy.contour_generator(x, y, values).lines(0.0)
        slices.append(as_outlines([each[:-1] for each in lines], height, index))
    return slices


def as_outlines(
    polygons: Sequence[FloatArray], height_mm: float, index: int, axes: FloatArray | None = None
) -> list[Outline]:
    """Polygons of one slice; those within an odd number of others are holes."""
    from matplotlib.path import Path

    depths = [
        sum(
            bool(Path(other).contains_point(each[0]))
            for k, other in enumerate(polygons)
            if k != number
        )
        for number, each in enumerate(polygons)
    ]
    return [
        outline(each, height_mm, index=index, hole=depth % 2 == 1, axes=axes)
        for each, depth in zip(polygons, depths, strict=True)
    ]


def cut_mesh(vertices: FloatArray, faces: IntArray, height_mm: float) -> list[FloatArray]:
    """The polygons in which a closed mesh meets the plane z = height, exactly."""
    above = vertices[:, 2] > height_mm
    crossed = faces[above[faces].any(axis=1) & ~above[faces].all(axis=1)]
    following: dict[tuple[int, int], tuple[int, int]] = {}
    for face in crossed.tolist():
        sides = [(face[k], face[(k + 1) % 3]) for k in range(3)]
        (up,) = [each for each in sides if above[each[1]] and not above[each[0]]]
        (down,) = [each for each in sides if above[each[0]] and not above[each[1]]]
        following[(min(down), max(down))] = (min(up), max(up))
    polygons = []
    while following:
        start, edge = following.popitem()
        walk = [start]
        while edge != start:
            walk.append(edge)
            edge = following.pop(edge)
        a, b = vertices[np.array(walk)].transpose(1, 0, 2)
        share = (height_mm - a[:, 2]) / (b[:, 2] - a[:, 2])
        polygons.append(a[:, :2] + share[:, None] * (b - a)[:, :2])
    return [each for each in polygons if len(each) > 2]


# -- solids --------------------------------------------------------------------------------------


def ball(radius: float, centre: Sequence[float] = (0.0, 0.0, 0.0)) -> Solid:
    a, b, c = centre
    return lambda x, y, z: np.sqrt((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) - radius


def rod(start: Sequence[float], end: Sequence[float], radius: float) -> Solid:
    """A segment's neighbourhood: a cylinder with round ends."""
    p, q = np.asarray(start, float), np.asarray(end, float)
    way = q - p

    def inside(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        arms = np.stack([x - p[0], y - p[1], z - p[2]], axis=-1)
        share = np.clip(arms @ way / (way @ way), 0.0, 1.0)
        return np.asarray(np.linalg.norm(arms - share[..., None] * way, axis=-1) - radius)

    return inside


def pillar(radius: float, low: float, high: float, centre: Sequence[float] = (0.0, 0.0)) -> Solid:
    """An upright cylinder with flat ends."""
    a, b = centre
    return lambda x, y, z: np.maximum(
        np.hypot(x - a, y - b) - radius, np.maximum(low - z, z - high)
    )


def torus(
    large: float, small: float, normal: str = "z", centre: Sequence[float] = (0, 0, 0)
) -> Solid:
    axes = {"z": (0, 1, 2), "x": (1, 2, 0), "y": (2, 0, 1)}[normal]

    def inside(*xyz: FloatArray) -> FloatArray:
        a, b, c = (xyz[axis] - centre[axis] for axis in axes)
        return np.asarray(np.hypot(np.hypot(a, b) - large, c) - small)

    return inside


def turned(profile: Callable[[FloatArray, FloatArray], FloatArray]) -> Solid:
    """A body of revolution: profile(radius, height), negative inside."""
    return lambda x, y, z: profile(np.hypot(x, y), z)


def box(low: Sequence[float], high: Sequence[float]) -> Solid:
    def inside(*xyz: FloatArray) -> FloatArray:
        sides = [np.maximum(a - v, v - b) for v, a, b in zip(xyz, low, high, strict=True)]
        return np.asarray(np.maximum.reduce(sides))

    return inside


def union(*solids: Solid) -> Solid:
    return lambda x, y, z: np.minimum.reduce([each(x, y, z) for each in solids])


def without(solid: Solid, *holes: Solid) -> Solid:
    return lambda x, y, z: np.maximum.reduce([solid(x, y, z), *(-each(x, y, z) for each in holes)])


CUP: Solid = without(pillar(15, -20, 20), pillar(12, -15, 30))
MUG: Solid = union(CUP, without(torus(10, 2, "x", (0, 15, 0)), pillar(13, -30, 30)))  # upright


# -- the stand-in --------------------------------------------------------------------------------


def stand_in(branch: Branch, *, count: int = 96) -> Mesh:
    """A branch's contours as rings joined by bands, closed by flat caps.

    CLOSED ends reach half-way to the next slice, JOINED ends their joint.
    """
    rings = _aligned([_ring(each, count) for each in branch.outlines])
    frames = [each.frame for each in branch.outlines]
    heights = [each.height_mm for each in branch.outlines]
    if branch.ends is not None:
        for at, end in ((0, branch.ends[0]), (-1, branch.ends[1])):
            to = _reach(heights[at], end)
            if to is not None:
                place = 0 if at == 0 else len(rings)
                rings.insert(place, rings[at])
                frames.insert(place, frames[at])
                heights.insert(place, to)
    rows = [
        _lifted(each, frame, height)
        for each, frame, height in zip(rings, frames, heights, strict=True)
    ]
    faces = _bands(len(rows), count, around=branch.cyclic)
    last = (len(rows) - 1) * count
    if is_ring_ended(branch):
        cap = triangulate_ring(rings[0], rings[-1])
        faces = np.vstack([faces, np.where(cap < count, cap, cap - count + last)[:, ::-1]])
    elif not branch.cyclic:
        caps = triangulate_polygon(rings[0]), triangulate_polygon(rings[-1])
        faces = np.vstack([faces, caps[0][:, ::-1], caps[1] + last])
    vertices = np.vstack(rows)
    mesh = Mesh(vertices, faces, np.zeros(len(vertices)))
    # A branch that begins downwards has made everything inside out.
    return mesh if _volume(mesh) > 0.0 else Mesh(vertices, faces[:, ::-1], mesh.synthetic)


def _ring(each: Outline, count: int) -> FloatArray:
    """Evenly along the contour, counter-clockwise."""
    fine = each.polygon_mm(2048)
    fine = fine if signed_area(fine) > 0.0 else fine[::-1]
    closed = np.vstack([fine, fine[:1]])
    along = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    wanted = np.arange(count) * (along[-1] / count)
    return np.stack([np.interp(wanted, along, column) for column in closed.T], axis=1)


def _aligned(rings: list[FloatArray]) -> list[FloatArray]:
    """Every ring begun where it lies nearest to the one before, mean places aside."""
    aligned = rings[:1]
    for each in rings[1:]:
        a, b = (ring - ring.mean(axis=0) for ring in (aligned[-1], each))
        spectrum = sum(np.conj(np.fft.rfft(a[:, k])) * np.fft.rfft(b[:, k]) for k in range(2))
        aligned.append(np.roll(each, -int(np.argmax(np.fft.irfft(spectrum, len(a)))), axis=0))
    return aligned


def _reach(height_mm: float, end: End) -> float | None:
    if end.ending is Ending.UNSEEN:
        return None
    return end.height_mm if end.ending is Ending.JOINED else 0.5 * (height_mm + end.height_mm)


def _lifted(ring: FloatArray, frame: Frame, height_mm: float) -> FloatArray:
    """Into the part frame, at exactly the height where the axes are those of the coordinates."""
    planar = ring + frame.axes[:2] @ frame.origin_mm
    return np.column_stack([planar, np.full(len(planar), height_mm)]) @ frame.axes


def _bands(rows: int, count: int, *, around: bool) -> IntArray:
    i = np.arange(count)
    j = np.roll(i, -1)
    faces = []
    for k in range(rows if around else rows - 1):
        a, b = k * count, (k + 1) % rows * count
        faces += [np.stack([a + i, a + j, b + j], 1), np.stack([a + i, b + j, b + i], 1)]
    return np.vstack(faces)


def _volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c))) / 6.0
