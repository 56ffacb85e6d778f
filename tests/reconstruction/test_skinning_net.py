"""Nets under way: derivatives, foot points, and the rows they add to a system."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.nurbs import basis_derivatives, evaluate_surface_at, surface_derivatives
from reconstruction.skinning.assembly import add_data, add_stiffness, empty_system
from reconstruction.skinning.bending import row_values, stiffness_rows
from reconstruction.skinning.blocks import Blocks, factorise, inverse_blocks
from reconstruction.skinning.feet import find_feet
from reconstruction.skinning.net import Net, basis_at, derivatives_at, knots_of
from reconstruction.skinning.noise import Noise
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.refining import refined
from reconstruction.skinning.unknowns import Unknowns, applied, unknowns_of
from reconstruction.skinning.variances import row_variances, variances_across
from tests.reconstruction.skinning_parts import torus_net, tube_net

NETS = {
    "tube": tube_net(),
    "short": tube_net(spans=(40, 4)),  # lines are columns
    "tip": tube_net(apex=True),
    "torus": torus_net(),
}
UP = np.array([0.0, 0.0, 1.0])


def somewhere(net: Net, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, net.spans[0], count), rng.uniform(0.0, net.spans[1], count)


def dense(matrix: Blocks) -> np.ndarray:
    blocks, size, length = matrix.panels.shape
    out = np.zeros((blocks * size, (blocks * size) + length))
    for k, panel in enumerate(matrix.panels):
        out[k * size : (k + 1) * size, k * size : k * size + length] = panel
    upper = np.triu(out[:, : blocks * size])
    return upper + np.triu(upper, 1).T


def jacobian(net: Net, unknowns: Unknowns, u: np.ndarray, v: np.ndarray, normals) -> np.ndarray:
    """How far each unknown moves the surface along normals, one unknown after the other."""
    size = unknowns.count
    rows = np.empty((len(u), size))
    before = evaluate_surface_at(net.surface(), u, v)
    for k in range(size):
        moves = np.zeros(size)
        moves[k] = 1.0
        after = evaluate_surface_at(net.moved(applied(net, unknowns, moves)).surface(), u, v)
        rows[:, k] = ((after - before) * normals).sum(axis=1)
    return rows


@pytest.mark.parametrize("name", NETS)
def test_derivatives_are_those_of_the_surface(name: str) -> None:
    net = NETS[name]
    u, v = somewhere(net, 50, 1)
    found, truth = derivatives_at(net, u, v), surface_derivatives(net.surface(), u, v, 2)
    orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    for k, (a, b) in enumerate(orders):
        assert found[:, k] == pytest.approx(truth[a, b], abs=1e-11)


@pytest.mark.parametrize("name", NETS)
def test_a_foot_point_is_where_the_arm_is_a_normal(name: str) -> None:
    net = NETS[name]
    u, v = somewhere(net, 200, 2)
    inner = np.clip(v, 0.5, net.spans[1] - 1.0)
    frames = derivatives_at(net, u, inner)
    normals = np.cross(frames[:, 1], frames[:, 2])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = np.random.default_rng(3).uniform(-0.8, 0.8, 200)
    cells = Moments(np.ones(200), frames[:, 0] + away[:, None] * normals, np.zeros((200, 3, 3)))
    feet = find_feet(net, cells, u + 0.2, inner - 0.2, np.zeros((3, 3)), rounds=12)
    assert feet.distances_mm == pytest.approx(away, abs=1e-7)


def test_a_cell_of_noisy_points_stands_where_the_points_do_not() -> None:
    """Both biases of a bent wall, arc and noise, are taken out: what is left is a tenth."""
    radius, sigma, arc = 10.0, 0.6, 0.5
    net = tube_net(radius, spans=(96, 6))
    true_radius = np.hypot(*evaluate_surface_at(net.surface(), np.zeros(1), np.ones(1))[0, :2])
    rng = np.random.default_rng(4)
    turn = rng.uniform(-arc / 2, arc / 2, 400_000)
    points = np.column_stack(
        [true_radius * np.cos(turn), true_radius * np.sin(turn), rng.uniform(9.0, 11.0, len(turn))]
    )
    points += rng.normal(0.0, sigma, points.shape)
    whole = Moments(np.array([4e5]), points.mean(axis=0)[None], np.cov(points.T)[None])
    single = Moments(np.ones(4000), points[:4000], np.zeros((4000, 3, 3)))
    noise = sigma**2 * np.eye(3)
    off = find_feet(net, whole, np.zeros(1), np.full(1, 3.0), noise, rounds=8).distances_mm[0]
    bare = np.hypot(*points.mean(axis=0)[:2]) - true_radius
    assert bare < -0.09  # the arc alone: -R arc^2 / 24
    assert abs(off) < 0.1 * abs(bare)
    start = np.mod(np.arctan2(points[:4000, 1], points[:4000, 0]) / math.tau, 1.0) * net.spans[0]
    alone = find_feet(net, single, start, np.full(4000, 3.0), noise, rounds=8).distances_mm
    outward = np.hypot(*points[:4000, :2].T).mean() - true_radius
    assert abs(alone.mean() - (outward - sigma**2 / (2 * radius))) < 1e-3


@pytest.mark.parametrize("name", NETS)
def test_data_enter_the_system_as_their_jacobian_says(name: str) -> None:
    net = NETS[name]
    unknowns = unknowns_of(net, (UP, None) if name != "torus" else (None, None))
    u, v = somewhere(net, 40, 5)
    rng = np.random.default_rng(6)
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances, weights = rng.normal(size=40), rng.uniform(0.5, 2.0, 40)
    at = (
        basis_at(u, net.knots_u, 0, closed=net.closed_u),
        basis_at(v, net.knots_v, 0, closed=net.closed_v),
    )
    matrix, right = empty_system(unknowns)
    add_data((matrix, right), net, unknowns, at, normals, distances, weights)
    rows = jacobian(net, unknowns, u, v, normals)
    assert dense(matrix) == pytest.approx(rows.T @ (weights[:, None] * rows), abs=1e-10)
    assert right.ravel() == pytest.approx(rows.T @ (weights * distances), abs=1e-10)


@pytest.mark.parametrize("name", NETS)
def test_rows_of_the_stiffness_say_how_they_change(name: str) -> None:
    net = NETS[name]
    unknowns = unknowns_of(net, (None, None))
    size = unknowns.count
    moves = np.random.default_rng(7).normal(0.0, 1e-4, size)
    moved = net.moved(applied(net, unknowns, moves))
    for before, after in zip(
        stiffness_rows(net, unknowns), stiffness_rows(moved, unknowns), strict=True
    ):
        # To first order: moves of 1e-4 leave some 1e-8, turns of the normals among it.
        change = after.values_mm - before.values_mm
        assert row_values(before, moves) == pytest.approx(change, abs=1e-7)
        assert np.abs(change).max() > 1e-4


def test_circles_and_straight_lines_cost_nothing() -> None:
    for name, which in (("tube", (0, 1)), ("torus", (0,))):
        net = NETS[name]
        rows = stiffness_rows(net, unknowns_of(net, (None, None)))
        for each in which:
            assert np.abs(rows[each].values_mm).max() < 1e-9


@pytest.mark.parametrize("name", NETS)
def test_variances_are_those_of_the_dense_inverse(name: str) -> None:
    net = NETS[name]
    unknowns = unknowns_of(net, (None, None))
    system = empty_system(unknowns)
    rows = stiffness_rows(net, unknowns)
    for each in rows:
        add_stiffness(system, each, np.full(len(each.values_mm), 2.0))
    system[0].diagonal[:] += 1.0
    truth = np.linalg.inv(dense(system[0]))
    factor = factorise(system[0])
    assert factor is not None
    inverse = inverse_blocks(factor)
    for each in rows:
        wide = np.zeros((len(each.values_mm), len(truth)))
        for k in range(each.numbers.shape[1]):
            there = each.numbers[:, k] >= 0
            wide[np.flatnonzero(there), each.numbers[there, k]] += each.slopes[there, k]
        expected = np.einsum("ri,ij,rj->r", wide, truth, wide)
        assert row_variances(each, inverse) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    u, v = somewhere(net, 20, 8)
    normals = np.tile([0.6, 0.0, 0.8], (20, 1))
    at = (
        basis_at(u, net.knots_u, 0, closed=net.closed_u),
        basis_at(v, net.knots_v, 0, closed=net.closed_v),
    )
    slopes = jacobian(net, unknowns, u, v, normals)
    expected = np.einsum("ri,ij,rj->r", slopes, truth, slopes)
    found = variances_across(inverse, net, unknowns, at, normals)
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", NETS)
def test_a_variance_does_not_depend_on_the_places_asked_for_with_it(name: str) -> None:
    net = NETS[name]
    unknowns = unknowns_of(net, (None, None))
    system = empty_system(unknowns)
    for each in stiffness_rows(net, unknowns):
        add_stiffness(system, each, np.full(len(each.values_mm), 2.0))
    system[0].diagonal[:] += 1.0
    factor = factorise(system[0])
    assert factor is not None
    inverse = inverse_blocks(factor)
    u, v = somewhere(net, 60, 4)
    normals = np.random.default_rng(5).normal(size=(60, 3))

    def variances(chosen: np.ndarray) -> np.ndarray:
        at = (
            basis_at(u[chosen], net.knots_u, 0, closed=net.closed_u),
            basis_at(v[chosen], net.knots_v, 0, closed=net.closed_v),
        )
        return variances_across(inverse, net, unknowns, at, normals[chosen])

    alone = np.concatenate([variances(np.array([k])) for k in range(60)])
    order = np.random.default_rng(6).permutation(60)
    np.testing.assert_array_equal(variances(order), alone[order])
    assert variances(order[:0]).shape == (0,)


def test_both_sizes_of_the_noise_are_told_by_the_residuals() -> None:
    rng = np.random.default_rng(9)
    normals = rng.normal(size=(20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    truth = Noise(0.04, 0.0025, UP)
    squares = truth.across(normals) * rng.normal(size=20_000) ** 2
    found = Noise(1.0, 1.0, UP).looked_at_again(normals, squares, np.ones(20_000), 0.0)
    assert found.level_mm2 == pytest.approx(0.04, rel=0.05)
    assert found.rise_mm2 == pytest.approx(0.0025, rel=0.15)


@pytest.mark.parametrize("along", [(True, False), (False, True), (True, True)])
@pytest.mark.parametrize("name", NETS)
def test_spans_are_halved_without_changing_the_surface(name: str, along: tuple[bool, bool]) -> None:
    net = NETS[name]
    fine = refined(net, along)
    assert fine.spans == (net.spans[0] * (1 + along[0]), net.spans[1] * (1 + along[1]))
    u, v = somewhere(net, 60, 8)
    before = evaluate_surface_at(net.surface(), u, v)
    after = evaluate_surface_at(fine.surface(), u * (1 + along[0]), v * (1 + along[1]))
    assert after == pytest.approx(before, abs=1e-11)
    assert fine.apex.sum() == net.apex.sum()


@pytest.mark.parametrize("spans", [6, 13])
@pytest.mark.parametrize("creases", [[], [2, 5]])
def test_cubics_on_integer_knots_are_those_of_any_knots(spans: int, creases: list[int]) -> None:
    for closed in (False, True):
        knots = knots_of(spans, closed=closed, creases=np.array(creases, dtype=np.int64))
        t = np.append(np.random.default_rng(9).uniform(0.0, spans, 200), np.arange(spans + 1.0))
        found = basis_at(t, knots, 2, closed=closed)
        first, values = basis_derivatives(t, 3, knots, 2, periodic=closed)
        assert (found.first == first - 3).all()
        assert found.values == pytest.approx(np.moveaxis(values, 0, 1), abs=1e-13)
