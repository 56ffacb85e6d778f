"""Which triangle, bead or line is seen in each pixel: the kernels that fill the z-buffer.

A *visibility buffer*: a pixel keeps only the number of what is seen and its nearness (see
`camera`); colours and light come later and once a pixel (Burns and Hunt 2013, The Visibility
Buffer, JCGT 2(2)). The pixel in row i, column j is sampled at its centre (j + 0.5, i + 0.5);
borders belong to both sides, and of two equally near things the one drawn first stays.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from reconstruction.arrays import FloatArray

DepthArray = NDArray[np.float32]
IdArray = NDArray[np.int32]

NOTHING = -1


@njit(cache=True)
def draw_triangles(
    screen: FloatArray, faces: IdArray, first_id: int, nearness: DepthArray, ids: IdArray
) -> None:
    """Draw faces (m, 3) of projected vertices (n, 3) into two buffers (h, w), in place."""
    height, width = ids.shape
    for face in range(faces.shape[0]):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        xa, ya, xb, yb, xc, yc = (
            screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1], screen[c, 0], screen[c, 1],
        )  # fmt: skip
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if not area * area > 0.0:  # no area, or a corner behind the eye
            continue
        left, right = _pixels(min(xa, xb, xc), max(xa, xb, xc), width)
        top, bottom = _pixels(min(ya, yb, yc), max(ya, yb, yc), height)
        slope_b, slope_c = (yc - ya) / area, (ya - yb) / area
        for row in range(top, bottom):
            y = row + 0.5 - ya
            for column in range(left, right):
                x = column + 0.5 - xa
                share_b = x * slope_b - y * (xc - xa) / area
                share_c = x * slope_c + y * (xb - xa) / area
                share_a = 1.0 - share_b - share_c
                if share_a < 0.0 or share_b < 0.0 or share_c < 0.0:
                    continue
                near = share_a * screen[a, 2] + share_b * screen[b, 2] + share_c * screen[c, 2]
                if near > nearness[row, column]:
                    nearness[row, column] = near
                    ids[row, column] = first_id + face


@njit(cache=True)
def draw_beads(
    screen: FloatArray,
    radius_px: float,
    height_mm: float,
    first_id: int,
    nearness: DepthArray,
    ids: IdArray,
) -> None:
    """Draw projected points (n, 3) as paraboloids that rise `height_mm` over their rim.

    A point covers at least the pixel that it is in.
    """
    height, width = ids.shape
    fall = 1.0 / (radius_px * radius_px)
    for point in range(screen.shape[0]):
        x, y, tip = screen[point, 0], screen[point, 1], screen[point, 2]
        if not (-radius_px < x < width + radius_px and -radius_px < y < height + radius_px):
            continue
        left, right = _pixels(x - radius_px, x + radius_px, width)
        top, bottom = _pixels(y - radius_px, y + radius_px, height)
        for row in range(top, bottom):
            aside = (row + 0.5 - y) ** 2 * fall
            for column in range(left, right):
                away = (column + 0.5 - x) ** 2 * fall + aside
                near = tip - height_mm * away
                if near > nearness[row, column] and away <= 1.0:
                    nearness[row, column] = near
                    ids[row, column] = first_id + point
        row, column = math.floor(y), math.floor(x)
        if 0 <= row < height and 0 <= column < width and tip > nearness[row, column]:
            nearness[row, column] = tip
            ids[row, column] = first_id + point


@njit(cache=True)
def draw_segments(
    screen: FloatArray,
    starts: IdArray,
    radius_px: float,
    first_id: int,
    nearness: DepthArray,
    ids: IdArray,
) -> None:
    """Draw thick lines with round ends from projected points `starts` (m,) to the next ones."""
    height, width = ids.shape
    for segment in range(starts.shape[0]):
        a = starts[segment]
        xa, ya, xb, yb = screen[a, 0], screen[a, 1], screen[a + 1, 0], screen[a + 1, 1]
        if not (xa - xa == 0.0 and xb - xb == 0.0):  # an end behind the eye
            continue
        left, right = _pixels(min(xa, xb) - radius_px, max(xa, xb) + radius_px, width)
        top, bottom = _pixels(min(ya, yb) - radius_px, max(ya, yb) + radius_px, height)
        for row in range(top, bottom):
            for column in range(left, right):
                x, y = column + 0.5, row + 0.5
                share = share_along(x, y, xa, ya, xb, yb)
                dx, dy = x - xa - share * (xb - xa), y - ya - share * (yb - ya)
                near = (1.0 - share) * screen[a, 2] + share * screen[a + 1, 2]
                if dx * dx + dy * dy <= radius_px**2 and near > nearness[row, column]:
                    nearness[row, column] = near
                    ids[row, column] = first_id + segment


@njit(cache=True)
def share_along(x: float, y: float, xa: float, ya: float, xb: float, yb: float) -> float:
    """Where on the segment a-b the point nearest to (x, y) lies, in [0, 1]."""
    square = (xb - xa) ** 2 + (yb - ya) ** 2
    if square == 0.0:
        return 0.0
    share = ((x - xa) * (xb - xa) + (y - ya) * (yb - ya)) / square
    return min(max(share, 0.0), 1.0)


@njit(cache=True)
def _pixels(low: float, high: float, size: int) -> tuple[int, int]:
    """Pixels whose centres are in [low, high], as a half-open range within [0, size)."""
    first = math.ceil(max(low - 0.5, 0.0))
    last = math.floor(min(high - 0.5, size - 1.0))
    return first, last + 1
