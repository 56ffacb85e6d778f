"""One program appends to a folder at a time: flock on a file inside it. POSIX only.

The kernel drops the lock when its holder dies, however it dies. The file stays; the number in it is
for messages and proves nothing.
"""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

from acquisition.errors import ScanInUse

LOCK = ".lock"
_LOOKERS_S = 0.005  # a look at the lock is over long before
_TRIES = 5


class FolderLock:
    """A held lock, until `release`."""

    def __init__(self, folder: Path) -> None:
        """Take the lock.

        Raises
        ------
        ScanInUse
            Another program holds it; names its process.
        OSError
            The folder cannot be written.
        """
        self._descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(self._descriptor)
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, b"%d\n" % os.getpid(), 0)
        except BlockingIOError as held:
            holder = os.pread(self._descriptor, 20, 0).decode("ascii", "replace").strip()
            self.release()
            raise ScanInUse(
                f"{folder}: process {holder or 'unknown'} is appending to it;"
                " wait for its end, or stop it first"
            ) from held
        except OSError:
            self.release()
            raise

    @property
    def held(self) -> bool:
        """Whether the lock is ours still."""
        return self._descriptor >= 0

    def release(self) -> None:
        """Let go; may be called again."""
        if self.held:
            os.close(self._descriptor)
            self._descriptor = -1


def is_locked(folder: Path) -> bool:
    """Whether a program appends to a .scan folder; a look of some microseconds.

    Raises
    ------
    OSError
        The lock's file cannot be read.
    """
    try:
        descriptor = os.open(folder / LOCK, os.O_RDONLY)
    except FileNotFoundError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False


def _lock(descriptor: int) -> None:
    """Take the lock; somebody who only looks whether it is held holds it for microseconds."""
    for _ in range(_TRIES - 1):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOOKERS_S)
        else:
            return
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
