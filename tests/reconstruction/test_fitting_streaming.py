"""What is kept when a slice's points are dropped is as good as the points, on any other curve."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.moments import cells_of_points
from reconstruction.fitting.refitting import refitted
from reconstruction.fitting.section import resolve_section
from reconstruction.nurbs import Curve, clamped_uniform, periodic_uniform
from tests.reconstruction.fit_cases import (
    Outline,
    noisy,
    rms_to,
    shuffled,
    superformula,
    wave,
)

SPANS = 150
EVEN = np.linspace(0.0, 1.0, 400, endpoint=False)
# Of the curve's own standard deviation. A cell stands for its points to second order, and single
# points have robust weights besides: measured 0.056 closed, 0.035 open.
CLOSE = 0.1


def neighbour(outline: Outline) -> Curve:
    """Next slice's section, closed: a little larger and aside, begun elsewhere, at uneven speed."""
    u = np.arange(200) / 200
    share = 0.31 + u + 0.03 * np.sin(4 * np.pi * u)
    return periodic_uniform(1.02 * outline(np.mod(share, 1.0)) + np.array([0.4, -0.3]))


def beside(outline: Outline) -> Curve:
    """The same, open; a little longer at both ends."""
    places = outline(np.linspace(0.0, 1.0, 120)) + np.array([0.0, 0.5])
    ends = [2 * places[0] - places[1], 2 * places[-1] - places[-2]]
    return clamped_uniform(np.vstack([ends[0], places, ends[1]]))


CASES: dict[str, tuple[Callable[[], Outline], Callable[[Outline], Curve]]] = {
    "closed": (superformula, neighbour),
    "open": (wave, beside),
}


def both(
    name: str, *, count: int = 20_000, sigma: float = 0.3
) -> tuple[FittedCurve, FittedCurve, Curve]:
    """The fit from kept cells along another curve, and that from the points themselves."""
    make, other = CASES[name]
    outline = make()
    points = shuffled(noisy(outline, count, sigma, 1)[0])
    (found,) = resolve_section(points, exact=Exact.NEVER).curves
    along = other(outline)
    kept = refitted(found, along, spans=SPANS)
    object.__setattr__(found, "cells", cells_of_points(points))
    return kept, refitted(found, along, spans=SPANS), along


@pytest.mark.parametrize("name", CASES)
def test_cells_moved_to_another_curve_give_the_fit_of_the_raw_points(name: str) -> None:
    kept, raw, _ = both(name)
    assert len(kept.cells) < 3000
    assert len(raw.cells) == 20_000
    across = ((kept(EVEN) - raw(EVEN)) * raw.normals(EVEN)).sum(axis=1)  # along it is gauge
    deviation = float(np.median(raw.deviation_mm(EVEN)))
    assert np.sqrt(np.mean(across**2)) < CLOSE * deviation
    np.testing.assert_allclose(kept.deviation_mm(EVEN), raw.deviation_mm(EVEN), rtol=0.1)
    assert kept.sigma_mm == pytest.approx(raw.sigma_mm, rel=0.01)


@pytest.mark.parametrize("name", CASES)
def test_knots_and_parametrisation_are_those_of_the_other_curve(name: str) -> None:
    kept, _, along = both(name)
    inner = np.unique(kept.curve.knots[(kept.curve.knots >= 0) & (kept.curve.knots <= 1)])
    np.testing.assert_allclose(inner, np.arange(SPANS + 1) / SPANS, atol=1e-12)
    start, end = along.domain
    arms = kept(EVEN) - along(start + (end - start) * EVEN)
    slipped = np.abs((arms * np.roll(kept.normals(EVEN), 1, axis=1) * [-1, 1]).sum(axis=1))
    aside = np.linalg.norm(arms, axis=1)
    assert np.median(slipped) < 0.35 * np.median(aside)  # it moves across, not along


def test_the_fit_along_a_neighbour_is_as_near_to_the_truth_as_the_first() -> None:
    outline = superformula()
    points = shuffled(noisy(outline, 20_000, 0.3, 2)[0])
    (found,) = resolve_section(points, exact=Exact.NEVER).curves
    again = refitted(found, neighbour(outline), spans=SPANS)
    assert rms_to(again(EVEN), outline) < 1.1 * rms_to(found(EVEN), outline)
    assert again.points_used + again.outliers == found.points_used + found.outliers


def test_a_gap_stays_where_it_was() -> None:
    outline = superformula()
    points = shuffled(noisy(outline, 20_000, 0.3, 3, gap=(0.40, 0.46))[0])
    (found,) = resolve_section(points, exact=Exact.NEVER).curves
    again = refitted(found, neighbour(outline), spans=SPANS)
    assert len(again.gaps) == 1
    np.testing.assert_allclose(again(again.gaps[0]), found(found.gaps[0]), atol=0.5)


def test_an_open_curve_is_not_refitted_along_a_loop() -> None:
    (found,) = resolve_section(shuffled(noisy(wave(), 2000, 0.3, 4)[0])).curves
    with pytest.raises(ValueError, match="closed True for a curve that is closed False"):
        refitted(found, neighbour(superformula()), spans=SPANS)


def leaning(turn: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Points (n, 3) of a cone in a slab of 2 mm; the wall leans by 0.5 mm a millimetre."""
    heights = rng.uniform(-1.0, 1.0, len(turn))
    radius = 50.0 + 0.5 * heights + rng.normal(0.0, 0.05, len(turn))
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), heights])


@pytest.mark.parametrize("loops", [1, 2])
def test_heights_are_kept_true_with_the_lean_of_the_wall(loops: int) -> None:
    rng = np.random.default_rng(5)
    middles = np.outer(np.arange(loops), [150.0, 0.0, 0.0])
    rings = [leaning(rng.uniform(0, 2 * np.pi, 20_000), rng) + middle for middle in middles]
    points = rng.permutation(np.vstack(rings))
    found = resolve_section(points[:, :2], heights_mm=points[:, 2])
    assert len(found.curves) == loops
    for curve in found.curves:
        cells = curve.cells
        assert len(cells.heights_mm) == len(cells)
        mine = np.hypot(*(points[:, :2] - curve(EVEN).mean(axis=0)).T) < 60.0
        assert cells.counts @ cells.heights_mm == pytest.approx(points[mine, 2].sum(), abs=2.0)
        outward = cells.means_mm - curve(EVEN).mean(axis=0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        zx, zy, zz = cells.height_covariances_mm2.T
        lean = cells.counts @ (zx * outward[:, 0] + zy * outward[:, 1]) / (cells.counts @ zz)
        assert lean == pytest.approx(0.5, abs=0.01)


def test_a_height_for_every_point_or_none() -> None:
    points = noisy(superformula(), 500, 0.3, 6)[0]
    with pytest.raises(ValueError, match=r"heights_mm: shape \(500,\) expected, got \(3,\)"):
        resolve_section(points, heights_mm=[1, 2, 3])


def test_a_cell_knows_which_of_its_points_lie_farthest_out() -> None:
    outline = superformula()
    points = noisy(outline, 20_000, 0.3, 7)[0]
    (found,) = resolve_section(points).curves
    ends = found.cells.extremes_mm.reshape(-1, 2)
    assert np.asarray(cKDTree(points).query(ends)[0]).max() == 0.0
