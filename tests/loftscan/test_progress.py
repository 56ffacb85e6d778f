"""Progress: a bar for a person, lines for a program, nothing into a pipe."""

from __future__ import annotations

import io
import json
import re
import sys

import pytest

from loftscan.progress import Lines, bars, silent


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_lines_are_one_json_object_a_step_with_rising_seconds() -> None:
    stream = io.StringIO()
    tell = Lines(stream)
    tell("slicing", 0, 0)
    tell("sections", 3, 91)
    first, second = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert first | {"seconds": 0} == {
        "event": "progress", "stage": "slicing", "done": 0, "total": 0, "seconds": 0
    }  # fmt: skip
    assert (second["stage"], second["done"], second["total"]) == ("sections", 3, 91)
    assert 0.0 <= first["seconds"] <= second["seconds"]


def test_each_line_leaves_at_once() -> None:
    flushed: list[str] = []

    class Pipe(io.StringIO):
        def flush(self) -> None:
            flushed.append(self.getvalue())

    Lines(Pipe())("slicing", 1, 2)
    assert flushed
    assert flushed[-1].endswith("}\n")


def test_a_program_gets_lines_on_stdout_and_nothing_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with bars(json_lines=True) as tell:
        tell("saving", 1, 1)
    said = capsys.readouterr()
    assert json.loads(said.out)["stage"] == "saving"
    assert said.err == ""


def test_a_pipe_gets_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with bars(json_lines=False) as tell:
        assert tell is silent
        tell("sections", 1, 2)
    assert capsys.readouterr() == ("", "")


def drawn(monkeypatch: pytest.MonkeyPatch, **environment: str) -> str:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    for name, value in (environment | {"COLUMNS": "120", "TERM": "xterm-256color"}).items():
        monkeypatch.setenv(name, value)
    with bars(json_lines=False) as tell:
        tell("slicing", 0, 0)
        for done in range(1, 9):
            tell("sections", done, 8)
    return terminal.getvalue()


def test_a_person_sees_stage_count_rate_and_time(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    seen = drawn(monkeypatch)
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", seen)
    assert "slicing" in plain
    last = [line for line in plain.splitlines() if "sections" in line][-1]
    assert "8/8" in last
    assert re.search(r"\d(\.\d)? ?[kM]?/s", last)
    assert re.search(r"0:00:0\d", last)
    assert "\x1b[3" in seen  # colours
    assert capsys.readouterr().out == ""


def test_no_color_is_respected(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = drawn(monkeypatch, NO_COLOR="1")
    assert "8/8" in seen
    assert not re.search(r"\x1b\[[0-9;]*3[0-9][;m]", seen)
