"""Sections into runs, patches and rows."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from reconstruction.arrays import FloatArray
from reconstruction.errors import NotLoftable
from reconstruction.lofting import lay_rows, loft_run, split_runs
from reconstruction.meshing import Row
from reconstruction.nurbs import Surface, evaluate_surface
from reconstruction.paper import PaperSettings, draw_sections
from reconstruction.sections import Section
from tests.reconstruction.part_cases import band, flat_slice

STEPS_MM = (0.0, 1.0, 2.5, 3.0, 5.0, 6.0, 7.0)  # uneven on purpose
HIDDEN_RAD = (1.0, 1.6)


def drawn(radii: list[float], *, hidden: bool = False) -> list[Section]:
    """Sections of a body of revolution, with a sector that was never seen."""
    slices = []
    for k, radius in enumerate(radii):
        rng = np.random.default_rng(k)
        planar = band(rng, radius_mm=radius, width_mm=0.4, points_a_mm=15.0)
        angle = np.arctan2(planar[:, 1], planar[:, 0])
        seen = ~((angle > HIDDEN_RAD[0]) & (angle < HIDDEN_RAD[1])) | (not hidden)
        slices.append(flat_slice(planar[seen], index=k, height_mm=STEPS_MM[k]))
    sections = list(draw_sections(slices, PaperSettings()))
    return [each for each in sections if isinstance(each, Section)]


def laid(sections: list[Section], intermediate: int = 0) -> list[Row]:
    runs = split_runs(sections)
    return lay_rows(runs, [loft_run(run) for run in runs], intermediate=intermediate)


def counts(rows: list[Row]) -> list[int]:
    return [len(row.points_mm) for row in rows]


def test_a_run_is_as_long_as_the_count_stays() -> None:
    sections = drawn([20.0, 19.5, 19.0, 12.0, 11.5, 6.0])
    runs = split_runs(sections)
    assert [[each.index for each in run] for run in runs] == [[0, 1, 2], [3, 4], [5]]
    assert [each for run in runs for each in run] == sections


def test_a_patch_contains_its_sections_at_their_own_heights() -> None:
    sections = drawn([20.0, 19.0, 18.5, 18.0, 18.5])
    patch = loft_run(sections)
    assert isinstance(patch, Surface)
    assert (patch.periodic_u, patch.periodic_v, patch.degree_v) == (True, False, 3)
    u = np.linspace(0.0, len(sections[0].knot_points_mm), 200)
    for section in sections:
        on_patch = evaluate_surface(patch, u, np.array([section.height_mm]))[:, 0]
        np.testing.assert_allclose(on_patch, section.curve(u), atol=1e-9)


@pytest.mark.parametrize(("length", "degree"), [(2, 1), (3, 2), (4, 3), (5, 3)])
def test_a_short_run_has_a_lower_degree(length: int, degree: int) -> None:
    patch = loft_run(drawn([20.0] * length))
    assert patch is not None
    assert patch.degree_v == degree


def test_one_section_makes_no_patch() -> None:
    assert loft_run(drawn([20.0])) is None


def test_without_intermediate_rows_the_rows_are_the_sections() -> None:
    sections = drawn([20.0, 19.5, 13.0, 12.5])
    for row, section in zip(laid(sections), sections, strict=True):
        np.testing.assert_array_equal(row.points_mm, section.knot_points_mm)


@pytest.mark.parametrize("intermediate", [1, 3])
def test_intermediate_rows_lie_evenly_between_sections_on_the_patch_and_across_runs(
    intermediate: int,
) -> None:
    sections = drawn([20.0, 19.5, 13.0, 12.5])
    rows = laid(sections, intermediate)
    assert len(rows) == 4 + 3 * intermediate
    heights = [float(row.points_mm[:, 2].mean()) for row in rows]
    own = [section.height_mm for section in sections]
    wanted = np.interp(np.arange(len(rows)) / (intermediate + 1), np.arange(4), own)
    np.testing.assert_allclose(heights, wanted, atol=1e-9)
    radii = [np.hypot(*row.points_mm[:, :2].T) for row in rows]
    for k, radius in enumerate(radii):
        low, high = sorted(
            (
                own_radius(sections, k // (intermediate + 1)),
                own_radius(sections, -(-k // (intermediate + 1))),
            )
        )
        assert low - 0.4 < radius.mean() < high + 0.4


def own_radius(sections: list[Section], k: int) -> float:
    return float(np.hypot(*sections[k].knot_points_mm[:, :2].T).mean())


@pytest.mark.parametrize("radii", [[40.0, 5.0], [5.0, 40.0], [40.0, 3.0, 30.0]])
@pytest.mark.parametrize("intermediate", [0, 1, 5])
def test_rows_of_very_different_sections_can_always_be_connected_in_pairs(
    radii: list[float], intermediate: int
) -> None:
    rows = laid(drawn(radii), intermediate)
    assert len(rows) >= len(radii) + intermediate * (len(radii) - 1)
    for before, after in pairwise(counts(rows)):
        assert max(before, after) <= 2 * min(before, after)


def angles(row: Row) -> FloatArray:
    return np.asarray(np.arctan2(row.points_mm[:, 1], row.points_mm[:, 0]))


@pytest.mark.parametrize("radii", [[20.0, 19.0], [20.0, 13.0], [13.0, 20.0], [40.0, 8.0]])
def test_rows_between_sections_are_synthetic_where_the_gap_is_and_nowhere_else(
    radii: list[float],
) -> None:
    rows = laid(drawn(radii, hidden=True), intermediate=2)
    assert len(rows) >= 4
    for row in rows:
        # The gap is known to a cell and a half, 0.8 mm each, and a knot's distance.
        slack = 1.2 / min(radii) + 2.0 * math.pi / len(row.points_mm)
        within = (angles(row) > HIDDEN_RAD[0] + slack) & (angles(row) < HIDDEN_RAD[1] - slack)
        beyond = (angles(row) < HIDDEN_RAD[0] - slack) | (angles(row) > HIDDEN_RAD[1] + slack)
        assert row.synthetic[within].all()
        assert not row.synthetic[beyond].any()
    assert sum(int(row.synthetic.sum()) for row in rows) > len(rows)


def test_one_section_alone_cannot_be_lofted() -> None:
    with pytest.raises(NotLoftable, match="two are needed") as refused:
        laid(drawn([20.0]))
    assert refused.value.indices == (0,)


def test_sections_at_one_height_cannot_be_lofted() -> None:
    (section,) = drawn([20.0])
    with pytest.raises(NotLoftable):
        loft_run([section, section])
