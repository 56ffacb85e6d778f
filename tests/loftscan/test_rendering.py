"""Pictures: what hides what, what colour it has, and that no run differs from another."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import trimesh

from loftscan.rendering import (
    Backdrop,
    Camera,
    Edges,
    Lens,
    MeshLayer,
    PointLayer,
    PolylineLayer,
    Scene,
    Shading,
    camera_around,
    compositing,
    decode_png,
    encode_png,
    render_mesh,
    render_points,
    render_scene,
)
from loftscan.rendering.compositing import occlusion
from loftscan.rendering.lighting import vertex_normals
from loftscan.rendering.rasterising import NOTHING, draw_beads, draw_segments, draw_triangles
from reconstruction.arrays import FloatArray
from reconstruction.meshing import Mesh

RED, BLUE = (200, 30, 30), (30, 60, 200)
FROM_X = Camera(np.array([[-10.0, -10, -10], [10, 10, 10]]), 0.0, 0.0, lens=Lens.ORTHOGRAPHIC)


def buffers(height: int, width: int):
    return np.full((height, width), -np.inf, np.float32), np.full(
        (height, width), NOTHING, np.int32
    )


def square(x_mm: float, half_mm: float, y_mm: float = 0.0) -> Mesh:
    """A square that faces +x."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half_mm + [y_mm, 0]
    vertices = np.column_stack([np.full(4, x_mm), corners])
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.zeros(4, bool))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices_mm for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        np.concatenate([mesh.synthetic for mesh in meshes]),
    )


def sphere(radius_mm: float) -> Mesh:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius_mm)
    return Mesh(ball.vertices, ball.faces, np.zeros(len(ball.vertices), bool))


def naive_triangles(screen: FloatArray, faces, height: int, width: int):
    """Every pixel against every triangle, by solving for the three shares."""
    nearness, ids = buffers(height, width)
    for row, column, face in itertools.product(range(height), range(width), range(len(faces))):
        corners = screen[faces[face]]
        system = np.stack([corners[:, 0], corners[:, 1], np.ones(3)])
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        shares = np.linalg.solve(system, [column + 0.5, row + 0.5, 1.0])
        near = np.float32(shares @ corners[:, 2])
        if np.all(shares >= 0) and near > nearness[row, column]:
            nearness[row, column], ids[row, column] = near, face
    return nearness, ids


