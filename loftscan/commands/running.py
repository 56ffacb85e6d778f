"""A command's work, and what becomes of its errors: one line and an exit code.

0 done; 1 the work failed; 2 bad usage or bad input; 3 stopped by the operator; 4 a device refused
or was lost. A traceback needs ``--debug``.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from typing import NoReturn

import typer


def run(work: Callable[[], None], *, debug: bool) -> None:
    """Run a command's work and turn what is known to go wrong into a line and an exit code."""
    try:
        work()
    except SystemError as broken:
        if debug or not _was_interrupted(broken):
            raise
        fail(3, _say(KeyboardInterrupt()))
    # Evaluated only when something went wrong: no command waits for what it does not use.
    except _known_errors() as error:
        if debug:
            raise
        fail(_exit_code(error), _say(error))


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether it is what compiled code, entered just then, made of a Ctrl-C; in several steps."""
    while isinstance(error, SystemError):
        error = error.__cause__
    return isinstance(error, KeyboardInterrupt)


def fail(code: int, message: str) -> NoReturn:
    """End the program with one line and an exit code."""
    typer.echo(f"loftscan: {' '.join(message.split())}", err=True)
    raise typer.Exit(code)


def _known_errors() -> tuple[type[BaseException], ...]:
    from acquisition.errors import AcquisitionError
    from drivers.errors import DriverError
    from reconstruction.errors import ReconstructionError

    ours = (AcquisitionError, DriverError, ReconstructionError)
    return (*ours, KeyboardInterrupt, MemoryError, OSError, ValueError)


def _exit_code(error: BaseException) -> int:
    from acquisition.errors import (
        DamagedSlice,
        GuardLost,
        InputTripped,
        LeaseLapsed,
        NotAScan,
        NotAsKept,
        NotNow,
        Stopped,
        ZeroLost,
    )
    from drivers.errors import DriverError
    from reconstruction.errors import ReconstructionError, TooFewPoints, UnreadableCloud

    # In this order: some are an OSError or a ValueError as well.
    codes: tuple[tuple[int, tuple[type[BaseException], ...]], ...] = (
        (3, (KeyboardInterrupt, Stopped)),
        (4, (DriverError, GuardLost, InputTripped, LeaseLapsed, NotAsKept, NotNow, ZeroLost)),
        (2, (UnreadableCloud, TooFewPoints, NotAScan, DamagedSlice)),
        (1, (ReconstructionError, OSError, MemoryError)),
        (2, (ValueError,)),
    )
    return next((code for code, kinds in codes if isinstance(error, kinds)), 1)


def _say(error: BaseException) -> str:
    # What failed twice for one reason is told once.
    return "; ".join(dict.fromkeys((_message(error), *getattr(error, "__notes__", ()))))


def _message(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt):
        return "stopped by the operator; nothing was written"
    if isinstance(error, BrokenPipeError):
        return "nobody reads its output any more, so it ended; slices that were kept are safe"
    if isinstance(error, MemoryError):
        remedy = "use a larger --resolution-mm or --spacing-mm, less --intermediate, or --crop"
        return f"out of memory ({error}); {remedy}"
    if isinstance(error, OSError) and error.errno is not None and not _is_ours(error):
        return _explain(error)
    return str(error.strerror) if isinstance(error, OSError) and error.strerror else str(error)


def _is_ours(error: OSError) -> bool:
    """Whether the message is one of ours already, and says what to do."""
    from acquisition.errors import AcquisitionError
    from drivers.errors import DriverError

    return isinstance(error, (AcquisitionError, DriverError))


_UNWRITABLE = {
    *(errno.EACCES, errno.EPERM, errno.EROFS),
    *(errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP),
}


def _explain(error: OSError) -> str:
    where = f"{error.filename}: " if error.filename else ""
    if error.errno in {errno.ENOSPC, errno.EDQUOT}:
        return (
            f"{where}the disk is full; free some space and run again, nothing half-written is left"
        )
    if error.errno in _UNWRITABLE:
        return f"{where}{error.strerror}; name a folder that may be written as --out"
    return f"{where}{error.strerror or error}"
