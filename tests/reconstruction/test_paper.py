"""The paper's steps from a slice to a section: plane, curve, base rule, residual, stream."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reconstruction.arrays import FloatArray
from reconstruction.nurbs import evaluate_curve
from reconstruction.ordering import Walk, walk_contour
from reconstruction.paper import (
    PaperSettings,
    PlaneRule,
    draw_curve,
    draw_section,
    draw_sections,
    lay_plane,
)
from reconstruction.reduction import reduce_points
from reconstruction.sections import Section, Skipped
from reconstruction.slices import Frame, Slice
from tests.reconstruction.part_cases import band, flat_slice, ring


def circle_slice(
    radius_mm: float, *, index: int = 0, height_mm: float = 0.0, seed: int = 0
) -> Slice:
    planar = band(np.random.default_rng(seed), radius_mm=radius_mm, width_mm=0.5, points_a_mm=15.0)
    return flat_slice(planar, index=index, height_mm=height_mm)


def stack(radii: list[float]) -> list[Slice]:
    return [
        circle_slice(radius, index=k, height_mm=float(k), seed=k) for k, radius in enumerate(radii)
    ]


def sections_of(radii: list[float], **chosen: float) -> list[Section]:
    drawn = list(draw_sections(stack(radii), PaperSettings(**chosen)))  # type: ignore[arg-type]
    assert all(isinstance(each, Section) for each in drawn)
    return [each for each in drawn if isinstance(each, Section)]


def random_frame(rng: np.random.Generator) -> Frame:
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return Frame(rng.uniform(-50.0, 50.0, 3), axes * np.sign(np.linalg.det(axes)))


@given(st.integers(0, 2**32 - 1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-3.0, 3.0))
@settings(max_examples=60, deadline=None)
def test_a_tilted_plane_is_recovered_in_any_frame(
    seed: int, along_x: float, along_y: float, rise_mm: float
) -> None:
    rng = np.random.default_rng(seed)
    frame = random_frame(rng)
    flat = rng.uniform(-20.0, 20.0, (300, 2))
    height = rise_mm + flat @ [along_x, along_y]
    points = frame.to_part(np.column_stack([flat, height]))
    found, planar = lay_plane(Slice(0, points, frame), PlaneRule.TILTED)
    np.testing.assert_allclose(planar[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found.axes) == pytest.approx(1.0)
    assert found.axes[2] @ frame.axes[2] > 0.0, "up stays up"
    np.testing.assert_allclose(found.to_part(planar), points, atol=1e-9)


def test_a_tilted_plane_is_recovered_from_noisy_points_within_their_noise() -> None:
    rng = np.random.default_rng(1)
    flat = rng.uniform(-20.0, 20.0, (2000, 2))
    height = 1.0 + flat @ [0.2, -0.1] + rng.normal(0.0, 0.1, 2000)
    piece = Slice(0, np.column_stack([flat, height]), Frame(np.zeros(3), np.eye(3)))
    found, planar = lay_plane(piece, PlaneRule.TILTED)
    truth = np.array([-0.2, 0.1, 1.0]) / math.sqrt(1.05)
    # Slopes are known to 0.1 / sqrt(2000) / 11.5 mm = 2e-4: four of that.
    assert math.acos(min(1.0, float(found.axes[2] @ truth))) < 8e-4
    assert planar[:, 2].std() == pytest.approx(0.1 / math.sqrt(1.05), rel=0.06)


def test_a_level_plane_lies_at_the_mean_height_and_is_not_turned() -> None:
    rng = np.random.default_rng(2)
    frame = random_frame(rng)
    planar = np.column_stack([rng.uniform(-9.0, 9.0, (50, 2)), rng.normal(0.4, 0.2, 50)])
    found, laid = lay_plane(Slice(0, frame.to_part(planar), frame), PlaneRule.LEVEL)
    np.testing.assert_allclose(found.axes, frame.axes, atol=1e-12)
    assert laid[:, 2].mean() == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(laid[:, :2], planar[:, :2], atol=1e-9)


def test_centres_of_mass_are_control_points_of_a_curve_that_passes_beside_them() -> None:
    points = np.column_stack([band(np.random.default_rng(0)), np.zeros(12566)])
    contour = walk_contour(reduce_points(points, size_mm=(4.0, 4.0, math.inf)), walk=Walk.PURE)
    curve = draw_curve(contour)
    centres = contour.points_mm
    beside = (np.roll(centres, 1, axis=0) + 4.0 * centres + np.roll(centres, -1, axis=0)) / 6.0
    met = evaluate_curve(curve, np.arange(len(centres), dtype=float))
    np.testing.assert_allclose(met, beside, atol=1e-12)
    assert sorted(map(tuple, curve.control_points_mm)) == sorted(map(tuple, centres))


def test_a_tilted_section_stands_at_the_height_of_its_middle() -> None:
    planar = band(np.random.default_rng(3), radius_mm=20.0, width_mm=0.4, centre_mm=(100.0, 0.0))
    points = np.column_stack([planar, 5.0 + 0.1 * planar[:, 0]])
    piece = Slice(0, points, Frame(np.array([0.0, 0.0, 5.0]), np.eye(3)))
    section, _ = draw_section(piece, PaperSettings(plane=PlaneRule.TILTED), None)
    assert section.height_mm == pytest.approx(15.0, abs=0.05)
    np.testing.assert_allclose(
        section.knot_points_mm[:, 2], 5.0 + 0.1 * section.knot_points_mm[:, 0], atol=1e-9
    )


def test_a_step_over_one_empty_cell_is_no_gap_and_one_over_more_is() -> None:
    rng = np.random.default_rng(0)
    planar = band(rng, radius_mm=20.0, width_mm=0.4)
    angle = np.arctan2(planar[:, 1], planar[:, 0])
    # At 1 mm cells: 1.1 mm leaves at most one cell empty, 5 mm more.
    seen = (np.abs(angle - 1.5708) > 0.5 * 1.1 / 20.0) & (np.abs(angle + 1.5708) > 0.5 * 5.0 / 20.0)
    piece = flat_slice(planar[seen])
    section, _ = draw_section(piece, PaperSettings(resolution_mm=1.0), None)
    assert len(section.gaps) == 1
    assert section.gap_mm == pytest.approx(5.0, abs=2.0)
    assert (section.knot_points_mm[section.synthetic, 1] < -15.0).all()


def replayed(sections: list[Section], share: float) -> list[tuple[int, bool]]:
    """Count and base flag of every section by the paper's words."""
    expected: list[tuple[int, bool]] = []
    base: Section | None = None
    for section in sections:
        near = base is not None and abs(section.length_mm - base.length_mm) <= (
            share * base.length_mm
        )
        if base is None or not near:
            base = section
            expected.append((len(section.contour.points_mm), True))
        else:
            expected.append((len(base.contour.points_mm), False))
    return expected


