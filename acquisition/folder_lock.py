"""One program appends to a folder at a time: flock on a file inside it. POSIX only.

The kernel drops the lock when its holder dies, however it dies. The file stays; the number in it is
for messages and proves nothing.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from acquisition.errors import ScanInUse

LOCK = ".lock"


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
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
