"""Exact shapes are recognised where there is one, with honest figures, and nowhere else."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.skinning.adjustment import Cells, Fitted, adjusted
from reconstruction.skinning.exact_shapes import Shape
from reconstruction.skinning.lack_of_fit import gained, lacks_fit, left_over
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.patches import pooled
from reconstruction.skinning.primitives import Cone, Cylinder, Sphere
from reconstruction.skinning.recognition import recognised
from reconstruction.skinning.revolution import Revolution
from reconstruction.skinning.revolving import revolved, sketched
from reconstruction.skinning.starting import (
    axis_near,
    cone_near,
    cylinder_near,
    plane_near,
    sphere_near,
)
from reconstruction.slices import Frame
from tests.campaigns.recognising import (
    NEAR,
    PATTERNS,
    TRUE,
    deviating,
    pulls,
    shape_of,
    steady,
    tapered,
    vase,
)
from tests.reconstruction.exact_cases import (
    PATCHES,
    STRIP,
    Ball,
    Board,
    Part,
    Scan,
    Turned,
    scanned,
)

POINTS = 20_000
SIGMA = 0.2
CYLINDER = Turned(steady(50.0))


def cells_of(scan: Scan) -> Cells:
    """The scan's cells with the truth about their scatter."""
    variances = scan.variances_mm2()
    return Cells(
        scan.moments, scan.moments.counts / variances, variances,
        np.ones(len(scan.moments)), scan.noise_mm2,
    )  # fmt: skip


def fitted_cylinder(scan: Scan, radius: float = 50.0) -> Fitted:
    """A cylinder fitted from the true one, its origin half-way up."""
    frame = Frame(scan.placed(np.array([[0.0, 0.0, 50.0]]))[0], scan.turn.T)
    found = adjusted(Cylinder(frame, radius), cells_of(scan), rounds=20)
    assert found is not None
    return found


@pytest.mark.parametrize("name", TRUE)
def test_a_part_of_an_exact_shape_is_taken_for_it(name: str) -> None:
    kind, part = TRUE[name]
    shape = shape_of(scanned(part, POINTS, 11, level_only=isinstance(part, Ball)))
    assert shape is not None
    assert shape.kind == kind


@pytest.mark.parametrize("sigma", [0.1, 0.2])
@pytest.mark.parametrize("name", NEAR)
def test_what_is_only_nearly_a_cylinder_is_not_taken_for_one(name: str, sigma: float) -> None:
    kind, part = NEAR[name]
    for seed in range(3):
        shape = shape_of(scanned(part, POINTS, seed, sigma=sigma))
        assert ("free" if shape is None else shape.kind) == kind


def test_a_free_surface_that_explains_far_more_keeps_its_place() -> None:
    scan = scanned(CYLINDER, POINTS, 1)
    misfit, edf = scan.free()
    variances = scan.variances_mm2()

    def claim(better: float) -> Shape | None:
        return recognised(
            scan.moments, variances, free_misfit=misfit - better, free_edf=edf,
            noise_covariance_mm2=scan.noise_mm2,
        )  # fmt: skip

    assert claim(0.0) is not None
    # Chance explains an excess of about the freedoms spared and four times its deviation: ~130.
    assert claim(300.0) is None


def test_a_dozen_cells_are_the_least_that_make_a_shape() -> None:
    scan = scanned(CYLINDER, POINTS, 1)
    moments = cells_of(scan).only(np.arange(11)).moments
    assert recognised(moments, SIGMA**2, free_misfit=11.0, free_edf=5.0) is None


def test_outlying_cells_do_not_keep_a_cylinder_from_being_recognised() -> None:
    scan = scanned(CYLINDER, POINTS, 2)
    rng = np.random.default_rng(2)
    astray = rng.choice(len(scan.moments), 8, replace=False)
    means = np.array(scan.moments.means_mm)
    outward = scan.part.standing(scan.local())[1] @ scan.turn.T
    means[astray] += 3.0 * outward[astray]
    misfit, edf = scan.free()  # without the outliers, as `recognised` asks for
    shape = recognised(
        replace(scan.moments, means_mm=means), scan.variances_mm2(), free_misfit=misfit,
        free_edf=edf, noise_covariance_mm2=scan.noise_mm2,
    )  # fmt: skip
    assert shape is not None
    assert isinstance(shape.form, Cylinder)
    # Taken in, they would shift the radius by 8 / 1500 * 3 mm = 0.016 mm, some ten deviations.
    assert abs(shape.form.radius_mm - 50.0) < 4.0 * shape.deviations[4]


