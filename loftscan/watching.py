"""A scan that is followed, as it is shown: a line for a person, JSON lines for a program.

``slice 12 of 100  1.9/s  97 % seen  0:00:45 left`` on a terminal, nothing into a pipe.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from loftscan.progress import Lines
from loftscan.updates import Fitted, Missed, Standing, Update

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

_SLICES = "sections"  # the stage that updates tell more of


class Watch(Protocol):
    """Told of every step of a stage and of every slice."""

    def step(self, stage: str, done: int, total: int) -> None:
        """Take note of a step."""
        ...

    def passing(self, updates: Iterator[Update]) -> Iterator[Update]:
        """Pass updates on, and tell of them."""
        ...


@contextmanager
def watching(*, json_lines: bool) -> Iterator[Watch]:
    """Show a followed scan in the way that fits who is looking."""
    if json_lines:
        yield _Told(Lines(sys.stdout))
        return
    if not sys.stderr.isatty():
        yield _Nobody()
        return
    with _rich() as shown:
        yield _Shown(shown)


def described(update: Update) -> dict[str, object] | None:
    """The JSON object of an update; None for the last, which `loftscan reconstruct` tells whole."""
    if not isinstance(update, (Fitted, Missed)):
        return None
    standing = update.standing
    where = {
        "done": standing.done,
        "total": standing.total,
        "coverage": round(standing.coverage, 4),
        "lag_s": None if standing.lag_s is None else round(standing.lag_s, 4),
    }
    if isinstance(update, Missed):
        named = {"event": "no_section", "index": update.index, "points": update.points}
        return {**named, "why": update.why, **where}
    section = update.section
    rms = section.residual.rms_mm
    return {
        "event": "section",
        "index": section.index,
        "points": section.points,
        "residual_rms_mm": rms if math.isfinite(rms) else None,
        **where,
    }


class _Nobody:
    def step(self, stage: str, done: int, total: int) -> None:
        """Tell nobody."""

    def passing(self, updates: Iterator[Update]) -> Iterator[Update]:
        return updates


class _Told:
    def __init__(self, lines: Lines) -> None:
        self._lines = lines

    def step(self, stage: str, done: int, total: int) -> None:
        if stage != _SLICES:
            self._lines(stage, done, total)

    def passing(self, updates: Iterator[Update]) -> Iterator[Update]:
        for update in updates:
            told = described(update)
            if told is not None:
                self._lines.say(**told)
            yield update


class _Shown:
    def __init__(self, shown: RichProgress) -> None:
        self._shown = shown
        self._slices = shown.add_task("waiting", total=None, seen="")
        self._stages: dict[str, TaskID] = {}

    def step(self, stage: str, done: int, total: int) -> None:
        if stage == _SLICES:
            return
        if stage not in self._stages:
            self._stages[stage] = self._shown.add_task(stage, seen="")
        self._shown.update(self._stages[stage], completed=done, total=total or None)

    def passing(self, updates: Iterator[Update]) -> Iterator[Update]:
        for update in updates:
            if isinstance(update, (Fitted, Missed)):
                self._show(update.standing)
            yield update

    def _show(self, standing: Standing) -> None:
        self._shown.update(
            self._slices,
            description="slice",
            completed=standing.done,
            total=standing.total,
            seen=f"{standing.coverage:.0%} seen",
        )


def _rich() -> RichProgress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        SpinnerColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.1f}/s" if task.speed else "")

    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:<12}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        Rate(),
        TextColumn("{task.fields[seen]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=Console(stderr=True),
        transient=True,
    )
