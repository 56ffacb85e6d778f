"""Slices from low to high, each at a height of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reconstruction.arrays import BoolArray, FloatArray, IntArray, frozen
from reconstruction.skinning.doubt import Doubt
from reconstruction.skinning.outlines import Outline

_SAME = 1e-9  # of the stack's height: slices closer than that lie at one height


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """The closed outlines of slices, empty slices among them."""

    slices: tuple[Sequence[Outline], ...]
    heights_mm: FloatArray  # (s,), rising
    indices: IntArray  # (s,), to name slices by
    unresolved: BoolArray  # (s,), whether points hang together there in no closed outline

    def __post_init__(self) -> None:
        object.__setattr__(self, "heights_mm", frozen(self.heights_mm))
        object.__setattr__(self, "indices", frozen(self.indices, np.int64))
        object.__setattr__(self, "unresolved", frozen(self.unresolved, np.bool_))

    def __len__(self) -> int:
        return len(self.slices)


def stack_up(
    slices: Sequence[Sequence[Outline]],
    heights_mm: ArrayLike,
    indices: Sequence[int] | None,
    unresolved: Sequence[bool] | None,
    doubts: list[Doubt],
) -> Stack:
    """Check what a caller gave; of slices at one height, keep the first that is not empty."""
    stack = _checked(slices, heights_mm, indices, unresolved)
    kept: list[int] = []
    same_mm = _SAME * float(np.ptp(stack.heights_mm)) if len(stack) else 0.0
    for level, piece in enumerate(stack.slices):
        if not kept or stack.heights_mm[level] - stack.heights_mm[kept[-1]] > same_mm:
            kept.append(level)
            continue
        out, other = level, kept[-1]
        if piece and not stack.slices[other]:
            out, other = other, level
        kept[-1] = other
        what = f"lies at the height of slice {stack.indices[other]}; left out"
        doubts.append(Doubt(int(stack.indices[out]), what))
    return Stack(
        tuple(stack.slices[each] for each in kept),
        stack.heights_mm[kept],
        stack.indices[kept],
        stack.unresolved[kept],
    )


def _checked(
    slices: Sequence[Sequence[Outline]],
    heights_mm: ArrayLike,
    indices: Sequence[int] | None,
    unresolved: Sequence[bool] | None,
) -> Stack:
    heights = np.asarray(heights_mm, dtype=np.float64)
    count = len(slices)
    if heights.shape != (count,):
        raise ValueError(f"heights_mm: {count} expected, got shape {heights.shape}")
    if not np.isfinite(heights).all() or (np.diff(heights) < 0.0).any():
        raise ValueError("heights_mm: finite and ascending expected; sort the slices first")
    for name, given in (("indices", indices), ("unresolved", unresolved)):
        if given is not None and len(given) != count:
            raise ValueError(f"{name}: {count} expected, got {len(given)}")
    named: list[int] = []
    for level, piece in enumerate(slices):
        following = named[-1] + 1 if named else 0
        named.append(
            piece[0].slice_index if piece else following if indices is None else indices[level]
        )
    open_ended = np.array([False] * count if unresolved is None else unresolved, dtype=np.bool_)
    return Stack(tuple(slices), heights, np.array(named, dtype=np.int64), open_ended)
