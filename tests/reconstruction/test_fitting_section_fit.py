"""From chain and raw points to a curve: at the floor, honest, blind to what must not matter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.errors import ReconstructionError, TooFewPoints
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section_fit import fit_chain
from tests.reconstruction.fit_cases import (
    Outline,
    chain_of,
    circle,
    distances_to,
    ellipse,
    noisy,
    rms_to,
    shuffled,
    superformula,
    wave,
)

EVEN = np.linspace(0, 1, 400, endpoint=False)

# The best rms of a periodic least squares fit at the true arc length, over all numbers of control
# points, 30 seeds (benchmarks/sections.py).
BEST_MM = {"circle": 0.034, "ellipse": 0.054, "superformula": 0.088}
OUTLINES = {"circle": circle(), "ellipse": ellipse(), "superformula": superformula()}


def fitted(points: np.ndarray, chain: Chain) -> FittedCurve:
    return fit_chain(points, chain, exact=Exact.NEVER)


@pytest.mark.parametrize("name", OUTLINES)
def test_a_free_fit_is_no_worse_than_the_best_number_of_control_points(name: str) -> None:
    squares = []
    for seed in range(5):
        points, share = noisy(OUTLINES[name], 2000, 0.5, seed)
        curve = fitted(shuffled(points, seed), chain_of(points, share, 0.5))
        squares.append(rms_to(curve(EVEN), OUTLINES[name]) ** 2)
    assert np.sqrt(np.mean(squares)) < 1.08 * BEST_MM[name]


@pytest.mark.parametrize("name", OUTLINES)
def test_the_band_covers_the_truth_about_as_often_as_it_says(name: str) -> None:
    covered = []
    for seed in range(12):
        points, share = noisy(OUTLINES[name], 1000, 0.5, seed + 50)
        curve = fitted(points, chain_of(points, share, 0.5))
        off = distances_to(curve(EVEN), OUTLINES[name])
        covered.append(off <= 1.96 * curve.deviation_mm(EVEN))
    assert 0.85 < np.mean(covered) < 0.995


def test_a_gap_is_bridged_marked_and_doubted() -> None:
    outline = superformula()
    points, share = noisy(outline, 2000, 0.5, 7, gap=(0.40, 0.46))
    curve = fitted(shuffled(points), chain_of(points, share, 0.5))
    assert len(curve.gaps) == 1
    start, end = curve.gaps[0]
    assert 0.03 < (end - start) % 1.0 < 0.12
    inside = (start + (end - start) * np.linspace(0.3, 0.7, 9)) % 1.0
    away = (start + 0.5 + 0.2 * np.linspace(-1, 1, 50)) % 1.0
    assert curve.deviation_mm(inside).min() > 3 * np.median(curve.deviation_mm(away))
    off = distances_to(curve(inside), outline)
    assert (off < 3 * curve.deviation_mm(inside)).all()


def test_covariance_lies_across_the_curve() -> None:
    points, share = noisy(superformula(), 1000, 0.5, 8)
    curve = fitted(points, chain_of(points, share, 0.5))
    covariance, normals = curve.covariance(EVEN), curve.normals(EVEN)
    across = np.einsum("ni,nij,nj->n", normals, covariance, normals)
    np.testing.assert_allclose(np.sqrt(across), curve.deviation_mm(EVEN))
    np.testing.assert_allclose(np.trace(covariance, axis1=1, axis2=2), across)


def test_one_parameter_gives_one_value_and_several_an_array() -> None:
    points, share = noisy(superformula(), 1000, 0.5, 8)
    curve = fitted(points, chain_of(points, share, 0.5))
    for name, shape in (
        ("deviation_mm", ()), ("normals", (2,)), ("covariance", (2, 2)), ("curvature", ())
    ):  # fmt: skip
        one, three = getattr(curve, name)(0.3), getattr(curve, name)([0.1, 0.3, 0.5])
        assert np.shape(one) == shape
        assert three.shape == (3, *shape)
        np.testing.assert_array_equal(three[1], one)
    assert curve(0.3).shape == (2,)


def test_curvature_is_that_of_the_ellipse_and_positive_to_the_left() -> None:
    points, share = noisy(ellipse(), 2000, 0.2, 9)
    curve = fit_chain(points, chain_of(points, share, 0.2))
    x, y = curve(EVEN).T
    wanted = 60 * 30 / ((30 * x / 60) ** 2 + (60 * y / 30) ** 2) ** 1.5
    np.testing.assert_allclose(curve.curvature(EVEN), wanted, rtol=0.02)


def test_a_curve_introduces_itself_in_a_line() -> None:
    points, share = noisy(superformula(), 2000, 0.5, 7, gap=(0.40, 0.46))
    words = repr(fitted(points, chain_of(points, share, 0.5)))
    assert words.startswith("<FittedCurve: free, closed, ")
    assert words.endswith("1 gap>")
    assert len(words) < 120


def test_many_points_gathered_into_cells_fit_like_the_points_themselves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points, share = noisy(superformula(), 12_000, 0.5, 9)
    chain = chain_of(points, share, 0.5)
    gathered = fitted(shuffled(points), chain)
    monkeypatch.setattr("reconstruction.fitting.section_fit._GATHERED_FROM", 10**9)
    single = fitted(shuffled(points), chain)
    assert len(gathered.cells) < 2000 < len(single.cells)
    assert gathered.points_used == pytest.approx(single.points_used, abs=10)
    assert gathered.residual_max_mm == pytest.approx(single.residual_max_mm, rel=0.3)
    apart = gathered(EVEN)[:, None, :] - single(np.linspace(0, 1, 4001))[None]
    nearest = np.linalg.norm(apart, axis=2).min(axis=1)
    assert np.sqrt(np.mean(nearest**2)) < 0.4 * np.median(single.deviation_mm(EVEN))


def test_residuals_are_those_of_the_unreduced_points() -> None:
    points, share = noisy(circle(), 20_000, 0.5, 10)
    curve = fit_chain(shuffled(points), chain_of(points, share, 0.5))
    off = np.abs(np.hypot(*(points - curve(EVEN).mean(axis=0)).T) - 50)
    assert curve.points_used + curve.outliers == 20_000
    assert curve.residual_rms_mm == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.01)
    assert curve.residual_max_mm == pytest.approx(off.max(), rel=0.02)


@pytest.mark.parametrize("count", [2000, 20_000], ids=["single points", "gathered"])
def test_stray_points_are_counted_and_do_not_bend_the_curve(count: int) -> None:
    outline = superformula()
    points, share = noisy(outline, count, 0.5, 11)
    strays = np.random.default_rng(1).uniform(-120, 120, (count // 50, 2))
    clean = fitted(points, chain_of(points, share, 0.5))
    dirty = fitted(shuffled(np.vstack([points, strays])), chain_of(points, share, 0.5))
    assert 0.85 * len(strays) < dirty.outliers < 1.1 * len(strays)
    assert rms_to(dirty(EVEN), outline) < 1.3 * rms_to(clean(EVEN), outline)


def test_an_open_run_ends_where_its_points_end() -> None:
    ends = []
    for seed in range(8):
        points, share = noisy(wave(), 2000, 0.5, seed)
        curve = fitted(shuffled(points), chain_of(points, share, 0.5, pieces=40, closed=False))
        assert not curve.closed
        ends.append([curve(0.0)[0], curve(1.0)[0] - 100])
    assert np.abs(np.mean(ends, axis=0)).max() < 0.4
    assert np.abs(ends).max() < 1.2


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open"])
def test_a_node_that_stands_far_out_of_its_chain_draws_no_loop(
    closed: bool,  # noqa: FBT001
) -> None:
    outline = superformula() if closed else wave()
    points, share = noisy(outline, 1000, 0.3, 16)
    chain = chain_of(points, share, 0.3, closed=closed)
    nodes = chain.nodes_mm.copy()
    nodes[30] += [12.0, 9.0]
    spiked = Chain(nodes, chain.sigma_mm, closed)
    places = fitted(points, spiked)(EVEN)
    np.testing.assert_array_less(distances_to(places[5:-5], outline), 0.4)


def test_heights_are_kept_as_moments_not_flattened() -> None:
    points, share = noisy(circle(), 20_000, 0.2, 12)
    heights = 5 + 0.1 * points[:, 0]
    curve = fit_chain(points, chain_of(points, share, 0.2), heights_mm=heights)
    expected = 5 + 0.1 * curve.cells.means_mm[:, 0]
    np.testing.assert_allclose(curve.cells.heights_mm, expected, atol=1e-9)


def test_the_order_of_the_points_does_not_matter() -> None:
    points, share = noisy(superformula(), 1500, 0.5, 13)
    chain = chain_of(points, share, 0.5)
    one, other = fitted(shuffled(points, 1), chain), fitted(shuffled(points, 2), chain)
    np.testing.assert_allclose(one(EVEN), other(EVEN), atol=1e-6)


@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0.0), (1e6, 0.0), (1.0, 1e9)])
def test_units_and_origin_do_not_matter(scale: float, shift: float) -> None:
    points, share = noisy(superformula(), 1000, 0.5, 14)
    plain = fitted(points, chain_of(points, share, 0.5))
    moved = points * scale + shift
    found = fitted(moved, chain_of(moved, share, 0.5 * scale))
    np.testing.assert_allclose((found(EVEN) - shift) / scale, plain(EVEN), atol=1e-2)
    np.testing.assert_allclose(found.deviation_mm(EVEN) / scale, plain.deviation_mm(EVEN), rtol=0.1)


def test_integers_are_points_too() -> None:
    points, share = noisy(circle(5000), 1000, 30, 15)
    whole = np.round(points).astype(np.int64)
    curve = fit_chain(whole, chain_of(points, share, 30))
    assert curve.kind == "circle"
    assert curve.points_used == 1000


@pytest.mark.parametrize("outline", [circle(), ellipse()], ids=["circle", "ellipse"])
def test_points_without_noise_are_met(outline: Outline) -> None:
    share = np.arange(400) / 400
    points = outline(share)
    curve = fit_chain(points, chain_of(points, share, 0.0))
    assert rms_to(curve(EVEN), outline) < 0.02


def test_too_few_points_are_refused_by_name() -> None:
    chain = Chain(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.full(3, 0.1), closed=True)
    with pytest.raises(TooFewPoints, match="3 points"):
        fit_chain(np.zeros((3, 2)), chain)
    with pytest.raises(TooFewPoints, match="near"):
        fit_chain(np.full((10, 2), 500.0), chain)


def test_a_chain_without_length_is_refused() -> None:
    chain = Chain(np.ones((3, 2)), np.full(3, 0.1), closed=True)
    with pytest.raises(TooFewPoints, match="0 mm"):
        fit_chain(np.ones((10, 2)), chain)


places = st.tuples(st.integers(-20, 20), st.integers(-20, 20))


@given(
    points=st.lists(places, min_size=4, max_size=40),
    nodes=st.lists(places, min_size=3, max_size=12),
    sigma=st.sampled_from([0.0, 0.1, 3.0]),
    closed=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_whatever_is_chained_gives_a_finite_curve_or_a_named_error(
    points: list[tuple[int, int]],
    nodes: list[tuple[int, int]],
    sigma: float,
    closed: bool,  # noqa: FBT001 (hypothesis draws it)
) -> None:
    chain = Chain(np.array(nodes, dtype=float), np.full(len(nodes), sigma), closed)
    try:
        curve = fit_chain(np.array(points, dtype=float), chain)
    except ReconstructionError:
        return
    assert np.isfinite(curve(EVEN)).all()
    assert np.isfinite(curve.covariance(EVEN)).all()
    assert curve.points_used + curve.outliers == len(points)