SHRINKING = [30.0, 28.0, 25.0, 23.0, 21.0, 18.0, 15.0, 13.0, 11.0, 9.0]
SHAPES = {
    "shrinking": SHRINKING,
    "growing": SHRINKING[::-1],
    "waisted": [20.0, 19.0, 16.0, 13.0, 12.5, 10.0, 13.0, 16.0, 16.5, 20.0],
}


@pytest.mark.parametrize("share", [0.1, 0.25])
@pytest.mark.parametrize("radii", SHAPES.values(), ids=SHAPES.keys())
def test_a_section_keeps_the_count_of_the_base_within_the_share_and_else_becomes_the_base(
    radii: list[float], share: float
) -> None:
    sections = sections_of(radii, base_share=share)
    found = [(len(each.knot_points_mm), each.base) for each in sections]
    assert found == replayed(sections, share)
    bases = [each.index for each in sections if each.base]
    assert len(bases) >= 3, "the shape is meant to need several"
    assert len(bases) < len(sections)


@pytest.mark.parametrize(
    ("radius_mm", "base"), [(15.2, False), (14.8, True), (24.8, False), (25.2, True)]
)
def test_a_quarter_shorter_or_longer_is_the_border(radius_mm: float, base: bool) -> None:  # noqa: FBT001
    first, second = sections_of([20.0, radius_mm])
    assert first.base
    assert second.base is base


