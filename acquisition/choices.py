"""choices.jsonl in a .scan folder: why each slice of an adaptive scan was taken, line by line.

A line is on the disk before its slice is begun, so that a slice that was decided and not taken is
known to a resume. Half a line at the end is what a program that died left: it decided nothing.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path

from acquisition.durable import storage, sync_folder

CHOICES = "choices.jsonl"


class ChosenBy(Enum):
    """Who wanted a slice."""

    RECONSTRUCTION = "reconstruction"
    WIDEST = "the widest span"  # nobody answered


@dataclass(frozen=True, slots=True)
class Chosen:
    """One slice beyond the coarse ones, or the end of them."""

    index: int | None  # None: no more
    why: str
    by: str  # of `ChosenBy`, or what ended it
    expected_mm: float | None = None
    slices: int = 0  # that were there


def write_choice(folder: Path, chosen: Chosen) -> None:
    """Append a line, for good.

    Raises
    ------
    StorageFailed
    """
    file = folder / CHOICES
    line = (json.dumps(asdict(chosen), ensure_ascii=False) + "\n").encode()
    with storage(folder, f"writing {CHOICES}"):
        new = not file.exists()
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            size = os.lseek(descriptor, 0, os.SEEK_END)
            torn = size and os.pread(descriptor, 1, size - 1) != b"\n"
            data = memoryview(b"\n" + line if torn else line)
            while data:
                data = data[os.write(descriptor, data) :]
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if new:
            sync_folder(folder)


def choices_in(folder: Path) -> tuple[Chosen, ...]:
    """The lines of a folder, those that are whole; none without a file."""
    try:
        text = (folder / CHOICES).read_bytes()
    except FileNotFoundError:
        return ()
    return tuple(_whole(text))


def is_ended(folder: Path) -> bool:
    """Whether the last choice was that there are slices enough."""
    return bool(found := choices_in(folder)) and found[-1].index is None


def _whole(text: bytes) -> Iterator[Chosen]:
    for line in text.split(b"\n"):
        try:
            found = Chosen(**json.loads(line))
        except (ValueError, TypeError):
            continue
        if found.index is None or (type(found.index) is int and found.index >= 0):
            yield found
