"""What a person is told about a result: every sentence when it is due, none when it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from loftscan.findings import judge
from loftscan.result import Result
from loftscan.spans import spans
from reconstruction.pipeline import Reconstruction
from reconstruction.sections import Section, Skipped
from reconstruction.setting_aside import Aside


def with_sections(done: Reconstruction, *changed: tuple[int, dict]) -> Reconstruction:
    """A reconstruction in which some sections, by their place, have other values."""
    sections = list(done.sections)
    for place, values in changed:
        sections[place] = replace(sections[place], **values)
    return replace(done, sections=tuple(sections))


def left_out(section: Section, share: float) -> dict:
    return {"left_out": int(share * section.points)}


def test_a_clean_scan_is_not_remarked_upon(part_result: Result) -> None:
    assert part_result.warnings == ()
    assert judge(part_result.cutting, part_result.reconstruction) == ()


def test_a_second_contour_is_named_with_its_slices(part_result: Result) -> None:
    done, sections = part_result.reconstruction, part_result.sections
    few = [(k, left_out(sections[k], 0.019)) for k in range(16)]
    assert judge(part_result.cutting, with_sections(done, *few)) == ()
    many = [(k, left_out(sections[k], 0.1)) for k in (3, 4, 5, 9)]
    points = sum(values["left_out"] for _, values in many)
    (sentence,) = judge(part_result.cutting, with_sections(done, *many))
    assert sentence.startswith(f"{points} points in slices 3-5, 9 belong to something beside")
    assert "drawn in the report but not made" in sentence


def test_a_section_that_is_mostly_a_bridge_is_not_to_be_measured(part_result: Result) -> None:
    done, length = part_result.reconstruction, part_result.sections[7].length_mm
    assert judge(part_result.cutting, with_sections(done, (7, {"gap_mm": 0.24 * length}))) == ()
    (sentence,) = judge(part_result.cutting, with_sections(done, (7, {"gap_mm": 0.26 * length})))
    assert sentence.startswith("section 7: synthetic over more than a quarter of the length")
    assert "do not measure there" in sentence


def test_a_contour_that_turns_twice_is_named_with_the_remedy(part_result: Result) -> None:
    contour = part_result.sections[2].contour
    twice = replace(
        contour,
        **{name: np.concatenate([getattr(contour, name)] * 2)
           for name in ("points_mm", "counts", "bridged", "cells")},
    )  # fmt: skip
    assert twice.turns == pytest.approx(2.0)
    done = with_sections(part_result.reconstruction, (2, {"contour": twice}))
    (sentence,) = judge(part_result.cutting, done)
    assert sentence.startswith("section 2: the contour crosses itself")
    assert "try a larger --resolution-mm, or --crop" in sentence


def test_slices_without_a_section_are_named_with_the_reason_of_the_fullest(
    part_result: Result,
) -> None:
    skipped = (Skipped(0, 2, "2 points"), Skipped(1, 90, "3 centres of mass"), Skipped(8, 0, "0"))
    done = replace(part_result.reconstruction, skipped=skipped)
    (sentence,) = judge(part_result.cutting, done)
    assert sentence == (
        "slices 0-1, 8: no section, so bridged or cut off (slice 1: 3 centres of mass)"
    )


def test_a_table_plate_is_said(part_result: Result) -> None:
    cutting = replace(part_result.cutting, aside={Aside.PLATE: 400, Aside.STRAY: 12})
    (sentence,) = judge(cutting, part_result.reconstruction)
    assert sentence == "400 points of the table plate under the part were set aside"


def test_a_part_on_its_side_is_asked_about(part_result: Result) -> None:
    done = part_result.reconstruction
    opened = [
        (k, {"contour": replace(section.contour, closed=False)})
        for k, section in enumerate(part_result.sections)
    ]
    assert judge(part_result.cutting, with_sections(done, *opened[:7])) == ()
    (sentence,) = judge(part_result.cutting, with_sections(done, *opened[:8]))
    assert sentence.endswith("was the part turned about another axis than --axis z?")


def test_every_sentence_can_stand_in_a_line(part_result: Result) -> None:
    done, sections = part_result.reconstruction, part_result.sections
    changed = [
        (k, {"gap_mm": section.length_mm, "contour": replace(section.contour, closed=False)}
         | left_out(section, 0.5))
        for k, section in enumerate(sections)
    ]  # fmt: skip
    cutting = replace(part_result.cutting, aside={Aside.PLATE: 1})
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
