"""Moving one axis: the Protocol that every table and stage keeps, and its values.

Positions are in the axis's own unit: radians for a table, millimetres for a stage. A driver
converts at the wire and nowhere else. A table's angle is unwrapped: ten turns are 20 pi.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol


class Kind(Enum):
    """What the axis does, and with it the unit of its positions."""

    ROTARY = "rad"
    LINEAR = "mm"


class Motion(Enum):
    """What the axis is doing."""

    STANDING = "standing"
    MOVING = "moving"
    HOMING = "homing"
    ALARM = "alarm"


@dataclass(frozen=True, slots=True)
class AxisState:
    """One answer of the device about itself."""

    motion: Motion
    position: float  # read back, in the axis's unit
    homed: bool
    alarm: str = ""  # the device's own code and its name, empty without one


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answered."""

    family: str  # such as "grbl"
    model: str
    firmware: str
    serial: str = ""


class Axis(Protocol):
    """One axis behind one link. Blocking, one caller at a time, every wait bounded.

    ``poll_until`` of the waiting methods: they call `pause(seconds)` for every wait, never longer
    than 50 ms at a time; the caller renews its lease and looks for a stop there, and may raise.
    """

    @property
    def kind(self) -> Kind:
        """Rotary or linear."""
        ...

    def identify(self) -> Identity:
        """Ask the device who it is."""
        ...

    def state(self) -> AxisState:
        """Ask the device what it is doing; idempotent, retried once after a quarantine.

        Raises
        ------
        NoReply, FrameError, LinkLost
        """
        ...

    def home(self, pause: Pause) -> AxisState:
        """Find the reference; returns when it is found.

        Raises
        ------
        Refused
            The device cannot home, or did not find its switch; says the alarm.
        """
        ...

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move to an absolute position and return what was read back, standing.

        Never sent twice: after a lost answer the position is read and compared.

        Raises
        ------
        Refused
            Not homed, outside the soft limits (checked before a byte is sent), an alarm, or the
            position read back is off by more than the axis tolerates.
        """
        ...

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move for a person at the bench: unhomed by one degree or millimetre at most.

        Raises
        ------
        Refused
            As `move_to`, or farther than that while not homed.
        """
        ...

    def stop(self) -> None:
        """Stop now, decelerating, position kept where the device can; allowed in every state."""
        ...


class Pause(Protocol):
    """How a driver waits: the caller decides what happens meanwhile."""

    def __call__(self, seconds: float, /) -> None:
        """Let at most `seconds` pass; may raise to abandon the wait (the driver then stops)."""
        ...
