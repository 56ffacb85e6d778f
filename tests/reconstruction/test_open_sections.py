"""Meridians and stripes: one surface each, closed or a sheet, measured against formulas."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from loftscan import reconstruct
from loftscan.result import Result
from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.exporting import read_step, read_threedm
from reconstruction.fit_pipeline import FittedReconstruction
from reconstruction.nurbs import evaluate_surface, points_and_tangents_at
from reconstruction.skinning.drawing import draw_outlines
from reconstruction.skinning.layout import Layout, fan_of, is_turned, layout_of
from reconstruction.skinning.skin import Skin
from reconstruction.slices import Frame, Slice
from tests.reconstruction import open_cases as cases

# A correct fit sits at 1.02 to 1.11 of sigma sqrt(freedom / points), one seed scatters about that.
NEAR_BOUND = 1.3
READ_BACK_MM = 1e-6


def skin_of(result: Result) -> Skin:
    done = result.reconstruction
    assert isinstance(done, FittedReconstruction)
    (skin,) = done.skinned.skins
    assert isinstance(skin, Skin)
    return skin


def bound_mm(result: Result) -> float:
    fit = skin_of(result).fit
    return cases.SIGMA * math.sqrt(fit.edf / fit.moments.total)


def lattice(result: Result, count: int = 300) -> FloatArray:
    (surface,) = result.surface
    u, v = (np.linspace(*domain, count) for domain in surface.domain)
    return evaluate_surface(surface, u, v).reshape(-1, 3)


def rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def between_ends(places: FloatArray) -> FloatArray:
    z = places[:, 2]
    return places[(z > 2.0) & (z < cases.VASE_HEIGHT - 2.0)]


def within_rim(places: FloatArray) -> FloatArray:
    return places[(np.abs(places[:, :2]) < [58.0, 38.0]).all(axis=1)]


def facing(result: Result, outside: FloatArray | None, count: int = 500) -> FloatArray:
    """Which way normals look on a lattice, beside a direction, or away from the z axis."""
    (surface,) = result.surface
    u, v = (np.linspace(*domain, count + 2)[1:-1] for domain in surface.domain)
    grid_u, grid_v = (each.ravel() for each in np.meshgrid(u, v, indexing="ij"))
    places, along, across = points_and_tangents_at(surface, grid_u, grid_v)
    ways = places * [1.0, 1.0, 0.0] if outside is None else outside
    return np.sign((np.cross(along, across) * ways).sum(axis=1))


@pytest.fixture(scope="module")
def lobed() -> Result:
    return reconstruct(cases.meridian_slices(cases.lobed_vase), exact="never")


@pytest.fixture(scope="module")
def stepped() -> Result:
    return reconstruct(cases.stripe_slices(cases.stepped_bulge, share_lost=0.15))


def test_meridians_all_round_make_one_closed_surface_at_the_bound_of_their_noise(
    lobed: Result,
) -> None:
    errors = cases.turned_errors(cases.lobed_vase, between_ends(lattice(lobed)))
    assert rms(errors) < NEAR_BOUND * bound_mm(lobed)
    assert lobed.metrics["layout"] == "meridians"
    assert lobed.metrics["watertight"]
    assert lobed.metrics["euler_number"] == 2
    assert (facing(lobed, None) == 1.0).all()  # no fold


def test_what_a_fifth_of_every_meridian_lacks_the_others_say() -> None:
    slices = cases.meridian_slices(cases.lobed_vase, share_lost=0.2)
    result = reconstruct(slices, exact="never")
    errors = cases.turned_errors(cases.lobed_vase, between_ends(lattice(result)))
    assert rms(errors) < NEAR_BOUND * bound_mm(result)
    assert np.abs(errors).max() < 6.0 * cases.SIGMA  # nowhere did a gap make it waver
    assert result.metrics["watertight"]


def test_meridians_of_a_ball_close_in_its_poles_and_it_is_recognised() -> None:
    result = reconstruct(cases.sphere_meridians())
    (shape,) = result.shapes
    assert shape is not None
    assert shape.kind == "sphere"
    (radius,) = [each for each in shape.quantities if each.name == "radius"]
    assert abs(radius.values[0] - cases.SPHERE_RADIUS) < 3.0 * radius.deviations[0]
    assert result.metrics["watertight"]
    assert result.metrics["euler_number"] == 2
    assert not any("no slice samples" in each for each in result.warnings)  # poles are measured


def test_a_free_ball_has_degenerate_rows_at_its_poles_and_does_not_fold() -> None:
    result = reconstruct(cases.sphere_meridians(), exact="never")
    assert skin_of(result).fit.net.apex[[0, -1]].all()
    places = lattice(result)
    errors = np.linalg.norm(places, axis=1) - cases.SPHERE_RADIUS
    assert rms(errors) < NEAR_BOUND * bound_mm(result)
    assert (facing(result, None) == 1.0).all()


def test_a_turned_part_by_meridians_is_an_exact_surface_of_revolution() -> None:
    result = reconstruct(cases.meridian_slices(cases.vase))
    (shape,) = result.shapes
    assert shape is not None
    assert shape.kind == "revolution"
    errors = cases.turned_errors(cases.vase, between_ends(lattice(result)))
    assert rms(errors) < 0.003  # half of what its free surface has


def test_planes_that_see_both_sides_of_the_axis_are_two_meridians_each() -> None:
    halves = cases.meridian_slices(cases.lobed_vase, count=60)
    planes = [
        Slice(k, np.concatenate([one.points_mm, other.points_mm]), one.frame)
        for k, (one, other) in enumerate(zip(halves[:30], halves[30:], strict=True))
    ]
    result = reconstruct(planes, exact="never")
    errors = cases.turned_errors(cases.lobed_vase, between_ends(lattice(result)))
    assert rms(errors) < 2.0 * bound_mm(result)  # where both walls come near, sections run together
    assert result.metrics["watertight"]


def test_meridians_over_half_a_turn_make_a_sheet_that_is_said_to_be_open() -> None:
    angles = np.linspace(0.0, math.pi, 37).tolist()
    result = reconstruct(cases.meridian_slices(cases.lobed_vase, angles_rad=angles))
    errors = cases.turned_errors(cases.lobed_vase, between_ends(lattice(result)))
    assert rms(errors) < NEAR_BOUND * bound_mm(result)
    assert result.metrics["surface_open"]
    assert result.metrics["euler_number"] == 1  # a disc
    assert result.metrics["volume_mm3"] is None
    assert any("no solid" in each for each in result.warnings)


def test_a_cloud_is_cut_in_meridians_where_that_is_asked_for() -> None:
    cloud = cases.cloud_of(cases.meridian_slices(cases.lobed_vase)) + np.array([300.0, -40.0, 0.0])
    rng = np.random.default_rng(3)
    result = reconstruct(
        rng.permutation(cloud), layout="meridians", axis_at_mm=(300.0, -40.0), exact="never"
    )
    places = between_ends(lattice(result) - [300.0, -40.0, 0.0])
    assert result.metrics["slices"] == 72
    assert rms(cases.turned_errors(cases.lobed_vase, places)) < NEAR_BOUND * bound_mm(result)


def test_stripes_make_an_open_sheet_as_wide_as_they_are_at_the_bound_of_their_noise() -> None:
    result = reconstruct(cases.stripe_slices(cases.bulge, share_lost=0.15, ragged=0.1))
    places = lattice(result)
    errors = cases.relief_errors(cases.bulge, within_rim(places))
    assert rms(errors) < NEAR_BOUND * bound_mm(result)
    # The stripe that reaches farthest of several says where they end.
    assert np.ptp(places[:, 0]) > 114.0
    # Borders move with the noise, along normals that lean a little.
    ends = [places[:, 1].min(), places[:, 1].max()]
    np.testing.assert_allclose(ends, [-40.0, 40.0], atol=cases.SIGMA)
    assert result.metrics["layout"] == "stripes"
    assert not result.metrics["watertight"]
    assert result.metrics["manifold"]
    assert result.metrics["components"] == 1
    sides = facing(result, np.array([0.0, 0.0, 1.0]))
    assert (sides == sides[0]).all()  # no fold


def test_an_open_mesh_looks_up() -> None:
    mesh = reconstruct(cases.stripe_slices(cases.bulge, count=20, points=200)).mesh
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0.0).all()


def test_a_step_across_stripes_is_an_edge_on_either_side(stepped: Result) -> None:
    places = within_rim(lattice(stepped))
    away = np.abs(cases.beyond_step(places[:, 0], places[:, 1]))
    errors = cases.relief_errors(cases.stepped_bulge, places[away > 0.5])
    assert rms(errors) < NEAR_BOUND * bound_mm(stepped)
    assert np.abs(errors).max() < 2.0 * cases.SIGMA  # a smooth surface would swing beside it
    assert len(skin_of(stepped).fit.net.creases) == 2


def test_the_wall_of_a_step_is_marked_as_synthetic(stepped: Result) -> None:
    mesh = stepped.mesh
    x, y, z = mesh.vertices_mm.T
    on_wall = np.abs(z - cases.bulge(x, y) - 0.5 * cases.STEP_MM) < 0.4 * cases.STEP_MM
    assert on_wall.any()
    assert mesh.synthetic[on_wall].all()


def test_a_sheet_goes_to_cad_as_one_valid_face_and_comes_back(
    stepped: Result, tmp_path: Path
) -> None:
    pytest.importorskip("OCP")
    from tests.reconstruction.test_exporting_solids import count_of, is_valid, read_shape

    folder = stepped.save(tmp_path / "out", formats=["step", "3dm", "iges"])
    shape = read_shape(folder / "surface.step")
    assert count_of(shape, "SOLID") == 0
    assert count_of(shape, "FACE") == 1
    assert is_valid(shape)
    (surface,) = stepped.surface
    u, v = (np.linspace(*domain, 60) for domain in surface.domain)
    for found in (
        read_step(folder / "surface.step"),
        read_threedm(folder / "surface.3dm")[0],
    ):
        (back,) = found
        off = evaluate_surface(back, u, v) - evaluate_surface(surface, u, v)
        assert np.abs(off).max() < READ_BACK_MM


def test_three_stripes_far_apart_are_followed_by_a_spline() -> None:
    result = reconstruct(cases.stripe_slices(cases.bulge, count=3))
    assert float(str(result.metrics["surface_deviation_rms_mm"])) < 1.5 * cases.SIGMA


def test_a_stripe_far_off_is_left_out_and_named() -> None:
    slices = cases.stripe_slices(cases.bulge, count=40, points=300)
    slices[17] = Slice(17, slices[17].points_mm + np.array([0.0, 0.0, 8.0]), slices[17].frame)
    result = reconstruct(slices)
    assert any("slice 17: stands out from both neighbours" in each for each in result.warnings)
    errors = cases.relief_errors(cases.bulge, within_rim(lattice(result)))
    assert rms(errors) < 2.0 * bound_mm(result)  # the neighbours' stripe is twice as wide there


def test_an_empty_slice_amid_stripes_is_bridged_and_named() -> None:
    slices = cases.stripe_slices(cases.bulge, count=40, points=300)
    slices[17] = Slice(17, np.empty((0, 3)), slices[17].frame)
    result = reconstruct(slices)
    assert any("slice 17" in each for each in result.warnings)
    errors = cases.relief_errors(cases.bulge, within_rim(lattice(result)))
    assert rms(errors) < 2.0 * bound_mm(result)


def test_one_stripe_is_no_surface() -> None:
    with pytest.raises(NotLoftable, match="two are needed"):
        reconstruct(cases.stripe_slices(cases.bulge, count=1), layout="stripes")


def test_the_reported_deviation_of_a_sheet_is_that_of_its_errors() -> None:
    skins = [
        skin_of(reconstruct(cases.stripe_slices(cases.bulge, count=40, points=200, seed=seed)))
        for seed in range(6)
    ]
    z = []
    for skin in skins:
        end_u, end_v = skin.fit.net.spans
        u, v = (np.linspace(0.1 * end, 0.9 * end, 12) for end in (end_u, end_v))
        places = evaluate_surface(skin.surface, u, v).reshape(-1, 3)
        grid_u, grid_v = np.meshgrid(u, v, indexing="ij")
        deviations = skin.deviation_mm(grid_u.ravel(), grid_v.ravel())
        z.append(cases.relief_errors(cases.bulge, places) / deviations)
    # 864 places of 6 scans, alike within a scan: the rms of z is known to about a tenth.
    assert 0.6 < rms(np.concatenate(z)) < 1.4


def test_planes_through_one_axis_are_a_fan_and_parallel_ones_are_none() -> None:
    frames = [piece.frame for piece in cases.meridian_slices(cases.vase, count=7, points=20)]
    fan = fan_of(frames)
    assert fan is not None
    np.testing.assert_allclose(fan.frame.axes[2], [0.0, 0.0, 1.0], atol=1e-12)
    angles = [fan.angle_of(frame) for frame in frames]
    np.testing.assert_allclose(angles, np.arange(7) / 7 * math.tau, atol=1e-12)
    rings = [Frame(np.array([0.0, 0.0, z]), np.eye(3)) for z in range(5)]
    assert fan_of(rings) is None
    assert not is_turned(rings[0], rings[1])


def test_an_axis_is_found_wherever_it_stands_and_however_it_leans() -> None:
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    place = np.array([120.0, -30.0, 55.0])
    frames = [
        Frame(place + float(k) * turn[2], piece.frame.axes @ turn)
        for k, piece in enumerate(cases.meridian_slices(cases.vase, count=9, points=20))
    ]
    fan = fan_of(frames)
    assert fan is not None
    np.testing.assert_allclose(np.abs(fan.frame.axes[2] @ turn[2]), 1.0, atol=1e-12)
    arm = fan.frame.origin_mm - place
    np.testing.assert_allclose(arm - (arm @ turn[2]) * turn[2], 0.0, atol=1e-9)


def test_planes_that_are_neither_parallel_nor_share_an_axis_are_refused() -> None:
    frames = [Frame(np.zeros(3), np.linalg.qr(np.random.default_rng(k).normal(size=(3, 3)))[0])
              for k in range(6)]  # fmt: skip
    with pytest.raises(NotLoftable, match="neither parallel nor"):
        fan_of(frames)


def test_planes_that_pass_their_axis_are_refused_and_it_is_said_by_how_much() -> None:
    frames = [
        Frame(10.0 * piece.frame.axes[2], piece.frame.axes)
        for piece in cases.meridian_slices(cases.vase, count=9, points=20)
    ]
    with pytest.raises(NotLoftable, match="10 mm"):
        fan_of(frames)


def test_rings_of_which_some_are_open_are_rings() -> None:
    slices = cases.rings_of(cases.vase, count=12, points=300)
    for k in (3, 4, 5, 8):  # the sensor saw a third of the turn
        points = slices[k].points_mm
        slices[k] = Slice(k, points[points[:, 0] > 10.0], slices[k].frame)
    assert layout_of([draw_outlines(piece) for piece in slices]) is Layout.RINGS
