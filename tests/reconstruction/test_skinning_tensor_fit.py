"""The surface of a branch against the true part: noise, gaps, ends, and what it says of itself."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.skinning.branch import Branch, Ending
from reconstruction.skinning.closing import closed_mesh
from reconstruction.skinning.drawing import SliceOutlines
from reconstruction.skinning.ends import Apex
from reconstruction.skinning.net import derivatives_at
from reconstruction.skinning.rounds import Manner, State
from reconstruction.skinning.skin import Skin, rims_of, skin_branch
from reconstruction.skinning.stiffness import Lattice
from reconstruction.skinning.surfacing import skin_slices
from reconstruction.skinning.tensor_fit import Posterior, _once
from reconstruction.slices import Frame, Slice
from tests.reconstruction.skinning_parts import Box, drawn, only_branch, ring_slices

STRIP: Box = (0.3, 0.3 + math.radians(36), -1.0, 101.0)
PATCH: Box = (3.0, 3.0 + math.radians(36), 40.0, 60.0)


def cylinder(turn: FloatArray, height: float) -> FloatArray:
    return np.full_like(turn, 50.0)


def oval(turn: FloatArray, height: float) -> FloatArray:
    wide = 1.0 + 0.002 * height
    return wide / np.sqrt((np.cos(turn) / 40.0) ** 2 + (np.sin(turn) / 28.0) ** 2)


def ball(turn: FloatArray, height: float) -> FloatArray:
    return np.full_like(turn, math.sqrt(max(40.0**2 - height**2, 0.0)))


def grid(skin: Skin, count: int = 160) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    end_u, end_v = skin.fit.net.spans
    u, v = np.meshgrid(
        np.linspace(0.0, end_u, count, endpoint=False), np.linspace(0.0, end_v, count)
    )
    frames = derivatives_at(skin.fit.net, u.ravel(), v.ravel())
    return u.ravel(), v.ravel(), frames[:, 0], np.cross(frames[:, 1], frames[:, 2])


@cache
def tube() -> Skin:
    """50 slices of 2000 points, 0.2 mm, with a strip and a patch missing."""
    heights = np.arange(50) * 2.0 + 1.0
    slices = ring_slices(heights.tolist(), cylinder, count=2000, sigma_mm=0.2, gaps=(STRIP, PATCH))
    return skin_branch(only_branch(drawn(slices)))


def inside(turn: FloatArray, height: FloatArray) -> np.ndarray:
    turn = np.mod(turn, math.tau)
    found = np.zeros(len(turn), bool)
    for start, end, low, high in (STRIP, PATCH):
        found |= (turn > start) & (turn < end) & (height > low) & (height < high)
    return found


def test_a_tube_with_gaps_is_right_outside_and_inside_them() -> None:
    """The issue's bounds for 1 000 000 points, 0.004 and 0.08 mm, times root 11 for 90 000."""
    _, _, places, _ = grid(tube())
    off = np.hypot(places[:, 0], places[:, 1]) - 50.0
    side = (places[:, 2] > 3.0) & (places[:, 2] < 97.0)
    gap = inside(np.arctan2(places[:, 1], places[:, 0]), places[:, 2])
    assert np.sqrt((off[side & ~gap] ** 2).mean()) < 0.004 * math.sqrt(11)
    assert np.sqrt((off[side & gap] ** 2).mean()) < 0.02


def test_a_tube_spends_few_degrees_of_freedom_and_knows_its_noise() -> None:
    fit = tube().fit
    assert fit.edf < 40.0
    assert math.sqrt(fit.noise.level_mm2) == pytest.approx(0.2, rel=0.01)


def test_a_round_done_again_has_the_covariance_that_was_thrown_away() -> None:
    skin = tube()
    fit, lattice = skin.fit, Lattice.over(skin.fit.net)
    logs = np.full(lattice.count, 3.0)
    state = State(fit.net, fit.net.control_mm, fit.feet.u, fit.feet.v, fit.noise, (logs, logs))
    manner = Manner(learning=True, model=0.3, steps=1)
    done = _once(state, fit.moments, lattice, rims_of(skin.brims), manner, 0)
    assert done is not None
    assert done.found.inverse is not None
    light = done.lighter()
    assert light.found.inverse is None
    again = Posterior(light.found.factor, light.found.inverse, light.again).inverse
    np.testing.assert_array_equal(again.panels, done.found.inverse.panels)


