"""Which segment of a section each beam of a fan meets first: a z-buffer on a line.

Seen from the emitter, in the turned frame of one profile, w ahead and x across::

                x                          a beam       x = u w
    emitter     |        .--- segment      a segment    1/w is affine in u = x/w
       o--------+---- w  |
         `-- u = x/w     '---              so the nearest of many has the largest 1/w

Each segment visits the beams between its two ends, borders included. Two that meet in an end give
it the same u to the last bit, so that every beam meets at least one of them. Loops stand flat and
views out of them: numba counts references to every view it makes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from sim.arrays import FloatArray, SegmentArray

NOTHING = -1
_AHEAD_MM = 1e-6  # what is not this far before the emitter is behind it
_NEAREST = 1.0 / _AHEAD_MM


def first_met(ends_mm: FloatArray, frames: FloatArray, slopes: FloatArray) -> SegmentArray:
    """Which segment each beam meets first, (k, n), `NOTHING` for none.

    Parameters
    ----------
    ends_mm : (s, 2, 2) in the part's frame
    frames : (k, 2, 3), of each profile: (w, x) = frame @ (X, Y, 1)
    slopes : (n,) increasing evenly
    """
    met = np.full((len(frames), len(slopes)), NOTHING, np.int32)
    _meet(ends_mm, frames, slopes, met)
    return met


@njit(cache=True, nogil=True, error_model="numpy")
def _meet(ends_mm: FloatArray, frames: FloatArray, slopes: FloatArray, met: SegmentArray) -> None:
    across, near = np.empty(ends_mm.shape[:2]), np.empty(ends_mm.shape[:2])
    nearness = np.empty(slopes.shape[0])
    for profile in range(frames.shape[0]):
        _turn(ends_mm, frames[profile], across, near)
        for segment in range(ends_mm.shape[0]):
            low, high = near[segment, 0], near[segment, 1]
            if not 0.0 < min(low, high) <= max(low, high) < _NEAREST:
                _cut_off(segment, ends_mm, frames[profile], across, near)
        nearness[:] = 0.0
        _draw(across, near, slopes, nearness, met[profile])


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(ends_mm: FloatArray, frame: FloatArray, across: FloatArray, near: FloatArray) -> None:
    """Write u = x/w and 1/w of every end."""
    wx, wy, w0 = frame[0, 0], frame[0, 1], frame[0, 2]
    xx, xy, x0 = frame[1, 0], frame[1, 1], frame[1, 2]
    for segment in range(ends_mm.shape[0]):
        for end in range(2):
            x, y = ends_mm[segment, end, 0], ends_mm[segment, end, 1]
            near[segment, end] = 1.0 / (wx * x + wy * y + w0)
            across[segment, end] = (xx * x + xy * y + x0) * near[segment, end]


@njit(cache=True, nogil=True, error_model="numpy")
def _cut_off(
    segment: int, ends_mm: FloatArray, frame: FloatArray, across: FloatArray, near: FloatArray
) -> None:
    """Write u and 1/w of what of a segment lies before the emitter: a point if nothing does."""
    w1, x1 = _turned(ends_mm[segment, 0, 0], ends_mm[segment, 0, 1], frame)
    w2, x2 = _turned(ends_mm[segment, 1, 0], ends_mm[segment, 1, 1], frame)
    if max(w1, w2) <= _AHEAD_MM:
        w1, x1, w2, x2 = 1.0, 0.0, 1.0, 0.0
    if w1 < _AHEAD_MM:
        x1 += (x2 - x1) * (_AHEAD_MM - w1) / (w2 - w1)
        w1 = _AHEAD_MM
    if w2 < _AHEAD_MM:
        x2 += (x1 - x2) * (_AHEAD_MM - w2) / (w1 - w2)
        w2 = _AHEAD_MM
    across[segment, 0], near[segment, 0] = x1 / w1, 1.0 / w1
    across[segment, 1], near[segment, 1] = x2 / w2, 1.0 / w2


@njit(cache=True, nogil=True)
def _turned(x: float, y: float, frame: FloatArray) -> tuple[float, float]:
    return (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2],
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _draw(
    across: FloatArray,
    near: FloatArray,
    slopes: FloatArray,
    nearness: FloatArray,
    met: SegmentArray,
) -> None:
    count = slopes.shape[0]
    beams_a_slope = (count - 1) / (slopes[count - 1] - slopes[0])
    for segment in range(across.shape[0]):
        u1, near1 = across[segment, 0], near[segment, 0]
        u2, near2 = across[segment, 1], near[segment, 1]
        if u1 > u2:
            u1, near1, u2, near2 = u2, near2, u1, near1
        if not u1 < u2:  # seen edge-on, or behind
            continue
        tilt = (near2 - near1) / (u2 - u1)
        low, high = min(near1, near2), max(near1, near2)
        for beam in range(_first_from(u1, slopes, beams_a_slope), count):
            if slopes[beam] > u2:
                break
            here = min(max(near1 + (slopes[beam] - u1) * tilt, low), high)
            if here > nearness[beam]:
                nearness[beam] = here
                met[beam] = segment


@njit(cache=True, nogil=True)
def _first_from(u: float, slopes: FloatArray, beams_a_slope: float) -> int:
    """Return the first beam of slope u or more: guessed by their even spacing, then made exact."""
    count = slopes.shape[0]
    beam = int(min(max(np.ceil((u - slopes[0]) * beams_a_slope), 0.0), float(count)))
    while beam > 0 and slopes[beam - 1] >= u:
        beam -= 1
    while beam < count and slopes[beam] < u:
        beam += 1
    return beam
