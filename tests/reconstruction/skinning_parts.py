"""Parts as formulas, sliced into noisy points, and nets that lie on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.drawing import SliceOutlines, draw_outlines
from reconstruction.skinning.net import Net, knots_of
from reconstruction.slices import Frame, Slice

Radius = Callable[[FloatArray, float], FloatArray]
Box = tuple[float, float, float, float]  # turn from, to; height from, to


def ring_slices(
    heights_mm: Sequence[float],
    radius: Radius,
    *,
    count: int,
    sigma_mm: float,
    seed: int = 1,
    gaps: Sequence[Box] = (),
) -> list[Slice]:
    """Slices of a part that is star-shaped about z, noise in their planes."""
    rng = np.random.default_rng(seed)
    slices = []
    for index, height in enumerate(heights_mm):
        turn = rng.uniform(0.0, math.tau, count)
        for start, end, low, high in gaps:
            if low < height < high:
                turn = turn[(turn < start) | (turn > end)]
        r = radius(turn, float(height))
        points = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(len(turn), height)])
        points[:, :2] += rng.normal(0.0, sigma_mm, (len(turn), 2))
        frame = Frame(np.array([0.0, 0.0, height]), np.eye(3))
        slices.append(Slice(index, points, frame))
    return slices


def drawn(slices: Sequence[Slice]) -> list[SliceOutlines]:
    return [draw_outlines(each, exact=Exact.NEVER) for each in slices]


def only_branch(
    pieces: Sequence[SliceOutlines], low: Ending = Ending.UNSEEN, high: Ending = Ending.UNSEEN
) -> Branch:
    """The largest outline of every slice, as one branch."""
    outlines = tuple(each.outlines[0] for each in pieces if each.outlines)
    first, last = outlines[0].height_mm, outlines[-1].height_mm
    step = outlines[1].height_mm - first
    ends = (
        End(low, first - (step if low is Ending.CLOSED else 0.0)),
        End(high, last + (step if high is Ending.CLOSED else 0.0)),
    )
    return Branch(outlines, cyclic=False, ends=ends, hole=False)


def tube_net(
    radius_mm: float = 10.0, spans: tuple[int, int] = (12, 6), *, apex: bool = False
) -> Net:
    """A net along a tube of one radius; with an apex it narrows to a point at the top."""
    knots_v = knots_of(spans[1], closed=False)
    turn = np.arange(spans[0]) / spans[0] * math.tau
    heights = np.linspace(0.0, 20.0, spans[1] + 3)
    wide = np.linspace(1.0, 0.0, spans[1] + 3) if apex else np.ones(spans[1] + 3)
    control = np.empty((spans[0], spans[1] + 3, 3))
    control[:, :, 0] = radius_mm * np.cos(turn)[:, None] * wide
    control[:, :, 1] = radius_mm * np.sin(turn)[:, None] * wide
    control[:, :, 2] = heights
    pointed = np.zeros(spans[1] + 3, np.bool_)
    pointed[-1] = apex
    return Net(
        control, knots_of(spans[0], closed=True), knots_v, closed_u=True, closed_v=False,
        apex=pointed,
    )  # fmt: skip


def torus_net(spans: tuple[int, int] = (12, 14)) -> Net:
    """A net along a torus of radii 20 and 6."""
    turn = np.arange(spans[0]) / spans[0] * math.tau
    tilt = np.arange(spans[1]) / spans[1] * math.tau
    arm = 20.0 + 6.0 * np.cos(tilt)
    control = np.empty((*spans, 3))
    control[:, :, 0] = np.cos(turn)[:, None] * arm
    control[:, :, 1] = np.sin(turn)[:, None] * arm
    control[:, :, 2] = 6.0 * np.sin(tilt)
    return Net(
        control, knots_of(spans[0], closed=True), knots_of(spans[1], closed=True), closed_u=True,
        closed_v=True, apex=np.zeros(spans[1], np.bool_),
    )  # fmt: skip
