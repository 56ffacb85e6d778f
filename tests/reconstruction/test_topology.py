"""Shuffled points to chains: loops, gaps, strays, nesting, open runs, what is too near."""

from __future__ import annotations

import math
import time
from itertools import product

import numpy as np
import pytest

from reconstruction.fitting.crossing import crossings, ways_along
from reconstruction.fitting.topology import Topology, find_chains
from tests.reconstruction import topology_shapes as shapes
from tests.reconstruction.topology_cases import (
    Outline,
    Scene,
    Uneven,
    arc,
    campaign_shapes,
    corner,
    ellipse,
    evenly,
    letter_s,
    overlapping,
    scene,
)
from tests.reconstruction.topology_judge import Answer, Verdict, judge

SETTINGS = [(0.5, 5.0), (0.5, 40.0), (2.0, 5.0), (2.0, 40.0)]  # band in mm, points per mm
NAMES = ("circle", "ellipse", "superformula", "blob2", "simple")
SURE = Verdict(Answer.RIGHT, doubted=False)


def outline_of(name: str) -> Outline:
    outline = campaign_shapes().get(name)
    if outline is None:
        pytest.skip("no curve data: set LOFTSCAN_DATA")
    return outline


def found_in(made: Scene) -> tuple[Topology, Verdict]:
    found = find_chains(made.points_mm)
    return found, judge(found, made)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
@pytest.mark.parametrize("outliers", [0.0, 0.02])
def test_a_loop_is_found_closed_and_in_order_gap_and_strays_or_not(
    name: str, band_mm: float, per_mm: float, outliers: float
) -> None:
    # The small campaign: of benchmarks/topology.py two clouds a row.
    for seed, gap in product(range(2), (0.0, 20.0)):
        made = scene(outline_of(name), np.random.default_rng(seed), per_mm=per_mm,
                     band_mm=band_mm, gap_degrees=gap, outliers=outliers)  # fmt: skip
        assert found_in(made)[1].answer is Answer.RIGHT


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_where_a_sixth_is_missing_a_loop_is_likely_but_in_doubt(
    name: str, band_mm: float, per_mm: float
) -> None:
    made = scene(outline_of(name), np.random.default_rng(5), per_mm=per_mm, band_mm=band_mm,
                 gap_degrees=60.0)  # fmt: skip
    found, verdict = found_in(made)
    assert verdict.answer is not Answer.WRONG
    if name in ("circle", "ellipse", "simple"):
        assert verdict == Verdict(Answer.RIGHT, doubted=True)
        (opened,) = found.chains[0].other_reading()
        assert not opened.closed
        ends = np.linalg.norm(opened.nodes_mm[0] - opened.nodes_mm[-1])
        assert ends > 0.8 * 60.0 / 180.0 * math.pi * 30.0  # across the gap, not another hole


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_an_arc_of_300_degrees_is_the_same_points_and_the_same_answer(
    band_mm: float, per_mm: float
) -> None:
    made = scene(arc(50.0, 300.0), np.random.default_rng(1), per_mm=per_mm, band_mm=band_mm)
    found, verdict = found_in(made)
    assert verdict == Verdict(Answer.AMBIGUOUS, doubted=True)
    assert [chain.closed for chain in found.chains] == [True]


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
    made = scene(OPEN[name](), np.random.default_rng(2), per_mm=per_mm, band_mm=band_mm)
    assert found_in(made)[1] == SURE


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_ends_that_run_past_each_other_five_thicknesses_apart_are_not_joined(
    band_mm: float, per_mm: float
) -> None:
    outline = overlapping(5.0 * band_mm)
    made = scene(outline, np.random.default_rng(3), per_mm=per_mm, band_mm=band_mm)
    assert found_in(made)[1] == SURE


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS[1:])
def test_an_s_that_comes_within_five_thicknesses_of_itself_is_followed(
    band_mm: float, per_mm: float
) -> None:
    # Not at 5 points/mm in 0.5 mm: there chance leaves holes as wide as its strokes are apart.
    made = scene(shapes.tight_s(band_mm), np.random.default_rng(3), per_mm=per_mm, band_mm=band_mm)
    assert found_in(made)[1] == SURE


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_loops_are_told_apart_and_a_hole_runs_clockwise(band_mm: float, per_mm: float) -> None:
    outlines = [ellipse(50, 50), ellipse(30, 30), ellipse(12, 16, (75.0, 0.0))]
    found, verdict = found_in(scene(outlines, np.random.default_rng(4), per_mm=per_mm,
                                    band_mm=band_mm))  # fmt: skip
    assert verdict == SURE
    by_size = sorted(zip(found.chains, found.depths, strict=True), key=lambda f: -f[0].length_mm)
    assert [depth for _, depth in by_size] == [0, 1, 0]
    areas = [signed_area(chain.nodes_mm) for chain, _ in by_size]
    assert areas[0] > 0 > areas[1]
    assert areas[2] > 0


