"""A branch whose points are one exact shape gets its surface, ended as the branch is; no other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from reconstruction.arrays import FloatArray
from reconstruction.fitting.curve import Exact
from reconstruction.meshing import Mesh
from reconstruction.nurbs import evaluate_surface, evaluate_surface_at
from reconstruction.skinning import surfacing
from reconstruction.skinning.apexes import tips_of
from reconstruction.skinning.branch import Branch, End, Ending
from reconstruction.skinning.ends import Apex, Brim
from reconstruction.skinning.exact_ends import Levels
from reconstruction.skinning.exact_skins import AnySkin, ExactSkin, exact_in_place_of, exact_skin
from reconstruction.skinning.outlines import Moments
from reconstruction.skinning.primitives import Cone, Cylinder, Sphere
from reconstruction.skinning.skin import Skin, skin_branch
from reconstruction.skinning.surfacing import Skinned, skin_slices
from tests.reconstruction.exact_parts import (
    GAP,
    HEIGHTS,
    HIGH,
    LOW,
    SIGMA,
    STEP,
    conical,
    empty,
    leaning,
    pieces,
    steady,
)
from tests.reconstruction.skinning_parts import Radius


def exact(found: Skinned) -> ExactSkin:
    (skin,) = found.skins
    assert isinstance(skin, ExactSkin)
    return skin


def solid_of(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def grid(skin: AnySkin, count: int = 40) -> tuple[FloatArray, FloatArray]:
    u, v = np.meshgrid(*(np.linspace(*domain, count) for domain in skin.surface.domain))
    return u.ravel(), v.ravel()


@pytest.fixture(scope="module")
def tube() -> Skinned:
    return skin_slices(pieces(steady(20.0), gaps=[GAP]))


def test_a_cylinder_is_one_rational_patch_between_level_ends(tube: Skinned) -> None:
    skin = exact(tube)
    assert [shape and shape.kind for shape in tube.shapes] == ["cylinder"]
    form = skin.shape.form
    assert isinstance(form, Cylinder)
    places = evaluate_surface(skin.surface, np.linspace(0, 1, 100), np.linspace(LOW, HIGH, 9))
    off = form.measure(places.reshape(-1, 3)).distances_mm
    assert np.abs(off).max() < 1e-12 * form.radius_mm * 100
    assert np.ptp(places[:, 0, 2]) < 1e-12
    assert places[0, 0, 2] == pytest.approx(LOW)
    assert places[0, -1, 2] == pytest.approx(HIGH)
    assert skin.surface.periodic_u


def test_its_figures_are_off_by_what_they_say(tube: Skinned) -> None:
    for figure, true in zip(
        exact(tube).shape.quantities, (None, (0.0, 0.0, 1.0), 20.0), strict=True
    ):
        if true is not None:
            off = np.abs(figure.values - np.atleast_1d(true))
            # Four: one of ten thousand figures is that far off by chance.
            assert (off < 4.0 * figure.deviations + 1e-7).all()


def test_the_mesh_of_an_exact_surface_is_closed_and_its_rings_lie_on_it(tube: Skinned) -> None:
    solid = solid_of(tube.mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.euler_number == 2
    form = exact(tube).shape.form
    assert np.abs(form.measure(tube.mesh.vertices_mm).distances_mm).max() < 1e-9
    assert isinstance(form, Cylinder)
    true = math.pi * form.radius_mm**2 * (HIGH - LOW)
    assert solid.volume == pytest.approx(true, rel=2.0 * tube.tolerance_mm / form.radius_mm)


def test_gaps_are_marked_on_an_exact_surface_as_well(tube: Skinned) -> None:
    x, y, z = tube.mesh.vertices_mm.T
    turn = np.mod(np.arctan2(y, x), math.tau)
    # A lattice box is 1.5 mm high and, with four cells in each, about 0.3 rad wide.
    deep = (turn > 1.35) & (turn < 1.65) & (z > 13.0) & (z < 19.0)
    far = ((turn < 0.6) | (turn > 2.4)) & (z > 1.0) & (z < 33.0)
    assert deep.any()
    assert tube.mesh.synthetic[deep].all()
    assert not tube.mesh.synthetic[far].any()


@pytest.mark.parametrize("recognition", Exact)
def test_where_slices_are_missing_the_mesh_stands_on_no_measured_point(recognition: Exact) -> None:
    kept = np.delete(HEIGHTS, [10, 11])
    mesh = skin_slices(pieces(steady(20.0), heights=kept), exact=recognition).mesh
    way = np.abs(mesh.vertices_mm[:, 2] - 0.5 * (HEIGHTS[9] + HEIGHTS[12]))
    inside = way < 1.5 * STEP - 0.01
    assert inside.any()
    assert mesh.synthetic[inside].all()
    # Boxes of the lattice that shows gaps within slices are two slices high.
    assert not mesh.synthetic[way > 3.5 * STEP].any()


def test_the_deviation_anywhere_is_that_of_the_shape_also_in_a_gap(tube: Skinned) -> None:
    skin = exact(tube)
    u, v = grid(skin)
    places = evaluate_surface_at(skin.surface, u, v)
    off = np.hypot(places[:, 0], places[:, 1]) - 20.0
    deviations = skin.deviation_mm(u, v)
    assert (np.abs(off) < 4.0 * deviations).all()
    np.testing.assert_allclose(deviations, skin.shape.deviation_mm(places))
    # Five figures of 12 000 points: nowhere near a free surface's.
    assert deviations.max() < 5.0 * SIGMA * math.sqrt(5.0 / 12_000)


def test_where_a_cylinder_is_certain_no_free_surface_is_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> Skin:
        raise AssertionError("a free surface was fitted")

    monkeypatch.setattr(surfacing, "skin_branch", refuse)
    assert exact(skin_slices(pieces(steady(20.0)))).shape.kind == "cylinder"


def test_the_outline_of_one_slice_is_no_plane() -> None:
    """All its points lie in one plane, exactly; a feature of one slice is such a branch."""
    (piece,) = pieces(steady(20.0), heights=HEIGHTS[:1])
    ends = (End(Ending.UNSEEN, LOW), End(Ending.UNSEEN, STEP))
    branch = Branch(piece.outlines, cyclic=False, ends=ends, hole=False)
    assert exact_skin(branch, None, Levels(HEIGHTS[:1], np.zeros(1, np.bool_))) is None


def test_a_branch_of_one_outline_keeps_its_free_surface_whatever_loose_points_say() -> None:
    skinned = skin_slices(pieces(steady(20.0)), exact=Exact.NEVER)
    (skin,) = skinned.skins
    assert isinstance(skin, Skin)
    levels = Levels(HEIGHTS, np.zeros(len(HEIGHTS), np.bool_))
    assert exact_in_place_of(skin, levels) is not None
    alone = replace(skin.branch, outlines=skin.branch.outlines[:1])
    assert exact_in_place_of(replace(skin, branch=alone), levels) is None


def test_never_keeps_a_cylinder_free() -> None:
    found = skin_slices(pieces(steady(20.0)), exact=Exact.NEVER)
    assert found.shapes == (None,)
    assert isinstance(found.skins[0], Skin)


def test_an_open_run_near_a_cylinder_has_its_say(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of a slice is missing: its run lies on no outline, and on the cylinder."""
    half = pieces(steady(20.0), gaps=[(0.0, 3.5, 10.0, 11.0)])
    assert any(piece.runs for piece in half)
    asked: list[int] = []

    def noted(branch: Branch, loose: Moments | None) -> Skin:
        asked.append(0 if loose is None else len(loose))
        return skin_branch(branch, loose)

    monkeypatch.setattr(surfacing, "skin_branch", noted)
    found = exact(skin_slices(half))
    assert asked, "the outlines alone decided"
    assert found.shape.kind == "cylinder"
    outlines = sum(len(outline.moments) for outline in found.branch.outlines)
    assert len(found.shape.moments) > outlines


