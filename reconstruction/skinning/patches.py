"""Cells pooled to patches of a form: what is smooth over the form is told by few of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reconstruction.arrays import FloatArray, IntArray

_COUNTS = (48, 20)  # around and along
_STEP = 1e-4  # of the form's size, for derivatives


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Weighted means over patches that hold cells."""

    of_cell: IntArray  # (m,), the patch of every cell; -1: it weighs nothing
    held: FloatArray  # (k,), sums of the weights
    middles_mm: FloatArray  # (k, 3)

    def mean(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """Weighted means of values (m,) or (m, d) of the cells, (k,) or (k, d)."""
        return _mean(self.of_cell, self.held, values, weights)

    def along(self, function: Callable[[FloatArray], FloatArray], ways: FloatArray) -> FloatArray:
        """Derivative of a function of places (k, 3) -> (k, d) along ways (k, 3) at the middles."""
        size = float(np.ptp(self.middles_mm, axis=0).max())
        longest = max(float(np.abs(ways).max()), 1e-300)
        step = _STEP * size / longest
        ahead = function(self.middles_mm + step * ways)
        behind = function(self.middles_mm - step * ways)
        return np.asarray((ahead - behind) / (2.0 * step))


def pooled(chart: FloatArray, places_mm: FloatArray, weights: FloatArray) -> Patches:
    """Pool cells by their place on a chart (m, 2)."""
    low, high = chart.min(axis=0), chart.max(axis=0)
    share = (chart - low) / np.maximum(high - low, 1e-300)
    at = np.minimum((share * _COUNTS).astype(np.int64), np.array(_COUNTS) - 1)
    box = at[:, 0] * _COUNTS[1] + at[:, 1]
    sums = np.bincount(box, weights, _COUNTS[0] * _COUNTS[1]).astype(np.float64)
    filled = np.flatnonzero(sums > 0.0)
    number = np.full(len(sums), -1)
    number[filled] = np.arange(len(filled))
    of_cell = number[box]
    return Patches(of_cell, sums[filled], _mean(of_cell, sums[filled], places_mm, weights))


def _mean(
    of_cell: IntArray, held: FloatArray, values: FloatArray, weights: FloatArray
) -> FloatArray:
    # The sums go one place up: the first is of what weighs nothing.
    columns = values[:, None] if values.ndim == 1 else values
    sums = [np.bincount(of_cell + 1, weights * c, len(held) + 1)[1:] for c in columns.T]
    means = np.stack(sums, axis=1) / held[:, None]
    return means[:, 0] if values.ndim == 1 else means