@pytest.mark.parametrize("seed", range(8))
def test_the_triangle_kernel_agrees_with_its_naive_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    screen = rng.uniform([-4, -4, -5], [18, 14, 5], (20, 3))
    faces = rng.integers(0, 20, (15, 3)).astype(np.int32)  # some without area, some both ways round
    nearness, ids = buffers(10, 14)
    draw_triangles(screen, faces, 0, nearness, ids)
    naive_nearness, naive_ids = naive_triangles(screen, faces, 10, 14)
    assert np.array_equal(ids, naive_ids)
    assert np.allclose(nearness, naive_nearness, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_the_bead_kernel_agrees_with_its_naive_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    screen = rng.uniform([-3, -3, -5], [15, 12, 5], (30, 3))
    nearness, ids = buffers(9, 12)
    draw_beads(screen, 1.7, 0.4, 5, nearness, ids)
    for row, column in itertools.product(range(9), range(12)):
        away = ((column + 0.5 - screen[:, 0]) ** 2 + (row + 0.5 - screen[:, 1]) ** 2) / 1.7**2
        near = np.where(away <= 1, screen[:, 2] - 0.4 * away, -np.inf)
        inside = (np.floor(screen[:, 0]) == column) & (np.floor(screen[:, 1]) == row)
        near = np.where(inside, screen[:, 2], near)
        seen = np.argmax(near) + 5 if np.isfinite(near).any() else NOTHING
        assert ids[row, column] == seen
        assert nearness[row, column] == np.float32(near.max())


@pytest.mark.parametrize("seed", range(4))
def test_the_segment_kernel_agrees_with_its_naive_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    screen = rng.uniform([-3, -3, -5], [15, 12, 5], (7, 3))
    starts = np.array([0, 1, 3, 4, 5], np.int32)
    nearness, ids = buffers(9, 12)
    draw_segments(screen, starts, 1.3, 0, nearness, ids)
    along = np.linspace(0, 1, 4001)[:, None]
    for row, column in itertools.product(range(9), range(12)):
        best, seen = -np.inf, NOTHING
        for number, start in enumerate(starts):
            line = (1 - along) * screen[start] + along * screen[start + 1]
            away = np.hypot(line[:, 0] - column - 0.5, line[:, 1] - row - 0.5)
            if abs(away.min() - 1.3) < 1e-3:
                pytest.skip("a pixel on the very border, which the sampled twin cannot decide")
            if away.min() < 1.3 and line[np.argmin(away), 2] > best:
                best, seen = line[np.argmin(away), 2], number
        assert ids[row, column] == seen
        assert nearness[row, column] == pytest.approx(best, abs=0.01)


def test_the_same_scene_gives_the_same_bytes() -> None:
    rng = np.random.default_rng(3)
    scene = Scene(
        (MeshLayer(sphere(6.0), edges=Edges.DRAWN),),
        (PointLayer(rng.normal(0, 5, (500, 3))),),
        (PolylineLayer((rng.normal(0, 5, (9, 3)),)),),
    )
    first, second = (
        encode_png(render_scene(scene, camera=FROM_X, size_px=(120, 90))) for _ in range(2)
    )
    assert first == second


@pytest.mark.parametrize("lens", list(Lens))
def test_a_near_square_hides_a_far_one_whatever_the_order(lens: Lens) -> None:
    camera = Camera(FROM_X.bounds_mm, 0.0, 0.0, lens=lens)
    near, far = MeshLayer(square(5, 8), RED), MeshLayer(square(-5, 4), BLUE)
    pictures = [render_scene(Scene(order), camera=camera, size_px=(80, 80))
                for order in ((near, far), (far, near))]  # fmt: skip
    assert np.array_equal(*pictures)
    middle = pictures[0][30:50, 30:50].astype(int)
    assert np.all(middle[..., 0] > middle[..., 2] + 80)


def test_a_sphere_covers_the_area_of_its_great_circle() -> None:
    black = render_mesh(
        sphere(10.0), camera=FROM_X, size_px=(400, 400), colours=(0, 0, 0), backdrop=Backdrop.PAPER
    )
    scale = FROM_X.view((400, 400)).scale_px_mm
    # 192 is halfway between white and the little that black reflects, in linear light.
    covered = np.count_nonzero(black.max(axis=2) < 192)
    assert covered == pytest.approx(math.pi * (10 * scale) ** 2, rel=0.01)


def test_colours_land_where_their_faces_are() -> None:
    mesh = joined(square(0, 4, y_mm=-5), square(0, 4, y_mm=5))
    colours = np.repeat(np.array([RED, BLUE], np.uint8), 2, axis=0)
    picture = render_mesh(mesh, camera=FROM_X, size_px=(100, 100), colours=colours).astype(int)
    # Seen from +x with z up, +y is on the right.
    assert picture[50, 28, 0] > picture[50, 28, 2] + 80
    assert picture[50, 72, 2] > picture[50, 72, 0] + 80


def test_colours_of_vertices_are_mixed_over_a_face_in_true_perspective() -> None:
    slanted = Mesh(
        np.array([[9.0, -8, -8], [-9, 8, -8], [-9, 8, 8], [9, -8, 8]]),
        np.array([[0, 1, 2], [0, 2, 3]]),
        np.zeros(4, bool),
    )
    colours = np.array([[0, 0, 0], [255, 255, 255], [255, 255, 255], [0, 0, 0]], np.uint8)
    camera = Camera(FROM_X.bounds_mm, 0.0, 0.0)
    picture = render_mesh(slanted, camera=camera, size_px=(201, 201), colours=colours)
    uniform = render_mesh(slanted, camera=camera, size_px=(201, 201), colours=(255, 255, 255))
    column, row = camera.view((201, 201)).project(np.zeros((1, 3)))[0, :2].astype(int)
    half, whole = (linear(image[row, column, 1]) for image in (picture, uniform))
    assert half / whole == pytest.approx(0.5, abs=0.02)


def linear(code: int) -> float:
    share = float(code) / 255
    return share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("colour", [(176, 190, 204), (200, 60, 40), (240, 240, 240)])
def test_a_surface_that_faces_the_eye_keeps_its_colour(colour: tuple[int, int, int]) -> None:
    picture = render_mesh(square(0, 9), camera=FROM_X, size_px=(60, 60), colours=colour)
    assert np.abs(picture[30, 30].astype(int) - colour).max() <= 12


def test_points_and_lines_are_hidden_by_a_mesh_before_them_and_seen_before_it() -> None:
    wall = MeshLayer(square(0, 9), (200, 200, 200))
    for x, visible in ((5.0, True), (-5.0, False)):
        dots = PointLayer(np.array([[x, -4.0, 0.0]]), RED, 5.0)
        line = PolylineLayer((np.array([[x, 4.0, -6.0], [x, 4.0, 6.0]]),), BLUE, 6.0)
        scene = Scene((wall,), (dots,), (line,))
        picture = render_scene(scene, camera=FROM_X, size_px=(100, 100)).astype(int)
        left, right = picture[50, 33], picture[50, 67]
        assert (left[0] > left[2] + 40) == visible
        assert (right[2] > right[0] + 40) == visible


def test_a_lifted_line_comes_out_of_the_surface_it_lies_in() -> None:
    wall = MeshLayer(square(0, 9), (200, 200, 200))
    path = (np.array([[-0.1, -6.0, 0.0], [-0.1, 6.0, 0.0]]),)
    for lift_mm, visible in ((0.0, False), (0.5, True)):
        line = PolylineLayer(path, BLUE, 6.0, lift_mm)
        scene = Scene((wall,), polylines=(line,))
        middle = render_scene(scene, camera=FROM_X, size_px=(80, 80))[40, 40].astype(int)
        assert (middle[2] > middle[0] + 40) == visible


def test_drawn_edges_darken_the_diagonal_only() -> None:
    plain, drawn = (
        render_mesh(square(0, 9), camera=FROM_X, size_px=(101, 101), edges=edges).astype(int)
        for edges in Edges
    )
    assert drawn[50, 50].sum() < plain[50, 50].sum() - 50
    assert np.array_equal(drawn[40, 70], plain[40, 70])


def test_smooth_shading_leaves_creases_sharp_and_rounds_facets() -> None:
    box = trimesh.creation.box(extents=(12, 12, 12))
    cube = Mesh(box.vertices, box.faces, np.zeros(8, bool))
    camera = camera_around(cube.vertices_mm)
    flat, smooth = (
        render_mesh(cube, camera=camera, size_px=(80, 80), shading=shading) for shading in Shading
    )
    assert np.array_equal(flat, smooth)
    coarse = trimesh.creation.icosphere(subdivisions=2, radius=9)
    ball = Mesh(coarse.vertices, coarse.faces, np.zeros(len(coarse.vertices), bool))
    facets, round_ = (
        render_mesh(ball, camera=FROM_X, size_px=(200, 200), shading=shading)[60:140, 60:140, 1]
        for shading in Shading
    )
    assert np.abs(np.diff(round_.astype(int), axis=0)).max() <= 5
    assert np.abs(np.diff(facets.astype(int), axis=0)).max() > 5


def test_a_tilted_plane_is_not_darkened_but_a_pit_is() -> None:
    y, x = np.mgrid[:60, :80].astype(np.float32)
    plane = 0.7 * x - 0.4 * y
    light = occlusion(plane, scale_px_mm=1.0, reach_px=8.0)
    assert np.all(light[10:-10, 10:-10] > 1 - 1e-5)  # nearness is float32
    pit = plane - 6 * (np.hypot(x - 40, y - 30) < 6).astype(np.float32)
    light = occlusion(pit, scale_px_mm=1.0, reach_px=8.0)
    # Of 8 pairs at least the outermost, over 7 px away, has the walls on both sides of the middle.
    assert light[30, 40] < 1 - 0.58 * 1.9 * 0.94 / 8
    assert light.min() >= 0.4


@pytest.mark.parametrize("seed", range(3))
def test_the_occlusion_kernel_agrees_with_its_naive_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near = rng.uniform(-3, 3, (11, 14)).astype(np.float32)
    near[rng.random(near.shape) < 0.2] = -np.inf
    offsets = compositing._pair_offsets(5.0)
    padded = np.pad(near, 8, constant_values=-np.inf)
    for i, j in zip(*np.nonzero(np.isfinite(near)), strict=True):
        pairs = offsets[4 * (i % 4) + (5 * (i % 4) + j) % 4]
        limits = 0.5 * np.linalg.norm(pairs, axis=1)
        rises = [padded[i + 8 + side * pairs[:, 0], j + 8 + side * pairs[:, 1]] - near[i, j]
                 for side in (1, -1)]  # fmt: skip
        sums = sum(np.clip(rise, -limits, limits) for rise in rises)
        hidden = np.mean(np.maximum(sums / (2 * limits) - 0.06, 0))
        light = compositing._occlusion(near, 0.5, 5.0)[i, j]
        assert light == pytest.approx(1 - 0.58 * min(1.0, 1.9 * hidden), abs=1e-5)


def test_normals_of_a_sphere_point_away_from_its_centre_and_of_a_cube_along_its_diagonals() -> None:
    ball = sphere(7.0)
    normals = vertex_normals(ball.vertices_mm, ball.faces.astype(np.int32))
    assert np.abs(normals - ball.vertices_mm / 7).max() < 0.01
    box = trimesh.creation.box(extents=(2, 2, 2))
    diagonals = vertex_normals(np.asarray(box.vertices), box.faces.astype(np.int32))
    assert np.allclose(diagonals, box.vertices / np.sqrt(3))


def test_an_empty_scene_is_its_backdrop() -> None:
    nothing = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty(0, bool))
    scene = Scene(
        (MeshLayer(nothing),),
        (PointLayer(np.empty((0, 3))),),
        (PolylineLayer(()), PolylineLayer((np.empty((0, 3)), np.zeros((1, 3))))),
    )
    camera = camera_around(nothing.vertices_mm)
    empty = render_scene(Scene(), camera=camera, size_px=(40, 30))
    assert np.array_equal(render_scene(scene, camera=camera, size_px=(40, 30)), empty)
    paper = render_scene(Scene(backdrop=Backdrop.PAPER), camera=camera, size_px=(40, 30))
    assert paper.shape == (30, 40, 3)
    assert np.all(paper == 255)


