"""Colour and light of what is seen: one pass over the visibility buffer for each layer.

A soft box from the upper left (key), a weaker one from the right (fill), a bright sky and a dim
floor, a broad highlight and a little rim: a studio table. The lamps stand with the camera, so a
part is lit well from every side. Sums are made in linear light; a surface that faces the eye keeps
its own colour within a few per cent, so that a colour bar beside it stays true.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from loftscan.rendering.rasterising import IdArray, share_along
from reconstruction.arrays import FloatArray

LightArray = NDArray[np.float32]  # linear light, 1 is white

_KEY = (-0.55, 0.60, 0.58)
_FILL = (0.75, 0.05, 0.66)
_HALF = (-0.3094, 0.3375, 0.8890)  # halfway from the key lamp to the eye
_CREASE_COSINE = 0.85  # 32 degrees from the mean of both sides: an edge of 64 stays sharp
_EDGE_PX = 1.1
_HAZE = 0.4  # how far the farthest points go towards the backdrop


@njit(cache=True)
def vertex_normals(vertices_mm: FloatArray, faces: IdArray) -> FloatArray:
    """Return unit normals (n, 3), the mean over the faces around weighted with their angles."""
    normals = np.zeros((len(vertices_mm), 3))
    for face in range(faces.shape[0]):
        x, y, z = _unit_of(_face_normal(vertices_mm, faces, face))
        for corner in range(3):
            vertex = faces[face, corner]
            angle = _angle(vertices_mm, faces, face, corner)
            normals[vertex, 0] += angle * x
            normals[vertex, 1] += angle * y
            normals[vertex, 2] += angle * z
    for vertex in range(normals.shape[0]):
        x, y, z = _unit(normals[vertex, 0], normals[vertex, 1], normals[vertex, 2])
        normals[vertex, 0], normals[vertex, 1], normals[vertex, 2] = x, y, z
    return normals


@njit(cache=True)
def light_faces(
    ids: IdArray,
    first_id: int,
    screen: FloatArray,  # (n, 3), projected vertices
    turned: FloatArray,  # (n, 3), vertices in the camera's axes
    normals: FloatArray,  # (n, 3), in the camera's axes; (0, 3) for flat shading
    faces: IdArray,  # (m, 3)
    colours: LightArray,  # (k, 3)
    painted: IdArray,  # (m, 3), which of the colours each corner has
    inverse_distance: float,
    edge_strength: float,
    lit: LightArray,  # (h, w, 3), written
) -> None:
    """Light the pixels in which faces `first_id` and following are seen."""
    share = np.empty(3)
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            face = ids[row, column] - first_id
            if face < 0 or face >= faces.shape[0]:
                continue
            edge_px = _shares(screen, faces, face, column + 0.5, row + 0.5, inverse_distance, share)
            x, y, z = _unit_of(_face_normal(turned, faces, face))
            behind = z < 0.0
            if normals.shape[0] > 0:
                x, y, z = _smooth(normals, faces, face, share, x, y, z)
            if z < 0.0:
                x, y, z = -x, -y, -z
            diffuse, gloss = studio_light(x, y, z)
            if behind:  # the inside of an open mesh
                diffuse, gloss = 0.55 * diffuse, 0.2 * gloss
            if edge_strength > 0.0 and edge_px < _EDGE_PX:
                diffuse *= 1.0 - edge_strength
            for channel in range(3):
                own = 0.0
                for corner in range(3):
                    own += share[corner] * colours[painted[face, corner], channel]
                lit[row, column, channel] = own * diffuse + gloss


@njit(cache=True)
def light_beads(
    ids: IdArray,
    first_id: int,
    screen: FloatArray,  # (n, 3)
    radius_mm: float,
    colours: LightArray,  # (1, 3) or (n, 3)
    lit: LightArray,
) -> None:
    """Colour the pixels in which points are seen; the farther, the nearer to the backdrop's."""
    last = colours.shape[0] - 1
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            point = ids[row, column] - first_id
            if point < 0 or point >= screen.shape[0]:
                continue
            depth = 0.5 - 0.5 * screen[point, 2] / radius_mm
            haze = _HAZE * min(1.0, max(0.0, depth)) ** 2
            for channel in range(3):
                own = colours[min(point, last), channel]
                lit[row, column, channel] = own + haze * (0.8 - own)


@njit(cache=True)
def light_segments(
    ids: IdArray,
    first_id: int,
    screen: FloatArray,
    starts: IdArray,  # (m,)
    radius_px: float,
    colours: LightArray,  # (m, 3)
    lit: LightArray,
) -> None:
    """Colour the pixels in which lines are seen, like round wires: darker at the sides."""
    for row in range(ids.shape[0]):
        for column in range(ids.shape[1]):
            segment = ids[row, column] - first_id
            if segment < 0 or segment >= starts.shape[0]:
                continue
            a = starts[segment]
            xa, ya, xb, yb = screen[a, 0], screen[a, 1], screen[a + 1, 0], screen[a + 1, 1]
            share = share_along(column + 0.5, row + 0.5, xa, ya, xb, yb)
            dx = column + 0.5 - xa - share * (xb - xa)
            dy = row + 0.5 - ya - share * (yb - ya)
            tone = 1.0 - 0.25 * (dx * dx + dy * dy) / radius_px**2
            for channel in range(3):
                lit[row, column, channel] = tone * colours[segment, channel]


