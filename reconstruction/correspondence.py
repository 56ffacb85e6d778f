r"""Which point of one section belongs to which of the next (the paper's section 2.4).

Sections of equal count correspond one to one. Where the bigger one has d points more, d pairs of
its neighbouring points are each connected to one point of the smaller, in sequence::

    smaller    o-------o-------o-------o
               |      / \      |      / \        two pairs: 6 points onto 4
    bigger     o-----o---o-----o-----o---o
"""

from __future__ import annotations

import numpy as np
from numba import njit

from reconstruction.arrays import FloatArray, IntArray

# Equidistant knots make nearly equal distances; within this share they count as equal, and then
# the pairs are spread evenly instead of crowding at the start of the numbering.
_EQUAL = 0.05


def connect_pairs(bigger_mm: FloatArray, smaller_count: int) -> IntArray:
    """Choose the pairs of the bigger section that share one point of the smaller.

    Parameters
    ----------
    bigger_mm : (n, d)
        Numbered points of the bigger section.
    smaller_count : int
        Points m of the smaller section, n / 2 <= m <= n.

    Returns
    -------
    (m,) int
        For each point of the smaller section the first point of the bigger one connected to it;
        the group ends where the next begins, so it has one point or two.

    Raises
    ------
    ValueError
        When m is out of range: pairs alone cannot connect more than twice as many points.

    References
    ----------
    paper, section 2.4: the points whose distance is smallest are chosen.
    """
    count = len(bigger_mm)
    pairs = count - smaller_count
    if not 0 <= pairs <= smaller_count:
        raise ValueError(f"{count} points cannot be connected in pairs to {smaller_count}")
    steps = np.linalg.norm(np.diff(bigger_mm, axis=0), axis=1)
    typical = max(float(np.mean(steps)) if len(steps) else 1.0, 1e-300)
    cost = np.round(steps / typical / _EQUAL)
    single = _choose_pairs(cost, pairs)
    return np.asarray(np.flatnonzero(single), dtype=np.int64)


@njit(cache=True)
def _choose_pairs(cost: FloatArray, pairs: int) -> IntArray:
    """Mark the first point of every group, for the least total cost of exactly `pairs` pairs.

    Dynamic programme over points and pairs used: a point stands alone or closes a pair with the
    one before. Among equal costs the pairs nearest to an even spread win.
    """
    count = len(cost) + 1
    infinite = np.inf
    best = np.full((count + 1, pairs + 1), infinite)
    paired = np.zeros((count + 1, pairs + 1), np.bool_)
    best[0, 0] = 0.0
    pace = pairs / count
    tie = 1.0 / (4.0 * count * count)
    for k in range(1, count + 1):
        for used in range(min(pairs, k // 2) + 1):
            best[k, used] = best[k - 1, used]
            if k >= 2 and used >= 1 and best[k - 2, used - 1] < infinite:
                uneven = abs((used - 0.5) - pace * (k - 1))
                total = best[k - 2, used - 1] + cost[k - 2] + tie * uneven
                if total < best[k, used]:
                    best[k, used], paired[k, used] = total, True
    first = np.ones(count, np.bool_)
    k, used = count, pairs
    while k > 0:
        if paired[k, used]:
            first[k - 1] = False
            k, used = k - 2, used - 1
        else:
            k -= 1
    return first.astype(np.int64)


def counts_between(before: int, after: int) -> tuple[int, ...]:
    """Counts of the intermediate sections that keep every step within what pairs can connect.

    Empty when the larger of the two counts is at most twice the smaller; else a geometric row.
    """
    small, big = min(before, after), max(before, after)
    steps = 1
    while big > small * 2**steps:
        steps += 1
    if steps > 1:
        # One step to spare: rounding must not leave a ratio just above two.
        steps += 1
    return tuple(round(before * (after / before) ** (k / steps)) for k in range(1, steps))
