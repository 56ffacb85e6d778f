"""Which loops lie within which: outer loops run counter-clockwise, holes clockwise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray


def signed_area(nodes: FloatArray) -> float:
    """Of a polygon (m, 2); counter-clockwise is positive."""
    x, y = (nodes - nodes[0]).T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def find_depths(rows: Sequence[tuple[FloatArray, bool]]) -> list[int]:
    """How many of the closed rows lie around each row; nodes (m, 2), and whether it is closed."""
    loops = [(number, nodes) for number, (nodes, closed) in enumerate(rows) if closed]
    return [
        sum(is_inside(nodes[0], loop) for number, loop in loops if number != own)
        for own, (nodes, _) in enumerate(rows)
    ]


def is_inside(place: FloatArray, loop: FloatArray) -> bool:
    """Whether a ray from the place to the right crosses the loop an odd number of times."""
    x, y = (loop - place).T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    over = (y > 0) != (next_y > 0)
    at = x[over] - y[over] * (next_x[over] - x[over]) / (next_y[over] - y[over])
    return bool((at > 0).sum() % 2)
