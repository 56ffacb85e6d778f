"""A mesh around all points, where branches cannot follow; and tips whose last slices are heaps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from reconstruction.comparison import measure, reference
from reconstruction.fitting.curve import Exact
from reconstruction.meshing import Mesh
from reconstruction.skinning.local_fit import cloud_of, moved
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


def test_vertices_are_moved_onto_a_sphere_by_much_less_than_the_noise() -> None:
    rng = np.random.default_rng(2)
    radius, sigma = 10.0, 0.2
    outward = rng.normal(size=(20_000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    points = outward * (radius + rng.normal(0.0, sigma, 20_000))[:, None]
    start = trimesh.creation.icosphere(subdivisions=3, radius=radius + 0.3)
    cloud = cloud_of(
        points, outward, np.ones(len(points)), sigma_mm=sigma, axis=np.zeros(3), box_mm=1.0
    )
    vertices, deviations = moved(
        np.array(start.vertices), np.array(start.faces), cloud, grain_mm=1.0, doubt_mm=1.0
    )
    off = np.linalg.norm(vertices, axis=1) - radius
    assert np.sqrt(np.mean(off**2)) < 0.25 * sigma
    # The deviation that is told is that of the scatter, within the rule's own bias.
    assert 0.5 < np.sqrt(np.mean(off**2)) / np.sqrt(np.mean(deviations**2)) < 2.0


def test_where_there_are_no_points_vertices_stay() -> None:
    start = trimesh.creation.icosphere(subdivisions=2, radius=10.0)
    far = np.full((20, 3), 100.0) + np.arange(20)[:, None]
    cloud = cloud_of(far, np.tile(UP, (20, 1)), np.ones(20), sigma_mm=0.1, axis=UP, box_mm=1.0)
    vertices, deviations = moved(
        np.array(start.vertices), np.array(start.faces), cloud, grain_mm=1.0, doubt_mm=1.0
    )
    np.testing.assert_array_equal(vertices, start.vertices)
    assert np.isinf(deviations).all()


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
