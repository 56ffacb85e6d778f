"""Files that are whole or not there.

A result that a CAD program opens half-written is worse than none: the bytes go to a temporary name
in the same folder, reach the disk, and only then take the final name (`os.replace` is atomic
within one file system).
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: Path | str) -> Iterator[BinaryIO]:
    """Open a binary file that takes the name `path` only when the block ends well.

    Whatever ends the block early (a full disk, Ctrl-C) leaves neither a half-written file nor the
    temporary one; a former file of that name stays as it was.

    Parameters
    ----------
    path
        Final name. Its folder must exist.

    Raises
    ------
    OSError
        From the file system, for example ENOSPC.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.part{path.suffix}")
    try:
        with temporary.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    _remember_name(path.parent)


def _remember_name(folder: Path) -> None:
    """Bring the renaming itself to the disk; only POSIX lets one open a folder for that."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