def signed_area(nodes: np.ndarray) -> float:
    """Positive for a counter-clockwise loop."""
    x, y = nodes.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2


def test_every_point_knows_its_chain() -> None:
    outlines = [ellipse(30, 30), ellipse(15, 15, (60.0, 10.0)), ellipse(20, 20, (0.0, 70.0))]
    made = scene(outlines, np.random.default_rng(6), per_mm=10.0, band_mm=1.0)
    found, verdict = found_in(made)
    assert verdict == SURE
    for number in range(3):
        assert len(set(found.chain_of_point[made.outline_of_point == number].tolist())) == 1


@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS)
def test_strays_are_set_aside(band_mm: float, per_mm: float) -> None:
    made = scene(outline_of("superformula"), np.random.default_rng(7), per_mm=per_mm,
                 band_mm=band_mm, outliers=0.02)  # fmt: skip
    found, verdict = found_in(made)
    assert verdict == SURE
    stray = found.chain_of_point < 0
    outlier = made.outline_of_point < 0
    # A few of them fall on the band itself.
    assert stray[outlier].mean() > 0.7
    assert stray[~outlier].mean() < 0.003


NEAR = {
    "concentric": shapes.concentric,
    "side by side": shapes.side_by_side,
    "spiral": shapes.spiral,
    "slot": shapes.slot,
    "clamp": shapes.clamp,
    "fins": lambda apart: shapes.fins(2 * apart),
}


@pytest.mark.parametrize("name", NEAR)
@pytest.mark.parametrize(("band_mm", "per_mm"), SETTINGS[1:])
def test_bands_three_thicknesses_apart_are_not_mixed(
    name: str, band_mm: float, per_mm: float
) -> None:
    made = scene(NEAR[name](3 * band_mm), np.random.default_rng(8), per_mm=per_mm, band_mm=band_mm)
    assert found_in(made)[1] == SURE


@pytest.mark.parametrize("name", NEAR)
def test_in_a_sparse_band_four_thicknesses_suffice(name: str) -> None:
    made = scene(NEAR[name](2.0), np.random.default_rng(0), per_mm=5.0, band_mm=0.5)
    assert found_in(made)[1].answer is Answer.RIGHT


MANY = [shapes.gear, shapes.rosette, shapes.beam, shapes.box, shapes.star, shapes.plate]


@pytest.mark.parametrize("make", MANY)
@pytest.mark.parametrize(("band_mm", "per_mm"), [(0.5, 40.0), (2.0, 5.0)])
def test_corners_teeth_and_holes_are_followed(make: object, band_mm: float, per_mm: float) -> None:
    assert callable(make)
    made = scene(make(), np.random.default_rng(1), per_mm=per_mm, band_mm=band_mm)
    assert found_in(made)[1] == SURE


UNEVEN = {
    "density 1:10": Uneven(sparsest=0.1),
    "one half 1:10": Uneven(sparsest=0.1, stepped=True),
    "band 1:4": Uneven(narrowest=0.25),
    "20 dropouts": Uneven(dropouts=20, dropout_mm=5.0),
    "6 long dropouts": Uneven(dropouts=6, dropout_mm=15.0),
}


@pytest.mark.parametrize("words", UNEVEN)
@pytest.mark.parametrize(("band_mm", "per_mm"), [(0.5, 40.0), (2.0, 40.0)])
def test_an_uneven_scan_of_a_loop_is_a_loop(words: str, band_mm: float, per_mm: float) -> None:
    made = scene(outline_of("circle"), np.random.default_rng(0), per_mm=per_mm, band_mm=band_mm,
                 uneven=UNEVEN[words])  # fmt: skip
    assert found_in(made)[1].answer is Answer.RIGHT


