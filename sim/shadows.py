"""What the camera cannot see of the line that the beams draw on the part.

The camera stands straight over the emitter, so that the ray from it to a lit point stays in the
upright plane of the beam. Seen from the camera, with w ahead, x across and G down from it::

    camera  C ---------------> w          u = x/w    as the beam's slope
            |'-.                          q = G/w    how steeply it looks down
          G |    '-. q                    a lit point at depth z has  q = rise / z
            v        '-.
    emitter E===========*==  beam         the sheet of light lies at G = rise

A face hides a lit point when its picture in (u, q) covers the point's and it is nearer. Both are
asked in float64, and only of the few faces whose picture comes near any lit point: a tree of boxes
is descended once a profile, not once a ray. For a camera under the sheet, which looks up,
everything stands mirrored.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from sim.arrays import FloatArray, ReasonArray
from sim.sensor import Reason

_LIT, _OCCLUDED = int(Reason.MEASURED), int(Reason.OCCLUDED)
_BEAMS_A_RUN = 8  # neighbours whose lowest and highest q are kept
_HIDDEN = -1.0  # stands for the q of a point that is known to be hidden; nan for: not asked
_ROUNDING = 1e-6  # of the spacing between beams
_DEEPEST = 64  # levels of the tree, more than any mesh has faces for

Frame = tuple[float, float, float, float, float, float]  # w of (X, Y, 1), then x of (X, Y, 1)
Point = tuple[float, float, float]  # w, x, G


@njit(cache=True, nogil=True, error_model="numpy")
def hide(
    tree: tuple[FloatArray, FloatArray],
    frames: FloatArray,
    slopes: FloatArray,
    camera: tuple[float, float],
    start_mm: FloatArray,
    reasons: ReasonArray,
) -> None:
    """Turn what is lit but hidden from the camera from measured into occluded, in place.

    Parameters
    ----------
    tree : boxes (2 L - 1, 6) and corners (L, m, 3, 3) of a `Hierarchy`
    frames : (k, 2, 3), of each profile: (w, x) = frame @ (X, Y, 1)
    slopes : (n,) increasing evenly
    camera : height of the sheet over z = 0, and of the camera over the sheet, in mm
    start_mm : (k, n), depth along the beam at which the ray to the camera starts
    reasons : (k, n)
    """
    count = slopes.shape[0]
    steep = np.empty(count)
    runs = np.empty((-(-count // _BEAMS_A_RUN), 2))
    for profile in range(frames.shape[0]):
        for beam in range(count):
            asked = reasons[profile, beam] == _LIT and start_mm[profile, beam] > 0.0
            steep[beam] = abs(camera[1]) / start_mm[profile, beam] if asked else np.nan
        _sum_up(steep, runs)
        w = frames[profile, 0, 0], frames[profile, 0, 1], frames[profile, 0, 2]
        x = frames[profile, 1, 0], frames[profile, 1, 1], frames[profile, 1, 2]
        _descend(tree, (*w, *x), slopes, camera, steep, runs)
        for beam in range(count):
            if steep[beam] == _HIDDEN:
                reasons[profile, beam] = _OCCLUDED


@njit(cache=True, nogil=True)
def _sum_up(steep: FloatArray, runs: FloatArray) -> None:
    """Lowest and highest q of each run of beams, of those that are asked."""
    for beam in range(steep.shape[0]):
        run = beam // _BEAMS_A_RUN
        if beam % _BEAMS_A_RUN == 0:
            runs[run, 0], runs[run, 1] = np.inf, -np.inf
        if not math.isnan(steep[beam]):
            runs[run, 0] = min(runs[run, 0], steep[beam])
            runs[run, 1] = max(runs[run, 1], steep[beam])


@njit(cache=True, nogil=True, error_model="numpy")
def _descend(
    tree: tuple[FloatArray, FloatArray],
    frame: Frame,
    slopes: FloatArray,
    camera: tuple[float, float],
    steep: FloatArray,
    runs: FloatArray,
) -> None:
    """Ask every face whose boxes come near a lit point."""
    boxes, corners = tree
    inner = boxes.shape[0] // 2
    stack = np.empty(_DEEPEST, np.int64)
    stack[0], depth = 0, 1
    while depth:
        depth -= 1
        node = stack[depth]
        if not _matters(boxes, node, frame, slopes, camera, runs):
            continue
        if node < inner:
            stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
            depth += 2
            continue
        for face in range(corners.shape[1]):
            a = _seen(corners, node - inner, face, 0, frame, camera)
            b = _seen(corners, node - inner, face, 1, frame, camera)
            c = _seen(corners, node - inner, face, 2, frame, camera)
            _cover(a, b, c, slopes, abs(camera[1]), steep)


@njit(cache=True, nogil=True, error_model="numpy")
def _matters(
    boxes: FloatArray,
    node: int,
    frame: Frame,
    slopes: FloatArray,
    camera: tuple[float, float],
    runs: FloatArray,
) -> bool:
    """Whether a box's picture meets that of a run of lit points."""
    height_mm, rise_mm = camera
    top, bottom = boxes[node, 5] - height_mm, boxes[node, 4] - height_mm
    if rise_mm < 0.0:
        top, bottom, rise_mm = -bottom, -top, -rise_mm
    if top <= 0.0:
        return False
    x, y, half_x, half_y = boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3]
    ahead = frame[0] * x + frame[1] * y + frame[2]
    half_ahead = abs(frame[0]) * half_x + abs(frame[1]) * half_y
    if ahead - half_ahead <= 0.0:
        return True
    near, far = 1.0 / (ahead - half_ahead), 1.0 / (ahead + half_ahead)
    low, high = rise_mm - top, rise_mm - max(bottom, 0.0)
    low *= far if low > 0.0 else near
    high *= near if high > 0.0 else far
    across = frame[3] * x + frame[4] * y + frame[5]
    half_across = abs(frame[3]) * half_x + abs(frame[4]) * half_y
    left, right = across - half_across, across + half_across
    left *= far if left > 0.0 else near
    right *= near if right > 0.0 else far
    first, last = _between(left, right, slopes)
    if first <= last:
        for run in range(first // _BEAMS_A_RUN, last // _BEAMS_A_RUN + 1):
            if runs[run, 0] <= high and runs[run, 1] >= low:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def _between(low: float, high: float, slopes: FloatArray) -> tuple[int, int]:
    """First and last beam between two slopes; one that lies on either is surely included."""
    count = slopes.shape[0]
    beams_a_slope = (count - 1) / (slopes[count - 1] - slopes[0])
    first = np.ceil((low - slopes[0]) * beams_a_slope - _ROUNDING)
    last = np.floor((high - slopes[0]) * beams_a_slope + _ROUNDING)
    return int(min(max(first, 0.0), float(count))), int(min(max(last, -1.0), count - 1.0))


@njit(cache=True, nogil=True)
def _seen(
    corners: FloatArray,
    leaf: int,
    face: int,
    corner: int,
    frame: Frame,
    camera: tuple[float, float],
) -> Point:
    x, y = corners[leaf, face, corner, 0], corners[leaf, face, corner, 1]
    over_mm = corners[leaf, face, corner, 2] - camera[0]
    ahead = frame[0] * x + frame[1] * y + frame[2]
    across = frame[3] * x + frame[4] * y + frame[5]
    return ahead, across, camera[1] - over_mm if camera[1] > 0.0 else over_mm - camera[1]


@njit(cache=True, nogil=True, error_model="numpy")
def _cover(
    a: Point, b: Point, c: Point, slopes: FloatArray, rise_mm: float, steep: FloatArray
) -> None:
    """Mark what one face hides of the beams that its picture spans.

    The ray from the camera is d = (1, u, q). It passes the face where it is on the same side of
    the planes through the camera and each edge, and it comes there before the start, w = rise / q,
    when ``volume / n.d < rise / q``. Neighbours share an edge's plane to the last bit.
    """
    if min(a[2], b[2], c[2]) >= rise_mm:
        return
    first, last = 0, slopes.shape[0] - 1
    if min(a[0], b[0], c[0]) > 0.0:
        ua, ub, uc = a[1] / a[0], b[1] / b[0], c[1] / c[0]
        first, last = _between(min(ua, ub, uc), max(ua, ub, uc), slopes)
    n = _cross(_less(b, a), _less(c, a), 1.0)
    volume = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
    if first > last or volume == 0.0:  # beside every beam, or edge-on
        return
    side = 1.0 if volume > 0.0 else -1.0
    n0, n1 = side * n[0] * rise_mm, side * n[1] * rise_mm
    n2 = side * (n[2] * rise_mm - volume)
    ab0, ab1, ab2 = _cross(a, b, side)
    bc0, bc1, bc2 = _cross(b, c, side)
    ca0, ca1, ca2 = _cross(c, a, side)
    for beam in range(first, last + 1):
        u, q = slopes[beam], steep[beam]
        if (
            n0 + n1 * u + n2 * q > 0.0
            and ab0 + ab1 * u + ab2 * q >= 0.0
            and bc0 + bc1 * u + bc2 * q >= 0.0
            and ca0 + ca1 * u + ca2 * q >= 0.0
        ):
            steep[beam] = _HIDDEN


@njit(cache=True, nogil=True)
def _less(a: Point, b: Point) -> Point:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(cache=True, nogil=True)
def _cross(a: Point, b: Point, side: float) -> Point:
    return (
        side * (a[1] * b[2] - a[2] * b[1]),
        side * (a[2] * b[0] - a[0] * b[2]),
        side * (a[0] * b[1] - a[1] * b[0]),
    )