@pytest.mark.parametrize(
    "radius",
    [
        lambda turn, _: 20.0 * (1.0 + 0.01 * np.cos(3.0 * turn)),
        lambda turn, _: 20.0 * (1.0 + 0.01 * np.cos(7.0 * turn)),
        lambda turn, z: 20.0 - 0.4 * np.exp(-((20.0 * (turn - 3.0)) ** 2 + (z - 17.0) ** 2) / 18.0),
    ],
    ids=["three lobes of 2 %", "seven lobes of 2 %", "a dent of 0.4 mm"],
)
def test_what_is_nearly_a_cylinder_stays_free(radius: Radius) -> None:
    assert skin_slices(pieces(radius)).shapes == (None,)


def test_a_barrel_is_a_surface_of_revolution() -> None:
    found = skin_slices(pieces(lambda turn, z: 20.0 + 2.0 * np.sin(z / 12.0) + 0.0 * turn))
    skin = exact(found)
    assert skin.shape.kind == "revolution"
    u, v = grid(skin)
    places = evaluate_surface_at(skin.surface, u, v)
    off = np.hypot(places[:, 0], places[:, 1]) - 20.0 - 2.0 * np.sin(places[:, 2] / 12.0)
    assert np.sqrt(np.mean(off**2)) < 0.1 * SIGMA
    assert solid_of(found.mesh).is_watertight


# --- ends -----------------------------------------------------------------------------------------


def test_a_cone_ends_in_its_apex_though_slices_below_it_are_heaps() -> None:
    near = np.append(HEIGHTS[:23], [34.5, 35.0, 35.5])
    cut = [*pieces(conical, heights=near), empty(26, 36.5)]
    heaps = [piece.height_mm for piece in cut if not piece.outlines and piece.unresolved]
    assert heaps, "of a ring no wider than the noise no outline can be drawn"
    skin = exact(skin_slices(cut))
    form = skin.shape.form
    assert isinstance(form, Cone)
    assert form.half_angle_rad == pytest.approx(0.35, abs=1e-3)
    assert skin.brims is not None
    low, high = skin.brims
    assert isinstance(low, Brim)
    assert isinstance(high, Apex)
    assert high.sharp
    np.testing.assert_allclose(high.point_mm, form.apex_mm)
    (tip,) = tips_of([skin])
    assert tip.sharp
    assert (np.abs(tip.point_mm - [0.0, 0.0, 36.0]) < 4.0 * tip.deviations_mm).all()
    assert tip.deviations_mm.max() < 0.03


