"""Rows into a mesh: closed and oriented whatever the counts, with the volume of the formula."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.meshing import Mesh, Row, mesh_rows
from reconstruction.soundness import soundness
from tests.reconstruction.part_cases import ring, star

LEVEL = np.eye(3)[:2]


def rows_of(rings: list[FloatArray]) -> list[Row]:
    return [Row(points, np.zeros(len(points), dtype=np.bool_)) for points in rings]


@given(st.integers(0, 2**32 - 1), st.integers(2, 8))
@settings(max_examples=100, deadline=None)
def test_rings_of_any_counts_make_a_closed_and_oriented_mesh(seed: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    count, made = int(rng.integers(3, 30)), []
    for height in range(rings):
        made.append(np.column_stack([star(rng, count), np.full(count, float(height))]))
        count = int(rng.integers(max(3, math.ceil(count / 2)), 2 * count + 1))
    mesh = mesh_rows(rows_of(made), LEVEL)
    facts = soundness(mesh)
    assert facts.watertight
    assert facts.oriented
    assert facts.manifold
    assert (facts.components, facts.euler_number, facts.unused_vertices) == (1, 2, 0)
    assert facts.volume_mm3 > 0.0
    np.testing.assert_array_equal(mesh.vertices_mm, np.concatenate(made))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_even_tangled_rings_make_a_closed_and_oriented_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = [12, 7, 9, 18]
    made = [np.column_stack([rng.normal(size=(n, 2)), np.full(n, k)]) for k, n in enumerate(counts)]
    facts = soundness(mesh_rows(rows_of(made), LEVEL))
    assert facts.watertight
    assert facts.oriented


@given(st.integers(3, 60), st.integers(2, 6))
@settings(max_examples=30, deadline=None)
def test_rings_one_above_another_make_an_exact_prism(count: int, rings: int) -> None:
    heights = np.linspace(0.0, 7.0, rings)
    mesh = mesh_rows(rows_of([ring(5.0, count, h) for h in heights]), LEVEL)
    base = 0.5 * count * 25.0 * math.sin(2.0 * math.pi / count)
    assert soundness(mesh).volume_mm3 == pytest.approx(7.0 * base, rel=1e-12)


@given(st.integers(3, 60), st.floats(0.1, 10.0))
@settings(max_examples=30, deadline=None)
def test_rings_that_shrink_make_an_exact_frustum(count: int, top_mm: float) -> None:
    mesh = mesh_rows(rows_of([ring(5.0, count), ring(top_mm, count, 9.0)]), LEVEL)
    circle_share = count * math.sin(2.0 * math.pi / count) / 2.0
    expected = 9.0 / 3.0 * (25.0 + 5.0 * top_mm + top_mm**2) * circle_share
    assert soundness(mesh).volume_mm3 == pytest.approx(expected, rel=1e-12)


# A ring of n points loses (2 pi / n)^2 / 6 of the circle's area. Where pairs shift points by up to
# one step against those below, chords across the band are twice as long: four times as much.
LOSS = 4.0 * (2.0 * math.pi) ** 2 / 6.0


@pytest.mark.parametrize(
    "counts", [(40, 40), (40, 31), (31, 40), (60, 45, 33, 24), (24, 48), (48, 24), (70, 69, 68)]
)
def test_a_cylinder_of_unequal_rings_loses_no_more_than_its_chords_do(
    counts: tuple[int, ...],
) -> None:
    rings = [ring(10.0, n, 4.0 * k) for k, n in enumerate(counts)]
    volume = soundness(mesh_rows(rows_of(rings), LEVEL)).volume_mm3
    exact = math.pi * 100.0 * 4.0 * (len(counts) - 1)
    assert exact * (1.0 - LOSS / min(counts) ** 2) <= volume < exact


def test_a_cone_whose_counts_fall_with_its_radius_has_its_volume() -> None:
    radii = [20.0, 16.0, 12.0, 9.0, 6.0]
    counts = [round(2.0 * math.pi * r / 1.2) for r in radii]
    rings = [ring(r, n, 5.0 * k) for k, (r, n) in enumerate(zip(radii, counts, strict=True))]
    volume = soundness(mesh_rows(rows_of(rings), LEVEL)).volume_mm3
    exact = sum(5.0 * math.pi / 3.0 * (a * a + a * b + b * b) for a, b in pairwise(radii))
    assert exact * (1.0 - LOSS / min(counts) ** 2) <= volume < exact


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_faces_look_outward_along_every_stacking_axis(axis: int) -> None:
    planar = [(axis + 1) % 3, (axis + 2) % 3, axis]
    axes = np.eye(3)[planar]
    rings = [ring(5.0, n, h) @ axes for n, h in ((12, 0.0), (9, 3.0), (9, 6.0))]
    facts = soundness(mesh_rows(rows_of(rings), axes[:2]))
    assert facts.sound
    assert facts.volume_mm3 > 0.9 * math.pi * 25.0 * 6.0 * (1.0 - LOSS / 81.0)


def test_a_band_takes_the_shorter_diagonals() -> None:
    turned = 0.3  # of a step: the diagonal against the turn is the longer one
    rings = [ring(5.0, 12), ring(5.0, 12, 2.0, turned * math.pi / 6.0)]
    mesh = mesh_rows(rows_of(rings), LEVEL)
    lengths = {
        round(float(np.linalg.norm(np.subtract(*mesh.vertices_mm[[a, b]]))), 9)
        for face in mesh.faces
        for a, b in pairwise([*face, face[0]])
        if (a < 12) != (b < 12) and (b - a) % 12 != 0
    }
    short = math.hypot(2.0, 10.0 * math.sin((1.0 - turned) * math.pi / 12.0))
    assert lengths == {round(short, 9)}


def test_marks_stay_with_their_points() -> None:
    marks = [np.arange(n) % 3 == 0 for n in (9, 8)]
    rows = [Row(ring(5.0, len(m), float(k)), m) for k, m in enumerate(marks)]
    np.testing.assert_array_equal(mesh_rows(rows, LEVEL).synthetic, np.concatenate(marks))


def test_a_mesh_cannot_be_written_to() -> None:
    mesh: Mesh = mesh_rows(rows_of([ring(5.0, 9), ring(5.0, 9, 1.0)]), LEVEL)
    assert not mesh.vertices_mm.flags.writeable
    assert not mesh.faces.flags.writeable
