"""Forms measure what they say, and a cell of points stands for its points to second order."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.skinning.adjustment import Cells, adjusted, against, spread_over
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.primitives import (
    Cone,
    Cylinder,
    Form,
    Plane,
    Reading,
    Sphere,
    axes_about,
)
from reconstruction.skinning.revolution import Revolution
from reconstruction.slices import Frame
from tests.reconstruction.exact_cases import Turned, gathered, scanned

FRAME = Frame(np.array([3.0, -2.0, 10.0]), axes_about(np.array([0.2, 0.1, 1.0]), np.eye(3)[0]))
PROFILE = np.array([[h, 20.0 + 4.0 * math.sin(h / 9.0)] for h in np.linspace(-30.0, 60.0, 25)])
FORMS: list[Form] = [
    Plane(FRAME),
    Cylinder(FRAME, 20.0),
    Cone(FRAME, 20.0, 0.4),
    Sphere(np.array([1.0, 2.0, 3.0]), 20.0),
    Revolution(FRAME, PROFILE, closed=False),
]
NAMES = [form.kind for form in FORMS]


def places_beside(form: Form, count: int = 40, seed: int = 1) -> FloatArray:
    """Places within 0.3 mm of a form, found by its own distances (bisection needs no more)."""
    rng = np.random.default_rng(seed)
    places = FRAME.to_part(rng.uniform([-25, -25, -10], [25, 25, 30], (count, 3)))
    for _ in range(3):
        reading = form.measure(places)
        places = places - reading.distances_mm[:, None] * reading.normals
    return np.asarray(places + 0.3 * rng.uniform(-1, 1, (count, 1)) * form.measure(places).normals)


@pytest.mark.parametrize("form", FORMS, ids=NAMES)
def test_slopes_are_what_a_small_move_changes(form: Form) -> None:
    places = places_beside(form)
    slopes = form.measure(places).slopes
    assert slopes.shape == (len(places), len(form.names))
    for k in range(len(form.names)):
        step = np.zeros(len(form.names))
        step[k] = 1e-5
        there = form.moved(step).measure(places).distances_mm
        back = form.moved(-step).measure(places).distances_mm
        np.testing.assert_allclose((back - there) / 2e-5, slopes[:, k], atol=2e-5)


@pytest.mark.parametrize("form", FORMS, ids=NAMES)
def test_normals_are_the_gradient_of_the_distance(form: Form) -> None:
    places = places_beside(form)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        ahead = form.measure(places + step).distances_mm
        behind = form.measure(places - step).distances_mm
        np.testing.assert_allclose(
            (ahead - behind) / 2e-5, form.measure(places).normals[:, axis], atol=1e-6
        )


@pytest.mark.parametrize("form", FORMS, ids=NAMES)
def test_curvatures_are_second_derivatives_of_the_distance(form: Form) -> None:
    places = places_beside(form)
    feet = places - (reading := form.measure(places)).distances_mm[:, None] * reading.normals
    at = form.measure(feet)
    around = at.around if form.kind != "sphere" else np.cross(at.normals, [0.3, 0.5, 0.8])
    around = around / np.linalg.norm(around, axis=1)[:, None]
    for way, bends in ((around, at.curvatures[:, 0]),
                       (np.cross(at.normals, around), at.curvatures[:, 1])):  # fmt: skip
        step = 2e-3
        second = (form.measure(feet + step * way).distances_mm
                  + form.measure(feet - step * way).distances_mm) / step**2  # fmt: skip
        np.testing.assert_allclose(second, bends, atol=2e-5)


def naive_second_form(reading: Reading, m: int) -> FloatArray:
    """The second fundamental form written out as a matrix."""
    n, t = reading.normals[m], reading.around[m]
    b = np.cross(n, t)
    one, other = reading.curvatures[m]
    if one == other:
        return np.asarray(one * (np.eye(3) - np.outer(n, n)))
    return np.asarray(one * np.outer(t, t) + other * np.outer(b, b))


def naive_share(bend: float, noise: float) -> float:
    """A smooth step down from 1 at a ratio of 0.35 to 0 at 0.6."""
    at = min(max((math.sqrt(max(bend, 0.0) / noise) - 0.35) / 0.25, 0.0), 1.0)
    return 1.0 - 3.0 * at**2 + 2.0 * at**3


@pytest.mark.parametrize("form", FORMS, ids=NAMES)
def test_the_kernel_of_spreads_agrees_with_its_naive_twin(form: Form) -> None:
    rng = np.random.default_rng(2)
    places = places_beside(form)
    count = len(places)
    roots = rng.normal(0.0, 0.5, (count, 3, 3)) * rng.uniform(0.5, 4.0, (count, 1, 1))
    spreads = roots @ roots.swapaxes(1, 2)
    noise = np.diag([0.04, 0.03, 0.01])
    scale = rng.uniform(0.5, 2.0, count)
    moments = Moments(np.full(count, 9.0), places, spreads)
    cells = Cells(moments, np.ones(count), np.ones(count), scale, noise)
    reading = form.measure(places)
    found = spread_over(reading, cells)
    shares = []
    for m in range(count):
        n = reading.normals[m]
        own = spreads[m] - scale[m] * noise
        second = naive_second_form(reading, m) @ own
        shift = 0.5 * float(np.trace(second))
        assert found.shifts_mm[m] == pytest.approx(shift, abs=1e-12)
        assert found.scatters_mm2[m] == pytest.approx(n @ spreads[m] @ n)
        bend = 0.5 * float(np.trace(second @ second))
        share = naive_share(bend, scale[m] * float(n @ noise @ n))
        shares.append(share)
        pull = share * (np.eye(3) - np.outer(n, n)) @ own @ n
        np.testing.assert_allclose(found.pulls_mm2[m], pull, atol=1e-12)
    assert form.kind == "plane" or any(0.0 < share < 1.0 for share in shares)


def spread_cells(moments: Moments, noise: FloatArray) -> Cells:
    count = len(moments)
    return Cells(moments, moments.counts, np.ones(count), np.ones(count), noise)


@pytest.mark.parametrize("level_only", [False, True], ids=["every way", "in the plane"])
@pytest.mark.parametrize("kind", ["cylinder", "cone", "sphere"])
def test_cells_of_a_small_radius_are_not_biased(kind: str, *, level_only: bool) -> None:
    """Cells 30 degrees wide, noise of a fifteenth of the radius: each of 2 000 000 points counts.

    The mean distance of all cells must vanish but for sampling and the fourth order, which is
    about (spread / radius)**4 of the radius, below 3e-4 mm here; without the corrections it is
    off by some 0.03 mm (spread) and 0.005 mm (noise).
    """
    rng = np.random.default_rng(3)
    count, sigma, radius = 2_000_000, 0.2, 3.0
    angle, z = math.tau * rng.random(count), rng.uniform(-1.0, 1.0, count)
    slope = {"cylinder": 0.0, "cone": 0.4, "sphere": 0.0}[kind]
    r = radius + slope * z
    points = np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
    forms: dict[str, Form] = {
        "cylinder": Cylinder(Frame(np.zeros(3), np.eye(3)), radius),
        "cone": Cone(Frame(np.zeros(3), np.eye(3)), radius, math.atan(0.4)),
        "sphere": Sphere(np.zeros(3), radius),
    }
    if kind == "sphere":
        points[:, :2] *= np.sqrt(1.0 - (z / radius) ** 2)[:, None]
    noise = np.diag([sigma**2, sigma**2, 0.0 if level_only else sigma**2])
    points += rng.normal(0.0, sigma, points.shape) * [1.0, 1.0, 0.0 if level_only else 1.0]
    sector = np.floor(np.arctan2(points[:, 1], points[:, 0]) / math.radians(30)).astype(np.int64)
    moments = gathered(points, sector * 100 + np.floor(4 * z).astype(np.int64))
    found, _ = against(forms[kind], spread_cells(moments, noise))
    raw = forms[kind].measure(moments.means_mm).distances_mm
    mean = float(np.average(found.distances_mm, weights=moments.counts))
    assert found.trust.min() == 1.0
    assert abs(float(np.average(raw, weights=moments.counts))) > 0.02
    assert abs(mean) < 4 * sigma / math.sqrt(count) + 3e-4


@pytest.mark.parametrize("level_only", [False, True], ids=["every way", "in the plane"])
def test_a_cone_cut_in_slabs_fits_like_its_single_points(*, level_only: bool) -> None:
    """Slabs cut a cone askew: in each, points farther along the wall lie farther off it.

    What a cell's covariance knows of that must bring the fit to where the points bring it: the
    half angle within a tenth of its standard deviation; without it the shift is several.
    """
    part = Turned(lambda _, z: 20.0 + 0.5 * z, height=6.0, slices=3)
    scan = scanned(part, 40_000, 4, level_only=level_only, turned=False)
    rng = np.random.default_rng(4)
    points = part.drawn(rng, 40_000)
    points += rng.normal(0.0, 0.2, points.shape) * [1.0, 1.0, 0.0 if level_only else 1.0]
    single = Moments(np.ones(len(points)), points, np.zeros((len(points), 3, 3)))
    start = Cone(Frame(np.array([0.0, 0.0, 3.0]), np.eye(3)), 21.5, math.atan(0.5))
    fits = []
    for moments in (scan.moments, single):
        steep = math.cos(math.atan(0.5)) ** 2
        variance = 0.04 * (steep if level_only else 1.0)
        count = len(moments)
        cells = Cells(moments, moments.counts / variance, np.full(count, variance),
                      np.ones(count), scan.noise_mm2)  # fmt: skip
        fits.append(adjusted(start, cells, rounds=20))
    assert fits[0] is not None
    assert fits[1] is not None
    gathered_fit, single_fit = fits[0].form, fits[1].form
    assert isinstance(gathered_fit, Cone)
    assert isinstance(single_fit, Cone)
    deviation = math.sqrt(fits[0].covariance[5, 5])
    assert abs(gathered_fit.half_angle_rad - single_fit.half_angle_rad) < 0.1 * deviation


def test_an_axis_that_has_run_away_gives_no_frame_and_does_not_go_round_for_ever() -> None:
    for axis in (np.array([np.nan, 0.0, 1.0]), np.array([0.0, np.inf, 0.0])):
        assert not np.isfinite(axes_about(axis, np.array([1.0, 0.0, 0.0]))).any()