@njit(cache=True)
def studio_light(x: float, y: float, z: float) -> tuple[float, float]:
    """Diffuse factor and highlight for a unit normal in the camera's axes, z towards the eye."""
    key = max(0.0, (x * _KEY[0] + y * _KEY[1] + z * _KEY[2] + 0.2) / 1.2)
    fill = max(0.0, x * _FILL[0] + y * _FILL[1] + z * _FILL[2])
    sky = 0.5 + 0.5 * y
    diffuse = 0.05 + 0.18 * sky + 1.05 * key * key + 0.12 * fill + 0.28 * z
    half = max(0.0, x * _HALF[0] + y * _HALF[1] + z * _HALF[2])
    half8 = ((half * half) ** 2) ** 2
    rim = (1.0 - z) ** 3
    return diffuse, 0.05 * half8 * half8 * half8 + 0.09 * half8**5 + 0.07 * rim * sky


@njit(cache=True)
def _shares(
    screen: FloatArray,
    faces: IdArray,
    face: int,
    x: float,
    y: float,
    inverse_distance: float,
    share: FloatArray,
) -> float:
    """Write the corners' shares of a pixel, true in perspective; return px to the nearest edge."""
    nearest, total = np.inf, 0.0
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    area = (screen[b, 0] - screen[a, 0]) * (screen[c, 1] - screen[a, 1]) - (
        screen[c, 0] - screen[a, 0]
    ) * (screen[b, 1] - screen[a, 1])
    for corner in range(3):
        p, q = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
        dx, dy = screen[q, 0] - screen[p, 0], screen[q, 1] - screen[p, 1]
        twice = dx * (y - screen[p, 1]) - dy * (x - screen[p, 0])
        nearest = min(nearest, abs(twice) / np.sqrt(dx * dx + dy * dy))
        share[corner] = twice / area * (1.0 + screen[faces[face, corner], 2] * inverse_distance)
        total += share[corner]
    for corner in range(3):
        share[corner] /= total
    return nearest


@njit(cache=True)
def _smooth(
    normals: FloatArray, faces: IdArray, face: int, share: FloatArray, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Mix the corners' normals; a corner on a crease gives the face's own normal (x, y, z)."""
    sx, sy, sz = 0.0, 0.0, 0.0
    for corner in range(3):
        vertex = faces[face, corner]
        nx, ny, nz = normals[vertex, 0], normals[vertex, 1], normals[vertex, 2]
        if nx * x + ny * y + nz * z < _CREASE_COSINE:
            nx, ny, nz = x, y, z
        sx, sy, sz = sx + share[corner] * nx, sy + share[corner] * ny, sz + share[corner] * nz
    return _unit(sx, sy, sz)


@njit(cache=True)
def _face_normal(vertices_mm: FloatArray, faces: IdArray, face: int) -> tuple[float, float, float]:
    """Twice the area times the unit normal."""
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    ux, uy, uz = (
        vertices_mm[b, 0] - vertices_mm[a, 0],
        vertices_mm[b, 1] - vertices_mm[a, 1],
        vertices_mm[b, 2] - vertices_mm[a, 2],
    )
    vx, vy, vz = (
        vertices_mm[c, 0] - vertices_mm[a, 0],
        vertices_mm[c, 1] - vertices_mm[a, 1],
        vertices_mm[c, 2] - vertices_mm[a, 2],
    )
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit(cache=True)
def _angle(vertices_mm: FloatArray, faces: IdArray, face: int, corner: int) -> float:
    """Angle of a face at one of its corners, in rad; 0 where a side has no length."""
    here, after = faces[face, corner], faces[face, (corner + 1) % 3]
    before = faces[face, (corner + 2) % 3]
    along, first, second = 0.0, 0.0, 0.0
    for axis in range(3):
        to_after = vertices_mm[after, axis] - vertices_mm[here, axis]
        to_before = vertices_mm[before, axis] - vertices_mm[here, axis]
        along += to_after * to_before
        first += to_after * to_after
        second += to_before * to_before
    if not first * second > 0.0:
        return 0.0
    angle: float = np.arccos(min(max(along / np.sqrt(first * second), -1.0), 1.0))
    return angle


@njit(cache=True)
def _unit_of(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    return _unit(vector[0], vector[1], vector[2])


@njit(cache=True)
def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    length = np.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 1.0
    return x / length, y / length, z / length
