"""Distances against brute force and analytic shapes; signs against winding numbers."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.comparison import (
    Method,
    Ways,
    compare_clouds,
    compare_meshes,
    compare_to_mesh,
    measure,
    reference,
    sample_surface,
)
from reconstruction.comparison.bounding import LEAF_SIZE, box_tree
from reconstruction.errors import TooFewPoints
from reconstruction.meshing import Mesh

SEEDS = st.integers(0, 2**32 - 1)


def mesh_of(solid, scale: float = 1.0) -> Mesh:
    vertices = np.asarray(solid.vertices) * scale
    return Mesh(vertices, np.asarray(solid.faces), np.zeros(len(vertices), bool))


def lathe(around: int, along: int) -> Mesh:
    """A wavy barrel with fans of needles for its ends."""
    turns = np.arange(around) / around * 2 * np.pi
    heights = np.linspace(0, 60, along)
    radii = 40 + 4 * np.sin(heights / 9)[:, None] + 2 * np.sin(5 * turns)
    x, y = radii * np.cos(turns), radii * np.sin(turns)
    rings = np.stack([x, y, np.broadcast_to(heights[:, None], x.shape)], -1).reshape(-1, 3)
    here = np.arange(around)
    there = np.roll(here, -1)
    faces = []
    for row in range(along - 1):
        low, high = row * around, (row + 1) * around
        faces.append(np.stack([low + here, low + there, high + there], 1))
        faces.append(np.stack([low + here, high + there, high + here], 1))
    top, bottom = (along - 1) * around, len(rings)
    faces.append(np.stack([np.full(around, bottom), there, here], 1))
    faces.append(np.stack([np.full(around, bottom + 1), top + here, top + there], 1))
    vertices = np.vstack([rings, [[0, 0, 0], [0, 0, 60]]])
    return Mesh(vertices, np.vstack(faces), np.zeros(len(vertices), bool))


def naive_distance(point, corners) -> float:
    """One triangle at a time: its plane if the foot is inside, else its three edges."""
    return min(naive_triangle_distance(point, *triangle) for triangle in corners)


def naive_triangle_distance(point, a, b, c) -> float:
    best = min(naive_edge_distance(point, *ends) for ends in ((a, b), (b, c), (c, a)))
    system = np.column_stack([b - a, c - a])
    share, _, rank, _ = np.linalg.lstsq(system, point - a, rcond=None)
    if rank == 2 and share.min() >= 0 and share.sum() <= 1:
        best = min(best, float(np.linalg.norm(point - a - system @ share)))
    return best


def naive_edge_distance(point, start, end) -> float:
    way = end - start
    length = way @ way
    share = np.clip((point - start) @ way / length, 0, 1) if length > 0 else 0.0
    return float(np.linalg.norm(point - start - share * way))


def winding_number(points, mesh: Mesh) -> np.ndarray:
    """Solid angles of all triangles over 4 pi: 1 inside, 0 outside (Van Oosterom 1983)."""
    a, b, c = (mesh.vertices_mm[mesh.faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dots = [np.einsum("ijk,ijk->ij", *pair) for pair in ((a, b), (b, c), (c, a))]
    volume = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    whole = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return np.arctan2(volume, whole).sum(axis=1) / (2 * np.pi)


@given(SEEDS, st.integers(1, 60), st.sampled_from([0, 2, 3]))
@settings(max_examples=25, deadline=None)
def test_the_tree_finds_what_trying_every_triangle_finds(seed, count, squash) -> None:
    random = np.random.default_rng(seed)
    corners = random.normal(size=(count, 3, 3)) * 10.0 ** random.uniform(-2, 1, (count, 1, 1))
    if squash:  # needles, or triangles without any area
        corners[::squash, 2] = corners[::squash, 1] + 1e-6 * random.normal(size=3) * (squash - 2)
    vertices = corners.reshape(-1, 3)
    mesh = Mesh(vertices, np.arange(len(vertices)).reshape(-1, 3), np.zeros(len(vertices), bool))
    points = random.normal(size=(8, 3)) * 5
    found = np.abs(measure(points, reference(mesh)).distances_mm)
    expected = [naive_distance(point, corners) for point in points]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_needles_of_an_end_cap_are_as_exact_as_any_face() -> None:
    mesh = lathe(250, 2)
    random = np.random.default_rng(5)
    points = random.uniform(-50, 70, (12, 3))
    points[:6, 2] = random.normal(0, 0.2, 6)  # near the lower fan
    found = np.abs(measure(points, reference(mesh)).distances_mm)
    corners = mesh.vertices_mm[mesh.faces]
    expected = [naive_distance(point, corners) for point in points]
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_every_triangle_is_in_a_leaf_and_every_leaf_is_small() -> None:
    mesh = lathe(300, 4)
    tree = box_tree(mesh.vertices_mm[mesh.faces])
    assert set(tree.triangle_of_item) == set(range(len(mesh.faces)))
    assert len(tree.triangle_of_item) <= 1.34 * len(mesh.faces)
    leaves = tree.children < 0
    assert tree.counts[leaves].sum() == len(tree.triangle_of_item)
    assert tree.counts[leaves].max() <= LEAF_SIZE


def test_the_order_of_points_and_faces_does_not_matter() -> None:
    mesh = lathe(90, 12)
    random = np.random.default_rng(6)
    points = sample_surface(mesh, 2000, seed=1) + random.normal(0, 1, (2000, 3))
    shuffle, faces = random.permutation(2000), random.permutation(len(mesh.faces))
    straight = measure(points, reference(mesh)).distances_mm
    mixed = Mesh(mesh.vertices_mm, np.roll(mesh.faces[faces], 1, axis=1), mesh.synthetic)
    other = measure(points[shuffle], reference(mixed)).distances_mm
    np.testing.assert_allclose(other, straight[shuffle], rtol=1e-11, atol=1e-11)


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_moving_everything_moves_no_distance(seed) -> None:
    random = np.random.default_rng(seed)
    mesh = lathe(40, 6)
    points = random.uniform(-60, 80, (200, 3))
    turn = trimesh.transformations.random_rotation_matrix(random.random(3))[:3, :3]
    shift = random.normal(size=3) * 1000
    there = Mesh(mesh.vertices_mm @ turn.T + shift, mesh.faces, mesh.synthetic)
    before = measure(points, reference(mesh)).distances_mm
    after = measure(points @ turn.T + shift, reference(there)).distances_mm
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_a_ball_is_as_far_as_its_radius_says() -> None:
    mesh = mesh_of(trimesh.creation.icosphere(5, 30.0))
    # A facet lies below the sphere by at most its edge squared over 8 R, times 4 / 3.
    edges = mesh.vertices_mm[mesh.faces] - mesh.vertices_mm[np.roll(mesh.faces, 1, axis=1)]
    sagitta = np.max(np.sum(edges**2, axis=2)) / (8 * 30.0) * 4 / 3
    random = np.random.default_rng(7)
    rays = random.normal(size=(5000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    radii = random.uniform(1, 60, 5000)
    deviation = compare_to_mesh(rays * radii[:, None], mesh)
    extra = deviation.distances_mm - (radii - 30.0)
    assert extra.min() > -1e-9
    assert extra.max() < sagitta
    assert not deviation.on_border.any()


def near_features(mesh: Mesh, seed: int, count: int, spread: float) -> np.ndarray:
    """Points close to vertices, edges and faces of a mesh, at all scales down to 1e-6."""
    random = np.random.default_rng(seed)
    corners = mesh.vertices_mm[mesh.faces[random.integers(len(mesh.faces), size=count)]]
    shares = random.dirichlet(np.ones(3), size=count)
    shares[: count // 3] = np.eye(3)[random.integers(3, size=count // 3)]
    shares[count // 3 : 2 * count // 3, 0] = 0
    shares /= shares.sum(axis=1, keepdims=True)
    base = np.einsum("ij,ijk->ik", shares, corners)
    return base + random.normal(size=(count, 3)) * spread * 10.0 ** -random.uniform(
        0, 6, (count, 1)
    )


SHARP = {
    "cube": trimesh.creation.box((10, 10, 10)),
    "thin cone": trimesh.creation.cone(1.0, 40.0, sections=5),
    "blade": trimesh.Trimesh(
        [[0, 0, 0], [20, 0, 0], [10, 0.2, 0], [10, 0.1, 30]],
        [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        process=False,
    ),
    "spike": trimesh.creation.cone(0.05, 10.0, sections=64),
}


@pytest.mark.parametrize("name", SHARP)
@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_the_sign_agrees_with_the_winding_number_at_sharp_places(name, seed) -> None:
    mesh = mesh_of(SHARP[name])
    points = near_features(mesh, seed, 150, 3.0)
    distances = measure(points, reference(mesh)).distances_mm
    clear = np.abs(distances) > 1e-8
    inside = winding_number(points, mesh) > 0.5
    np.testing.assert_array_equal(distances[clear] < 0, inside[clear])
    assert 0 < inside.sum() < len(points)


def test_plain_vertex_normals_would_get_a_blade_wrong() -> None:
    """Shows that the test above can fail: face normals of one neighbour are not enough."""
    mesh = mesh_of(SHARP["blade"])
    points = near_features(mesh, 3, 3000, 3.0)
    against = reference(mesh)
    readings = measure(points, against)
    normals = against.triangles.rows[readings.faces, 9:12]
    naive = np.einsum("ij,ij->i", points - readings.feet_mm, normals) < 0
    clear = np.abs(readings.distances_mm) > 1e-8
    inside = winding_number(points, mesh) > 0.5
    assert np.any(naive[clear] != inside[clear])


def test_seams_that_were_never_welded_are_no_borders() -> None:
    mesh = mesh_of(SHARP["cube"])
    soup = Mesh(
        mesh.vertices_mm[mesh.faces].reshape(-1, 3),
        np.arange(36).reshape(-1, 3),
        np.zeros(36, bool),
    )
    points = near_features(mesh, 4, 600, 3.0)
    welded, loose = measure(points, reference(mesh)), measure(points, reference(soup))
    np.testing.assert_allclose(loose.distances_mm, welded.distances_mm, atol=1e-12)
    assert not loose.on_border.any()


def test_points_past_an_open_edge_are_flagged() -> None:
    plate = trimesh.Trimesh(
        [[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    points = np.array([[5, 5, 2.0], [5, 5, -2.0], [5, 5, 0.0], [-3, 5, 4.0], [11, 11, 1.0]])
    deviation = compare_to_mesh(points, mesh_of(plate))
    np.testing.assert_allclose(deviation.distances_mm[:3], [2.0, -2.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(deviation.distances_mm[3:]), [5.0, np.sqrt(3)], rtol=1e-12)
    np.testing.assert_array_equal(deviation.on_border, [False, False, False, True, True])
    assert deviation.statistics.on_border == 2


def test_statistics_are_those_of_the_distances() -> None:
    mesh = mesh_of(SHARP["cube"])
    heights = np.random.default_rng(8).normal(0.02, 0.1, 4000)
    points = np.column_stack([np.linspace(-1, 1, 4000), np.zeros(4000), 5 + heights])
    numbers = compare_to_mesh(points, mesh).statistics
    assert (numbers.count, numbers.set_aside) == (4000, 0)
    assert numbers.mean_mm == pytest.approx(heights.mean(), abs=1e-12)
    assert numbers.rms_mm == pytest.approx(np.sqrt(np.mean(heights**2)), rel=1e-9)
    assert numbers.std_mm == pytest.approx(heights.std(), rel=1e-9)
    assert numbers.median_mm == pytest.approx(np.median(heights), abs=1e-12)
    assert numbers.absolute_95_mm == pytest.approx(np.quantile(np.abs(heights), 0.95), rel=1e-9)
    assert (numbers.min_mm, numbers.max_mm) == pytest.approx((heights.min(), heights.max()))
    assert numbers.histogram_counts.sum() == 4000
    assert len(numbers.histogram_edges_mm) == len(numbers.histogram_counts) + 1


def test_the_verdict_states_its_rule_and_counts_all_points_by_default() -> None:
    mesh = mesh_of(SHARP["cube"])
    points = np.column_stack([np.zeros(100), np.zeros(100), np.full(100, 5.05)])
    points[0, 2] = 5.2
    points[1, 2] = 90.0
    out = compare_to_mesh(points, mesh, tolerance_mm=0.1).verdict
    assert not out.within
    assert out.rule == "all 100 points within +-0.1 mm"
    assert out.share_within == pytest.approx(0.98)
    most = compare_to_mesh(points, mesh, tolerance_mm=0.1, required_share=0.95).verdict
    assert most.within
    assert most.rule == "at least 95 % of 100 points within +-0.1 mm"
    near = compare_to_mesh(points, mesh, tolerance_mm=0.3, max_distance_mm=10.0)
    assert near.verdict.within
    assert near.verdict.rule.endswith("1 points farther off than asked for were set aside")
    assert near.statistics.set_aside == 1
    assert near.distances_mm[1] == pytest.approx(85.0)
    assert compare_to_mesh(points, mesh).verdict is None


def test_nothing_left_to_judge_is_out_of_tolerance() -> None:
    points = np.full((3, 3), 500.0)
    deviation = compare_to_mesh(
        points, mesh_of(SHARP["cube"]), tolerance_mm=1.0, max_distance_mm=1.0
    )
    assert not deviation.verdict.within
    assert np.isnan(deviation.statistics.rms_mm)
    assert deviation.statistics.count == 0


def test_two_balls_differ_by_their_radii_both_ways() -> None:
    small = mesh_of(trimesh.creation.icosphere(4, 20.0))
    large = mesh_of(trimesh.creation.icosphere(4, 20.5))
    both = compare_meshes(large, small, ways=Ways.BOTH)
    assert both.samples is None
    assert both.a_to_b.statistics.count == len(large.vertices_mm)
    assert both.a_to_b.statistics.mean_mm == pytest.approx(0.5, abs=1e-9)
    assert both.b_to_a.statistics.mean_mm == pytest.approx(-0.5, abs=0.02)
    sampled = compare_meshes(large, small, samples=5000, seed=3)
    assert sampled.b_to_a is None
    assert sampled.a_to_b.statistics.count == 5000
    assert sampled.a_to_b.statistics.mean_mm == pytest.approx(0.5, abs=0.01)


def test_clouds_have_no_sign_and_say_so() -> None:
    random = np.random.default_rng(9)
    cloud, other = random.normal(size=(300, 3)), random.normal(size=(200, 3))
    deviation = compare_clouds(cloud, other, tolerance_mm=0.5)
    expected = np.linalg.norm(cloud[:, None] - other[None], axis=2)
    np.testing.assert_allclose(deviation.distances_mm, expected.min(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(deviation.nearest, expected.argmin(axis=1))
    assert deviation.method is Method.POINT_TO_POINT
    assert "unsigned" in deviation.method.value


def test_samples_lie_on_the_mesh_and_spread_by_area() -> None:
    mesh = mesh_of(trimesh.creation.box((2, 4, 20)))
    points = sample_surface(mesh, 20_000, seed=4)
    assert np.abs(measure(points, reference(mesh)).distances_mm).max() < 1e-12
    ends = np.mean(np.abs(points[:, 2]) > 10 - 1e-9)
    share = 16 / 256
    assert abs(ends - share) < 4.5 * np.sqrt(share * (1 - share) / 20_000)
    np.testing.assert_array_equal(points, sample_surface(mesh, 20_000, seed=4))


def test_what_cannot_be_compared_is_refused() -> None:
    mesh = mesh_of(SHARP["cube"])
    with pytest.raises(TooFewPoints, match="no points"):
        compare_to_mesh(np.zeros((0, 3)), mesh)
    with pytest.raises(ValueError, match="finite"):
        compare_to_mesh(np.full((2, 3), np.nan), mesh)
    with pytest.raises(ValueError, match="shape"):
        compare_to_mesh(np.zeros((5, 2)), mesh)
    with pytest.raises(ValueError, match="without faces"):
        compare_to_mesh(np.zeros((5, 3)), Mesh(np.zeros((3, 3)), np.zeros((0, 3)), np.zeros(3)))
    with pytest.raises(ValueError, match="tolerance"):
        compare_to_mesh(np.zeros((5, 3)), mesh, tolerance_mm=-1.0)
    with pytest.raises(ValueError, match="max_distance_mm"):
        compare_to_mesh(np.zeros((5, 3)), mesh, max_distance_mm=0.0)
    with pytest.raises(ValueError, match="without area"):
        sample_surface(Mesh(np.zeros((3, 3)), [[0, 1, 2]], np.zeros(3)), 5, seed=0)
