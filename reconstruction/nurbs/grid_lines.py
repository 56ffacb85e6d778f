"""Lines of constant u and of constant v so close that flat triangles between them are near enough.

Steps are as long as `flatness` allows: long where the surface is flat, short where it bends. Steps
in u have h^2 (|S_uu| + r |M|) constant, those in v k^2 (|S_vv| + |M| / r): the ratio r, and what
each direction gets of the tolerance, are those that give the fewest rectangles.
"""

from __future__ import annotations

import math
from itertools import pairwise, product

import numpy as np
from numba import njit

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.nurbs.flatness import Flatness, flatness
from reconstruction.nurbs.values import Surface

_SHARES = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95)  # of the tolerance, for steps in u
_RATIOS = 2.0 ** np.arange(-7, 8)
_MOST_LINES = 20_000
_FULL = 1.0 - 1e-9  # of a step, against rounding
_EVENER = 12  # bisections for equal steps


def grid_lines(surface: Surface, *, tolerance_mm: float) -> tuple[FloatArray, FloatArray]:
    """Parameters u (m,), v (n,), the domain's ends among them, of a grid within a tolerance.

    The grid is as wide as second derivatives allow when each rectangle is cut along the better
    diagonal; `tessellate` measures what comes out, and leaves out what is not needed.

    Raises
    ------
    ValueError
        The tolerance is not positive, or so fine that the grid could not be held.
    """
    none = np.empty(0)
    return place_lines(flatness(surface), tolerance_mm=tolerance_mm, also_u=none, also_v=none)


def place_lines(
    flat: Flatness, *, tolerance_mm: float, also_u: FloatArray, also_v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Like `grid_lines`, with lines at given parameters, too."""
    if not tolerance_mm > 0:
        raise ValueError(f"the tolerance must be above 0 mm, got {tolerance_mm:g}")
    across = float(np.ptp(flat.breaks_v) / np.ptp(flat.breaks_u))
    ratios = across * _RATIOS if flat.bends.twist.any() else np.array([across])
    best, chosen = math.inf, (flat.breaks_u, flat.breaks_v)
    for ratio, share in product(ratios, _SHARES):
        in_u, in_v = _budgeted(flat, ratio, share, tolerance_mm)
        cost = _steps(flat.breaks_u, in_u, flat.sharp_u)
        cost *= _steps(flat.breaks_v, in_v, flat.sharp_v)
        if cost < best:
            best, chosen = cost, (in_u, in_v)
    return (
        _lines(flat.breaks_u, chosen[0], flat.sharp_u, also_u, tolerance_mm),
        _lines(flat.breaks_v, chosen[1], flat.sharp_v, also_v, tolerance_mm),
    )


def _budgeted(
    flat: Flatness, ratio: float, share: float, tolerance_mm: float
) -> tuple[FloatArray, FloatArray]:
    """Bends (a,) of u and (b,) of v by which a step h is long enough when h^2 bend = 1."""
    bends = flat.bends
    in_u = (bends.along_u + ratio * bends.twist).max(axis=1) / share
    in_v = (bends.along_v + bends.twist / ratio).max(axis=0) / (1.0 - share)
    h, k = (np.minimum(1.0 / np.sqrt(np.maximum(m, 1e-300)), width) for m, width in (
        (in_u, np.ptp(flat.breaks_u)), (in_v, np.ptp(flat.breaks_v))))  # fmt: skip
    # All errors grow with the squares of h and k: scale both so that the worst is the tolerance.
    scale = float(bends.off(h[:, None], k).max()) / tolerance_mm
    return in_u * scale, in_v * scale


def _steps(breaks: FloatArray, bends: FloatArray, sharp: BoolArray) -> float:
    """About how many steps are needed from end to end."""
    loads = np.concatenate([[0.0], np.cumsum(np.sqrt(bends) * np.diff(breaks))])
    return float(np.maximum(np.diff(loads[sharp]), 1.0).sum())


def _lines(
    breaks: FloatArray,
    bends: FloatArray,
    sharp: BoolArray,
    also: FloatArray,
    tolerance_mm: float,
) -> FloatArray:
    """Place the lines, those between two fixed ones about evenly loaded."""
    breaks, bends, sharp = _with_lines(breaks, bends, sharp, also)
    room = np.empty(_MOST_LINES)
    pieces = [breaks[:1]]
    for i, j in pairwise(np.flatnonzero(sharp).tolist()):
        count = _evenly(breaks, bends, i, j, 1.0, room)
        if count >= _MOST_LINES:
            raise ValueError(
                f"a tolerance of {tolerance_mm:g} mm asks for more than {_MOST_LINES} lines in one "
                "direction: allow a larger one"
            )
        pieces += [room[:count].copy(), breaks[j : j + 1]]
    return np.concatenate(pieces)


def _with_lines(
    breaks: FloatArray, bends: FloatArray, sharp: BoolArray, also: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Make given parameters fixed lines."""
    together = np.unique(np.concatenate([breaks, also]))
    span = np.clip(np.searchsorted(breaks, together, "right") - 1, 0, len(bends) - 1)
    fixed = np.isin(together, also) | np.isin(together, breaks[sharp])
    return together, bends[span[:-1]], fixed


@njit(cache=True)
def _walk(
    breaks: FloatArray, bends: FloatArray, first: int, last: int, budget: float, lines: FloatArray
) -> int:
    """Step from one break to another as far as the budget allows; the lines between, counted."""
    here, span, count = breaks[first], first, 0
    while True:
        worst, ahead = 0.0, span
        target = breaks[last]
        while ahead < last:
            worse = max(worst, bends[ahead])
            reach = here + _FULL * math.sqrt(budget / worse) if worse > 0.0 else np.inf
            if reach < breaks[ahead + 1]:
                # The next span bends so much more that the step must end where it begins.
                target = max(reach, breaks[ahead]) if ahead > span else reach
                break
            worst = worse
            ahead += 1
        if ahead == last or count == len(lines):
            return count
        lines[count] = target
        count += 1
        here, span = target, ahead


@njit(cache=True)
def _evenly(
    breaks: FloatArray, bends: FloatArray, first: int, last: int, budget: float, lines: FloatArray
) -> int:
    """Like `_walk`, with the smallest budget that needs no more lines: no short step at the end."""
    count = _walk(breaks, bends, first, last, budget, lines)
    low, high = 0.0, 1.0
    for _ in range(_EVENER):
        middle = (low + high) / 2.0
        if _walk(breaks, bends, first, last, middle * budget, lines) > count:
            low = middle
        else:
            high = middle
    return _walk(breaks, bends, first, last, high * budget, lines)
