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

from drivers.axis import Pause
from drivers.errors import Refused
from drivers.grbl.conversation import Conversation, machine_coordinate
from drivers.grbl.messages import State
from drivers.grbl.settings import Homing, Settings
from drivers.grbl.wire import jog

_SOFT_LIMITS, _HARD_LIMITS, _HOMING, _HOMING_DIRECTION, _PULL_OFF, _LOCATE = 20, 21, 22, 23, 27, 24
_TRAVEL: Final = 130
_FORCED_ORIGIN: Final = 1 << 3  # of grblHAL's $22: home is 0, and travel goes one way from it
_PRINTED: Final = 0.0005  # half of a report's last digit
_AT_HOME: Final = 0.1  # of its unit: far above a step, far below a pull-off
_STILL: Final = 2  # idle reports after which it has come to its end
_PAST: Final = 2.0  # how many pull-offs it looks beyond
_LEAVINGS: Final = 10  # pull-offs, within which an axis leaves a switch that it stands on
_SLOWLY_S: Final = 2.0  # beyond what a pull-off takes


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


def check_travel(
    talk: Conversation, index: int, settings: Settings, position: float, zero: float
) -> None:
    """Refuse what the controller's own soft limits would answer with ALARM:2."""
    window = travel_of(talk, index)
    if window is None or settings.homing is not Homing.SWITCH:
        return
    machine = settings.to_wire(position) + zero
    if not window[0] - _PRINTED <= machine <= window[1] + _PRINTED:
        raise Refused(
            f"{settings.name}: {machine:.3f} {settings.unit} of the controller is outside its own"
            f" travel {window[0]:g} to {window[1]:g}; raise ${_TRAVEL + index}, or set $20=0"
        )


def check_home(talk: Conversation, index: int, name: str, machine: float) -> None:
    """Refuse a homing after which the controller does not count from the switch.

    Its line has no checksum, and `$H` with one bit bent is `$X`, which is answered ok as well. A
    controller that homed stands a pull-off from an end of its travel, or calls that place 0.
    """
    if _PULL_OFF not in talk.dialogue.settings or _TRAVEL + index not in talk.dialogue.settings:
        return
    pull_off, travel = talk.setting(_PULL_OFF), abs(talk.setting(_TRAVEL + index))
    if min(abs(abs(machine) - each) for each in (0.0, pull_off, travel - pull_off)) > _AT_HOME:
        raise Refused(
            f"{name}: homing was answered ok, yet the controller stands at {machine:.3f}, where no"
            f" homing ends (pull-off {pull_off:g}, travel {travel:g}); check the cable, home again"
        )


def leave_switch(talk: Conversation, index: int, settings: Settings, pause: Pause) -> None:
    """Go off a home switch that is closed before homing begins, a pull-off at a time.

    An axis that stood still on its cam, as after a reset, can be deeper in than homing pulls off,
    which would end it with ALARM:8. With limits on the controller would take a closed switch for
    an alarm: then it is left to `$H`.

    Raises
    ------
    Refused
        It stays closed.
    """
    letter = settings.letter
    if letter not in talk.status(pause).pins:
        return
    if any(_flag(talk, code) for code in (_HARD_LIMITS, _SOFT_LIMITS)):
        return
    pull_off, feed_per_min = talk.rate(_PULL_OFF), talk.rate(_LOCATE)
    downward = int(talk.setting(_HOMING_DIRECTION)) >> index & 1
    for _ in range(_LEAVINGS):
        status = talk.status(pause)
        if letter not in status.pins:
            return
        if status.state is State.ALARM:
            talk.exchange("$X", pause)
        here = machine_coordinate(talk, status, letter)
        place = here + pull_off if downward else here - pull_off
        talk.exchange(jog(letter, place, feed_per_min), pause)
        _wait_until_idle(talk, pull_off / feed_per_min * 60.0 + _SLOWLY_S, settings, pause)
    raise Refused(
        f"{settings.name}: the home switch stays closed over {_LEAVINGS * pull_off:g}"
        f" {settings.unit}; check its wiring, and $5 and $23 of the controller"
    )


def _wait_until_idle(talk: Conversation, within_s: float, settings: Settings, pause: Pause) -> None:
    upsets, still = talk.dialogue.upsets, 0
    deadline_s = talk.clock() + within_s
    while still < _STILL:
        if talk.clock() >= deadline_s:
            raise Refused(f"{settings.name}: did not leave its home switch; check the axis")
        talk.until(lambda: False, settings.poll_s, pause)
        status = talk.status(pause)
        if talk.dialogue.upsets != upsets:
            raise talk.upset("leaving the switch")
        still = still + 1 if status.state is State.IDLE else 0


def _flag(talk: Conversation, code: int) -> bool:
    return code in talk.dialogue.settings and bool(int(talk.setting(code)) & 1)


@dataclass(frozen=True, slots=True)
class Sighting:
    """Between which two places the switch closed, in machine coordinates."""

    start: float
    clear: float  # the last place where it was open
    pressed_at: float
    pressed: bool

    def seen(self, place: float, pressed: bool) -> Sighting:  # noqa: FBT001
        """One report more."""
        return (
            replace(self, pressed_at=place, pressed=True) if pressed else replace(self, clear=place)
        )


@dataclass(frozen=True, slots=True)
class PinSearch:
    """How the switch is looked for, in the wire's unit."""

    talk: Conversation
    index: int
    settings: Settings
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
        way = -1.0 if downward else 1.0
        return cls(talk, index, settings, way, talk.setting(_PULL_OFF), feed)

    def creep(self, start: float, pause: Pause) -> Sighting:
        """Jog slowly from the place of home; between which two reports the switch closed."""
        place, pressed = self._look(pause)
        sighting = Sighting(start, place, place, pressed)
        end = start + self.way * _PAST * self.pull_off
        self.talk.exchange(jog(self.settings.letter, end, self.feed_per_min), pause)
        upsets, still = self.talk.dialogue.upsets, 0
        while not sighting.pressed and still < _STILL:
            self.talk.until(lambda: False, self.settings.poll_s, pause)
            sighting = sighting.seen(*self._look(pause))
            if self.talk.dialogue.upsets != upsets:
                raise self.talk.upset("the search for the switch")
            status = self.talk.dialogue.status
            still = still + 1 if status is not None and status.state is State.IDLE else 0
        return sighting

    def _look(self, pause: Pause) -> tuple[float, bool]:
        status = self.talk.status(pause)
        letter = self.settings.letter
        return machine_coordinate(self.talk, status, letter), letter in status.pins

    def off(self, found: Sighting) -> float:
        """How far the switch is from its place, the nearest that was seen; infinite if nowhere."""
        if not found.pressed:
            return math.inf
        expected = found.start + self.way * self.pull_off
        if found.clear == found.pressed_at:  # pressed where it had to be open
            return found.pressed_at - expected
        low, high = sorted((found.clear, found.pressed_at))
        return min(max(expected, low), high) - expected

    def refusal(self, off: float) -> Refused:
        """Why the axis is not where it says."""
        far = f"{abs(off):.3f}" if math.isfinite(off) else f"more than {self.pull_off:g}"
        tolerated = self.settings.to_wire(self.settings.tolerance)
        return Refused(
            f"{self.settings.name}: the home switch is {far} {self.settings.unit} from its place,"
            f" tolerated {tolerated:.3f}; steps were lost, or ${100 + self.index} is wrong; remove"
            " the cause, then home"
        )
