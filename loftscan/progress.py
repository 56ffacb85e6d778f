"""What is happening, told while it happens: a bar for a person, lines for a program."""

from __future__ import annotations

import json
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol, TextIO

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID


class Progress(Protocol):
    """Told of every step: the stage, how many are done, of how many (0: not known)."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Take note of a step."""


def silent(stage: str, done: int, total: int) -> None:
    """Tell nobody."""


class Lines:
    """One JSON object a line, for programs (`--json`)."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._begun = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Write the step as a line."""
        seconds = round(time.monotonic() - self._begun, 3)
        self.say(event="progress", stage=stage, done=done, total=total, seconds=seconds)

    def say(self, **fields: object) -> None:
        """Write one object as a line."""
        print(json.dumps(fields), file=self._stream, flush=True)


@contextmanager
def bars(*, json_lines: bool) -> Iterator[Progress]:
    """Show progress in the way that fits who is looking.

    A bar with rate and time left on a terminal, JSON lines when asked, nothing into a pipe.
    """
    if json_lines:
        yield Lines(sys.stdout)
        return
    if not sys.stderr.isatty():
        yield silent
        return
    with _rich() as shown:
        yield _Bars(shown)


def _rich() -> RichProgress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description:<12}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
    )


class _Bars:
    def __init__(self, shown: RichProgress) -> None:
        self._shown = shown
        self._tasks: dict[str, TaskID] = {}
        self._begun: dict[str, float] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        if stage not in self._tasks:
            self._tasks[stage] = self._shown.add_task(stage, rate="")
            self._begun[stage] = time.monotonic()
        seconds = max(time.monotonic() - self._begun[stage], 1e-3)
        rate = f"{_short(done / seconds)}/s" if done else ""
        self._shown.update(self._tasks[stage], completed=done, total=total or None, rate=rate)


def _short(rate: float) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if rate >= size:
            return f"{rate / size:.1f} {letter}"
    return f"{rate:.1f}"
