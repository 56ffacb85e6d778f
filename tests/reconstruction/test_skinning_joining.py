"""Solids out of branches, judged by trimesh and by what the parts are."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.meshing import Mesh, Row, mesh_rows
from reconstruction.skinning.branching import find_branches
from reconstruction.skinning.joining import join_solids
from reconstruction.skinning.outlines import Outline
from reconstruction.skinning.ring_caps import triangulate_ring
from reconstruction.skinning.slivers import without_slivers
from reconstruction.soundness import soundness
from tests.reconstruction.part_cases import star
from tests.reconstruction.skinning_cases import (
    CUP,
    MUG,
    Solid,
    as_outlines,
    ball,
    box,
    cut,
    cut_mesh,
    pillar,
    ring,
    rod,
    signed_area,
    stand_in,
    torus,
    turned,
    union,
    without,
)

WITHIN_MM = 1e-4
BLOCK = box((-20, -15, -20), (20, 15, 20))
FORK = union(
    rod((0, 0, -20), (0, 0, 0), 6), rod((0, 0, 0), (10, 0, 20), 5), rod((0, 0, 0), (-10, 0, 20), 5)
)
BORES = (
    rod((0, 0, -40), (0, 0, 0), 4),
    rod((0, 0, 0), (20, 0, 40), 3.5),
    rod((0, 0, 0), (-20, 0, 40), 3.5),
)
GOBLET = turned(
    lambda r, z: np.maximum(
        np.maximum(r - np.where(np.abs(z) < 5, 3, 15), np.abs(z) - 20),
        -np.maximum(r - 13, 7 - np.abs(z)),
    )
)
BUNDT = turned(
    lambda r, z: np.maximum(
        np.maximum(r - 20, np.abs(z) - 10), -np.maximum(np.abs(r - 10) - 4, -5 - z)
    )
)
# Each with its Euler number: 2 for every surface, less 2 for every handle.
SOLIDS: dict[str, tuple[Solid, int]] = {
    "fork": (FORK, 2),
    "fork of pipes": (without(FORK, *BORES), -2),
    "trousers": (
        union(rod((-8, 0, -20), (-5, 0, 5), 5), rod((8, 0, -20), (5, 0, 5), 5), pillar(13, 3, 15)),
        2,
    ),
    "ring lying": (torus(15, 5), 0),
    "ring standing": (torus(15, 5, "x"), 0),
    "two rings through each other": (union(torus(15, 4, "x"), torus(15, 4, "z")), -4),
    "cup": (CUP, 2),
    "mug": (MUG, 0),
    "mug lying, handle up": (lambda x, y, z: MUG(x, z, y), 0),
    "mug lying, handle aside": (lambda x, y, z: MUG(z, y, x), 0),
    "goblet, hollow on both sides": (GOBLET, 2),
    "form for a ring of cake": (BUNDT, 2),
    "cup with a candle": (union(CUP, rod((0, 0, -18), (0, 0, 24), 4)), 2),
    "ball with a cavity": (without(ball(20), ball(12)), 4),
    "ball in a ball": (union(without(ball(20), ball(12)), ball(7)), 6),
    "two balls": (union(ball(8, (12, 0, 3)), ball(8, (-12, 0, -3))), 4),
    "block with a bore across": (without(BLOCK, rod((0, -30, 0), (0, 30, 0), 8)), 0),
    "block with a bore along": (without(BLOCK, pillar(8, -30, 30)), 0),
    "block with both": (
        without(BLOCK, rod((0, -30, 0), (0, 30, 0), 8), pillar(4, -30, 30, (14, 0))),
        -2,
    ),
    "plate with two holes": (
        without(
            box((-25, -15, -3), (25, 15, 3)), pillar(5, -5, 5, (-12, 0)), pillar(5, -5, 5, (12, 0))
        ),
        -2,
    ),
    "pipe in a pipe": (
        union(
            without(pillar(20, -40, 40), pillar(18, -41, 41)),
            without(pillar(14, -10.2, 10.2), pillar(12, -41, 41)),
        ),
        0,
    ),
    "funnel with a thin wall": (
        turned(lambda r, z: np.maximum(np.abs(r - (12 + z / 2)) - 0.6, np.abs(z) - 20)),
        0,
    ),
}


def skinned(
    slices: list[list[Outline]], heights: FloatArray, *, count: int = 96, **options: object
) -> Mesh:
    found = find_branches(slices, heights)
    parts = [stand_in(each, count=count) for each in found.branches]
    return join_solids(
        parts, [each.hole for each in found.branches], within_mm=WITHIN_MM, **options
    )


def judged(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


@pytest.mark.parametrize("step", [1.0, 1.7])
@pytest.mark.parametrize("name", SOLIDS)
def test_a_solid_keeps_its_euler_number(name: str, step: float) -> None:
    solid, euler = SOLIDS[name]
    heights = np.arange(-25.0, 25.1, step) + 0.03
    slices = cut(solid, heights)
    mesh = skinned(slices, heights)
    assert soundness(mesh).sound
    judge = judged(mesh)
    assert judge.is_watertight
    assert judge.is_winding_consistent
    assert judge.euler_number == euler
    # The sections' areas times their distance: what any such surface encloses, but for half a slab
    # where it folds over at an end, and 5 % for the ways from contour to contour: cones for steps.
    areas = [sum(_area(each) for each in piece) for piece in slices if piece]
    ends = 0.5 * step * (areas[0] + areas[-1])
    assert judge.volume == pytest.approx(sum(areas) * step, abs=ends + 0.05 * sum(areas) * step)


def _area(each: Outline) -> float:
    x, y = each.polygon_mm(400).T  # holes run clockwise
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0


@pytest.mark.parametrize("count", [60, 131, 200, 256])
def test_rims_that_differ_by_a_chord_from_what_they_stand_on_join_all_the_same(count: int) -> None:
    """The rim of a mug and the inside below it are cut out of one wall, with other corners."""
    heights = np.arange(-25.0, 25.1, 1.0) + 0.03
    mesh = skinned(cut(MUG, heights), heights, count=count)
    assert soundness(mesh).sound
    assert judged(mesh).euler_number == 0


@pytest.mark.parametrize(
    ("name", "euler"),
    [("spot", 2), ("nefertiti_lowres", 2), ("penguin_hr", 2), ("torus", 0)],
)
def test_a_known_model_cut_in_60_slices_keeps_its_euler_number(
    shared_data: Path, name: str, euler: int
) -> None:
    model = trimesh.load(shared_data / "models" / f"{name}.obj", force="mesh", process=False)
    model.merge_vertices(merge_tex=True, merge_norm=True)
    assert model.euler_number == euler
    axes = np.eye(3)[[2, 0, 1]]  # sliced along y
    low, high = model.bounds[:, 1]
    heights = low + (np.arange(60) + 0.5) / 60 * (high - low)
    turned_mm = np.asarray(model.vertices) @ axes.T
    slices = [
        as_outlines(cut_mesh(turned_mm, np.asarray(model.faces), height), height, index, axes)
        for index, height in enumerate(heights)
    ]
    mesh = skinned(slices, heights, normal=axes[2])
    assert soundness(mesh).sound
    assert judged(mesh).euler_number == euler
    # Missing: half a slice at either end, and what 96 corners a ring cut off.
    assert judged(mesh).volume == pytest.approx(model.volume, rel=0.01)


# -- contact -------------------------------------------------------------------------------------


def blob(rng: np.random.Generator, radius: float, centre: tuple[float, float]) -> FloatArray:
    count = int(rng.integers(30, 200))
    angle = np.arange(count) * (math.tau / count)
    away = radius * (1 + 0.2 * np.cos(3 * angle + rng.uniform(0, math.tau)))
    return np.stack([away * np.cos(angle), away * np.sin(angle)], axis=1) + centre


def column(shape: FloatArray, low: float, high: float, *, marked: bool = False) -> Mesh:
    rows = [
        Row(np.column_stack([shape, np.full(len(shape), height)]), np.full(len(shape), marked))
        for height in (low, high)
    ]
    return mesh_rows(rows, np.eye(3)[:2])


def moved(mesh: Mesh, turn: FloatArray) -> Mesh:
    return Mesh(mesh.vertices_mm @ turn.T, mesh.faces, mesh.synthetic)


@pytest.mark.parametrize("seed", range(25))
def test_columns_that_touch_in_one_plane_grow_together(seed: int) -> None:
    """Two legs under a body, contours crossing anyhow; the contact is one face each, no edge."""
    rng = np.random.default_rng(seed)
    plane = rng.uniform(1.0, 2.0)
    parts = [
        column(blob(rng, 1.0, (-2, 0)), 0.0, plane),
        column(blob(rng, 1.0, (2, 0)), 0.0, plane),
        column(blob(rng, 2.5, (0, 0)), plane, 3.0),
    ]
    turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    tilted = [moved(each, turn) for each in parts]
    for made, normal in ((parts, np.eye(3)[2]), (tilted, turn[:, 2])):
        mesh = join_solids(made, [False] * 3, within_mm=1e-9, normal=normal)
        judge = judged(mesh)
        assert judge.is_watertight
        assert (judge.euler_number, judge.body_count) == (2, 1)
        # Nothing overlaps, so nothing is lost.
        volumes = sum(judged(each).volume for each in parts)
        assert judge.volume == pytest.approx(volumes, rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_a_cavity_that_ends_in_a_face_opens_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hollow = blob(rng, 1.0, (0, 0))
    body, cavity = column(blob(rng, 3.0, (0, 0)), 0.0, 3.0), column(hollow, 1.0, 3.0)
    mesh = join_solids([body, cavity], [False, True], within_mm=1e-9)
    assert judged(mesh).euler_number == 2  # a cup; with a skin over it, 4
    rest = judged(body).volume - judged(cavity).volume
    assert judged(mesh).volume == pytest.approx(rest, rel=1e-9)


def test_a_cavity_from_joint_to_joint_is_one_through_several_solids() -> None:
    parts = [column(ring(5.0), 0.0, 2.0), column(ring(6.0, count=90), 2.0, 4.0)]
    mesh = join_solids([*parts, column(ring(2.0), 0.0, 4.0)], [False, False, True], within_mm=1e-9)
    assert judged(mesh).euler_number == 0


def test_a_solid_in_a_cavity_is_there_if_it_comes_after_it() -> None:
    parts = [column(ring(r), low, 4.0) for r, low in ((9.0, 0.0), (6.0, 1.0), (3.0, 1.0))]
    mesh = join_solids(parts, [False, True, False], within_mm=1e-9)
    hollow = judged(parts[0]).volume - judged(parts[1]).volume
    assert judged(mesh).volume == pytest.approx(hollow + judged(parts[2]).volume, rel=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_a_ring_is_cut_into_triangles_that_cover_it_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outer, inner = 4.0 * star(rng, 40), blob(rng, 1.0, (0.5, 0.2))
    faces = triangulate_ring(outer, inner)
    assert len(faces) == len(outer) + len(inner)
    a, b, c = np.moveaxis(np.vstack([outer, inner])[faces], 1, 0)
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (doubled > -1e-9).all()
    assert doubled.sum() / 2 == pytest.approx(signed_area(outer) - signed_area(inner))
    sides = np.vstack([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    counted = {(int(i), int(j)) for i, j in sides}
    assert len(counted) == len(sides)
    rim = {(i, j) for i, j in counted if (j, i) not in counted}
    n, m = len(outer), len(inner)
    assert rim == {(i, (i + 1) % n) for i in range(n)} | {
        (n + (i + 1) % m, n + i) for i in range(m)
    }


# -- marks, slivers, refusals --------------------------------------------------------------------


def test_marks_of_synthetic_vertices_come_through() -> None:
    seen, bridged = (
        column(ring(5.0), 0.0, 2.0),
        column(ring(3.0, (1.0, 0.0)), 2.0, 4.0, marked=True),
    )
    mesh = join_solids([seen, bridged], [False, False], within_mm=1e-9)
    for part in (seen, bridged):
        away, nearest = cKDTree(mesh.vertices_mm).query(part.vertices_mm)
        kept = away < 1e-9
        assert kept.mean() > 0.9
        assert (mesh.synthetic[nearest[kept]] == part.synthetic[kept]).mean() == 1.0


def strip(middle: tuple[float, float, float], *, beside: float = 0.5) -> Mesh:
    """A tetrahedron, one face cut in three by a vertex near one of its edges or corners."""
    corners = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [beside, 1, 4], middle], dtype=float)
    faces = [[0, 4, 1], [1, 4, 2], [2, 4, 0], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    return Mesh(corners, np.array(faces), np.array([0, 0, 0, 0, 1]))


def test_a_sliver_along_an_edge_is_turned() -> None:
    mesh = strip((2.0, 1e-6, 0.0))
    made = without_slivers(mesh, within_mm=1e-5)
    assert len(made.faces) == len(mesh.faces)
    assert soundness(mesh, flat_below_mm=1e-5).degenerate_faces == 1
    assert soundness(made, flat_below_mm=1e-5).sound


def test_a_sliver_at_a_corner_is_merged_and_stays_marked() -> None:
    mesh = strip((1e-6, 1e-6, 0.0))
    made = without_slivers(mesh, within_mm=1e-5)
    assert len(made.vertices_mm) == 4
    assert made.synthetic.sum() == 1
    assert soundness(made, flat_below_mm=1e-5).sound
    assert judged(made).volume == pytest.approx(judged(mesh).volume, rel=1e-5)


def test_what_is_higher_than_the_tolerance_is_left_alone() -> None:
    mesh = strip((2.0, 1e-4, 0.0))
    made = without_slivers(mesh, within_mm=1e-5)
    np.testing.assert_array_equal(made.vertices_mm, mesh.vertices_mm)
    np.testing.assert_array_equal(made.faces, mesh.faces)


def test_a_part_that_is_open_is_refused_by_its_number() -> None:
    good = column(ring(5.0), 0.0, 2.0)
    cracked = Mesh(good.vertices_mm, good.faces[:-1], good.synthetic)
    with pytest.raises(NotLoftable, match="part 1 is no closed mesh") as caught:
        join_solids([good, cracked], [False, False], within_mm=1e-9)
    assert caught.value.indices == (1,)


def test_a_part_that_is_inside_out_is_refused() -> None:
    good = column(ring(5.0), 0.0, 2.0)
    with pytest.raises(NotLoftable, match="part 0 is flat or inside out"):
        join_solids(
            [Mesh(good.vertices_mm, good.faces[:, ::-1], good.synthetic)], [False], within_mm=1e-9
        )


def test_cavities_alone_are_no_solid() -> None:
    with pytest.raises(NotLoftable, match="leave no solid"):
        join_solids([column(ring(5.0), 0.0, 2.0)], [True], within_mm=1e-9)


def test_a_flag_for_every_part_is_asked_for() -> None:
    with pytest.raises(ValueError, match="one for each of 1 parts expected, got 2"):
        join_solids([column(ring(5.0), 0.0, 2.0)], [True, False], within_mm=1e-9)
