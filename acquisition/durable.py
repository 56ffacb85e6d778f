"""Files that are whole or not there, even after a power cut: write, fsync, rename, fsync folder.

Where one follows the other (`name_ahead`, `write_named`) the folder is synced first, once for many.
A file under work has a name of its own (`temporary`), so that whoever lists the folder never takes
half a file for a whole one.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from acquisition.errors import AcquisitionError, StorageFailed

_SUFFIX = ".part"
_REMEDIES = {
    errno.ENOSPC: "the disk is full; free some space",
    errno.EDQUOT: "your disk quota is used up; free some space",
    errno.EFBIG: "the limit on file sizes (ulimit -f) is reached; raise it",
    errno.EROFS: "the disk is read-only; mount it writable or choose another folder",
    errno.EACCES: "no permission to write there; change it or choose another folder",
    errno.EPERM: "no permission to write there; change it or choose another folder",
    errno.EIO: "the disk reports an error; copy the folder to another disk",
}


def write_whole(path: Path, data: bytes) -> None:
    """Put `data` at `path` so that it is there, whole, for good when this returns.

    Raises
    ------
    OSError
        It is not certain to be there; nothing half is.
    """
    part = path.with_name(f".{path.name}{_SUFFIX}")
    try:
        _write(part, data)
        part.replace(path)
    except OSError:
        with suppress(OSError):  # the first failure is the one to tell
            part.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def name_ahead(folder: Path, numbers: range) -> tuple[Path, ...]:
    """Make empty files under work whose names last, for `write_named`; raises OSError.

    The numbers must be new to the folder: a name that a rename has just left is, until the folder
    is synced, still that of the file which was renamed, and a new file would take it away.
    """
    parts = tuple(folder / f".ahead-{number}{_SUFFIX}" for number in numbers)
    try:
        for part in parts:
            os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666))
        sync_folder(folder)
    except OSError:
        with suppress(OSError):  # the first failure is the one to tell
            for part in parts:
                part.unlink(missing_ok=True)
        raise
    return parts


def write_named(part: Path, path: Path, data: bytes) -> None:
    """Put `data` into a file of `name_ahead`, for good, and call it `path`.

    One sync instead of two: after a power cut the bytes are there, whole, under one of the names.

    Raises
    ------
    OSError
        It is not certain to be there; nothing half is at `path`.
    """
    try:
        _write(part, data)
        part.replace(path)
    except OSError:
        with suppress(OSError):  # the first failure is the one to tell
            part.unlink(missing_ok=True)
        raise


def rename_whole(part: Path, path: Path) -> None:
    """Give a file that somebody else wrote its name for good; raises as `write_whole`."""
    descriptor = os.open(part, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    part.replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in a folder last."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def temporary(folder: Path) -> Iterator[Path]:
    """Files under work in a folder: of a writer that lives, or left by one that died."""
    return folder.glob(f".*{_SUFFIX}")


@contextmanager
def storage(folder: Path, doing: str) -> Iterator[None]:
    """Turn an OSError inside into a StorageFailed that names the folder and the remedy."""
    try:
        yield
    except AcquisitionError:
        raise  # says what to do already
    except OSError as failed:
        number = failed.errno or errno.EIO
        remedy = _REMEDIES.get(number, "check the disk")
        message = f"{folder}: {doing} failed ({os.strerror(number)}): {remedy}"
        raise StorageFailed(number, f"{message}; what was kept is safe") from failed


def _write(path: Path, data: bytes) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(descriptor, rest) :]
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
