"""A slice's points to its curves: which, in which order, and what became of every point."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numba.core.caching import FunctionCache
from numba.core.registry import CPUDispatcher

from loftscan.inputs import Unit, open_input
from reconstruction.arrays import FloatArray
from reconstruction.errors import ReconstructionError, TooFewPoints, Unfittable
from reconstruction.fitting import section
from reconstruction.fitting.chain import Chain
from reconstruction.fitting.curve import Exact, FittedCurve
from reconstruction.fitting.section import fit_section, resolve_section
from reconstruction.slicing import cut_cloud
from reconstruction.survey import Axis
from tests.reconstruction.topology_cases import (
    Outline,
    arc,
    corner,
    ellipse,
    scene,
    superformula,
)

BAND_MM = 0.5


def cloud(outlines: Outline | list[Outline], rng: np.random.Generator, *, per_mm: float = 8.0,
          band_mm: float = BAND_MM, outliers: float = 0.0) -> FloatArray:  # fmt: skip
    return scene(outlines, rng, per_mm=per_mm, band_mm=band_mm, outliers=outliers).points_mm


def moved(outline: Outline, *by_mm: float) -> Outline:
    return Outline(outline.points_mm + np.array(by_mm), closed=outline.closed)


def annulus(
    rng: np.random.Generator, *, wall_mm: float = 12.0, outliers: float = 0.0
) -> FloatArray:
    return cloud([ellipse(r, r) for r in (40.0, 40.0 - wall_mm)], rng, outliers=outliers)


def area(curve: FittedCurve) -> float:
    x, y = curve(np.linspace(*curve.domain, 2000, endpoint=False)).T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.mark.parametrize("exact", list(Exact))
def test_the_outer_loop_comes_first_and_the_hole_runs_clockwise(
    rng: np.random.Generator, exact: Exact
) -> None:
    outer, hole = fit_section(annulus(rng), exact=exact)
    kind = "circle" if exact is Exact.AUTO else "free"
    assert (outer.kind, hole.kind) == (kind, kind)
    assert outer.closed
    assert hole.closed
    assert area(outer) == pytest.approx(math.pi * 40.0**2, rel=0.005)
    assert area(hole) == pytest.approx(-math.pi * 28.0**2, rel=0.005)


def test_loops_come_before_runs_and_the_larger_before_the_smaller(
    rng: np.random.Generator,
) -> None:
    pieces = [
        moved(corner(), 100.0, 0.0),
        ellipse(8.0, 8.0, (-60.0, 0.0)),
        moved(arc(20.0, 120.0), 0.0, 150.0),
        ellipse(30.0, 20.0),
    ]
    found = resolve_section(cloud(pieces, rng))
    assert [curve.closed for curve in found.curves] == [True, True, False, False]
    assert found.depths == (0, 0, 0, 0)
    sizes = [abs(area(curve)) for curve in found.curves[:2]]
    np.testing.assert_allclose(sizes, [math.pi * 600.0, math.pi * 64.0], rtol=0.03)
    lengths = [chain.length_mm for chain in found.chains[2:]]
    np.testing.assert_allclose(lengths, [105.0, 20.0 * math.tau / 3], rtol=0.05)


def test_every_point_is_accounted_for_once(rng: np.random.Generator) -> None:
    points = annulus(rng, outliers=0.02)
    found = resolve_section(points)
    fitted = sum(curve.points_used + curve.outliers for curve in found.curves)
    assert fitted + len(found.strays) + len(found.unordered) == len(points)
    assert not np.intersect1d(found.strays, found.unordered).size
    radius = np.hypot(*points[found.strays].T)
    assert len(found.strays) > 0
    assert (np.minimum(np.abs(radius - 40.0), np.abs(radius - 28.0)) > BAND_MM).all()


def test_thickness_and_spacing_are_those_of_the_cloud(rng: np.random.Generator) -> None:
    found = resolve_section(cloud(superformula(), rng, per_mm=10.0, band_mm=2.0))
    assert found.sigma_mm == pytest.approx(2.0 / math.sqrt(12.0), rel=0.15)
    assert found.width_mm == 4.0 * found.sigma_mm
    assert found.band_mm == pytest.approx(2.0, rel=0.15)
    assert found.spacing_mm == pytest.approx(0.1, rel=0.05)


def test_a_chain_without_a_curve_does_not_cost_the_others(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = annulus(rng)
    inner = np.flatnonzero(np.hypot(*points.T) < 34.0)
    real = section.fit_chain

    def failing(points: FloatArray, chain: Chain, *, exact: Exact, heights_mm: None) -> FittedCurve:
        if np.hypot(*chain.nodes_mm.T).max() < 34.0:
            raise np.linalg.LinAlgError("singular")
        return real(points, chain, exact=exact)

    monkeypatch.setattr(section, "fit_chain", failing)
    found = resolve_section(points)
    assert [curve.kind for curve in found.curves] == ["circle"]
    assert found.failures == ("singular",)
    np.testing.assert_array_equal(found.unordered, inner)


def test_where_no_chain_has_a_curve_the_error_says_why(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(points: FloatArray, chain: Chain, *, exact: Exact, heights_mm: None) -> FittedCurve:
        raise TooFewPoints("the reason")

    monkeypatch.setattr(section, "fit_chain", failing)
    with pytest.raises(Unfittable, match="the reason"):
        fit_section(annulus(rng))


def test_a_curve_that_is_not_finite_is_none(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = section.fit_chain

    def lost(points: FloatArray, chain: Chain, *, exact: Exact, heights_mm: None) -> FittedCurve:
        curve = real(points, chain, exact=exact)
        broken = np.full_like(curve.curve.control_points_mm, np.nan)
        object.__setattr__(curve.curve, "control_points_mm", broken)
        return curve

    monkeypatch.setattr(section, "fit_chain", lost)
    points = annulus(rng)
    found = resolve_section(points)
    assert found.curves == ()
    assert len(found.failures) == 2
    assert len(found.unordered) + len(found.strays) == len(points)


def test_points_that_are_all_of_one_chain_are_not_copied(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, given = cloud(ellipse(40.0, 30.0), rng, per_mm=40.0), []
    real = section.fit_chain

    def noting(points: FloatArray, chain: Chain, *, exact: Exact, heights_mm: None) -> FittedCurve:
        given.append(points)
        return real(points, chain, exact=exact)

    monkeypatch.setattr(section, "fit_chain", noting)
    fit_section(points)
    assert len(given) == 1
    assert given[0] is points


@pytest.mark.parametrize("kind", ["int16", "int64", "float32", "list"])
def test_any_kind_of_numbers_does(rng: np.random.Generator, kind: str) -> None:
    points = np.round(cloud(ellipse(3000.0, 3000.0), rng, per_mm=0.1, band_mm=20.0))
    given = points.astype(np.int64).tolist() if kind == "list" else points.astype(kind)
    (curve,), (wanted,) = fit_section(given), fit_section(points)
    np.testing.assert_array_equal(curve.curve.control_points_mm, wanted.curve.control_points_mm)


def test_a_slice_far_from_the_origin_has_the_same_curve(rng: np.random.Generator) -> None:
    away = np.array([1e9, -1e9])
    points = np.round(cloud(ellipse(60.0, 30.0), rng, per_mm=20.0, band_mm=BAND_MM) * 1024) / 1024
    (here,), found = fit_section(points), resolve_section(points + away)
    (far,), (chain,) = found.curves, found.chains
    assert far.kind == here.kind
    assert far.sigma_mm == pytest.approx(here.sigma_mm, rel=1e-4)
    u = np.linspace(0.0, 1.0, 200)
    np.testing.assert_allclose(far(u) - away, here(u), rtol=0, atol=1e-5)
    assert np.abs(chain.nodes_mm - away).max() < 62.0
    np.testing.assert_allclose(far.cells.means_mm - away, here.cells.means_mm, rtol=0, atol=1e-5)


# -- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "points",
    [np.zeros((10, 3)), np.zeros(10), np.zeros((5, 2, 2)), [[0, 1j]] * 9, [["a", "b"]] * 9, []],
)
def test_another_shape_or_no_numbers_is_the_callers_mistake(points: object) -> None:
    with pytest.raises(ValueError, match="expected, got"):
        fit_section(points)


def test_masked_rows_are_not_taken_for_points(rng: np.random.Generator) -> None:
    points = annulus(rng)
    with pytest.raises(ValueError, match="masked"):
        fit_section(np.ma.masked_greater(points, 39.0))
    assert len(fit_section(np.ma.masked_greater(points, 1e9))) == 2  # nothing is masked


@pytest.mark.parametrize("points", [np.zeros((0, 2)), np.eye(2), np.ones((500, 2)), np.eye(2)[:1]])
def test_too_few_places_are_named(points: FloatArray) -> None:
    with pytest.raises(TooFewPoints, match="a curve needs 4"):
        fit_section(points)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e200, -1e200])
def test_what_is_no_length_is_counted(rng: np.random.Generator, value: float) -> None:
    points = annulus(rng)
    points[[5, 7], [0, 1]] = value
    with pytest.raises(Unfittable, match=f"2 of {len(points)} points are no finite lengths"):
        fit_section(points)


@pytest.mark.parametrize("count", [400, 2000, 20_000])
@pytest.mark.parametrize("way", [(100.0, 30.0), (100.0, 0.0), (0.0, 1.0)])
def test_points_on_one_line_are_a_line(count: int, way: tuple[float, float]) -> None:
    share = np.random.default_rng(0).random((count, 1))
    (curve,) = fit_section(share * way)
    assert (curve.kind, curve.closed) == ("line", False)
    size = math.hypot(*way)
    ends = curve([0.0, 1.0]) / size
    unit = np.array(way) / size
    assert np.abs(ends[:, 0] * unit[1] - ends[:, 1] * unit[0]).max() < 1e-6
    np.testing.assert_allclose(np.sort(ends @ unit), [0.0, 1.0], atol=0.03)
    assert curve.points_used > 0.95 * count


@pytest.mark.parametrize("count", [50, 3000, 20_000])
@pytest.mark.parametrize(("a", "b", "kind"), [(50, 50, "circle"), (60, 30, "ellipse")])
def test_a_ring_without_noise_is_exact(count: int, a: float, b: float, kind: str) -> None:
    turn = np.random.default_rng(1).random(count) * math.tau
    points = np.column_stack([a * np.cos(turn), b * np.sin(turn)])
    (curve,) = fit_section(points)
    assert curve.kind == kind
    assert curve.sigma_mm < 1e-4
    assert np.hypot(*(curve(np.linspace(0, 1, 200)) / [a, b]).T) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("scale", [1e-25, 1e25])
def test_any_unit_of_length_does(rng: np.random.Generator, scale: float) -> None:
    points = cloud(ellipse(60.0, 30.0), rng, per_mm=5.0, band_mm=BAND_MM)
    (curve,), (here,) = fit_section(points * scale), fit_section(points)
    assert curve.kind == here.kind == "ellipse"
    assert curve.sigma_mm == pytest.approx(here.sigma_mm * scale, rel=1e-3)


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_lengths_beyond_all_measure_are_named(rng: np.random.Generator, scale: float) -> None:
    points = cloud(ellipse(60.0, 30.0), rng, per_mm=5.0, band_mm=BAND_MM)
    with pytest.raises((TooFewPoints, Unfittable), match=r"in one place|no finite lengths"):
        fit_section(points * scale)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    arrays(
        np.float64,
        st.tuples(st.integers(0, 60), st.just(2)),
        elements=st.one_of(st.floats(-1e6, 1e6), st.integers(-3, 3).map(float), st.floats()),
    )
)
def test_any_points_give_finite_curves_or_a_named_error(points: FloatArray) -> None:
    try:
        curves = fit_section(points)
    except ReconstructionError:
        return
    for curve in curves:
        assert np.isfinite(curve(np.linspace(0.0, 1.0, 50))).all()
        assert np.isfinite(curve.covariance(0.5)).all()


# -- real slices, and large ones -----------------------------------------------------------------


def test_every_slice_of_a_real_scan_goes_through(shared_data: Path) -> None:
    with open_input(shared_data / "scans" / "bigCub.pts", Unit.CM) as given_:
        cutting = cut_cloud(given_.chunks, Axis.Y)
    for piece in cutting.slices():
        found = resolve_section(piece.frame.to_plane(piece.points_mm)[:, :2])
        assert found.curves
        assert not found.failures


def test_every_kernel_of_the_fit_is_kept_on_disk_for_the_next_process() -> None:
    kernels = {
        f"{module.__name__}.{name}": value
        for module in [sys.modules[name] for name in sys.modules if ".fitting." in name]
        for name, value in vars(module).items()
        if isinstance(value, CPUDispatcher)
    }
    assert len(kernels) > 30
    for name, kernel in kernels.items():
        assert isinstance(kernel._cache, FunctionCache), name


_LARGE = """
import numpy as np
from reconstruction.fitting.section import resolve_section
def most_mb():
    line = next(each for each in open("/proc/self/status") if each.startswith("VmHWM"))
    return int(line.split()[1]) / 1024
turn = np.random.default_rng(0).random(460_800) * 2 * np.pi
points = 50 * np.column_stack([np.cos(turn), np.sin(turn)])
points += np.random.default_rng(1).normal(0, 0.5, points.shape)
resolve_section(points[::50].copy())
before = most_mb()
assert len(resolve_section(points).curves) == 1
print(most_mb() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc")
def test_half_a_million_points_need_little_memory_beside_themselves() -> None:
    ran = subprocess.run([sys.executable, "-c", _LARGE], capture_output=True, text=True, check=True)
    assert float(ran.stdout) < 30.0
