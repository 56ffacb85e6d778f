"""The names of simulated ports, which are gone when their station is, however it came to its end.

A killed simulator could not take them away itself, and the pseudo-terminal that a name is left
leading to may be another station's a moment later: a program that opens its lost port again would
then speak to a stranger's device.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_SWEEP = """
import contextlib, os, sys
sys.stdin.read()
with contextlib.suppress(FileNotFoundError):
    for entry in list(os.scandir(sys.argv[1])):
        if entry.is_symlink():
            os.unlink(entry.path)
"""


@contextmanager
def vanishing(folder: Path) -> Iterator[None]:
    """Have a process of its own wait for the end of this one, and unlink the names in a folder."""
    words = [sys.executable, "-I", "-S", "-c", _SWEEP, str(folder)]
    # In a session of its own: what ends this process by its group must not end that one.
    sweeper = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        yield
    finally:
        with sweeper:  # closes its pipe and waits
            pass
