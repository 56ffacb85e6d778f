"""The walk against the paper's rule in plain Python, and on contours with gaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray, IntArray
from reconstruction.errors import TooFewPoints
from reconstruction.nurbs import Curve, curve_derivatives, evaluate_curve
from reconstruction.ordering import Contour, Walk, walk_contour
from reconstruction.paper import draw_curve
from reconstruction.reduction import Cells, reduce_points
from tests.reconstruction.part_cases import band

Place = tuple[int, int]


def cells_at(places: list[Place], rng: np.random.Generator, *, side_mm: float = 1.0) -> Cells:
    """Occupied cells with random counts and centres of mass."""
    lattice = np.column_stack([np.array(sorted(places)), np.zeros(len(places), dtype=int)])
    inside = np.column_stack([rng.uniform(0.0, 1.0, (len(places), 2)), np.zeros(len(places))])
    counts = rng.integers(1, 30, len(places))
    return Cells((side_mm, side_mm, math.inf), lattice, side_mm * (lattice + inside), counts)


def naive_walk(cells: Cells) -> tuple[list[int], bool, set[int]]:
    """The paper's section 2.3 by hand: path, whether it came back, walked or eliminated cells."""
    at = {(int(i), int(j)): n for n, (i, j, _) in enumerate(cells.lattice)}
    place = {n: where for where, n in at.items()}

    def region(n: int) -> list[int]:
        i, j = place[n]
        around = [(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
        return [at[where] for where in around if where in at]

    def product(here: int, n: int) -> float:
        away = cells.centres_mm[n, :2] - cells.centres_mm[here, :2]
        return float(cells.counts[n] * math.hypot(*away))

    path = [max(range(len(cells)), key=lambda n: cells.counts[n])]
    gone = {path[0]}
    while True:
        here = path[-1]
        if len(path) > 4 and path[0] in region(here):
            return path, True, gone
        living = [n for n in region(here) if n not in gone]
        if not living:
            return path, False, gone
        chosen = max(living, key=lambda n: product(here, n))
        # At the first step what lies behind stays, so that the walk can come back through it.
        gone |= set(region(here)) & set(region(chosen) if len(path) == 1 else region(here))
        gone.add(chosen)
        path.append(chosen)


def assert_walked_alike(cells: Cells) -> Contour:
    contour = walk_contour(cells, walk=Walk.PURE)
    path, closed, gone = naive_walk(cells)
    assert contour.cells.tolist() == path
    assert contour.closed is closed
    assert set(np.flatnonzero(contour.visited).tolist()) == gone
    np.testing.assert_array_equal(contour.points_mm, cells.centres_mm[path, :2])
    np.testing.assert_array_equal(contour.counts, cells.counts[path])
    expected = np.zeros(len(path), dtype=bool)
    expected[-1] = not closed
    np.testing.assert_array_equal(contour.bridged, expected)
    return contour


patterns = st.sets(st.tuples(st.integers(-6, 6), st.integers(-6, 6)), min_size=3, max_size=120)


@given(patterns, st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_on_any_pattern_of_cells_the_pure_walk_is_the_papers(places: set[Place], seed: int) -> None:
    assert_walked_alike(cells_at(list(places), np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("cell_mm", [0.8, 2.0, 4.0])
def test_on_a_band_the_pure_walk_is_the_papers(seed: int, cell_mm: float) -> None:
    assert_walked_alike(paper_cells(seed, cell_mm))


def paper_cells(seed: int, cell_mm: float) -> Cells:
    """Circle of 100 mm diameter, band of 2 mm, 40 points a mm of arc, random grid offset."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(0.0, cell_mm, 2)
    planar = band(rng) + offset
    points = np.column_stack([planar, np.zeros(len(planar))])
    cells = reduce_points(points, size_mm=(cell_mm, cell_mm, math.inf), origin_mm=np.zeros(3))
    centres = cells.centres_mm - np.array([*offset, 0.0])
    return Cells(cells.size_mm, cells.lattice, centres, cells.counts)


def turning(curve: Curve) -> float:
    """Total turning of a plane curve, in full turns: 1 for a convex one, more where it waves."""
    start, end = curve.domain
    parameters = np.linspace(start, end, 8 * len(curve.control_points_mm), endpoint=False)
    ways = curve_derivatives(curve, parameters, order=1)[1]
    angles = np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))
    return float(np.abs(np.diff(angles)).sum() / (2.0 * math.pi))


def test_the_papers_figure_6_comes_out_on_fifty_clouds() -> None:
    squares, turns_at_4, turns_at_08, closures = [], [], [], 0
    for seed in range(50):
        coarse = walk_contour(paper_cells(seed, 4.0), walk=Walk.PURE)
        assert coarse.closed
        assert abs(coarse.turns) == pytest.approx(1.0, abs=1e-9)
        curve = draw_curve(coarse)
        points = evaluate_curve(curve, np.linspace(0.0, len(coarse.points_mm), 1000))
        squares.append(np.mean((np.hypot(points[:, 0], points[:, 1]) - 50.0) ** 2))
        fine = walk_contour(paper_cells(seed, 0.8), walk=Walk.PURE)
        closures += fine.closed and abs(fine.turns) > 0.99
        turns_at_4.append(turning(curve))
        turns_at_08.append(turning(draw_curve(fine)) if len(fine.points_mm) > 40 else math.nan)
    assert math.sqrt(np.mean(squares)) <= 0.18
    assert closures <= 25  # "the curve is not uniform": most walks lose themselves
    assert np.nanmean(turns_at_08) >= 3.0 * np.mean(turns_at_4)


def gapped_circle(
    gaps: list[tuple[float, float]], *, radius_mm: float = 20.0, seed: int = 0
) -> tuple[Cells, FloatArray]:
    """A thin band at 1 mm cells without the given intervals of angle."""
    rng = np.random.default_rng(seed)
    planar = band(rng, radius_mm=radius_mm, width_mm=0.4)
    angle = np.arctan2(planar[:, 1], planar[:, 0]) % (2.0 * math.pi)
    for low, high in gaps:
        planar, angle = (
            planar[~((angle > low) & (angle < high))],
            angle[~((angle > low) & (angle < high))],
        )
    points = np.column_stack([planar, np.zeros(len(planar))])
    return reduce_points(points, size_mm=(1.0, 1.0, math.inf), origin_mm=np.zeros(3)), planar


def bridged_angles(contour: Contour) -> list[tuple[float, float]]:
    """From and to which angle each bridged segment leads, counter-clockwise."""
    following = np.roll(contour.points_mm, -1, axis=0)
    ends = np.stack([contour.points_mm, following])[:, contour.bridged]
    angles = np.arctan2(ends[..., 1], ends[..., 0]) % (2.0 * math.pi)
    if contour.turns < 0:
        angles = angles[::-1]
    return sorted((float(a), float(b)) for a, b in angles.T)


@pytest.mark.parametrize("seed", range(6))
def test_the_widening_walk_crosses_gaps_and_tells_exactly_which(seed: int) -> None:
    gaps = [(0.6, 1.0), (2.0, 2.35), (4.4, 5.1)]
    cells, _ = gapped_circle(gaps, seed=seed)
    contour = walk_contour(cells)
    assert contour.closed
    assert abs(contour.turns) == pytest.approx(1.0, abs=1e-9)
    found = bridged_angles(contour)
    assert len(found) == len(gaps)
    # A centre of mass lies within two cells, 2 / 20 rad, of the gap's border.
    np.testing.assert_allclose(found, gaps, atol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_the_pure_walk_stops_at_a_gap(seed: int) -> None:
    cells, _ = gapped_circle([(2.0, 2.4)], seed=seed)
    contour = walk_contour(cells, walk=Walk.PURE)
    assert not contour.closed
    assert contour.bridged.tolist() == [False] * (len(contour.points_mm) - 1) + [True]


@pytest.mark.parametrize("seed", range(6))
def test_an_arc_is_walked_from_end_to_end_although_the_walk_begins_within(seed: int) -> None:
    cells, planar = gapped_circle([(1.0, 3.0)], seed=seed)
    contour = walk_contour(cells, reach_mm=3.0)
    assert not contour.closed
    assert np.flatnonzero(contour.bridged).tolist() == [len(contour.points_mm) - 1]
    ends = np.sort(np.arctan2(*contour.points_mm[[0, -1]].T[::-1]) % (2.0 * math.pi))
    np.testing.assert_allclose(ends, [1.0, 3.0], atol=0.1)
    assert cells.counts[contour.visited].sum() >= 0.95 * len(planar)


@pytest.mark.parametrize("seed", range(6))
def test_gaps_within_an_arc_stay_marked_when_the_walk_turns_round(seed: int) -> None:
    cells, _ = gapped_circle([(1.0, 3.0), (3.8, 4.0), (5.5, 5.7)], seed=seed)
    contour = walk_contour(cells, reach_mm=8.0)
    assert not contour.closed
    steps = contour.segments_mm
    # A step within the band is at most two cells long, diagonally; a gap is 4 mm of arc wide.
    np.testing.assert_array_equal(np.flatnonzero(contour.bridged), np.flatnonzero(steps > 3.0))
    assert contour.bridged.sum() == 3


def test_a_gap_is_crossed_onwards_and_not_into_the_other_side_of_the_part() -> None:
    # Two walls 4 cells apart, a gap of 3 cells in the upper one. The cells behind the gap hold 12
    # points, others 10: diagonally across it would be count x distance = 56 against 48.
    walls = [(i, j) for i in range(30) for j in (0, 4) if (i, j) not in [(24, 4), (25, 4), (26, 4)]]
    places = sorted([*walls, *[(i, j) for i in (-1, 30) for j in (1, 2, 3)]])
    lattice = np.column_stack([np.array(places), np.zeros(len(places), dtype=int)])
    counts = np.array([12 if place in [(23, 4), (27, 4)] else 10 for place in places])
    counts[places.index((5, 0))] = 50
    contour = walk_contour(Cells((1.0, 1.0, math.inf), lattice, lattice + 0.5, counts))
    assert contour.closed
    (bridge,) = np.flatnonzero(contour.bridged)
    ends = contour.points_mm[[bridge, (bridge + 1) % len(contour.points_mm)]]
    assert sorted(ends[:, 0]) == [23.5, 27.5]
    assert (ends[:, 1] == 4.5).all()


def test_a_gap_wider_than_the_reach_is_not_crossed_and_a_narrower_one_is() -> None:
    cells, _ = gapped_circle([(1.0, 1.4)])  # 8 mm of arc
    assert not walk_contour(cells, reach_mm=5.0).closed
    assert walk_contour(cells, reach_mm=11.0).closed


def diamond(size: int) -> list[Place]:
    """A ring one cell wide in which every cell touches just two others."""
    upper = [(i, size - abs(i)) for i in range(-size, size + 1)]
    return upper + [(i, -j) for i, j in upper if j > 0]


@pytest.mark.parametrize("walk", list(Walk))
@pytest.mark.parametrize("size", [2, 5, 9])
def test_a_ring_of_which_every_cell_is_walked_is_closed_too(walk: Walk, size: int) -> None:
    places = diamond(size)
    contour = walk_contour(cells_at(places, np.random.default_rng(size)), walk=walk)
    assert contour.closed
    assert not contour.bridged.any()
    assert sorted(contour.cells) == list(range(len(places)))


def test_of_two_contours_the_one_with_most_points_is_taken() -> None:
    rng = np.random.default_rng(1)
    large = band(rng, radius_mm=20.0, width_mm=0.4, points_a_mm=30.0)
    # Small but dense: the fullest cell is here, most of the points are there.
    small = band(rng, radius_mm=4.0, width_mm=0.2, points_a_mm=80.0, centre_mm=(60.0, 0.0))
    points = np.column_stack([np.concatenate([large, small]), np.zeros(len(large) + len(small))])
    cells = reduce_points(points, size_mm=(1.0, 1.0, math.inf))
    contour = walk_contour(cells, reach_mm=5.0)
    assert contour.closed
    assert (contour.points_mm[:, 0] < 30.0).all()


def test_segments_lead_round_and_a_ring_makes_one_turn() -> None:
    corners = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [0.0, 4.0]])
    square = contour_of(corners)
    np.testing.assert_allclose(square.segments_mm, [3.0, 4.0, 3.0, 4.0])
    assert square.turns == pytest.approx(1.0)
    assert contour_of(corners[::-1]).turns == pytest.approx(-1.0)
    assert contour_of(np.tile(corners, (2, 1))).turns == pytest.approx(2.0)


def contour_of(points_mm: FloatArray) -> Contour:
    count = len(points_mm)
    numbers: IntArray = np.arange(count)
    none = np.zeros(count, dtype=np.bool_)
    return Contour(points_mm, np.ones(count, dtype=np.int64), none, True, numbers, none)  # noqa: FBT003


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_cells_are_no_contour(count: int) -> None:
    points = np.arange(3.0 * count).reshape(count, 3)
    with pytest.raises(TooFewPoints, match="use finer cells"):
        walk_contour(reduce_points(points, size_mm=(1.0, 1.0, math.inf)))