def test_a_cylinder_is_known_in_its_gaps_as_well_as_beside_them() -> None:
    """A fifth of its wall is missing; its five freedoms are as good as 200 000 points make them.

    sigma * sqrt(5 / 200 000) is 0.001 mm; 0.0045 mm is what that stands for at 4.5 deviations.
    """
    part = Turned(steady(50.0), gaps=STRIP + PATCHES)
    scan = scanned(part, 200_000, 3, level_only=True)
    shape = shape_of(scan)
    assert shape is not None
    assert isinstance(shape.form, Cylinder)
    for angle_rad, low, high in ((1.3, 3.0, 97.0), (2.3, 6.0, 24.0), (0.4, 3.0, 97.0)):
        z = np.linspace(low, high, 50)
        places = np.column_stack(
            [np.full(50, 50.0 * math.cos(angle_rad)), np.full(50, 50.0 * math.sin(angle_rad)), z]
        )
        off = shape.form.measure(scan.placed(places)).distances_mm
        assert np.abs(off).max() < 0.0045
        assert (np.abs(off) < 4.0 * shape.deviation_mm(scan.placed(places))).all()


@pytest.mark.parametrize(("slope", "radius"), [(0.0, 50.0), (0.3, 20.0)], ids=["cylinder", "cone"])
def test_reported_deviations_are_what_the_figures_scatter_by(slope: float, radius: float) -> None:
    """The mean square of 15 scans' errors over deviations, 75 or 90 numbers, is 1 +- 0.16."""
    part = Turned(tapered(slope) if slope else steady(radius))
    found = [
        pulls(scanned(part, POINTS, seed), lambda z: radius + slope * z, slope)
        for seed in range(200, 215)
    ]
    every = np.array([each for each in found if each is not None])
    assert len(every) == 15
    assert 1.0 - 4 * 0.16 < (every**2).mean() < 1.0 + 4 * 0.16
    assert np.abs(every).max() < 4.0


def test_what_noise_leaves_over_are_standard_normal_numbers() -> None:
    waves, rests = [], []
    for seed in range(5):
        scan = scanned(CYLINDER, POINTS, seed)
        found = fitted_cylinder(scan)
        wave, rest, _ = left_over(found, cells_of(scan))
        waves.append(wave)
        rests.append(rest)
        assert not lacks_fit(found, cells_of(scan))
    # 170 and some 4800 numbers: 4.5 standard deviations of their mean squares.
    every, rest = np.concatenate(waves), np.concatenate(rests)
    assert abs((every**2).mean() - 1.0) < 4.5 * math.sqrt(2.0 / len(every))
    # Patches have lost what the form and the waves took up, some 40 of a thousand.
    assert 0.87 < (rest**2).mean() < 1.07


@pytest.mark.parametrize("name", PATTERNS)
def test_a_deviation_of_ten_of_its_standard_deviations_is_seen(name: str) -> None:
    scan = scanned(deviating(PATTERNS[name], 10.0, POINTS), POINTS, 5)
    assert lacks_fit(fitted_cylinder(scan), cells_of(scan))


def test_windows_of_patches_agree_with_their_naive_twin() -> None:
    scan = scanned(Turned(steady(50.0), gaps=STRIP), POINTS, 5)
    found = fitted_cylinder(scan)
    patches = pooled(found.chart, scan.moments.means_mm, scan.moments.counts)
    values = np.random.default_rng(9).normal(size=len(patches.held))
    windows = patches.windows(values, 2)
    for around in (0, 1, 20, 47):
        for along in (0, 7, 19):
            apart = np.abs(patches.boxes - [around, along])
            apart[:, 0] = np.minimum(apart[:, 0], 48 - apart[:, 0])
            total = values[(apart <= 2).all(axis=1)].sum()
            assert windows[around * 20 + along] == pytest.approx(total, abs=1e-12)


