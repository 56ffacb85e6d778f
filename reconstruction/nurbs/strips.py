"""Bands of a tessellation: which lines each of them needs, and the triangles that fill it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.nurbs.flatness import Flatness


def dropped_lines(
    flat: Flatness, u: FloatArray, v: FloatArray, fixed: BoolArray, tolerance_mm: float
) -> BoolArray:
    """Which lines each band can do without, (bands, lines).

    Neighbouring cells become one, then neighbouring pairs, and so on, as long as `flatness` allows;
    `fixed` lines (lines,) and the ends stay.
    """
    cells = flat.bends.over(
        lambda by, values: _over(by, _over(by, values, flat.breaks_u, u).T, flat.breaks_v, v)
    )
    height = np.diff(v)[:, None]
    whole: BoolArray = np.ones((len(v) - 1, len(u) - 1), dtype=np.bool_)  # (bands, cells)
    dropped: BoolArray = np.zeros((len(v) - 1, len(u)), dtype=np.bool_)
    size = 1
    while whole.shape[1] > 1:
        pairs = whole.shape[1] // 2
        starts = 2 * size * np.arange(pairs)
        middles, ends = starts + size, np.minimum(starts + 2 * size, len(u) - 1)
        ones, others = slice(0, 2 * pairs, 2), slice(1, 2 * pairs, 2)
        cells = cells.over(lambda by, m: by(m[:, ones], m[:, others]))  # noqa: B023
        both = whole[:, ones] & whole[:, others] & ~fixed[middles]
        whole = both & (cells.off(u[ends] - u[starts], height) <= tolerance_mm)
        dropped[:, middles] = whole
        size *= 2
    return dropped


def _over(by: np.ufunc, values: FloatArray, breaks: FloatArray, lines: FloatArray) -> FloatArray:
    """Reduce the cells (a, k) that lie between two lines; (lines - 1, k)."""
    first = np.searchsorted(breaks, lines[:-1], "right") - 1
    beyond = np.searchsorted(breaks, lines[1:], "left")
    padded = np.concatenate([values, values[-1:]])
    pairs = np.stack([first, np.maximum(beyond, first + 1)], axis=1).ravel()
    return np.asarray(by.reduceat(padded, pairs, axis=0)[::2])


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    r"""Two chains of points, by growing parameter, between which triangles are wanted.

    ::

        upper   o-------o---o      numbers of points (n,) and (m,), and the parameter of each
                | \   / | / |
        lower   o---o---o---o      where it grows to the right, triangles are counter-clockwise
    """

    lower: IntArray
    lower_at: FloatArray
    upper: IntArray
    upper_at: FloatArray

    def triangles(self, parameters: FloatArray, flat: Flatness) -> IntArray:
        """Fill the strip, (n + m - 2, 3), along diagonals that leave the surface least.

        Parameters
        ----------
        parameters
            Of all points, (.., 2).
        """
        faces = np.empty((len(self.lower) + len(self.upper) - 2, 3), dtype=np.int64)
        form = (flat.bends.least + flat.bends.most) / 2.0
        shared = np.isin(self.lower_at, self.upper_at), np.isin(self.upper_at, self.lower_at)
        _fill(
            self.lower, self.lower_at, shared[0], self.upper, self.upper_at, shared[1],
            parameters, flat.breaks_u, flat.breaks_v, form, faces,
        )  # fmt: skip
        return faces


@njit(cache=True)
def _fill(
    lower: IntArray, lower_at: FloatArray, lower_shared: BoolArray,
    upper: IntArray, upper_at: FloatArray, upper_shared: BoolArray,
    parameters: FloatArray, breaks_u: FloatArray, breaks_v: FloatArray, form: FloatArray,
    faces: IntArray,
) -> None:  # fmt: skip
    """Step along one chain or the other; where both have a parameter, one waits for the other."""
    i = j = 0
    for face in range(len(faces)):
        if j + 1 == len(upper) or (
            i + 1 < len(lower) and upper_shared[j] and lower_at[i] < upper_at[j]
        ):
            step_lower = True
        elif i + 1 == len(lower) or (lower_shared[i] and upper_at[j] < lower_at[i]):
            step_lower = False
        else:
            one = _sag(parameters[lower[i + 1]], parameters[upper[j]], breaks_u, breaks_v, form)
            other = _sag(parameters[lower[i]], parameters[upper[j + 1]], breaks_u, breaks_v, form)
            step_lower = one < other or (one == other and lower_at[i + 1] <= upper_at[j + 1])
        if step_lower:
            faces[face] = lower[i], lower[i + 1], upper[j]
            i += 1
        else:
            faces[face] = lower[i], upper[j + 1], upper[j]
            j += 1


@njit(cache=True)
def _sag(
    one: FloatArray, other: FloatArray, breaks_u: FloatArray, breaks_v: FloatArray, form: FloatArray
) -> float:
    """How far the surface leaves a chord, times 8, by its second fundamental form in the middle."""
    u, v = (one[0] + other[0]) / 2.0, (one[1] + other[1]) / 2.0
    a = min(max(np.searchsorted(breaks_u, u, side="right") - 1, 0), form.shape[1] - 1)
    b = min(max(np.searchsorted(breaks_v, v, side="right") - 1, 0), form.shape[2] - 1)
    h, k = other[0] - one[0], other[1] - one[1]
    return float(abs(h * h * form[0, a, b] + 2.0 * h * k * form[1, a, b] + k * k * form[2, a, b]))
