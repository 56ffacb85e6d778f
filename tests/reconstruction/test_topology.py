"""Shuffled points to chains: loops, gaps, strays, nesting, open runs."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.fitting.topology import Topology, find_chains
from tests.reconstruction.topology_cases import (
    arc,
    cloud,
    corner,
    ellipse,
    evenly,
    fault,
    letter_s,
    overlapping,
    signed_area,
    superformula,
    with_outliers,
)

SHAPES = {"circle": ellipse(50, 50), "ellipse": ellipse(60, 30), "lobes": superformula()}
SETTINGS = [(0.5, 5.0), (0.5, 40.0), (2.0, 5.0), (2.0, 40.0)]  # band in mm, points per mm


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
@pytest.mark.parametrize("gap_degrees", [0.0, 20.0])
def test_a_loop_is_found_closed_and_in_order_gap_or_not(
    name: str, band_mm: float, per_mm: float, gap_degrees: float
) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        points = cloud(SHAPES[name], rng, per_mm=per_mm, band_mm=band_mm, gap_degrees=gap_degrees)
        (chain,) = find_chains(points).chains
        assert chain.closed
        assert fault(chain, SHAPES[name], band_mm=band_mm, gap_mm=2.5 * gap_degrees) == ""
        assert len(chain.gaps) >= (gap_degrees > 0)


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_where_a_sixth_of_a_circle_is_missing_a_loop_is_likely_but_in_doubt(
    band_mm: float, per_mm: float
) -> None:
    rng = np.random.default_rng(5)
    points = cloud(SHAPES["circle"], rng, per_mm=per_mm, band_mm=band_mm, gap_degrees=60.0)
    (chain,) = find_chains(points).chains
    assert chain.closed
    assert chain.ambiguous
    assert len(chain.gaps) == 1
    assert fault(chain, SHAPES["circle"], band_mm=band_mm, gap_mm=60.0) == ""


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_an_arc_of_300_degrees_is_the_same_points_and_the_same_answer(
    band_mm: float, per_mm: float
) -> None:
    outline = arc(50.0, 300.0)
    rng = np.random.default_rng(1)
    points = cloud(outline, rng, per_mm=per_mm, band_mm=band_mm, closed=False)
    (chain,) = find_chains(points).chains
    assert chain.ambiguous
    assert fault(chain, outline, band_mm=band_mm, closed=False) == ""


OPEN = {
    "corner": corner,
    "letter S": lambda: letter_s(20.0),
    "half circle": lambda: arc(50.0, 180.0),
    "straight": lambda: evenly(np.array([[0.0, 0.0], [70.0, 20.0]]), closed=False),
}


@pytest.mark.parametrize("name", OPEN)
@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_a_run_whose_ends_do_not_face_each_other_stays_open(
    name: str, band_mm: float, per_mm: float
) -> None:
    outline = OPEN[name]()
    rng = np.random.default_rng(2)
    points = cloud(outline, rng, per_mm=per_mm, band_mm=band_mm, closed=False)
    (chain,) = find_chains(points).chains
    assert not chain.closed
    assert not chain.ambiguous
    assert fault(chain, outline, band_mm=band_mm, closed=False) == ""


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_ends_that_run_past_each_other_five_thicknesses_apart_are_not_joined(
    band_mm: float, per_mm: float
) -> None:
    outline = overlapping(5.0 * band_mm)
    rng = np.random.default_rng(3)
    points = cloud(outline, rng, per_mm=per_mm, band_mm=band_mm, closed=False)
    (chain,) = find_chains(points).chains
    assert not chain.closed
    assert fault(chain, outline, band_mm=band_mm, closed=False) == ""


def matched(found: Topology, outlines: list[FloatArray], band_mm: float) -> list[int]:
    """The chain of each outline; every chain must have one."""
    assert len(found.chains) == len(outlines)
    numbers = [
        next(
            n for n, chain in enumerate(found.chains) if not fault(chain, outline, band_mm=band_mm)
        )
        for outline in outlines
    ]
    assert sorted(numbers) == list(range(len(outlines)))
    return numbers


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_loops_are_told_apart_and_a_hole_runs_clockwise(band_mm: float, per_mm: float) -> None:
    outlines = [ellipse(50, 50), ellipse(30, 30), ellipse(12, 16, (75.0, 0.0))]
    rng = np.random.default_rng(4)
    clouds = [cloud(outline, rng, per_mm=per_mm, band_mm=band_mm) for outline in outlines]
    found = find_chains(np.vstack(clouds))
    numbers = matched(found, outlines, band_mm)
    assert [found.depths[n] for n in numbers] == [0, 1, 0]
    turns = [signed_area(found.chains[n].nodes_mm) for n in numbers]
    assert turns[0] > 0 > turns[1]
    assert turns[2] > 0


def test_every_point_knows_its_chain() -> None:
    outlines = [ellipse(30, 30), ellipse(15, 15, (60.0, 10.0)), ellipse(20, 20, (0.0, 70.0))]
    rng = np.random.default_rng(6)
    clouds = [cloud(outline, rng, per_mm=10.0, band_mm=1.0) for outline in outlines]
    found = find_chains(np.vstack(clouds))
    numbers = matched(found, outlines, 1.0)
    truth = np.repeat(numbers, [len(points) for points in clouds])
    np.testing.assert_array_equal(found.chain_of_point, truth)


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_strays_are_set_aside_and_do_not_bend_a_loop(band_mm: float, per_mm: float) -> None:
    outline = SHAPES["lobes"]
    rng = np.random.default_rng(7)
    clean = cloud(outline, rng, per_mm=per_mm, band_mm=band_mm)
    found = find_chains(with_outliers(clean, rng, 0.02))
    (chain,) = found.chains
    assert chain.closed
    assert fault(chain, outline, band_mm=band_mm) == ""
    # A few of them fall on the band itself.
    assert 0.6 * 0.02 * len(clean) < len(found.strays) <= 0.02 * len(clean) * 1.1


@pytest.mark.parametrize("band_mm", [0.5, 2.0])
@pytest.mark.parametrize("per_mm", [5.0, 40.0])
def test_the_thickness_and_the_spacing_are_those_that_were_put_in(
    band_mm: float, per_mm: float
) -> None:
    rng = np.random.default_rng(8)
    found = find_chains(cloud(SHAPES["ellipse"], rng, per_mm=per_mm, band_mm=band_mm))
    assert found.band_mm == pytest.approx(band_mm, rel=0.12)
    assert found.width_mm == pytest.approx(found.band_mm * 4.0 / math.sqrt(12.0))
    assert found.spacing_mm == pytest.approx(1.0 / per_mm, rel=0.05)


def test_a_hundred_points_in_a_band_of_half_a_radius_are_one_loop() -> None:
    outline = ellipse(50, 50)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        points = cloud(outline, rng, per_mm=100 / (100 * math.pi), band_mm=25.0)
        (chain,) = find_chains(points).chains
        assert chain.closed
        assert fault(chain, outline, band_mm=25.0) == ""


def test_few_exact_points_go_in_single_file_through_a_narrow_slot() -> None:
    slot = np.array([[0, 0], [60, 0], [60, 40], [33, 40], [33, 8], [30, 8], [30, 40], [0, 40.0]])
    outline = evenly(slot, closed=True)
    points = np.random.default_rng(9).permutation(outline[:: round(1.5 / 0.05)])
    (chain,) = find_chains(points).chains
    assert chain.closed
    assert fault(chain, outline, band_mm=0.8) == ""


def test_the_answer_does_not_depend_on_the_order_of_the_points() -> None:
    rng = np.random.default_rng(10)
    points = cloud(SHAPES["ellipse"], rng, per_mm=5.0, band_mm=1.0)
    one, other = find_chains(points), find_chains(points[::-1])
    np.testing.assert_array_equal(one.chains[0].nodes_mm, other.chains[0].nodes_mm)
    np.testing.assert_array_equal(one.chain_of_point, other.chain_of_point[::-1])


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_chains_scale_with_the_part(factor: float) -> None:
    rng = np.random.default_rng(11)
    points = cloud(SHAPES["circle"], rng, per_mm=5.0, band_mm=1.0)
    small, big = find_chains(points), find_chains(factor * points)
    np.testing.assert_allclose(
        big.chains[0].nodes_mm, factor * small.chains[0].nodes_mm, rtol=1e-6, atol=1e-9 * factor
    )
    assert big.sigma_mm == pytest.approx(factor * small.sigma_mm, rel=1e-6)


def test_half_a_million_points_cost_less_than_a_quarter_of_a_second() -> None:
    # Ten times what it takes on a machine to itself: this one may be busy.
    points = cloud(SHAPES["circle"], np.random.default_rng(12), per_mm=1466.8, band_mm=2.0)
    find_chains(points)
    begun = time.process_time()
    (chain,) = find_chains(points).chains
    assert time.process_time() - begun < 0.25
    assert len(points) > 460_000
    assert fault(chain, SHAPES["circle"], band_mm=2.0) == ""
