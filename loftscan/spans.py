"""Indices as a person writes them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby


def spans(indices: Iterable[int]) -> str:
    """Numbers as a person writes them: 3-7, 9, 12-13."""
    ordered = sorted(set(indices))
    runs = [
        [index for _, index in group]
        for _, group in groupby(enumerate(ordered), key=lambda pair: pair[1] - pair[0])
    ]
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