def naive_gain(found: Fitted, other: Fitted, cells: Cells) -> float:
    """The fall of the sum of squares over all cells."""
    before = float((cells.precisions * found.distances_mm**2).sum())
    return before - float((cells.precisions * other.distances_mm**2).sum())


@pytest.mark.parametrize("slope", [0.0, 0.0005, 0.002])
def test_what_a_cone_gains_on_a_cylinder_is_the_fall_of_the_squares(slope: float) -> None:
    scan = scanned(Turned(lambda _, z: 50.0 + slope * (z - 50.0)), POINTS, 6)
    cells, found = cells_of(scan), fitted_cylinder(scan)
    assert isinstance(found.form, Cylinder)
    cone = adjusted(Cone(found.form.frame, found.form.radius_mm, 1e-3), cells, rounds=40)
    assert cone is not None
    fall = naive_gain(found, cone, cells)
    # Patches tell a linear rise but for what it does within one: 1 in 20**2; and the squares of
    # single cells also fall by their pulls, some tenths.
    assert gained(found, cone.form, cells) == pytest.approx(fall, rel=0.02, abs=0.5)
    if slope == 0.002:
        assert fall > 100.0


def test_the_profile_of_a_vase_is_as_good_as_its_freedoms_let_it_be() -> None:
    scan = scanned(Turned(vase, slices=50), POINTS, 7)
    cells = cells_of(scan)
    axis = axis_near(scan.moments.means_mm[::4], cells.precisions[::4], degree=8)
    sketch = sketched(axis, cells)
    assert sketch is not None
    found = revolved(sketch, cells)
    assert found is not None
    assert isinstance(found.form, Revolution)
    z = np.linspace(3.0, 97.0, 200)
    angle = 2.4 * np.arange(200)
    r = vase(angle, z)
    places = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    off = found.form.measure(scan.placed(places)).distances_mm
    # The expected rms of a fit with so many freedoms; its scatter is less than a half of it.
    assert float(np.sqrt((off**2).mean())) < 1.5 * SIGMA * math.sqrt(found.freedom / POINTS)


def exact_places(part: Part, count: int = 400) -> FloatArray:
    return part.drawn(np.random.default_rng(8), count)


def test_planes_and_spheres_are_found_from_exact_places_at_once() -> None:
    weights = np.ones(400)
    plane = plane_near(exact_places(Board()), weights)
    np.testing.assert_allclose(np.abs(plane.frame.axes[2]), [0.0, 1.0, 0.0], atol=1e-12)
    sphere = sphere_near(exact_places(Ball(low=0.3)), weights)
    assert isinstance(sphere, Sphere)
    assert sphere.radius_mm == pytest.approx(30.0, abs=1e-9)
    np.testing.assert_allclose(sphere.centre_mm, 0.0, atol=1e-9)


@pytest.mark.parametrize("turn", [math.tau, math.tau / 3], ids=["whole", "120 deg"])
@pytest.mark.parametrize("degree", [0, 2], ids=["cylinder", "cone"])
def test_axes_are_found_without_a_first_guess(degree: int, turn: float) -> None:
    """From there least squares must arrive at the true form, to rounding."""
    radius = steady(50.0) if degree == 0 else tapered(0.3)
    part = Turned(radius, turn=turn)
    for seed in range(5):
        places, weights = (
            scanned(part, 400, seed, sigma=0.0).placed(exact_places(part)),
            np.ones(400),
        )
        frame = axis_near(places, weights, degree=degree)
        near = cylinder_near if degree == 0 else cone_near
        singles = Moments(weights, places, np.zeros((400, 3, 3)))
        cells = Cells(singles, 1e12 * weights, 1e-12 * weights, weights, np.zeros((3, 3)))
        found = adjusted(near(frame, places, weights), cells, rounds=12)
        assert found is not None
        assert np.abs(found.distances_mm).max() < 1e-6
