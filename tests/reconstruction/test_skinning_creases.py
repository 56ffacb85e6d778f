"""Edges of a part: corners that follow each other from slice to slice stay sharp in the surface."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from loftscan import reconstruct
from reconstruction.arrays import FloatArray
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.nurbs import evaluate_surface, evaluate_surface_at
from reconstruction.skinning.aligning import align, shares_along
from reconstruction.skinning.branching import find_branches
from reconstruction.skinning.creases import find_creases
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.skinning.edges import joined
from reconstruction.skinning.net import Net, knots_of
from reconstruction.skinning.skin import Skin
from reconstruction.slices import Frame, Slice

SIGMA_MM = 0.1
Corners = Callable[[float], FloatArray]  # height -> (n, 2)


def polygon(count: int, radius_mm: float, turn: float = 0.0) -> FloatArray:
    angle = turn + np.arange(count) * (math.tau / count)
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def ell(height_mm: float) -> FloatArray:
    del height_mm
    return np.array([[-20, -20], [20, -20], [20, 0], [0, 0], [0, 20], [-20, 20.0]])


def along(corners: FloatArray, count: int, seed: int) -> FloatArray:
    """Points along a polygon, one at random in each of even steps, with noise."""
    rng = np.random.default_rng(seed)
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    starts = np.concatenate([[0.0], lengths.cumsum()])
    at = (np.arange(count) + rng.random(count)) / count * starts[-1]
    side = np.searchsorted(starts, at, "right") - 1
    places = corners[side] + ((at - starts[side]) / lengths[side])[:, None] * sides[side]
    return places + rng.normal(0.0, SIGMA_MM, places.shape)


def piece(index: int, places: FloatArray) -> Slice:
    points = np.column_stack([places, np.full(len(places), float(index))])
    return Slice(index, points, Frame(np.array([0.0, 0.0, float(index)]), np.eye(3)))


def prism(corners: Corners, slices: int = 20, count: int = 600) -> list[Slice]:
    return [piece(k, along(corners(float(k)), count, k)) for k in range(slices)]


def skins_of(slices: list[Slice]) -> tuple[Skin, ...]:
    done = reconstruct(slices, method="fit").reconstruction
    assert isinstance(done, FittedReconstruction)
    assert done.mesh.faces.size
    return done.skinned.skins


def edges_off_mm(skin: Skin, corners: Corners) -> FloatArray:
    """How far places on the surface's edges, away from its ends, lie off the true ones."""
    net = skin.fit.net
    v = np.linspace(2.0, net.spans[1] - 2.0, 30)
    lines = evaluate_surface(net.surface(), net.creases.astype(np.float64), v)
    truth = [corners(float(place[2])) for place in lines.reshape(-1, 3)]
    off = [
        np.linalg.norm(each - place[:2], axis=1).min()
        for each, place in zip(truth, lines.reshape(-1, 3), strict=True)
    ]
    return np.array(off)


@pytest.mark.parametrize(
    ("corners", "edges"),
    [
        (lambda h: polygon(4, 28.0, 0.005 * h), 4),  # twisted
        (lambda h: polygon(6, 20.0 - 0.2 * h), 6),  # tapered, an obtuse one: some slices miss it
        (ell, 6),
    ],
)
def test_the_edges_of_a_prism_stay_where_its_faces_meet(corners: Corners, edges: int) -> None:
    (skin,) = skins_of(prism(corners))
    assert len(skin.fit.net.creases) == edges
    off = edges_off_mm(skin, corners)
    # A corner of one slice is known to about the noise; ten neighbours to either side say more.
    assert math.sqrt(float((off**2).mean())) < 0.25 * SIGMA_MM
    assert off.max() < SIGMA_MM


def test_a_square_hole_in_a_square_bar_has_edges_as_well() -> None:
    slices = [
        piece(
            k,
            np.concatenate(
                [along(polygon(4, 28.0), 700, k), along(polygon(4, 12.0), 400, 1000 + k)]
            ),
        )
        for k in range(14)
    ]
    outer, hole = skins_of(slices)
    assert (len(outer.fit.net.creases), len(hole.fit.net.creases)) == (4, 4)
    for skin, radius in ((outer, 28.0), (hole, 12.0)):
        off = edges_off_mm(skin, lambda _, size=radius: polygon(4, size))
        assert off.max() < SIGMA_MM


def outlines_of(slices: list[Slice]):
    drawn = [draw_outlines(each) for each in slices]
    heights = np.array([each.height_mm for each in drawn])
    return find_branches([each.outlines for each in drawn], heights).branches[0].outlines


def test_a_corner_that_one_slice_alone_shows_is_no_edge() -> None:
    angle = np.arange(600) * (math.tau / 600)
    oval = np.column_stack([25.0 * np.cos(angle), 18.0 * np.sin(angle)])
    rng = np.random.default_rng(5)
    slices = [piece(k, oval + rng.normal(0.0, SIGMA_MM, oval.shape)) for k in range(12)]
    slices[6] = piece(6, along(polygon(4, 26.0), 600, 6))
    outlines = outlines_of(slices)
    assert [len(each.fitted.creases) for each in outlines].count(0) == len(outlines) - 1
    sure, likely = find_creases(outlines, align(outlines, 120))
    assert sure.shape == likely.shape == (len(outlines), 0)


