"""The home switch as a witness: where it must be seen, and where it was.

Homing ends a pull-off before the switch. Creeping back to it, the switch closes between two
reports, and a report tells place and pins of one moment::

    place of home |---- pull-off ($27) ---->| switch
                  . . . . . . c             p             c last clear report, p first pressed one
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

from drivers.errors import Refused
from drivers.grbl.conversation import Conversation
from drivers.grbl.settings import Settings

_SOFT_LIMITS, _HARD_LIMITS, _HOMING, _HOMING_DIRECTION, _PULL_OFF, _LOCATE = 20, 21, 22, 23, 27, 24
_TRAVEL: Final = 130
_FORCED_ORIGIN: Final = 1 << 3  # of grblHAL's $22: home is 0, and travel goes one way from it
_PAST: Final = 2.0  # how many pull-offs it looks beyond


def travel_of(talk: Conversation, index: int) -> tuple[float, float] | None:
    """Lowest and highest machine coordinate that the controller's soft limits allow, if on."""
    if not _flag(talk, _SOFT_LIMITS) or _TRAVEL + index not in talk.dialogue.settings:
        return None
    travel = talk.setting(_TRAVEL + index)
    if travel <= 0.0:  # grblHAL: an axis without limits
        return None
    forced = int(talk.setting(_HOMING)) & _FORCED_ORIGIN
    downward = int(talk.setting(_HOMING_DIRECTION)) >> index & 1
    return (0.0, travel) if forced and downward else (-travel, 0.0)


def _flag(talk: Conversation, code: int) -> bool:
    return code in talk.dialogue.settings and bool(int(talk.setting(code)) & 1)


@dataclass(frozen=True, slots=True)
class Sighting:
    """Between which two places the switch closed, in machine coordinates."""

    start: float
    clear: float  # the last place where it was open
    pressed_at: float
    pressed: bool

    def seen(self, place: float, pressed: bool) -> Sighting:  # noqa: FBT001 (a pin is one)
        """One report more."""
        return (
            replace(self, pressed_at=place, pressed=True) if pressed else replace(self, clear=place)
        )


@dataclass(frozen=True, slots=True)
class PinSearch:
    """How the switch is looked for, in the wire's unit."""

    way: float  # 1 or -1
    pull_off: float
    feed_per_min: float

    @classmethod
    def of(cls, talk: Conversation, index: int, settings: Settings) -> PinSearch:
        """As the controller homes; slow enough that the tolerance is told.

        Raises
        ------
        Refused
            The controller's limits are on, and a switch that closes would be an alarm.
        """
        for code, what in ((_HARD_LIMITS, "hard"), (_SOFT_LIMITS, "soft")):
            if _flag(talk, code):
                raise Refused(
                    f"{settings.name}: its switch cannot be looked for with {what} limits on;"
                    f" set ${code}=0 for the check",
                    code=code,
                )
        downward = int(talk.setting(_HOMING_DIRECTION)) >> index & 1
        fine = settings.to_wire(settings.tolerance) / settings.poll_s * 60.0
        feed = min(talk.rate(_LOCATE), fine)
        return cls(-1.0 if downward else 1.0, talk.setting(_PULL_OFF), feed)

    def end(self, start: float) -> float:
        """Where it gives up."""
        return start + self.way * _PAST * self.pull_off

    def begin(self, start: float, place: float, pressed: bool) -> Sighting:  # noqa: FBT001
        """What is seen before it creeps."""
        return Sighting(start, place, place, pressed)

    def off(self, found: Sighting) -> float:
        """How far the switch is from its place, the nearest that was seen; infinite if nowhere."""
        if not found.pressed:
            return math.inf
        expected = found.start + self.way * self.pull_off
        low, high = sorted((found.clear, found.pressed_at))
        if found.clear == found.pressed_at:  # pressed where it had to be open
            return found.pressed_at - expected
        return min(max(expected, low), high) - expected

    def words(self, off: float) -> str:
        """The distance for a message."""
        return f"{abs(off):.3f}" if math.isfinite(off) else f"more than {self.pull_off:g}"