def test_sections_are_drawn_one_by_one_as_slices_come() -> None:
    taken: list[int] = []

    def coming() -> Iterator[Slice]:
        for piece in stack([20.0, 19.0, 18.0, 17.0]):
            taken.append(piece.index)
            yield piece

    drawing = draw_sections(coming(), PaperSettings())
    assert taken == []
    for number in range(4):
        assert next(drawing).index == number
        assert taken == list(range(number + 1))


@pytest.mark.parametrize(
    ("planar", "reason"),
    [
        (np.empty((0, 2)), "0 points"),
        (ring(5.0, 7)[:, :2], "7 points, a section needs 8"),
        (np.ones((30, 2)), "in one place"),
    ],
    ids=["none", "seven", "one place"],
)
def test_a_slice_that_makes_no_section_is_skipped_with_its_reason_and_the_next_one_drawn(
    planar: FloatArray, reason: str
) -> None:
    slices = [circle_slice(20.0), flat_slice(planar, index=1), circle_slice(20.0, index=2)]
    before, skipped, after = draw_sections(slices, PaperSettings())
    assert isinstance(skipped, Skipped)
    assert (skipped.index, skipped.points) == (1, len(planar))
    assert reason in skipped.reason
    assert isinstance(before, Section)
    assert isinstance(after, Section)
    assert not after.base, "the base outlives a skipped slice"


def test_cells_too_coarse_for_a_contour_are_named_with_their_size() -> None:
    (skipped,) = draw_sections([circle_slice(5.0)], PaperSettings(resolution_mm=6.0))
    assert isinstance(skipped, Skipped)
    assert "at 6 mm resolution" in skipped.reason or "use finer cells" in skipped.reason


def test_a_section_stands_in_its_plane_and_counts_its_points() -> None:
    piece = circle_slice(20.0, index=3, height_mm=7.5)
    section, base = draw_section(piece, PaperSettings(), None)
    count = len(section.knot_points_mm)
    assert (section.index, section.points) == (3, len(piece.points_mm))
    assert (base.count, base.length_mm) == (count, section.length_mm)
    assert section.height_mm == pytest.approx(7.5)
    np.testing.assert_allclose(section.knot_points_mm[:, 2], 7.5)
    np.testing.assert_allclose(
        section.curve(np.arange(count, dtype=float)), section.knot_points_mm, atol=1e-9
    )
    assert section.length_mm == pytest.approx(2.0 * math.pi * 20.0, rel=0.01)


def test_points_that_belong_to_something_else_are_left_out_counted_and_still_in_the_sum() -> None:
    rng = np.random.default_rng(5)
    inner = rng.uniform(-1.0, 1.0, (40, 2))
    outline = band(rng, radius_mm=20.0, width_mm=0.5, points_a_mm=15.0)
    piece = flat_slice(np.concatenate([outline, inner]))
    section, _ = draw_section(piece, PaperSettings(), None)
    assert section.left_out == 40
    np.testing.assert_array_equal(section.left_out_mm, piece.points_mm[-40:])
    assert section.residual.count == len(outline)
    assert section.residual_all.count == len(outline) + 40
    assert section.residual.max_mm < 1.0
    assert section.residual_all.max_mm == pytest.approx(20.0, abs=0.5)


@pytest.mark.parametrize("resolution_mm", [1.5, 3.0])
def test_the_operators_resolution_makes_the_cells(resolution_mm: float) -> None:
    section, _ = draw_section(circle_slice(20.0), PaperSettings(resolution_mm=resolution_mm), None)
    assert section.resolution.cell_mm == resolution_mm
    # A walk steps one to two cells at a time.
    steps = section.contour.segments_mm
    assert resolution_mm * 0.5 < steps.mean() < resolution_mm * 2.0
