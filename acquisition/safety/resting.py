"""The way to rest: off and stop at once where they are heard, then over links opened again.

::

    laser off, stage stops, table stops          what is heard at once waits for nobody
    laser's link again, off                      a lost link is opened again for this alone:
    a lost axis's link again, stop               nothing moves by it, and "homed" is forgotten

A link is tried again for two seconds from its loss on, and once more each time that somebody asks.
Where that was in vain the operator is told to press the emergency stop.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from acquisition.errors import GuardLost
from acquisition.safety.guarding import AttendedLink
from acquisition.safety.states import Event
from acquisition.safety.supervising import PermittedLaser, Supervisor
from drivers.endings import at_last
from drivers.errors import DriverError, LinkLost, Refused

REOPEN_S = 2.0  # a port that is plugged in again has its name back within one
_BETWEEN_TRIES_S = 0.05


class Line:
    """A link that can be opened again.

    Parameters
    ----------
    before, after
        What is due around each try: the guard lets go of the old link, and is given the new one.
    """

    def __init__(
        self,
        link: AttendedLink,
        *,
        before: Callable[[], object],
        after: Callable[[], object],
        clock: Callable[[], float],
        sleep: Callable[[float], object],
    ) -> None:
        self._link = link
        self._before = before
        self._after = after
        self._clock = clock
        self._sleep = sleep
        self._gives_up_s: float | None = None

    @property
    def is_lost(self) -> bool:
        """Whether nothing arrives over it any more."""
        return self._link.is_lost

    def say_again(self, say: Callable[[], object]) -> None:
        """Open the link again and say something over it; anew where it is lost at once.

        A gateway whose own cable is out takes a connection, and breaks it.

        Raises
        ------
        LinkLost
            Nothing there, for so long.
        DriverError
            What `say` raises over a link that holds.
        """
        if self._gives_up_s is None:
            self._gives_up_s = self._clock() + REOPEN_S
        while True:
            try:
                self._reopen()
                say()
            except DriverError as gone:
                if not self.is_lost:
                    raise
                if self._clock() >= self._gives_up_s:
                    raise LinkLost(f"not opened again in {REOPEN_S:g} s ({gone})") from gone
            else:
                self._gives_up_s = None
                return
            self._sleep(_BETWEEN_TRIES_S)

    def _reopen(self) -> None:
        with suppress(GuardLost):  # nothing is lit without it; this must go on
            self._before()
        self._link.reopen()
        with suppress(GuardLost):
            self._after()


class Stoppable(Protocol):
    """An axis, of which this module knows no more."""

    def stop(self) -> None:
        """Stop now."""
        ...


@dataclass(frozen=True, slots=True)
class _Mover:
    name: str
    axis: Stoppable
    line: Line | None

    @property
    def is_lost(self) -> bool:
        return self.line is not None and self.line.is_lost


class Rest:
    """What is to be brought to rest at a station, and how its links are opened again."""

    def __init__(self, laser: PermittedLaser, safety: Supervisor) -> None:
        self._laser = laser
        self._safety = safety
        self._movers: list[_Mover] = []

    def add(self, name: str, axis: Stoppable, line: Line | None) -> None:
        """Stop this axis, too; the last that was added is stopped first."""
        self._movers.append(_Mover(name, axis, line))

    def come(self) -> None:
        """Laser off and axes stopped; whatever fails, the rest is done.

        Raises
        ------
        DriverError
            Something was not confirmed, over a new link neither: press the emergency stop.
        """
        unheard: list[_Mover] = []
        with ExitStack() as endings:  # done in reverse
            endings.enter_context(at_last(lambda: self._stop_again(unheard)))
            endings.enter_context(at_last(self._laser.off_where_unheard))
            for mover in self._movers:
                endings.enter_context(at_last(_stopping(mover, unheard)))
            endings.enter_context(at_last(self._laser.off_where_heard))

    def _stop_again(self, unheard: list[_Mover]) -> None:
        with ExitStack() as endings:
            for mover in unheard:
                endings.enter_context(at_last(partial(self._reach, mover)))

    def _reach(self, mover: _Mover) -> None:
        self._safety.tell(Event.AXIS_LINK_LOST)
        try:
            if mover.line is None or not mover.is_lost:  # a neighbour on it was first
                mover.axis.stop()
            else:
                mover.line.say_again(mover.axis.stop)
        except DriverError as failed:
            kind = LinkLost if isinstance(failed, LinkLost) else Refused
            raise kind(
                f"{mover.name}: its link was lost and the stop not confirmed over a new one"
                f" ({failed}): press the emergency stop"
            ) from failed


def _stopping(mover: _Mover, unheard: list[_Mover]) -> Callable[[], None]:
    def stop() -> None:
        try:
            mover.axis.stop()
        except DriverError:
            if not mover.is_lost:
                raise
            unheard.append(mover)

    return stop
