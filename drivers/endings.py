"""Leaving in order: what must be done on the way out, without hiding why one leaves.

An ending that fails after another error becomes a note of that error: the first cause is what the
operator reads first. Endings are done in the reverse order of entering, each of them whatever
became of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.errors import DriverError


@contextmanager
def unless_done(ending: Callable[[], None]) -> Iterator[None]:
    """Do `ending` if the block is left by anything but its end."""
    try:
        yield
    except BaseException as cause:
        try:
            ending()
        except DriverError as failed:
            cause.add_note(str(failed))
        raise


@contextmanager
def at_last(ending: Callable[[], None]) -> Iterator[None]:
    """Do `ending` on every way out."""
    with unless_done(ending):
        yield
    ending()