def test_a_cone_that_is_cut_off_ends_level() -> None:
    cut = [*pieces(conical, heights=HEIGHTS[:15]), empty(15, float(HEIGHTS[15]))]
    skin = exact(skin_slices(cut))
    assert skin.shape.kind == "cone"
    assert skin.brims is not None
    assert all(isinstance(brim, Brim) for brim in skin.brims)
    _, (low, high) = skin.surface.domain
    assert (low, high) == pytest.approx((LOW, HEIGHTS[14] + 0.5 * STEP))


def test_a_heap_beyond_the_tip_belongs_to_something_else() -> None:
    """A stem too thin for outlines goes on above: the cone does not end in the air below it."""
    stem = np.arange(32.0, 50.0, 1.5)
    stemmed = np.append(HEIGHTS[:20], stem)
    found = skin_slices(
        pieces(lambda turn, z: np.maximum(conical(turn, z), 0.02), heights=stemmed, count=300)
    )
    for skin in found.skins:
        if skin.shape is not None and skin.brims is not None:
            assert isinstance(skin.brims[1], Brim)


def test_a_ball_runs_out_in_its_poles() -> None:
    def ball(turn: FloatArray, z: float) -> FloatArray:
        return np.full_like(turn, math.sqrt(max(20.0**2 - (z - 20.0) ** 2, 0.0)))

    heights = np.arange(27) * 1.5 + 0.5
    cut = [empty(0, -1.0), *pieces(ball, heights=heights), empty(28, 41.0)]
    found = skin_slices(cut)
    skin = exact(found)
    assert isinstance(skin.shape.form, Sphere)
    low, high = tips_of([skin])
    np.testing.assert_allclose(low.point_mm, [0.0, 0.0, 0.0], atol=4.0 * low.deviations_mm.max())
    np.testing.assert_allclose(high.point_mm, [0.0, 0.0, 40.0], atol=4.0 * high.deviations_mm.max())
    assert not high.sharp
    solid = solid_of(found.mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(4.0 / 3.0 * math.pi * 20.0**3, rel=2e-3)


def test_a_leaning_cylinder_ends_in_the_planes_of_its_slices() -> None:
    skin = exact(skin_slices(leaning(0.3, 12.0)))
    form = skin.shape.form
    assert isinstance(form, Cylinder)
    assert form.radius_mm == pytest.approx(12.0, abs=0.01)
    assert abs(form.frame.axes[2] @ [math.sin(0.3), 0.0, math.cos(0.3)]) > 1.0 - 1e-6
    u = np.linspace(0.0, 1.0, 50)
    for end, height in zip(skin.surface.domain[1], (LOW, HIGH), strict=True):
        rim = evaluate_surface_at(skin.surface, u, np.full(50, end))
        np.testing.assert_allclose(rim[:, 2], height, atol=1e-12 * 100)


def oval(turn: FloatArray, z: float) -> FloatArray:
    """A tip 30.5 mm up, its sections no circles by far."""
    return max(1.0 - z / 30.5, 0.0) * (15.0 + 1.5 * np.cos(2.0 * turn))


def test_the_tip_of_a_free_surface_knows_how_far_it_may_lie_off() -> None:
    found = skin_slices([*pieces(oval, heights=HEIGHTS[:20]), empty(20, 31.5)])
    assert found.shapes == (None,)
    (tip,) = tips_of(found.skins)
    assert tip.sharp
    assert (np.abs(tip.point_mm - [0.0, 0.0, 30.5]) < 4.0 * tip.deviations_mm).all()
    assert 0.0 < tip.deviations_mm.max() < 1.0


def test_the_top_of_a_free_dome_is_no_place_that_could_be_measured() -> None:
    def dome(turn: FloatArray, z: float) -> FloatArray:
        return math.sqrt(max(1.0 - (z / 30.0) ** 2, 0.0)) * (15.0 + 1.5 * np.cos(2.0 * turn))

    found = skin_slices([*pieces(dome, heights=HEIGHTS[:20]), empty(20, 30.5)])
    brims = found.skins[0].brims
    assert brims is not None
    assert isinstance(brims[1], Apex)
    assert not brims[1].sharp
    assert tips_of(found.skins) == ()


def test_heaps_that_follow_a_level_are_told_in_their_order() -> None:
    levels = Levels(np.arange(6.0), np.array([True, False, False, True, True, False]))
    assert levels.heaps_beyond(2.0, last=True).tolist() == [3.0, 4.0]
    assert levels.heaps_beyond(1.0, last=True).tolist() == []
    assert levels.heaps_beyond(1.0, last=False).tolist() == [0.0]