@pytest.mark.parametrize("band_mm", [0.5, 2.0])
@pytest.mark.parametrize("per_mm", [5.0, 40.0])
def test_the_thickness_and_the_spacing_are_those_that_were_put_in(
    band_mm: float, per_mm: float
) -> None:
    made = scene(ellipse(60, 30), np.random.default_rng(8), per_mm=per_mm, band_mm=band_mm)
    found = find_chains(made.points_mm)
    assert found.band_mm == pytest.approx(band_mm, rel=0.12)
    assert found.width_mm == pytest.approx(found.band_mm * 4.0 / math.sqrt(12.0))
    assert found.spacing_mm == pytest.approx(1.0 / per_mm, rel=0.05)


def test_a_hundred_points_in_a_band_of_half_a_radius_are_one_loop() -> None:
    for seed in range(5):
        made = scene(ellipse(50, 50), np.random.default_rng(seed), per_mm=100 / (100 * math.pi),
                     band_mm=25.0)  # fmt: skip
        assert found_in(made)[1] == SURE


def test_few_exact_points_go_in_single_file_through_a_narrow_slot() -> None:
    outline = shapes.slot(3.0)
    chosen = np.random.default_rng(9).permutation(np.arange(0, len(outline.points_mm), 30))
    seen, owner = np.ones(len(outline.points_mm), np.bool_), np.zeros(len(chosen), np.int64)
    made = Scene(outline.points_mm[chosen], (outline,), (seen,), owner, 0.8, 1 / 1.5)
    assert found_in(made)[1] == SURE


def test_a_patch_that_two_runs_end_in_is_named_and_not_threaded() -> None:
    rng = np.random.default_rng(3)
    made = scene(arc(50.0, 320.0), rng, per_mm=2.0, band_mm=0.5)
    patch = rng.uniform([38.0, -22.0], [54.0, -8.0], (300, 2))  # in the middle of what is missing
    found = find_chains(np.vstack([made.points_mm, patch]))
    assert (found.chain_of_point[-300:] < 0).mean() > 0.8
    assert len(found.unordered) > 240
    (chain,) = found.chains
    assert chain.ambiguous
    middle = np.abs(chain.nodes_mm - [46.0, -15.0]).max(axis=1) < 5.0
    assert not middle.any()


@pytest.mark.parametrize("seed", range(12))
def test_no_chain_crosses_itself_or_another_whatever_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = []
    for _ in range(rng.integers(2, 6)):
        centre, radius = rng.uniform(-40.0, 40.0, 2), rng.uniform(5.0, 40.0)
        angle = rng.uniform(0.0, math.tau) + rng.uniform(1.0, 6.0) * rng.random(
            int(rng.integers(60, 400))
        )
        ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        pieces.append(centre + ring + rng.normal(0.0, 0.3, ring.shape))
    chains = find_chains(np.vstack(pieces)).chains
    ways = [ways_along(chain.nodes_mm, closed=chain.closed) for chain in chains]
    every = np.concatenate([np.empty((0, 2, 2)), *ways])
    assert not crossings(every, every).any()


def test_the_answer_does_not_depend_on_the_order_of_the_points() -> None:
    points = scene(ellipse(60, 30), np.random.default_rng(10), per_mm=5.0, band_mm=1.0).points_mm
    one, other = find_chains(points), find_chains(points[::-1])
    np.testing.assert_array_equal(one.chains[0].nodes_mm, other.chains[0].nodes_mm)
    np.testing.assert_array_equal(one.chain_of_point, other.chain_of_point[::-1])


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_chains_scale_with_the_part(factor: float) -> None:
    points = scene(ellipse(50, 50), np.random.default_rng(11), per_mm=5.0, band_mm=1.0).points_mm
    small, big = find_chains(points), find_chains(factor * points)
    np.testing.assert_allclose(
        big.chains[0].nodes_mm, factor * small.chains[0].nodes_mm, rtol=1e-6, atol=1e-9 * factor
    )
    assert big.sigma_mm == pytest.approx(factor * small.sigma_mm, rel=1e-6)


def test_half_a_million_points_cost_less_than_a_quarter_of_a_second() -> None:
    # Ten times what it takes on a machine to itself: this one may be busy.
    made = scene(ellipse(50, 50), np.random.default_rng(12), per_mm=1466.8, band_mm=2.0)
    find_chains(made.points_mm)
    begun = time.process_time()
    found = find_chains(made.points_mm)
    assert time.process_time() - begun < 0.25
    assert len(made.points_mm) > 460_000
    assert judge(found, made) == SURE
