"""Cells pooled to patches of a form: what is smooth over the form is told by few of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from reconstruction.arrays import BoolArray, FloatArray, IntArray

_COUNTS = (48, 20)  # around and along
_SPARSE = 0.35  # of the points that cells nearby hold ...
_SPARSER = 3.0  # ... and standard deviations fewer
_STEP = 1e-4  # of the form's size, for derivatives


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Weighted means over patches that hold cells."""

    of_cell: IntArray  # (m,), the patch of every cell; -1: it weighs nothing
    held: FloatArray  # (k,), sums of the weights
    middles_mm: FloatArray  # (k, 3)
    boxes: IntArray  # (k, 2), place on the chart's lattice, around and along

    def mean(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """Weighted means of values (m,) or (m, d) of the cells, (k,) or (k, d)."""
        if values.ndim == 1:
            return self.sums(weights * values) / self.held
        return np.stack([self.mean(column, weights) for column in values.T], axis=1)

    def sums(self, values: FloatArray) -> FloatArray:
        """Sums of values (m,) of the cells, (k,)."""
        # One place up: the first is of what weighs nothing.
        return np.bincount(self.of_cell + 1, values, len(self.held) + 1)[1:].astype(np.float64)

    def windows(self, values: FloatArray, reach: int) -> FloatArray:
        """Sums of values (k,) of the patches at most so many boxes away, over the lattice.

        The lattice closes around. Where the chart does not, a window holds some from both of its
        sides: as good a sample of noise as any.
        """
        lattice = np.zeros(_COUNTS)
        lattice[self.boxes[:, 0], self.boxes[:, 1]] = values
        padded = np.pad(lattice, ((reach, reach), (0, 0)), mode="wrap")
        padded = np.pad(padded, ((0, 0), (reach, reach)))
        side = 2 * reach + 1
        return np.asarray(sliding_window_view(padded, (side, side)).sum(axis=(2, 3)).ravel())

    def along(self, function: Callable[[FloatArray], FloatArray], ways: FloatArray) -> FloatArray:
        """Derivative of a function of places (k, 3) -> (k, d) along ways (k, 3) at the middles."""
        if not len(self.middles_mm):  # every cell was thrown out
            return function(self.middles_mm)
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
    boxes = np.column_stack(np.divmod(filled, _COUNTS[1]))
    patches = Patches(number[box], sums[filled], np.zeros((len(filled), 3)), boxes)
    return replace(patches, middles_mm=patches.mean(places_mm, weights))


def beyond_rims(points: FloatArray, patches: Patches) -> BoolArray:
    """Which cells hold far fewer points than those beside them.

    They lie beyond a rim: noise has carried their points there, across a leaning wall more often
    one way than the other.
    """
    alike = patches.sums(np.ones(len(points)))
    usual = (patches.sums(points) / alike)[patches.of_cell]
    fewer = usual - points > _SPARSER * np.sqrt(np.maximum(usual, 0.0))
    return (points < _SPARSE * usual) & fewer & (patches.of_cell >= 0)
