"""The slices of an adaptive scan: asked for, refused, or chosen without an answer."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.adaptive_plan import Adaptive
from acquisition.choices import CHOICES, Chosen, choices_in, is_ended, write_choice
from acquisition.choosing import NextSlices
from acquisition.plan import Plan, parse_plan, ring, write_plan
from acquisition.scan_record import State
from acquisition.scanfile import ScanFolder, ScanWriter
from acquisition.slice_request import (
    SliceRequest,
    decode_request,
    encode_request,
    request_file,
    write_request,
)
from tests.acquisition.scan_cases import record, sweep

ADAPTIVE = Adaptive(tolerance_mm=0.1, coarse_step_mm=4.0, most_slices=9, answer_within_s=2.0)
PLAN = replace(ring(0.0, 16.0, 1.0, 3), adaptive=ADAPTIVE)


class Scanning:
    """A scan of nothing: slices are kept as they are asked for, on a clock that only waits move."""

    def __init__(self, path: Path, plan: Plan = PLAN) -> None:
        self.now_s = 0.0
        self.said: list[str] = []
        self.wants_pause = False
        self.answers: Iterator[SliceRequest] = iter(())
        folder = ScanFolder(path)
        made = replace(record(), plan=plan)
        self.writer: ScanWriter = (
            folder.resume() if path.exists() else ScanFolder.create(path, made)
        )
        self.folder = self.writer.folder
        self.next = NextSlices(
            plan, self.folder, lambda: self.wants_pause, self.said.append, lambda: self.now_s
        )

    def pause(self, seconds: float) -> None:
        self.now_s += seconds
        found = next(self.answers, None)
        if found is not None:
            write_request(self.folder.path, found)

    def take(self, most: int = 100) -> list[int]:
        taken: list[int] = []
        for index in self.next(self.pause):
            self.writer.append(sweep(index))
            taken.append(index)
            if len(taken) == most:
                break
        return taken


def asking(*indices: int | None) -> Iterator[SliceRequest]:
    """Answers to the coarse slices and to all that follow."""
    seen = {0, 4, 8, 12, 16}
    for index in indices:
        yield SliceRequest(tuple(sorted(seen)), index, "it bends", 0.2)
        if index is not None:
            seen.add(index)


def test_the_coarse_slices_come_first_and_then_what_is_asked_for(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    scanning.answers = asking(6, 5, None)
    assert scanning.take() == [0, 4, 8, 12, 16, 6, 5]
    assert scanning.said == ["no more slices: it bends"]
    assert [each.index for each in choices_in(scanning.folder.path)] == [6, 5, None]
    assert choices_in(scanning.folder.path)[0].by == "reconstruction"
    assert scanning.folder.is_whole()
    scanning.writer.finish(State.COMPLETE)


def test_without_an_answer_the_widest_span_is_halved_and_that_is_said_once(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    assert scanning.take() == [0, 4, 8, 12, 16, 2, 6, 10, 14]
    # The patience of 2 s is spent once, in steps of 20 ms, not for each of the four slices.
    assert scanning.now_s == pytest.approx(2.0, abs=0.05)
    assert len(scanning.said) == 2
    assert "did not answer within 2 s" in scanning.said[0]
    assert scanning.said[1] == "no more slices: there are 9, and most_slices is 9"


def test_reconstruction_that_wakes_up_late_is_heard_again(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    write_request(scanning.folder.path, SliceRequest((0,), 1, "of another time", 1.0))
    assert scanning.take(6)[-1] == 2
    now = tuple(sorted({0, 2, 4, 8, 12, 16}))
    write_request(scanning.folder.path, SliceRequest(now, 15, "it bends", 0.2))
    assert scanning.take(1) == [15]


def test_an_answer_to_other_slices_is_no_answer(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    write_request(scanning.folder.path, SliceRequest((0, 4, 8, 12), 7, "it bends", 0.2))
    assert scanning.take(6)[-1] == 2


@pytest.mark.parametrize("wanted", [4, 17, 10**9])
def test_a_slice_that_cannot_be_had_is_not_taken(tmp_path: Path, wanted: int) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    scanning.answers = asking(wanted)
    assert scanning.take(6)[-1] == 2
    assert f"asks for slice {wanted}" in scanning.said[0]


def test_rubbish_beside_the_folder_is_named_and_passed_over(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    request_file(scanning.folder.path).write_text("{")
    assert scanning.take(6)[-1] == 2
    assert "a.next.json: no JSON" in scanning.said[0]


def test_the_seconds_are_a_budget_too(tmp_path: Path) -> None:
    plan = replace(PLAN, adaptive=replace(ADAPTIVE, most_s=2.0))
    scanning = Scanning(tmp_path / "a.scan", plan)
    assert scanning.take() == [0, 4, 8, 12, 16, 2]  # the wait took the two seconds
    assert scanning.said[-1] == "no more slices: 2 s have gone, and most_s is 2"


def test_a_pause_ends_the_choosing_and_decides_nothing(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    scanning.take(5)
    scanning.wants_pause = True
    assert scanning.take() == []
    assert choices_in(scanning.folder.path) == ()
    assert not scanning.folder.is_whole()


def test_a_resume_takes_what_was_decided_and_goes_on_choosing(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    scanning.take(3)
    write_choice(scanning.folder.path, Chosen(6, "it bends", "reconstruction", 0.2, 5))
    scanning.writer.close()
    again = Scanning(tmp_path / "a.scan")
    assert again.folder.missing() == (6, 12, 16)
    assert again.take(4) == [6, 12, 16, 2]


def test_a_slice_damaged_after_the_end_is_taken_again_and_nothing_else(tmp_path: Path) -> None:
    scanning = Scanning(tmp_path / "a.scan")
    scanning.answers = asking(6, None)
    scanning.take()
    scanning.writer.finish(State.COMPLETE)
    scanning.folder.file(6).write_bytes(b"rubbish")
    again = Scanning(tmp_path / "a.scan")
    assert again.take() == [6]
    assert again.said == []
    assert again.folder.is_whole()


def test_half_a_line_decides_nothing_and_does_not_spoil_the_next(tmp_path: Path) -> None:
    write_choice(tmp_path, Chosen(6, "it bends", "reconstruction"))
    with (tmp_path / CHOICES).open("a") as file:
        file.write('{"index": 7, "wh')
    write_choice(tmp_path, Chosen(None, "enough", "reconstruction"))
    assert [each.index for each in choices_in(tmp_path)] == [6, None]
    assert is_ended(tmp_path)


def test_a_request_reads_back() -> None:
    asked = SliceRequest((0, 4, 8), 6, "it bends", 0.25)
    assert decode_request(encode_request(asked, "a.scan")) == asked


@given(st.binary(max_size=40) | st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3), max_leaves=5,
).map(lambda value: json.dumps({
    "format": "loftscan.next", "version": 1, "unit": "mm", "seen": value, "index": value,
    "why": value, "expected_mm": value,
}).encode()))  # fmt: skip
def test_no_request_crashes_the_reader(data: bytes) -> None:
    with suppress(ValueError):  # anything else fails
        decode_request(data)


def test_a_plan_reads_back_and_says_what_contradicts_itself() -> None:
    text = write_plan(PLAN)
    assert parse_plan(text) == PLAN
    with pytest.raises(ValueError, match=r"coarse_step_mm: 0\.5 is less than ring"):
        parse_plan(text.replace("coarse_step_mm = 4.0", "coarse_step_mm = 0.5"))
    with pytest.raises(ValueError, match=r"adaptive\.most_slices: 4 do not even make the 5"):
        parse_plan(text.replace("most_slices = 9", "most_slices = 4"))
    with pytest.raises(ValueError, match=r"tolerance_mm: 0\.0 is out of bounds"):
        parse_plan(text.replace("tolerance_mm = 0.1", "tolerance_mm = 0.0"))
