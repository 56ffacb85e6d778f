"""A mesh around all points, where branches cannot follow; and tips whose last slices are heaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from reconstruction.comparison import measure, reference
from reconstruction.fitting.curve import Exact
from reconstruction.meshing import Mesh
from reconstruction.skinning import wrapping
from reconstruction.skinning.draping import Cloud, draped
from reconstruction.skinning.mesh_feet import closest_in
from reconstruction.skinning.skin import Skin
from reconstruction.skinning.standing_in import part_of
from reconstruction.skinning.surfacing import skin_slices
from reconstruction.skinning.wrapping import Swarm, share_apart, share_far, wrapped
from reconstruction.slices import Frame, Slice
from reconstruction.soundness import soundness
from tests.reconstruction.skinning_parts import drawn, ring_slices

UP = np.array([0.0, 0.0, 1.0])
SIGMA_MM = 0.15


def cut(solid: trimesh.Trimesh, heights_mm: np.ndarray, count: int, seed: int) -> list[Slice]:
    """Points uniform along the section of a solid, noise in the plane."""
    rng = np.random.default_rng(seed)
    slices = []
    for index, height in enumerate(heights_mm):
        segments = trimesh.intersections.mesh_plane(solid, UP, UP * height)
        lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
        which = rng.choice(len(segments), count, p=lengths / lengths.sum())
        share = rng.random(count)[:, None]
        points = (1 - share) * segments[which, 0] + share * segments[which, 1]
        points[:, :2] += rng.normal(0.0, SIGMA_MM, (count, 2))
        slices.append(Slice(index, points, Frame(UP * height, np.eye(3))))
    return slices


def swarm_of_slices(slices: list[Slice]) -> Swarm:
    points = np.concatenate([each.points_mm for each in slices])
    levels = np.repeat(np.arange(len(slices)), [len(each.points_mm) for each in slices])
    pitch = float(slices[1].frame.origin_mm[2] - slices[0].frame.origin_mm[2])
    return Swarm(points, np.ones(len(points)), levels, SIGMA_MM, pitch, UP)


def off_mm(mesh: Mesh, solid: trimesh.Trimesh) -> np.ndarray:
    """Distances of places on a mesh from the true solid."""
    made = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    places = np.array(trimesh.sample.sample_surface(made, 4000, seed=3)[0])
    unmarked = np.zeros(len(solid.vertices), dtype=np.bool_)
    truth = Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int64), unmarked)
    return np.abs(measure(places, reference(truth)).distances_mm)


def mug() -> trimesh.Trimesh:
    """An egg with a handle: genus 1."""
    body = trimesh.creation.icosphere(subdivisions=5, radius=12.0)
    body.apply_scale([1.0, 1.0, 1.7])
    handle = trimesh.creation.torus(10.0, 2.5, major_sections=72, minor_sections=36)
    handle.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [1, 0, 0]))
    handle.apply_translation([13.0, 0.0, 0.0])
    return trimesh.boolean.union([body, handle])


def cow() -> trimesh.Trimesh:
    """A body with two ears that begin and end within two slices, and two legs that merge."""
    parts = [trimesh.creation.icosphere(subdivisions=4, radius=12.0)]
    for side in (-1.0, 1.0):
        ear = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
        ear.apply_scale([7.0, 2.0, 1.6])
        ear.apply_translation([side * 13.0, 0.0, 4.0])
        leg = trimesh.creation.icosphere(subdivisions=4, radius=3.0)
        leg.apply_scale([1.0, 1.0, 4.0])
        leg.apply_translation([side * 6.0, 0.0, -16.0])
        parts += [ear, leg]
    return trimesh.boolean.union(parts)


@pytest.mark.parametrize(
    ("solid", "euler"), [(mug(), 0), (cow(), 2)], ids=["a handle", "ears and legs"]
)
def test_a_wrapped_mesh_is_closed_has_the_right_holes_and_lies_nearer_than_the_noise(
    solid, euler: int
) -> None:
    low, high = solid.bounds[:, 2]
    slices = cut(solid, np.arange(low + 0.4, high, 0.8), 400, seed=5)
    swarm = swarm_of_slices(slices)
    mesh = wrapped(swarm)
    assert mesh is not None
    sound = soundness(mesh)
    assert sound.sound
    assert sound.euler_number == euler
    # A third of one point's noise for most of the surface; level ends are half a pitch from the
    # last slice, and edges are rounded by about a pitch.
    off = off_mm(mesh, solid)
    assert np.median(off) < SIGMA_MM / 3.0
    assert np.quantile(off, 0.95) < 0.8
    assert share_far(mesh, swarm) < 0.01


def test_ears_that_come_and_go_within_two_slices_come_out_whole() -> None:
    solid = cow()
    low, high = solid.bounds[:, 2]
    skinned = skin_slices(drawn(cut(solid, np.arange(low + 0.4, high, 0.8), 400, seed=6)))
    assert soundness(skinned.mesh).sound
    assert soundness(skinned.mesh).euler_number == 2
    assert np.quantile(off_mm(skinned.mesh, solid), 0.95) < 0.8


def test_a_surface_that_does_not_follow_the_points_is_replaced_and_it_is_said() -> None:
    solid = trimesh.creation.icosphere(subdivisions=4, radius=12.0)
    stack = drawn(cut(solid, np.arange(-11.6, 12.0, 0.8), 300, seed=8))
    aside = np.array(solid.vertices) + np.array([2.0, 0.0, 0.0])
    wrong = Mesh(aside, np.array(solid.faces), np.zeros(len(aside), dtype=np.bool_))
    mesh, words = part_of(wrong, (), (), stack)
    assert "of the points lie farther from them than their noise explains" in words
    assert soundness(mesh).sound
    assert np.quantile(off_mm(mesh, solid), 0.95) < 0.8


def test_one_slice_that_lies_elsewhere_is_no_reason_to_replace_a_surface() -> None:
    solid = trimesh.creation.icosphere(subdivisions=4, radius=12.0)
    slices = cut(solid, np.arange(-11.6, 12.0, 0.8), 300, seed=8)
    moved_mm = slices[14].points_mm + np.array([5.0, 0.0, 0.0])
    slices[14] = Slice(14, moved_mm, slices[14].frame)
    mesh = Mesh(
        np.array(solid.vertices), np.array(solid.faces), np.zeros(len(solid.vertices), np.bool_)
    )
    kept, words = part_of(mesh, (), (), drawn(slices))
    assert words == ""
    assert kept is mesh


def test_a_plain_part_keeps_its_branch() -> None:
    slices = ring_slices(
        np.arange(20) * 1.0, lambda turn, z: 12.0 + 0.2 * z + 0.0 * turn, count=300, sigma_mm=0.1
    )
    skinned = skin_slices(drawn(slices))
    assert skinned.wrapping == ""
    assert len(skinned.skins) == 1


def ball_cloud(seed: int, count: int = 20_000, sigma_mm: float = 0.2) -> Cloud:
    """Points of a ball of 10 mm, noise along its normals."""
    rng = np.random.default_rng(seed)
    outward = rng.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = outward * (10.0 + rng.normal(0.0, sigma_mm, count))[:, None]
    return Cloud(points, outward, np.ones(count), sigma_mm, np.zeros(3))


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_mesh_is_draped_over_a_ball_by_much_less_than_the_noise(seed: int) -> None:
    start = trimesh.creation.icosphere(subdivisions=4, radius=10.3)
    vertices = draped(
        np.array(start.vertices), np.array(start.faces), ball_cloud(seed), grain_mm=1.0
    )
    off = np.linalg.norm(vertices, axis=1) - 10.0
    # Windows of 1.5 grains hold 110 points: six of their means' freedoms would leave 0.23 sigma.
    assert np.sqrt(np.mean(off**2)) < 0.15 * 0.2


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_gap_in_the_points_is_crossed_as_the_points_around_it_go(seed: int) -> None:
    cloud = ball_cloud(seed)
    seen = cloud.outward[:, 0] < 0.95  # a hole of 6.2 mm, six grains wide
    cloud = Cloud(cloud.points_mm[seen], cloud.outward[seen], cloud.counts[seen], 0.2, np.zeros(3))
    start = trimesh.creation.icosphere(subdivisions=4, radius=10.3)
    vertices = draped(np.array(start.vertices), np.array(start.faces), cloud, grain_mm=1.0)
    off = np.linalg.norm(vertices, axis=1) - 10.0
    # It stood 0.3 mm too high there as everywhere; the rest of the ball says so, and the hole does.
    assert np.abs(off[vertices[:, 0] > 9.5]).max() < 0.1


def test_a_start_that_dips_between_the_last_outlines_of_a_dome_becomes_the_dome() -> None:
    tops = []
    for seed in range(2, 7):
        cloud = ball_cloud(seed)
        seen = cloud.outward[:, 2] < 0.95  # the last outline has a radius of 3.1 mm
        cloud = Cloud(cloud.points_mm[seen], cloud.outward[seen], cloud.counts[seen], 0.2, UP)
        start = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
        vertices = np.array(start.vertices)
        vertices[:, 2] = np.minimum(
            vertices[:, 2], 9.5
        )  # level there, 0.5 mm too low in the middle
        vertices = draped(vertices, np.array(start.faces), cloud, grain_mm=1.0)
        off = np.linalg.norm(vertices, axis=1) - 10.0
        middle = (np.hypot(vertices[:, 0], vertices[:, 1]) < 1.0) & (vertices[:, 2] > 0.0)
        tops.append(float(off[middle].mean()))
    # What noise says of the slope at the rim leaves some 0.15 mm in the middle of one dome, 0.07 mm
    # in the mean of five; moves that only bend little themselves leave nearly all of the dip.
    assert abs(np.mean(tops)) < 0.15
    assert np.abs(tops).max() < 0.4


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_ripples_of_the_start_that_points_do_not_have_do_not_stay(seed: int) -> None:
    start = trimesh.creation.icosphere(subdivisions=5, radius=10.0)
    vertices = np.array(start.vertices)
    ripples = 0.02 * np.sin(vertices @ np.array([3.1, 2.3, 1.7]))[:, None]  # 1.5 mm long
    vertices = draped(
        vertices * (1.0 + ripples), np.array(start.faces), ball_cloud(seed), grain_mm=1.0
    )
    off = np.linalg.norm(vertices, axis=1) - 10.0
    # As from a smooth start; the ripples have 0.14 mm rms.
    assert np.sqrt(np.mean(off**2)) < 0.15 * 0.2


def test_where_there_are_no_points_vertices_stay() -> None:
    start = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    far = np.full((20, 3), 100.0) + np.arange(20)[:, None]
    cloud = Cloud(far, np.tile(UP, (20, 1)), np.ones(20), 0.1, UP)
    vertices = draped(np.array(start.vertices), np.array(start.faces), cloud, grain_mm=1.0)
    np.testing.assert_array_equal(vertices, start.vertices)


def test_the_nearest_place_of_a_triangle_is_that_of_a_fine_lattice_of_places() -> None:
    rng = np.random.default_rng(4)
    s, t = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 301), np.linspace(0, 1, 301)))
    shares = np.stack([1.0 - s - t, s, t], axis=1)[s + t <= 1.0 + 1e-12]
    for _ in range(60):
        point, *corners = rng.normal(size=(4, 3))
        found = np.array(closest_in(point, *corners)) @ np.array(corners)
        lattice = np.linalg.norm(shares @ np.array(corners) - point, axis=1)
        assert np.linalg.norm(found - point) <= lattice.min() + 1e-12
        assert np.linalg.norm(found - point) > lattice.min() - 0.01


def test_shares_tell_a_shifted_mesh_from_its_points() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=10.0)
    points = np.array(trimesh.sample.sample_surface(sphere, 20_000, seed=1)[0])
    levels = np.clip(((points[:, 2] + 10.0) / 0.3).astype(np.int64), 0, 66)
    swarm = Swarm(points, np.ones(len(points)), levels, 0.05, 0.3, UP)
    vertices, unmarked = np.array(sphere.vertices), np.zeros(len(sphere.vertices), dtype=np.bool_)
    mesh = Mesh(vertices, np.array(sphere.faces), unmarked)
    aside = Mesh(vertices + np.array([3.0, 0.0, 0.0]), mesh.faces, unmarked)
    assert share_far(mesh, swarm) == 0.0
    assert share_far(aside, swarm) > 0.8
    assert share_apart(mesh, mesh, swarm) == 0.0
    assert share_apart(mesh, aside, swarm) > 0.7


# --- tips -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_cone_whose_last_slices_are_heaps_ends_in_a_point_among_them(seed: int) -> None:
    slope, tip_mm, sigma, pitch_mm = 0.4, 66.0, 0.3, 1.1
    heights = np.arange(60) * pitch_mm + 0.55  # the last ones are narrower than their noise
    slices = ring_slices(
        heights, lambda turn, z: np.full_like(turn, slope * (tip_mm - z)),
        count=500, sigma_mm=sigma, seed=seed,
    )  # fmt: skip
    pieces = drawn(slices)
    assert not pieces[-1].outlines
    (skin,) = skin_slices(pieces, exact=Exact.NEVER).skins
    assert isinstance(skin, Skin)
    found = float(skin.fit.net.control_mm[:, -1, 2].mean())
    # Two slices or more have no contour; a flat cap above the last one is that much too low.
    assert abs(found - tip_mm) < 1.5 * pitch_mm
    low, high = skin.apex_deviations_mm
    assert math.isnan(low)
    assert 0.0 < high < 2.0 * pitch_mm


def test_a_big_part_has_a_mesh_of_bounded_size_that_lies_on_it_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=20.0)
    swarm = swarm_of_slices(cut(ball, np.arange(-19.5, 20.0, 1.0), 300, seed=5))
    monkeypatch.setattr(wrapping, "_MOST_VERTICES", 4_000)
    mesh = wrapped(swarm)
    assert mesh is not None
    # Level sets do not come in every size; half as many again would mean that none was asked for.
    assert 3_000 < len(mesh.vertices_mm) < 6_000
    assert np.sqrt(np.mean(off_mm(mesh, ball) ** 2)) < SIGMA_MM / 2.0
