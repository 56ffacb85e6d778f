"""Where along a row nodes are due: where points are, and none where they are missing.

A hole is wider than the band is thick, and than chance explains; across it nobody knows where the
middle runs, and no node is put there. Lengths are in reaches.
"""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray, IntArray
from reconstruction.fitting.regression import STEP

_HOLE = 1.5  # reaches without a point: no node is put there, where it would hang in the air
_BESIDE = 24  # points on either side of a hole tell how far apart they usually are: ...
_OTHERS = 3  # gaps that may be among the ways of so many points, and fewer among fewer
_SILENT = 5.5  # ... it is a gap from so many times the widest of their other ways, ...
_SILENCE = 11.0  # ... or times the way that three quarters of them do not exceed
_TAIL = 2  # points beyond either end of a row of many that may be strays ...
_MANY = 100  # ... one for every so many points


def grid_between(
    along: FloatArray, thick: FloatArray, period: float
) -> tuple[FloatArray, tuple[int, ...]]:
    """Steps along the stretches that points support, and after which of them a gap follows.

    Points lie at `along` (n,), ascending; the band is as thick as `thick` (n,) at each of them; a
    closed row repeats after a period.
    """
    closed = period < np.inf
    breaks, wide = _holes(along, thick, period)
    if closed and not len(breaks):
        return np.linspace(0.0, period, max(round(period / STEP), 4), endpoint=False), ()
    if closed:  # from one hole to its repetition
        along = np.concatenate([along[breaks[0] + 1 :], along[: breaks[0] + 1] + period])
        breaks, wide = breaks[1:] - breaks[0] - 1, np.roll(wide, -1)
    else:
        along, beyond = _without_tails(along)
        inner = (breaks >= beyond) & (breaks < beyond + len(along) - 1)
        breaks, wide = breaks[inner] - beyond, wide[inner]
    starts, ends = along[np.append(0, breaks + 1)], along[np.append(breaks, len(along) - 1)]
    pieces = [
        np.linspace(start, end, max(round((end - start) / STEP), 1) + 1)
        for start, end in zip(starts, ends, strict=True)
    ]
    grid = np.concatenate(pieces)
    last = np.cumsum([len(piece) for piece in pieces]) - 1
    if not closed:
        return grid, tuple(last[:-1][wide].tolist())
    grid = np.mod(grid, period)
    first = int(np.argmin(grid))
    return np.roll(grid, -first), tuple(sorted(((last[wide] - first) % len(grid)).tolist()))


def gaps_among(along: FloatArray, period: float) -> tuple[int, ...]:
    """After which of the points a gap follows, however thin the band."""
    holes, gaps = _holes(along, np.zeros(len(along)), period)
    return tuple(holes[gaps].tolist())


def _holes(along: FloatArray, thick: FloatArray, period: float) -> tuple[IntArray, BoolArray]:
    """After which points there is a hole, and which are gaps.

    A gap is thicker than the band, and wider than the ways around it explain.
    """
    ways = np.diff(along, append=along[0] + period if period < np.inf else -np.inf)
    holes = np.flatnonzero(ways > np.minimum(_HOLE, thick))
    most = min(_BESIDE, (len(ways) - 1) // 2)
    beside = np.concatenate([np.arange(-most, 0), np.arange(1, most + 1)])
    around = np.sort(ways[(holes[:, None] + beside) % len(ways)], axis=1)
    gaps = np.ones(len(holes), np.bool_)
    if most:
        widest = -1 - max(_OTHERS * most // _BESIDE, 1)
        gaps &= ways[holes] > np.minimum(
            _SILENT * around[:, widest], _SILENCE * around[:, -1 - most // 2]
        )
    kept = gaps | (ways[holes] > _HOLE)
    return holes[kept], gaps[kept]


def _without_tails(along: FloatArray) -> tuple[FloatArray, int]:
    """Without the first and last two of many points, and how many are left out.

    They may be strays beyond the ends.
    """
    beyond = min(_TAIL, len(along) // _MANY)
    inner = along[beyond : len(along) - beyond]
    if not inner[-1] > inner[0]:
        return np.array([inner[0], inner[0] + STEP]), beyond
    return inner, beyond
