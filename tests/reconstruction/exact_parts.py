"""Parts of exact shapes, sliced and drawn: what `skin_slices` gets."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from reconstruction.arrays import FloatArray
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.slices import Frame, Slice
from tests.reconstruction.skinning_parts import Box, Radius, drawn, ring_slices

SIGMA = 0.1
STEP = 1.5
HEIGHTS = np.arange(24) * STEP
LOW, HIGH = -0.5 * STEP, HEIGHTS[-1] + 0.5 * STEP  # brims lie half a step beyond
GAP = (1.0, 2.0, 10.0, 22.0)  # turn from, to; height from, to


def steady(radius: float) -> Radius:
    return lambda turn, _: np.full_like(turn, radius)


def pieces(
    radius: Radius,
    *,
    heights: FloatArray = HEIGHTS,
    count: int = 500,
    gaps: Sequence[Box] = (),
) -> list[SliceOutlines]:
    levels = [float(each) for each in heights]
    return drawn(ring_slices(levels, radius, count=count, sigma_mm=SIGMA, gaps=gaps))


def empty(index: int, height: float) -> SliceOutlines:
    (drawn_piece,) = drawn(
        [Slice(index, np.empty((0, 3)), Frame(np.array([0.0, 0.0, height]), np.eye(3)))]
    )
    return drawn_piece


def leaning(turn_rad: float, radius: float) -> list[SliceOutlines]:
    """A cylinder that leans towards x: level cuts are ellipses that move along."""
    rng = np.random.default_rng(3)
    slices = []
    for index, height in enumerate(HEIGHTS):
        turn = rng.uniform(0.0, math.tau, 500)
        x = radius / math.cos(turn_rad) * np.cos(turn) + height * math.tan(turn_rad)
        points = np.column_stack([x, radius * np.sin(turn), np.full(len(turn), height)])
        points[:, :2] += rng.normal(0.0, SIGMA, (len(turn), 2))
        slices.append(Slice(index, points, Frame(np.array([0.0, 0.0, height]), np.eye(3))))
    return drawn(slices)


def conical(turn: FloatArray, z: float) -> FloatArray:
    """A cone of half angle 0.35 rad whose apex is 36 mm up."""
    return np.full_like(turn, max(36.0 - z, 0.0) * math.tan(0.35))


def bored() -> list[SliceOutlines]:
    slices = []
    for index, height in enumerate(HEIGHTS):
        rings = [
            ring_slices(
                [float(height)], steady(radius), count=500, sigma_mm=SIGMA, seed=100 * index + k
            )[0].points_mm
            for k, radius in enumerate((20.0, 12.0))
        ]
        frame = Frame(np.array([0.0, 0.0, height]), np.eye(3))
        slices.append(Slice(index, np.concatenate(rings), frame))
    return drawn(slices)


def legs() -> list[SliceOutlines]:
    """Two cylinders of radius 6 that end in one of radius 20."""
    slices = []
    for index, height in enumerate(HEIGHTS):
        rng = np.random.default_rng(index)
        turn = rng.uniform(0.0, math.tau, (2, 400))
        radius, aside = (6.0, 10.0) if height < 17.0 else (20.0, 0.0)
        x = radius * np.cos(turn) + np.array([[aside], [-aside]])
        flat = np.stack([x, radius * np.sin(turn)], axis=2).reshape(-1, 2)
        flat += rng.normal(0.0, SIGMA, flat.shape)
        points = np.column_stack([flat, np.full(len(flat), height)])
        slices.append(Slice(index, points, Frame(np.array([0.0, 0.0, height]), np.eye(3))))
    return drawn(slices)


PARTS = {
    "cylinder": (lambda: pieces(steady(20.0)), ["cylinder"]),
    "leaning cylinder": (lambda: leaning(0.3, 12.0), ["cylinder"]),
    "cone with its apex": (
        lambda: [*pieces(conical, heights=np.append(HEIGHTS[:23], 34.8)), empty(25, 36.3)],
        ["cone"],
    ),
    "vase": (
        lambda: pieces(lambda turn, z: 20.0 + 2.0 * np.sin(z / 6.0) + 0.0 * turn),
        ["revolution"],
    ),
    "cylinder with a bore": (bored, ["cylinder", "cylinder"]),
    "two legs": (legs, ["cylinder", "cylinder", "cylinder"]),
}