def test_points_that_are_not_finite_or_behind_the_eye_are_not_drawn() -> None:
    camera = Camera(FROM_X.bounds_mm, 0.0, 0.0, lens=Lens.PORTRAIT)
    lost = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e4, 0, 0]])
    picture = render_points(lost, camera=camera, size_px=(50, 50), radius_px=4)
    assert np.array_equal(picture, render_scene(Scene(), camera=camera, size_px=(50, 50)))


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_up_axis_points_up(up: str) -> None:
    axis = "xyz".index(up)
    pole = np.zeros((2, 3))
    pole[1, axis] = 10.0
    camera = camera_around(pole, np.ones((1, 3)), up=up, azimuth_rad=0.7, elevation_rad=0.4)
    low, high = camera.view((100, 100)).project(pole)
    assert high[1] < low[1] - 50
    assert high[0] == pytest.approx(low[0], abs=1e-9) or camera.lens is Lens.PORTRAIT


@pytest.mark.parametrize("lens", list(Lens))
def test_the_whole_box_is_in_the_picture_from_every_side(lens: Lens) -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        corners = rng.uniform(-50, 50, (2, 3))
        box = np.array(list(itertools.product(*corners.T)))
        camera = camera_around(
            box, azimuth_rad=rng.uniform(0, 7), elevation_rad=rng.uniform(-1.57, 1.57), lens=lens
        )
        seen = camera.view((200, 120)).project(box)[:, :2]
        assert np.all((seen > 0) & (seen < [200, 120]))
        spans = np.ptp(seen, axis=0) / [200, 120]
        assert spans.max() == pytest.approx(0.86)


