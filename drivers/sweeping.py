"""Turning an axis steadily and being told on the way where it is: for axes that can.

::

    sweep_to       o===========================================o   one move, sent once
    seen            ^    ^    ^    ^    ^    ^    ^    ^    ^      each answer about the position,
                                                                   with the time it was asked at

The time is that of the question, not of the answer: a device says where it is when it is asked, and
what comes after, the wire and a program that looks up now and then, scatters more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from drivers.axis import AxisState, Pause


class Onlooker(Protocol):
    """Who is told of a sweep while it goes on."""

    def seen(self, asked_s: float, position: float) -> None:
        """Where the axis was when it was asked at that time, in its own unit."""
        ...

    def failing(self) -> None:
        """The sweep is given up: called before the axis is stopped, which takes its time."""
        ...


@dataclass(frozen=True, slots=True)
class Course:
    """How an axis is swept, and who looks on."""

    speed: float  # in the axis's unit a second, no more than that of its moves
    onlooker: Onlooker


@runtime_checkable
class Sweeper(Protocol):
    """An axis that can be swept."""

    def sweep_to(self, position: float, course: Course, pause: Pause) -> AxisState:
        """Move as `Axis.move_to`, straight to it at a steady speed, telling the onlooker.

        Nothing takes up backlash at the end: whoever goes on from there comes from below again.

        Raises
        ------
        Refused
            As `Axis.move_to`; or the speed is not one that it can be told.
        """
        ...
