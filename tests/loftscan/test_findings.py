"""What a person is told about a result: every sentence when it is due, none when it is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loftscan import reconstruct
from loftscan.findings import judge
from loftscan.methods import AnyReconstruction
from loftscan.result import Result
from loftscan.sliced import Sliced
from loftscan.spans import spans
from loftscan.surface_findings import judge_surface
from reconstruction.cleanup import CleanupSettings
from reconstruction.sections import Section, Skipped
from reconstruction.setting_aside import Aside
from tests.system.command_cases import NOISE_MM, ROW_MM, FloatArray


def with_sections(done: AnyReconstruction, *changed: tuple[int, dict]) -> AnyReconstruction:
    """A reconstruction in which some sections, by their place, have other values."""
    sections = list(done.sections)
    for place, values in changed:
        sections[place] = replace(sections[place], **values)
    return replace(done, sections=tuple(sections))


def left_out(section: Section, share: float) -> dict:
    return {"left_out": int(share * section.points)}


@pytest.fixture(params=["part_result", "paper_result"])
def any_result(request: pytest.FixtureRequest) -> Result:
    """A result of either method."""
    return request.getfixturevalue(request.param)


def news(result: Result, cutting: Sliced, done: AnyReconstruction) -> tuple[str, ...]:
    """What is said of a changed result, and was not said of the result itself."""
    before = judge(result.cutting, result.reconstruction)
    said = judge(cutting, done)
    assert set(before) <= set(said)
    return tuple(sentence for sentence in said if sentence not in before)


def test_a_clean_scan_is_not_remarked_upon(paper_result: Result) -> None:
    assert paper_result.warnings == ()
    assert judge(paper_result.cutting, paper_result.reconstruction) == ()


def test_of_a_fit_only_shadows_and_ends_and_the_shoulder_are_remarked_upon(
    part_result: Result,
) -> None:
    assert part_result.warnings == judge(part_result.cutting, part_result.reconstruction) == (
        *(f"slice {k}: a contour 127 mm long may be closed or open: closed" for k in (2, 3, 4)),
        "contours step abruptly between slices 7 and 8: made level, midway; do not measure at which"
        " height",
        "ends of the part that no slice samples: 2 closed by a flat cap; do not measure on them",
    )  # fmt: skip


def test_slices_from_whose_points_the_surface_keeps_away_are_named(part_result: Result) -> None:
    cutting, off = part_result.cutting, part_result.deviation
    sample = part_result.sample_mm
    beside = np.isin(np.rint(sample[:, 2] / ROW_MM), [7, 8])
    away = replace(off, distances_mm=off.distances_mm + 0.5 * beside)
    said = judge_surface(cutting, part_result.reconstruction, sample, away, CleanupSettings())
    assert len(said) == 1
    assert said[0].startswith("slices 7-8: half of the points lie far beyond their noise from the")
    assert said[0].endswith("do not measure there; scan more densely, or choose --method paper")


def swaying_cloud(noise_mm: float) -> FloatArray:
    """A part without a shoulder, row by row, (n, 3)."""
    rng = np.random.default_rng(4)
    turn, rows = np.arange(240) * (math.tau / 240), np.arange(16) * ROW_MM
    angle, height = (grid.ravel() for grid in np.meshgrid(turn, rows))
    radius = 20.0 + 3.0 * np.sin(height / 8.0) + 2.0 * np.cos(2.0 * angle)
    radius += rng.normal(0.0, noise_mm, len(angle))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def test_a_surface_that_keeps_to_its_points_is_not_remarked_upon() -> None:
    assert reconstruct(swaying_cloud(NOISE_MM)).warnings == (
        "ends of the part that no slice samples: 2 closed by a flat cap; do not measure on them",
    )


def test_a_mesh_too_coarse_for_its_points_is_said() -> None:
    coarse = reconstruct(swaying_cloud(NOISE_MM / 50), decimate_to_faces=300)
    (said,) = (each for each in coarse.warnings if "half of the points" in each)
    assert said.endswith("a mesh so coarse does not follow the surface; ask for more faces")


def test_a_second_contour_is_named_with_its_slices(paper_result: Result) -> None:
    done, sections = paper_result.reconstruction, paper_result.sections
    few = [(k, left_out(sections[k], 0.019)) for k in range(16)]
    assert judge(paper_result.cutting, with_sections(done, *few)) == ()
    many = [(k, left_out(sections[k], 0.1)) for k in (3, 4, 5, 9)]
    points = sum(values["left_out"] for _, values in many)
    (sentence,) = judge(paper_result.cutting, with_sections(done, *many))
    assert sentence.startswith(f"{points} points in slices 3-5, 9 belong to something beside")
    assert "drawn in the report but not made" in sentence


def test_a_section_that_is_mostly_a_bridge_is_not_to_be_measured(any_result: Result) -> None:
    done, length = any_result.reconstruction, any_result.sections[7].length_mm
    less, more = (with_sections(done, (7, {"gap_mm": k * length})) for k in (0.24, 0.26))
    assert news(any_result, any_result.cutting, less) == ()
    (sentence,) = news(any_result, any_result.cutting, more)
    assert sentence.startswith("section 7: synthetic over more than a quarter of the length")
    assert "do not measure there" in sentence


def test_a_contour_that_turns_twice_is_named_with_the_remedy(paper_result: Result) -> None:
    contour = paper_result.sections[2].contour
    twice = replace(
        contour,
        **{name: np.concatenate([getattr(contour, name)] * 2)
           for name in ("points_mm", "counts", "bridged", "cells")},
    )  # fmt: skip
    assert twice.turns == pytest.approx(2.0)
    done = with_sections(paper_result.reconstruction, (2, {"contour": twice}))
    (sentence,) = judge(paper_result.cutting, done)
    assert sentence.startswith("section 2: the contour crosses itself")
    assert "try a larger --resolution-mm, or --crop" in sentence


def test_slices_without_a_section_are_named_with_the_reason_of_the_fullest(
    any_result: Result,
) -> None:
    skipped = (Skipped(0, 2, "2 points"), Skipped(1, 90, "3 centres of mass"), Skipped(8, 0, "0"))
    done = replace(any_result.reconstruction, skipped=skipped)
    (sentence,) = news(any_result, any_result.cutting, done)
    assert sentence == (
        "slices 0-1, 8: no section, so bridged or cut off (slice 1: 3 centres of mass)"
    )


def test_a_table_plate_is_said(any_result: Result) -> None:
    cutting = replace(any_result.cutting, aside={Aside.PLATE: 400, Aside.STRAY: 12})
    (sentence,) = news(any_result, cutting, any_result.reconstruction)
    assert sentence == "400 points of the table plate under the part were set aside"


def test_a_part_on_its_side_is_asked_about(paper_result: Result) -> None:
    done = paper_result.reconstruction
    opened = [
        (k, {"contour": replace(section.contour, closed=False)})
        for k, section in enumerate(paper_result.sections)
    ]
    assert judge(paper_result.cutting, with_sections(done, *opened[:7])) == ()
    (sentence,) = judge(paper_result.cutting, with_sections(done, *opened[:8]))
    assert sentence.endswith("was the part turned about another axis than --axis z?")


def test_a_part_on_its_side_is_asked_about_by_the_fit_too(part_result: Result) -> None:
    done, sections = part_result.reconstruction, part_result.sections
    opened = [
        (k, {"outlines": replace(each.outlines, outlines=())}) for k, each in enumerate(sections)
    ]
    asked = "was the part turned about another axis than --axis z?"
    few, half = (judge(part_result.cutting, with_sections(done, *opened[:k])) for k in (7, 8))
    assert not any(asked in sentence for sentence in few)
    assert half[-1].endswith(asked)


def test_every_sentence_can_stand_in_a_line(paper_result: Result) -> None:
    done, sections = paper_result.reconstruction, paper_result.sections
    changed = [
        (k, {"gap_mm": section.length_mm, "contour": replace(section.contour, closed=False)}
         | left_out(section, 0.5))
        for k, section in enumerate(sections)
    ]  # fmt: skip
    cutting = replace(paper_result.cutting, aside={Aside.PLATE: 1})
    skipped = replace(with_sections(done, *changed), skipped=(Skipped(3, 1, "1 points"),))
    told = judge(cutting, skipped)
    assert len(told) == 5
    assert all(sentence.isprintable() and not sentence.endswith(".") for sentence in told)


# -- numbers as a person writes them -------------------------------------------------------------


@pytest.mark.parametrize(
    ("indices", "said"),
    [
        ([], ""),
        ([4], "4"),
        ([4, 5], "4-5"),
        ([12, 3, 9, 7, 4, 5, 6, 13, 3], "3-7, 9, 12-13"),
    ],
)
def test_neighbouring_numbers_become_a_span(indices: list[int], said: str) -> None:
    assert spans(indices) == said


@given(st.sets(st.integers(0, 60)))
def test_spans_name_each_number_once_and_nothing_between(indices: set[int]) -> None:
    named: list[int] = []
    for span in filter(None, spans(indices).split(", ")):
        first, _, last = span.partition("-")
        named += range(int(first), int(last or first) + 1)
    assert named == sorted(indices)
    # No two spans could have been one.
    starts = [int(span.split("-")[0]) for span in filter(None, spans(indices).split(", "))]
    assert all(start - 1 not in indices for start in starts)