def test_gaps_are_marked() -> None:
    skin = tube()
    u, v, places, _ = grid(skin, 80)
    turn = np.arctan2(places[:, 1], places[:, 0])
    deep = np.abs(np.mod(turn, math.tau) - 0.3 - math.radians(18)) < math.radians(8)
    far = np.abs(np.mod(turn, math.tau) - 5.0) < 0.4
    middle = (places[:, 2] > 20.0) & (places[:, 2] < 80.0)
    assert skin.synthetic(u, v)[deep & middle].all()
    assert not skin.synthetic(u, v)[far & middle].any()


def test_where_nothing_was_measured_the_deviation_is_wider() -> None:
    gap: Box = (1.0, 2.0, -1.0, 61.0)
    heights = (np.arange(30) * 2.0).tolist()
    slices = ring_slices(heights, oval, count=400, sigma_mm=0.3, gaps=(gap,))
    skin = skin_branch(only_branch(drawn(slices)))
    u, v, places, _ = grid(skin, 80)
    turn = np.mod(np.arctan2(places[:, 1], places[:, 0]), math.tau)
    middle = (places[:, 2] > 10.0) & (places[:, 2] < 48.0)
    deviation = skin.deviation_mm(u, v)
    deep, far = middle & (np.abs(turn - 1.5) < 0.2), middle & (np.abs(turn - 4.5) < 0.4)
    assert deviation[deep].mean() > 2.0 * deviation[far].mean()


def test_the_surface_does_not_fold() -> None:
    _, _, places, cross = grid(tube())
    outward = (cross * places * [1.0, 1.0, 0.0]).sum(axis=1)
    assert (outward > 0.0).all()