def test_an_edge_runs_through_a_slice_that_does_not_show_it() -> None:
    slices = prism(lambda _: polygon(4, 28.0), 14)
    angle = np.arange(600) * (math.tau / 600)
    # A square with round corners at the same places: |x + y|^6 + |x - y|^6 = const.
    radius = (np.abs(np.cos(angle + math.pi / 4)) ** 6 + np.sin(angle + math.pi / 4) ** 6) ** (
        -1 / 6
    )
    rounded = 19.8 * radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    noise = np.random.default_rng(5).normal(0.0, SIGMA_MM, rounded.shape)
    slices[5] = piece(5, rounded + noise)
    outlines = outlines_of(slices)
    assert outlines[5].fitted.creases == ()
    sure, _ = find_creases(outlines, align(outlines, 120))
    assert sure.shape[1] == 4
    u = np.linspace(0.0, 1.0, 4000, endpoint=False)
    shares, places = shares_along(outlines[5], u), outlines[5].fitted(u)
    for share in sure[5]:
        x, y = places[np.argmin(np.abs((shares - share + 0.5) % 1.0 - 0.5))]
        quarter = math.degrees(math.atan2(y, x)) / 90.0
        assert abs(quarter - round(quarter)) < 0.04  # under four degrees from a corner


# -- nets with creases -------------------------------------------------------------------------


def folded_sheet() -> Net:
    """A tube of square section, its four edges creases, u = 1, 3, 5, 7."""
    creases = np.array([1, 3, 5, 7])
    smooth = knots_of(8, closed=True, creases=creases)
    count, knots_v = len(smooth) - 7, knots_of(3, closed=False)
    abscissae = (smooth[1:-3] + smooth[2:-2] + smooth[3:-1])[:count] / 3.0
    corners = polygon(4, 10.0, -math.pi / 4)
    side = np.floor((abscissae - 1.0) / 2.0).astype(int)
    share = ((abscissae - 1.0) / 2.0 - side)[:, None]
    planar = (1.0 - share) * corners[side % 4] + share * corners[(side + 1) % 4]
    control = np.zeros((count, 6, 3))
    control[..., :2] = planar[:, None]
    control[..., 2] = np.arange(6.0) * 4.0
    net = Net(control, smooth, knots_v, True, False, np.zeros(6, np.bool_))  # noqa: FBT003
    return net.cut_at(creases)


def test_a_net_hands_out_its_creases_as_triple_knots_and_the_same_surface() -> None:
    net = folded_sheet()
    np.testing.assert_array_equal(net.creases, [1, 3, 5, 7])
    surface = net.surface()
    values, times = np.unique(surface.knots_u, return_counts=True)
    assert all(times[values == crease] == 3 for crease in net.creases)
    u = np.linspace(0.0, 8.0, 200, endpoint=False)
    places = evaluate_surface_at(surface, u, np.full(200, 1.3))
    # On the square: the farther coordinate is that of a face.
    np.testing.assert_allclose(np.abs(places[:, :2]).max(axis=1), 10.0 / math.sqrt(2), atol=1e-12)


def test_columns_that_meet_go_where_the_moved_faces_meet() -> None:
    net = folded_sheet()
    normals = np.zeros_like(net.control_mm)
    pushed = np.array([0.3, -0.2, 0.5, 0.0])  # of each face, along its normal
    bounds = [0, *net.crease_columns[:, 1], len(normals)]
    moves = np.zeros(normals.shape[:2])
    for face, start, end in zip([3, 0, 1, 2, 3], bounds[:-1], bounds[1:], strict=True):
        angle = face * math.pi / 2
        normals[start:end] = [math.cos(angle), math.sin(angle), 0.0]
        moves[start:end] = pushed[face]
    moved = net
    for _ in range(6):  # a ridge leaves a fiftieth for the next round
        control = moved.control_mm + moves[..., None] * normals
        fresh = moved.moved(joined(moved, control, moves, normals))
        done = ((fresh.control_mm - moved.control_mm) * normals).sum(axis=2)
        moves, moved = moves - done, fresh
    half = 10.0 / math.sqrt(2)
    right, top, left, bottom = half + pushed
    wanted = np.array([[right, -bottom], [right, top], [-left, top], [-left, -bottom]])
    found = moved.control_mm[net.crease_columns[:, 0], 2, :2]
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    np.testing.assert_array_equal(
        moved.control_mm[net.crease_columns[:, 0]], moved.control_mm[net.crease_columns[:, 1]]
    )
    # No column of a face was overrun: they run on in order.
    places = evaluate_surface_at(moved.surface(), np.linspace(1.0, 3.0, 50), np.full(50, 1.0))
    assert (np.diff(places[:, 1]) > 0.0).all()
