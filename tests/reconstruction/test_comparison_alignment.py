"""Best fit: recovers what was done to the points, and leaves alone what nothing holds."""

import math

import numpy as np
import pytest
import trimesh

from reconstruction.comparison import (
    Align,
    Ways,
    best_fit,
    compare_meshes,
    compare_to_mesh,
    moved,
    reference,
    sample_surface,
)
from reconstruction.errors import TooFewPoints
from reconstruction.meshing import Mesh


def mesh_of(solid) -> Mesh:
    return Mesh(solid.vertices, solid.faces, np.zeros(len(solid.vertices), bool))


def lump() -> Mesh:
    """A ball with three different bumps: no symmetry."""
    solid = trimesh.creation.icosphere(4)
    rays = np.asarray(solid.vertices)
    radii = np.full(len(rays), 20.0)
    for place, height, width in (
        ((1, 0, 0), 9, 0.3),
        ((0, 1, 0.3), 5, 0.2),
        ((0.2, -0.5, 1), 7, 0.5),
    ):
        place = np.array(place) / np.linalg.norm(place)
        radii += height * np.exp(-np.sum((rays - place) ** 2, axis=1) / width)
    return Mesh(rays * radii[:, None], solid.faces, np.zeros(len(rays), bool))


def motion(angle_rad: float, shift_mm: float, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    transform = trimesh.transformations.rotation_matrix(angle_rad, random.normal(size=3))
    shift = random.normal(size=3)
    transform[:3, 3] = shift_mm * shift / np.linalg.norm(shift)
    return transform


@pytest.mark.parametrize(
    ("angle_rad", "shift_mm"), [(0.0, 0.0), (1e-4, 0.01), (0.1, 2.0), (0.3, 5.0), (2.5, 200.0)]
)
def test_a_known_motion_is_recovered_exactly_without_noise(angle_rad, shift_mm) -> None:
    mesh = lump()
    points = sample_surface(mesh, 4000, seed=1)
    done = motion(angle_rad, shift_mm, seed=2)
    deviation = compare_to_mesh(moved(points, done), mesh, align=Align.BEST_FIT, tolerance_mm=1e-6)
    found = deviation.alignment
    assert found.converged
    assert found.held_freedoms == 6
    assert np.abs(moved(moved(points, done), found.transform) - points).max() < 1e-6
    assert found.rotation_rad == pytest.approx(angle_rad, abs=1e-7)
    assert deviation.verdict.within
    turn = found.transform[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_noise_and_strays_leave_the_motion_within_its_own_uncertainty() -> None:
    mesh = lump()
    random = np.random.default_rng(3)
    points = sample_surface(mesh, 20_000, seed=4) + random.normal(0, 0.1, (20_000, 3))
    points[:1000] += random.uniform(2, 10, (1000, 3))  # 5 % strays, all to one side
    done = motion(0.05, 1.0, seed=5)
    found = best_fit(moved(points, done), reference(mesh))
    assert found.converged
    left = found.transform @ done - np.eye(4)
    # Each of 20 000 points holds 0.1 mm; a bump holds turning worse than shifting: 20 sigma.
    assert np.abs(left[:3, 3]).max() < 20 * 0.1 / math.sqrt(20_000)
    assert found.rms_mm == pytest.approx(0.1, rel=0.1)


def test_a_cylinder_is_not_spun_about_its_axis() -> None:
    mesh = mesh_of(trimesh.creation.cylinder(20.0, 60.0, sections=360))
    points = sample_surface(mesh, 8000, seed=6)
    noise = np.random.default_rng(7).normal(0, 0.05, points.shape)
    shift = np.array([0.5, -0.3, 0.2])
    found = best_fit(points + noise + shift, reference(mesh))
    assert found.converged
    assert found.held_freedoms == 5
    np.testing.assert_allclose(found.transform[:3, 3], -shift, atol=0.01)
    assert abs(found.transform[0, 1]) < 2e-4


def test_meshes_are_aligned_before_both_ways_are_measured() -> None:
    mesh = lump()
    done = motion(0.1, 3.0, seed=8)
    other = Mesh(moved(mesh.vertices_mm, done), mesh.faces, mesh.synthetic)
    both = compare_meshes(other, mesh, align=Align.BEST_FIT, ways=Ways.BOTH, tolerance_mm=1e-6)
    assert both.a_to_b.verdict.within
    assert both.b_to_a.verdict.within
    assert both.b_to_a.alignment is None


def test_five_points_hold_no_motion() -> None:
    with pytest.raises(TooFewPoints, match="5 points"):
        best_fit(np.eye(5, 3), reference(lump()))
