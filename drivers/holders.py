"""Who has a device file open, as far as /proc lets us see.

Linux only; elsewhere, and for processes of other users, the answer is shorter, never wrong.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_LONGEST_COMMAND = 120  # characters that a message shows


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has the file open."""

    pid: int
    command: str

    def __str__(self) -> str:
        return f"process {self.pid} ({self.command})"


def holders_of(device: str, *, processes: Path = Path("/proc")) -> tuple[Holder, ...]:
    """Every process in which a descriptor leads to `device`, by rising pid."""
    target = os.path.realpath(device)
    pids = sorted(int(entry.name) for entry in processes.glob("[0-9]*"))
    return tuple(
        Holder(pid, _command(processes / str(pid)))
        for pid in pids
        if target in _open_files(processes / str(pid))
    )


def holder_of(pid_text: str, *, processes: Path = Path("/proc")) -> Holder | None:
    """The process of a number that a lock file names; None when it is dead, or dead but unburied.

    A number that is none belongs to nobody.
    """
    if not (pid_text.isascii() and pid_text.isdecimal()):
        return None
    process = processes / pid_text
    try:
        state = (process / "stat").read_bytes().rpartition(b")")[2].split()[0]
    except (OSError, IndexError):
        return None
    return None if state in (b"Z", b"X") else Holder(int(pid_text), _command(process))


def _open_files(process: Path) -> Iterator[str]:
    try:
        for descriptor in (process / "fd").iterdir():
            yield str(descriptor.readlink())
    except OSError:
        return  # it ended meanwhile, or belongs to someone else


def _command(process: Path) -> str:
    try:
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return "name unknown"
    # A script that was given as an argument has lines of its own, and a message has one.
    said = " ".join(b" ".join(words).decode(errors="replace").split()) or "name unknown"
    return said if len(said) <= _LONGEST_COMMAND else f"{said[: _LONGEST_COMMAND - 3]}..."