def test_the_mesh_of_a_tube_is_closed_with_level_caps() -> None:
    mesh = closed_mesh(tube(), 0.02)
    solid = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.euler_number == 2
    assert solid.volume == pytest.approx(math.pi * 50.0**2 * 100.0, rel=1e-3)
    assert mesh.vertices_mm[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert mesh.vertices_mm[:, 2].max() == pytest.approx(100.0, abs=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_band_covers_the_truth(seed: int) -> None:
    """Nineteen places of twenty, on average; of one cloud at least four of five."""
    slices = ring_slices((np.arange(30) * 2.0).tolist(), oval, count=400, sigma_mm=0.3, seed=seed)
    skin = skin_branch(only_branch(drawn(slices)))
    u, v, places, _ = grid(skin, 60)
    inner = (places[:, 2] > 1.0) & (places[:, 2] < 57.0)
    turn = np.arctan2(places[:, 1], places[:, 0])
    radius = np.array([oval(np.array([t]), z)[0] for t, z in zip(turn, places[:, 2], strict=True)])
    around = 1e-4
    slope = np.array(
        [
            (oval(np.array([t + around]), z)[0] - oval(np.array([t - around]), z)[0])
            for t, z in zip(turn, places[:, 2], strict=True)
        ]
    ) / (2 * around * radius)
    off = np.abs(np.hypot(places[:, 0], places[:, 1]) - radius) / np.hypot(1.0, slope)
    covered = off[inner] <= 1.96 * skin.deviation_mm(u, v)[inner]
    assert covered.mean() > 0.8
    floor = 0.3 * math.sqrt(skin.fit.edf / (30 * 400))
    assert np.sqrt((off[inner] ** 2).mean()) < 1.5 * floor


def test_a_ball_is_closed_by_a_rounded_apex_at_either_end() -> None:
    step = 80.0 / 40
    heights = (-40.0 + step * (np.arange(40) + 0.5)).tolist()
    slices = ring_slices(heights, ball, count=400, sigma_mm=0.1)
    skin = skin_branch(only_branch(drawn(slices), Ending.CLOSED, Ending.CLOSED))
    assert skin.brims is not None
    assert all(isinstance(each, Apex) and not each.sharp for each in skin.brims)
    _, _, places, _ = grid(skin)
    off = np.linalg.norm(places, axis=1) - 40.0
    assert np.sqrt((off**2).mean()) < 0.03
    assert np.abs(off).max() < 0.25
    mesh = closed_mesh(skin, 0.02)
    solid = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.euler_number == 2


def test_an_outline_that_stands_out_is_left_out_and_its_points_are_used_where_they_fit() -> None:
    slices = ring_slices((np.arange(20) * 2.0).tolist(), cylinder, count=1500, sigma_mm=0.2)
    pieces = drawn(slices)
    moved = ring_slices([20.0], lambda turn, z: np.full_like(turn, 30.0), count=500, sigma_mm=0.2)
    pieces[10] = drawn(moved)[0]
    skin = skin_branch(only_branch(pieces))
    assert len(skin.branch.outlines) == 19
    u, v, places, _ = grid(skin)
    off = np.hypot(places[:, 0], places[:, 1]) - 50.0
    assert (np.abs(off) < 5.0 * skin.deviation_mm(u, v)).all()
    assert np.sqrt((off**2).mean()) < 0.03


def torus_slices(
    *, count: int = 600, sigma_mm: float = 0.15, beyond_mm: tuple[float, ...] = ()
) -> list[SliceOutlines]:
    """A torus of radii 40 and 12, lying flat: a loop with a hole in each slice, nothing beyond."""
    rng = np.random.default_rng(11)
    slices = []
    for height in -12.0 + 24.0 / 30 * (np.arange(30) + 0.5):
        wide = math.sqrt(144.0 - height**2)
        outer = rng.random(count) < (40 + wide) / 80.0
        slices.append(
            ring_slices(
                [float(height)],
                lambda turn, z, o=outer, w=wide: np.where(o, 40.0 + w, 40.0 - w),
                count=count,
                sigma_mm=sigma_mm,
                seed=int(1e6 + 1e3 * height),
            )[0]
        )
    beyond = [Frame(np.array([0.0, 0.0, height]), np.eye(3)) for height in beyond_mm]
    slices += [Slice(0, np.empty((0, 3)), frame) for frame in beyond]
    return drawn([Slice(k, each.points_mm, each.frame) for k, each in enumerate(slices)])


@pytest.mark.parametrize("beyond_mm", [(), (-12.4, 12.4)])
def test_a_torus_is_one_surface_that_closes_both_ways_in_any_order_of_slices(
    beyond_mm: tuple[float, ...],
) -> None:
    """Whether slices beyond it saw nothing, or none was taken there."""
    pieces = torus_slices(beyond_mm=beyond_mm)
    order = np.random.default_rng(12).permutation(len(pieces))
    found = skin_slices([pieces[k] for k in order])
    (skin,) = found.skins
    assert skin.branch.cyclic
    solid = trimesh.Trimesh(found.mesh.vertices_mm, found.mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.euler_number == 0
    _, _, places, _ = grid(skin)
    off = np.hypot(np.hypot(places[:, 0], places[:, 1]) - 40.0, places[:, 2]) - 12.0
    assert np.sqrt((off**2).mean()) < 0.06
    assert solid.volume == pytest.approx(2 * math.pi**2 * 40.0 * 144.0, rel=0.005)


def test_a_ring_that_is_cut_off_half_way_turns_over_once_and_is_closed_by_a_level_ring() -> None:
    pieces = [each for each in torus_slices() if each.height_mm > 0.0]
    found = skin_slices(pieces)
    (skin,) = found.skins
    assert not skin.branch.cyclic
    solid = trimesh.Trimesh(found.mesh.vertices_mm, found.mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.euler_number == 0
    # From z = 0 on, half a slice below the first one, that is half of it.
    assert solid.volume == pytest.approx(math.pi**2 * 40.0 * 144.0, rel=0.01)


def test_a_tube_with_a_bore_that_does_not_narrow_is_closed_by_level_rings() -> None:
    slices = []
    for index, height in enumerate(np.arange(12) * 2.0):
        outer, inner = (
            ring_slices([float(height)], lambda turn, z, r=r: np.full_like(turn, r), count=900,
                        sigma_mm=0.1, seed=10 * index + int(r))[0].points_mm
            for r in (30.0, 20.0)
        )  # fmt: skip
        frame = Frame(np.array([0.0, 0.0, height]), np.eye(3))
        slices.append(Slice(index, np.vstack([outer, inner]), frame))
    found = skin_slices(drawn(slices))
    solid = trimesh.Trimesh(found.mesh.vertices_mm, found.mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.euler_number == 0
    assert solid.volume == pytest.approx(math.pi * (900 - 400) * 24.0, rel=0.01)


def test_a_branch_of_few_outlines_still_has_a_surface() -> None:
    for heights in ([0.0, 2.0], [0.0, 2.0, 4.0]):
        branch: Branch = only_branch(
            drawn(ring_slices(heights, cylinder, count=1500, sigma_mm=0.1))
        )
        _, _, places, _ = grid(skin_branch(branch))
        assert np.abs(np.hypot(places[:, 0], places[:, 1]) - 50.0).max() < 0.15
