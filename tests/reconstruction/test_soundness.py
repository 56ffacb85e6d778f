"""Soundness against trimesh, against counting by hand, and on the classic bad cases."""

from collections import Counter, defaultdict

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.meshing import Mesh
from reconstruction.soundness import soundness


def mesh_of(vertices, faces) -> Mesh:
    vertices = np.asarray(vertices, dtype=float).reshape(-1, 3)
    return Mesh(vertices, np.asarray(faces).reshape(-1, 3), np.zeros(len(vertices), bool))


def box(offset=(0.0, 0.0, 0.0), size=10.0) -> tuple[np.ndarray, np.ndarray]:
    solid = trimesh.creation.box((size, size, size))
    return np.asarray(solid.vertices) + offset, np.asarray(solid.faces)


def naive_counts(faces) -> dict[str, int]:
    """Dictionaries and breadth-first search, as one would count on paper."""
    around = defaultdict(list)
    directed = Counter()
    for number, face in enumerate(faces):
        for k in range(3):
            tail, head = int(face[k]), int(face[(k + 1) % 3])
            around[frozenset((tail, head))].append(number)
            directed[tail, head] += 1
    twice = {frozenset(edge) for edge, count in directed.items() if count > 1}
    split = sum(naive_fans(faces, around, v) > 1 for v in set(np.ravel(faces).tolist()))
    everything = set(range(len(faces)))
    return {
        "boundary_edges": sum(len(of) == 1 for of in around.values()),
        "nonmanifold_edges": sum(len(of) > 2 for of in around.values()),
        "misdirected_edges": len(twice),
        "nonmanifold_vertices": split,
        "components": naive_pieces(everything, around.values()),
    }


def naive_fans(faces, around, vertex) -> int:
    here = {number for number, face in enumerate(faces) if vertex in face}
    return naive_pieces(here, [of for edge, of in around.items() if vertex in edge])


def naive_pieces(items, ties) -> int:
    left, pieces = set(items), 0
    while left:
        pieces += 1
        front = [left.pop()]
        while front:
            item = front.pop()
            for tie in ties:
                if item in tie:
                    fresh = left.intersection(tie)
                    left -= fresh
                    front.extend(fresh)
    return pieces


@given(st.integers(0, 2**32 - 1), st.integers(1, 14), st.integers(4, 8))
@settings(max_examples=40, deadline=None)
def test_random_heaps_of_triangles_are_counted_as_by_hand(seed, count, vertices) -> None:
    random = np.random.default_rng(seed)
    faces = np.array([random.choice(vertices, 3, replace=False) for _ in range(count)])
    facts = soundness(mesh_of(random.normal(size=(vertices, 3)), faces))
    expected = naive_counts(faces)
    assert {name: getattr(facts, name) for name in expected} == expected


@pytest.mark.parametrize(
    "solid",
    [
        trimesh.creation.icosphere(3, 7.0),
        trimesh.creation.torus(10.0, 3.0),
        trimesh.creation.cylinder(5.0, 20.0),
        trimesh.creation.annulus(3.0, 6.0, 9.0),
    ],
    ids=["sphere", "torus", "cylinder", "annulus"],
)
def test_solids_measure_as_in_trimesh(solid) -> None:
    solid = trimesh.Trimesh(solid.vertices, solid.faces, process=False)
    facts = soundness(mesh_of(solid.vertices + np.array([300.0, -200.0, 50.0]), solid.faces))
    assert facts.sound
    assert facts.watertight is bool(solid.is_watertight)
    assert facts.oriented is bool(solid.is_winding_consistent)
    assert facts.euler_number == solid.euler_number
    assert facts.components == solid.body_count
    assert facts.volume_mm3 == pytest.approx(solid.volume, rel=1e-11)
    assert facts.area_mm2 == pytest.approx(solid.area, rel=1e-12)


def test_a_cube_has_its_volume_and_its_mirror_image_the_negative() -> None:
    vertices, faces = box()
    assert soundness(mesh_of(vertices, faces)).volume_mm3 == pytest.approx(1000.0, rel=1e-12)
    inward = soundness(mesh_of(vertices, faces[:, ::-1]))
    assert inward.volume_mm3 == pytest.approx(-1000.0, rel=1e-12)
    assert inward.oriented
    assert not inward.sound


def test_a_missing_face_opens_three_edges_and_leaves_no_volume() -> None:
    vertices, faces = box()
    facts = soundness(mesh_of(vertices, faces[1:]))
    assert (facts.boundary_edges, facts.euler_number) == (3, 1)
    assert not facts.watertight
    assert facts.manifold
    assert np.isnan(facts.volume_mm3)


def test_a_turned_face_is_closed_but_not_oriented() -> None:
    vertices, faces = box()
    faces = faces.copy()
    faces[0] = faces[0, ::-1]
    facts = soundness(mesh_of(vertices, faces))
    assert facts.watertight
    assert facts.misdirected_edges == 3
    assert np.isnan(facts.volume_mm3)


def test_cubes_that_touch_in_a_vertex_are_closed_but_not_manifold() -> None:
    vertices, faces = box()
    other = faces + 8
    shared = int(np.flatnonzero(np.all(vertices == 5.0, axis=1))[0])
    opposite = int(np.flatnonzero(np.all(vertices == -5.0, axis=1))[0]) + 8
    other[other == opposite] = shared
    heap = mesh_of(np.vstack([vertices, vertices + 10.0]), np.vstack([faces, other]))
    facts = soundness(heap)
    assert facts.watertight
    assert (facts.nonmanifold_edges, facts.nonmanifold_vertices) == (0, 1)
    assert (facts.components, facts.unused_vertices) == (2, 1)
    assert not facts.sound


def test_a_needle_without_height_is_degenerate_and_a_thin_one_is_not() -> None:
    flat = mesh_of([[0, 0, 0], [10, 0, 0], [5, 1e-12, 0]], [[0, 1, 2]])
    thin = mesh_of([[0, 0, 0], [10, 0, 0], [5, 1e-6, 0]], [[0, 1, 2]])
    repeated = mesh_of([[0, 0, 0], [10, 0, 0], [5, 5, 0]], [[0, 1, 1]])
    assert [soundness(m).degenerate_faces for m in (flat, thin, repeated)] == [1, 0, 1]
    assert soundness(thin, flat_below_mm=1e-5).degenerate_faces == 1


def test_no_faces_are_no_solid() -> None:
    facts = soundness(mesh_of([], np.zeros((0, 3), dtype=int)))
    assert not facts.watertight
    assert (facts.components, facts.euler_number, facts.area_mm2) == (0, 0, 0.0)


def test_a_face_that_names_no_vertex_is_the_callers_mistake() -> None:
    with pytest.raises(ValueError, match=r"outside 0 \.\. 2"):
        soundness(mesh_of(np.eye(3), [[0, 1, 3]]))
    with pytest.raises(ValueError, match="finite"):
        soundness(mesh_of([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]]))
