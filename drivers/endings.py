"""Leaving in order: what must be done on the way out, without hiding why one leaves.

An ending that fails after another error becomes a note of that error: the first cause is what the
operator reads first. Endings are done in the reverse order of entering, each of them whatever
became of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused

_STOP_TRIES = 3
_OFF_TRIES = 3


@contextmanager
def unless_done(ending: Callable[[], None]) -> Iterator[None]:
    """Do `ending` if the block is left by anything but its end."""
    try:
        yield
    except BaseException as cause:
        try:
            ending()
        except DriverError as failed:
            for each in (str(failed), *getattr(failed, "__notes__", ())):
                cause.add_note(each)
        raise


@contextmanager
def at_last(ending: Callable[[], None]) -> Iterator[None]:
    """Do `ending` on every way out."""
    with unless_done(ending):
        yield
    ending()


def insist(stop: Callable[[], object], name: str) -> None:
    """Say a stop until it is acknowledged, three times at most; `name` is the axis's.

    Raises
    ------
    NoReply, FrameError
        It was never acknowledged: press the emergency stop.
    """
    for tries_left in reversed(range(_STOP_TRIES)):
        try:
            stop()
        except (NoReply, FrameError) as lost:
            if not tries_left:
                lost.add_note(f"{name}: the stop was not acknowledged: emergency stop!")
                raise
        else:
            return


def insist_dark(put_out: Callable[[], bool], name: str) -> None:
    """Put a laser out, three tries, whatever goes wrong in the ones before; a lost link takes none.

    Parameters
    ----------
    put_out
        Says off, and returns whether what was read back is dark.
    name
        The switch's.

    Raises
    ------
    LinkLost
        Nothing was heard; whoever opened the link may open it again.
    Refused
        Not confirmed: press the emergency stop.
    """
    reason: DriverError | None = None
    for _ in range(_OFF_TRIES):
        try:
            if put_out():
                return
        except LinkLost as lost:
            raise LinkLost(f"{name}: off was not heard: {lost}") from lost
        except DriverError as failed:
            reason = failed
    raise Refused(
        f"{name}: off was not confirmed in {_OFF_TRIES} tries"
        f"{'' if reason is None else f' ({reason})'}: press the emergency stop"
    ) from reason


def stop_or_refuse(stop: Callable[[], object], name: str) -> None:
    """Stop an axis whose move was given up; `Refused` where even that fails."""
    try:
        stop()
    except DriverError as failed:
        raise Refused(f"{name}: the stop failed: {failed}") from failed
