"""Contours that step abruptly from one slice to the next end in a level joint, and nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact
from reconstruction.skinning.branching import Branching, find_branches
from reconstruction.skinning.drawing import SliceOutlines, draw_outlines
from reconstruction.skinning.exact_skins import ExactSkin
from reconstruction.skinning.surfacing import Skinned, skin_slices
from reconstruction.slices import Frame, Slice
from tests.reconstruction.skinning_parts import Radius, ring_slices

STEP, SIGMA = 2.0, 0.05
HEIGHTS = [STEP * k for k in range(16)]


def pieces(radius: Radius) -> list[SliceOutlines]:
    return [draw_outlines(each) for each in ring_slices(HEIGHTS, radius, count=400, sigma_mm=SIGMA)]


def branching(of: list[SliceOutlines]) -> Branching:
    return find_branches([each.outlines for each in of], [each.height_mm for each in of])


def stepped(turn: FloatArray, height: float) -> FloatArray:
    """An oval foot and a thinner round neck, 7 mm less."""
    oval = 20.0 + 2.0 * np.cos(2.0 * turn)
    return oval if height < 15.0 else np.full_like(turn, 13.0)


def volume(skinned: Skinned) -> float:
    solid = trimesh.Trimesh(skinned.mesh.vertices_mm, skinned.mesh.faces, process=False)
    assert solid.is_watertight
    return float(solid.volume)


def test_a_shoulder_between_two_slices_is_a_level_joint_midway() -> None:
    found = branching(pieces(stepped))
    (joint,) = found.joints
    assert joint.shoulder
    assert joint.height_mm == pytest.approx(15.0)
    assert [len(each.outlines) for each in found.branches] == [8, 8]


@pytest.mark.parametrize("recognition", Exact)
def test_the_surface_beside_a_shoulder_is_as_exact_as_elsewhere(recognition: Exact) -> None:
    skinned = skin_slices(pieces(stepped), exact=recognition)
    assert skinned.wrapping == ""
    x, y, z = skinned.mesh.vertices_mm.T
    turn, radii = np.arctan2(y, x), np.hypot(x, y)
    # Of rims that lie in the joint, each belongs to one side.
    foot = np.abs(radii - stepped(turn, 0.0)) < np.abs(radii - stepped(turn, 30.0))
    off = radii - np.where(foot, stepped(turn, 0.0), stepped(turn, 30.0))
    wall = (np.abs(z - 15.0) < 4.0) & (radii > 12.0)
    # A point's noise; the paper's way, interpolation, passes on all of its section's.
    assert np.sqrt((off[wall] ** 2).mean()) < 0.5 * SIGMA
    true = 16.0 * math.pi * (20.0**2 + 2.0**2 / 2.0 + 13.0**2)
    assert volume(skinned) == pytest.approx(true, rel=0.001)


def test_the_steps_of_a_turned_shaft_are_the_cylinders_they_are() -> None:
    def shaft(turn: FloatArray, height: float) -> FloatArray:
        return np.full_like(turn, 20.0 if height < 9.0 else 26.0 if height < 13.0 else 15.0)

    skinned = skin_slices(pieces(shaft))  # a flange of two slices between foot and neck
    assert [len(skin.branch.outlines) for skin in skinned.skins] == [5, 2, 9]
    # Two circles alone may be of any shape of revolution.
    kinds = [skin.shape.kind for skin in skinned.skins[::2] if isinstance(skin, ExactSkin)]
    assert kinds == ["cylinder"] * 2
    true = math.pi * (10.0 * 20.0**2 + 4.0 * 26.0**2 + 18.0 * 15.0**2)
    assert volume(skinned) == pytest.approx(true, rel=0.001)


def test_a_bore_with_a_shoulder_in_it_is_hollow_on_either_side_of_it() -> None:
    rng = np.random.default_rng(5)
    slices = []
    for index, height in enumerate(HEIGHTS):
        rings = []
        for radius in (20.0, 8.0 if height < 15.0 else 13.0):
            turn = rng.uniform(0.0, math.tau, 400)
            wide = radius + rng.normal(0.0, SIGMA, 400)
            rings.append(
                np.column_stack([wide * np.cos(turn), wide * np.sin(turn), np.full(400, height)])
            )
        frame = Frame(np.array([0.0, 0.0, height]), np.eye(3))
        slices.append(draw_outlines(Slice(index, np.concatenate(rings), frame)))
    true = 16.0 * math.pi * (2.0 * 20.0**2 - 8.0**2 - 13.0**2)
    assert volume(skin_slices(slices)) == pytest.approx(true, rel=0.001)


def cone(turn: FloatArray, height: float) -> FloatArray:
    return np.full_like(turn, 60.0 - 1.8 * height)


def ball(turn: FloatArray, height: float) -> FloatArray:
    return np.full_like(turn, math.sqrt(15.3**2 - (height - 15.0) ** 2))


def flare(turn: FloatArray, height: float) -> FloatArray:
    """A bell whose wall gets ever flatter."""
    return np.full_like(turn, 10.0 + 0.5 * math.exp(height / 8.0))


def pushed_aside(turn: FloatArray, height: float) -> FloatArray:
    """One slice that is wider than all others."""
    return np.full_like(turn, 23.0 if height == 14.0 else 20.0)


def spout(turn: FloatArray, height: float) -> FloatArray:
    """A feature of one side, that begins between two slices."""
    side = np.exp(-((np.mod(turn, math.tau) - math.pi) ** 2) / 0.2)
    return np.asarray(20.0 + (6.0 * side if height > 15.0 else 0.0))


def waisted(turn: FloatArray, height: float) -> FloatArray:
    """A shoulder that is rounded over several slices."""
    return np.full_like(turn, 16.0 - 4.0 * math.tanh((height - 15.0) / 4.0))


def terraces(turn: FloatArray, height: float) -> FloatArray:
    """A cone of which every slice was recorded twice."""
    return cone(turn, 4.0 * (height // 4.0))


@pytest.mark.parametrize("radius", [cone, ball, flare, pushed_aside, spout, waisted, terraces])
def test_what_is_no_shoulder_is_not_parted(radius: Callable[..., FloatArray]) -> None:
    assert branching(pieces(radius)).joints == ()
