"""Bands of height in which a branch has no points at all: slices between others are missing."""

from __future__ import annotations

import numpy as np

from reconstruction.arrays import BoolArray, FloatArray
from reconstruction.skinning.branch import Branch
from reconstruction.skinning.outlines import Moments

_MISSING = 1.5  # times the usual way from slice to slice: one at least is missing there
_INSIDE = 1e-6  # of that way: the slices beside a band are seen


def unseen_bands(branch: Branch, used: Moments) -> FloatArray:
    """Lowest and highest height (g, 2) of each band, along the stacking axis.

    Parameters
    ----------
    used
        Cells of its surface, those that are on none of its outlines, too.
    """
    axis = branch.axes[2]
    every = [*(outline.moments for outline in branch.outlines), used]
    seen = np.sort(np.concatenate([each.means_mm @ axis for each in every]))
    missing = np.flatnonzero(np.diff(seen) > _MISSING * branch.pitch_mm)
    margin = _INSIDE * branch.pitch_mm if len(missing) else 0.0
    return np.stack([seen[missing] + margin, seen[missing + 1] - margin], axis=1)


def lies_in(heights_mm: FloatArray, bands: FloatArray) -> BoolArray:
    """Whether heights, of any shape, lie in any of the bands (g, 2)."""
    place = np.searchsorted(bands.ravel(), heights_mm)
    return np.asarray(place % 2 == 1)