def test_nearness_is_affine_on_a_plane_in_perspective() -> None:
    rng = np.random.default_rng(6)
    plane = rng.uniform(-9, 9, (50, 2)) @ rng.normal(size=(2, 3))
    seen = camera_around(plane).view((640, 480)).project(plane)
    basis = np.column_stack([seen[:, :2], np.ones(50)])
    fitted = basis @ np.linalg.lstsq(basis, seen[:, 2], rcond=None)[0]
    assert np.abs(fitted - seen[:, 2]).max() < 1e-9


def test_a_png_gives_the_picture_back() -> None:
    picture = np.random.default_rng(0).integers(0, 256, (7, 9, 3), np.uint8)
    assert np.array_equal(decode_png(encode_png(picture)), picture)
    with pytest.raises(ValueError, match="shape"):
        encode_png(picture[..., 0])


def test_wrong_arguments_are_refused_with_their_numbers() -> None:
    mesh = square(0, 1)
    with pytest.raises(ValueError, match="fit neither 4 vertices nor 2 faces"):
        MeshLayer(mesh, np.zeros((5, 3), np.uint8))
    with pytest.raises(ValueError, match="outside the 4 vertices"):
        MeshLayer(Mesh(mesh.vertices_mm, np.array([[0, 1, 4]]), mesh.synthetic))
    with pytest.raises(ValueError, match="whole numbers"):
        PointLayer(np.zeros((1, 3)), np.array([[0.1, 0.2, 0.3]]))
    with pytest.raises(ValueError, match="0 x 5"):
        render_scene(Scene(), camera=FROM_X, size_px=(0, 5))
    with pytest.raises(ValueError, match="finite"):
        Camera(np.full((2, 3), np.nan))
