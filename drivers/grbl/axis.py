"""A rotary table or a linear axis on Grbl 1.1 or grblHAL.

Stock Grbl knows no rotary axis: a table is wired to X, Y or Z with its steps per "mm" set to steps
per degree. Grbl's mm are then degrees, its mm a minute degrees a minute, and nothing wraps: the
unwrapped angle of `drivers.axis` is simply what the controller counts. Degrees stand here only
where a line is made or a report is read::

    position (rad or mm)  --to_wire-->  + zero  -->  machine coordinates (G53), never work ones

Grbl has no checksum and is open loop, so no motion is believed: it is over when two reports agree
that the controller is idle (or one does, at the target), and the position read back is compared.
One report is not enough by itself, since `ok` comes before the planner has started to move.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from typing import Final

from drivers.axis import AxisState, Identity, Kind, Motion, Pause
from drivers.endings import unless_done
from drivers.errors import NoReply, Refused
from drivers.grbl.conversation import (
    BANNER_S,
    QUIET_S,
    Conversation,
    axis_index,
    homing_line,
    homing_s,
    identity_of,
    machine_coordinate,
    motion_of,
)
from drivers.grbl.messages import Error, State, Status, error_name, error_remedy
from drivers.grbl.reference import PinSearch, check_home, check_travel, leave_switch
from drivers.grbl.settings import Homing, Settings
from drivers.grbl.stopping import Rest, come_to_rest, reset_held
from drivers.grbl.wire import FENCE, Realtime, feed_move, jog
from drivers.links import ByteLink
from drivers.recipes import Order, Recipe, Word
from drivers.sweeping import Course

_GENTLY_S: Final = 0.1
RESET_S: Final = 0.2  # until the banner of a board that is up
_PLANNER_S: Final = 0.1  # idle for so long somewhere else, a move is over and not yet to begin
_UNHOMED_JOG: Final = 1.0  # degree or mm, from where the axis stands
_ROUNDING: Final = 1e-9  # of a speed: degrees to radians and back


class _Doing(Enum):
    """What was last asked of the controller."""

    NOTHING = "nothing"
    JOG = "jog"
    FEED = "feed"
    HOMING = "homing"


_ENDING: Final = {
    _Doing.NOTHING: Realtime.JOG_CANCEL,  # harmless when nothing moves, and never elided
    _Doing.JOG: Realtime.JOG_CANCEL,
    _Doing.FEED: Realtime.HOLD,
    _Doing.HOMING: Realtime.RESET,  # the homing loop hears nothing else
}


class GrblAxis:
    """One axis of a Grbl controller; keeps `drivers.axis.Axis`.

    The first question opens the dialogue with a soft reset, which ends any motion; nothing moves
    by it. `jog_to` is for people at the bench: it works unhomed within one degree or millimetre.
    """

    def __init__(self, link: ByteLink, settings: Settings, *, clock: Callable[[], float]) -> None:
        self._settings = settings
        self._talk = Conversation(link, settings.name, clock)
        self._identity: Identity | None = None
        self._doing = _Doing.NOTHING
        self._zero = 0.0  # machine coordinate of position 0, in the wire's unit
        self._homed_at: int | None = None  # the dialogue's count of upsets when homed
        self._taken_up = False  # the last motion went up by the backlash or more

    # --- what an axis does -------------------------------------------------------------------

    @property
    def kind(self) -> Kind:
        """Rotary or linear."""
        return self._settings.kind

    def identify(self) -> Identity:
        """Reset the controller, ask who it is and compare its settings.

        Raises
        ------
        NoReply, FrameError, LinkLost
        Refused
            Its steps a unit are not the expected ones, or it reports inches; `code` is the setting.
        """
        return self._identity or self._open(None)

    def inspect(self) -> Identity:
        """As `identify`, without the reset; see `drivers.inspection`."""
        identity = self._talk.introduced()
        self._check_settings()
        return identity

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        return self._talk.counters()

    def state(self) -> AxisState:
        """Ask for a report.

        The position is NaN after an alarm that silences the controller until it is reset.
        """
        if self._talk.dialogue.locked:
            return AxisState(Motion.ALARM, math.nan, homed=False, alarm=self._talk.alarm_text())
        return self._axis_state(self._talk.status(None))

    def home(self, pause: Pause) -> AxisState:
        """Find the switch, or name the place where the axis stands its zero."""
        self._taken_up = False
        self._homed_at = None
        self._ready(pause)
        self._unlock(pause)
        if self._settings.homing is Homing.SWITCH:
            self._find_switch(pause)
        status = self._idle(pause)
        if self._settings.homing is Homing.SWITCH:
            check_home(self._talk, self._index(), self._name, self._machine(status))
        self._zero = self._machine(status) - self._settings.to_wire(self._settings.home_position)
        self._homed_at = self._talk.dialogue.upsets
        return self._axis_state(status)

    def move_to(self, position: float, pause: Pause) -> AxisState:
        """Move in a straight feed (G1) in machine coordinates."""
        self._settings.check_limits(position)
        if not self._homed:
            raise Refused(f"{self._name}: not homed; home it first")
        check_travel(self._talk, self._index(), self._settings, position, self._zero)
        return self._travel(self._settings.to_wire(position), _Doing.FEED, pause)

    def sweep_to(self, position: float, course: Course, pause: Pause) -> AxisState:
        """Move in one straight feed of its own speed; see `drivers.sweeping`."""
        self._settings.check_limits(position)
        if not self._homed:
            raise Refused(f"{self._name}: not homed; home it first")
        check_travel(self._talk, self._index(), self._settings, position, self._zero)
        self._ready(pause)
        here = self._position(self._idle(pause))
        target = self._settings.to_wire(position)
        return self._axis_state(self._leg(here, target, _Doing.FEED, pause, course))

    def jog_to(self, position: float, pause: Pause) -> AxisState:
        """Move by a jog: cancelled by one byte, refused beyond the controller's own travel."""
        self._settings.check_limits(position)
        return self._travel(self._settings.to_wire(position), _Doing.JOG, pause)

    def check_reference(self, pause: Pause, *, turns: int = 0) -> float:
        """Look where the home switch is now; how far from where it must be, in the axis's unit.

        The controller counts the steps that it sends. That they were made, and that a unit has as
        many of them as everybody says, only the switch knows: it is approached from the place of
        home, or `turns` whole turns of a table away from it.

        Raises
        ------
        Refused
            Off by more than the axis tolerates: "homed" is lost. Or it cannot be looked for:
            software zero, or limits switched on in the controller.
        """
        self._settings.check_turns(turns)
        place = self._settings.home_position + turns * math.tau
        self.move_to(place, pause)
        search = PinSearch.of(self._talk, self._index(), self._settings)
        start = self._settings.to_wire(place) + self._zero
        with self._stopped_unless_done(_Doing.JOG):
            off = search.off(search.creep(start, pause))
        self.stop()
        if abs(off) > self._tolerance():
            self._homed_at = None
            raise search.refusal(off)
        self.move_to(place, pause)
        return self._settings.from_wire(off)

    def stop(self) -> None:
        """Stop, gently if the controller can, else by a reset that loses the position.

        Waits behind nothing: the bytes go past any line, and a line that Grbl has not read yet
        is stopped when it starts.

        Raises
        ------
        NoReply
            The stop was not confirmed: press the emergency stop.
        LinkLost
        """
        doing, self._doing = self._doing, _Doing.NOTHING
        self._taken_up = False
        if doing is not _Doing.HOMING and self._rested(
            come_to_rest(self._talk, _ENDING[doing], 2 * self._braking_s() + 1.0)
        ):
            if doing is _Doing.JOG:
                self._talk.dialogue.give_up()  # asks whether lines are heard before the next
            return
        self._homed_at = None
        if not self._talk.reset(None, within_s=BANNER_S):
            raise NoReply(
                f"{self._name}: the stop was not confirmed in {BANNER_S} s; press the"
                " emergency stop"
            )

    def recipes(self) -> tuple[Recipe, ...]:
        """Hold or cancel, then reset; see `drivers.recipes`.

        The reset comes after a tenth of a second, standing or not: homing hears nothing else, and
        the position is a dead program's, which nobody will believe again.
        """
        gentle = Word(Realtime.HOLD.wire + Realtime.JOG_CANCEL.wire, b"", 0.0)
        reset = Word(Realtime.RESET.wire, rb"Grbl\w* \S+ \[", RESET_S)
        stands = Word(Realtime.STATUS.wire, rb"<(?:Idle|Hold:0|Alarm|Door:[01]|Sleep)[|>]", 0.03)
        name = self._name
        return (
            Recipe(name, Order.AXIS, (gentle,), (stands,), rest_s=_GENTLY_S),
            Recipe(f"{name}, reset", Order.AXIS, (reset,), (stands,)),
        )

    # --- moving ------------------------------------------------------------------------------

    def _travel(self, target: float, doing: _Doing, pause: Pause) -> AxisState:
        self._ready(pause)
        status = self._idle(pause)
        here = self._position(status)
        if not self._homed and abs(target - here) > _UNHOMED_JOG:
            raise Refused(
                f"{self._name}: not homed; it jogs at most {_UNHOMED_JOG:g} {self._settings.unit}"
            )
        for leg in self._legs(here, target):
            status = self._leg(here, leg, doing, pause)
            here = self._position(status)
        self._taken_up = self._settings.backlash > 0
        return self._axis_state(status)

    def _legs(self, here: float, target: float) -> list[float]:
        # From below: the play of the gear is always taken up in one direction.
        slack = self._settings.to_wire(self._settings.backlash)
        if slack == 0 or (self._taken_up and target >= here):
            return [target]
        before = target - slack
        if self._homed:
            self._settings.check_limits(self._settings.from_wire(before))
        return [before, target]

    def _leg(
        self, here: float, target: float, doing: _Doing, pause: Pause, course: Course | None = None
    ) -> Status:
        """Send one move, once, and see it end where it should."""
        spell = jog if doing is _Doing.JOG else feed_move
        line = spell(self._settings.letter, target + self._zero, self._feed_per_min(course))
        lost: NoReply | None = None
        self._taken_up = False
        before_stop = course.onlooker.failing if course else _nothing
        with self._stopped_unless_done(doing), unless_done(before_stop):
            try:
                self._talk.exchange(line, pause)
            except NoReply as unanswered:
                lost = unanswered  # it may have been heard: the position decides, not a second try
            status = self._until_standing(target, abs(target - here), pause, course)
            self._compare(target, self._position(status), lost)
        return status

    @contextmanager
    def _stopped_unless_done(self, doing: _Doing) -> Iterator[None]:
        """Stop on every way out but the good one, whatever is raised; that stays the cause."""
        self._doing = doing
        try:
            with unless_done(self._stop_what_began):
                yield
        finally:
            self._doing = _Doing.NOTHING

    def _stop_what_began(self) -> None:
        # A line that was refused moves nothing.
        if not isinstance(self._talk.dialogue.answer, Error):
            self.stop()

    def _until_standing(
        self, target: float, distance: float, pause: Pause, course: Course | None
    ) -> Status:
        within_s = 2 * self._duration_s(distance, course) + 2.0
        deadline_s = self._talk.clock() + within_s
        upsets = self._talk.dialogue.upsets
        far = distance > self._tolerance()
        idle: tuple[float, float] | None = None  # where, and since when
        while self._talk.clock() < deadline_s:
            status = self._talk.status(pause)
            self._check_moving(status, upsets)
            here, now_s = self._position(status), self._talk.clock()
            if course is not None:
                course.onlooker.seen(self._talk.asked_s, self._settings.from_wire(here))
            if status.state is State.IDLE:
                if far and abs(here - target) <= self._tolerance():
                    return status
                if idle is None or idle[0] != here:
                    idle = (here, now_s)
                elif now_s - idle[1] >= _PLANNER_S:
                    return status
            self._talk.until(
                lambda: self._talk.dialogue.upsets != upsets, self._settings.poll_s, pause
            )
        raise NoReply(f"{self._name}: still moving after {within_s:.1f} s; check feed and load")

    def _check_moving(self, status: Status, upsets: int) -> None:
        if self._talk.dialogue.upsets != upsets:
            raise self._talk.upset("the move")
        if status.state not in (State.IDLE, State.RUN, State.JOG):
            raise Refused(
                f"{self._name}: {status.state.value} during a move; check the hold and door inputs"
            )

    def _compare(self, target: float, here: float, lost: NoReply | None) -> None:
        if abs(here - target) <= self._tolerance():
            return
        unit = self._settings.unit
        if lost is not None:
            raise NoReply(
                f"{self._name}: a move was not answered and was not repeated; the axis stands at"
                f" {here:.3f} {unit}, not at {target:.3f}; check the cable"
            ) from lost
        self._homed_at = None
        raise Refused(
            f"{self._name}: stands at {here:.3f} {unit}, {abs(here - target):.3f} from"
            f" {target:.3f}, tolerated {self._tolerance():.3f}; check the line, then home"
        )

    # --- homing ------------------------------------------------------------------------------

    def _unlock(self, pause: Pause) -> None:
        """Clear an alarm; homing by a switch does that itself, unless only a reset is heard."""
        if self._talk.dialogue.locked and not self._talk.reset(pause, within_s=BANNER_S):
            raise NoReply(f"{self._name}: no banner after a reset; switch its supply off and on")
        status = self._talk.status(pause)
        self._talk.dialogue.clear_alarm()
        if status.state is State.ALARM and self._settings.homing is Homing.SOFTWARE_ZERO:
            self._talk.exchange("$X", pause)

    def _find_switch(self, pause: Pause) -> None:
        if not int(self._talk.setting(22)) & 1:  # grblHAL: a mask, bit 0 enables
            raise Refused(f"{self._name}: {error_name(5)}; {error_remedy(5)}", code=5)
        with self._stopped_unless_done(_Doing.JOG):
            leave_switch(self._talk, self._index(), self._settings, pause)
        with self._stopped_unless_done(_Doing.HOMING):
            line = homing_line(self._talk, self._settings.letter)
            self._talk.exchange(line, pause, within_s=homing_s(self._talk))

    # --- stopping ----------------------------------------------------------------------------

    def _rested(self, rest: Rest) -> bool:
        """Whether it stands; forgets "homed" where the place was not kept."""
        if not rest.kept:
            self._homed_at = None
        return rest.done

    # --- asking ------------------------------------------------------------------------------

    def _ready(self, pause: Pause) -> None:
        """Open the dialogue, or mend it after a lost answer."""
        if self._talk.dialogue.outstanding:  # the caller left an exchange by raising
            self._talk.dialogue.give_up()
        if self._identity is None:
            self._open(pause)
        if self._talk.dialogue.fenced:
            return
        lost: NoReply | None = None
        if not self._talk.dialogue.mute:
            try:
                self._talk.exchange(FENCE, pause)
            except NoReply as unanswered:  # a torn line swallowed it, or it is suspended
                lost = unanswered
            else:
                return
        status = self._talk.status(pause)
        if motion_of(status) is Motion.MOVING or not self._rested(reset_held(self._talk, status)):
            raise NoReply(
                f"{self._name}: does not answer lines any more; stop it, then home"
            ) from lost

    def _open(self, pause: Pause | None) -> Identity:
        self._homed_at = None
        self._identity = self._talk.insist(lambda: self._introduced(pause))
        return self._identity

    def _introduced(self, pause: Pause | None) -> Identity:
        """Handshake that needs no banner: an open port may have swallowed it."""
        self._talk.drain()
        self._talk.reset(pause, within_s=BANNER_S)
        self._talk.until(lambda: False, QUIET_S, pause)  # startup lines, a second banner
        self._talk.dialogue.reset_asked = False
        self._talk.status(pause)
        self._talk.dialogue.settings.clear()
        self._talk.exchange("$I", pause)
        self._talk.exchange("$$", pause)
        identity = identity_of(self._talk)
        self._check_settings()
        return identity

    def _check_settings(self) -> None:
        if self._talk.setting(13):
            raise Refused(f"{self._name}: reports inches; set $13=0 on the controller", code=13)
        code = 100 + self._index()
        self._settings.check_steps(self._talk.rate(code), code=code)

    def _idle(self, pause: Pause) -> Status:
        status = self._talk.status(pause)
        if status.state in (State.ALARM, State.SLEEP):
            raise self._talk.upset("idle")
        if status.state is not State.IDLE:
            raise Refused(f"{self._name}: is in state {status.state.value}; stop it first")
        return status

    # --- what a report means -----------------------------------------------------------------

    def _axis_state(self, status: Status) -> AxisState:
        position = self._settings.from_wire(self._position(status))
        motion = motion_of(status)
        alarm = self._talk.alarm_text() if motion is Motion.ALARM else ""
        return AxisState(motion, position, self._homed, alarm)

    def _position(self, status: Status) -> float:
        """From the zero, in the wire's unit."""
        return self._machine(status) - self._zero

    def _machine(self, status: Status) -> float:
        return machine_coordinate(self._talk, status, self._settings.letter)

    def _index(self) -> int:
        return axis_index(self._talk, self._settings.letter)

    # --- quantities --------------------------------------------------------------------------

    @property
    def _name(self) -> str:
        return self._settings.name

    @property
    def _homed(self) -> bool:
        return self._homed_at == self._talk.dialogue.upsets

    def _tolerance(self) -> float:
        return self._settings.to_wire(self._settings.tolerance)

    def _feed_per_min(self, course: Course | None = None) -> float:
        fastest = min(
            60 * self._settings.to_wire(self._settings.speed),
            self._talk.rate(110 + self._index()),
        )
        if course is None:
            return fastest
        feed = 60 * self._settings.to_wire(course.speed)
        if feed > fastest * (1.0 + _ROUNDING):
            raise Refused(
                f"{self._name}: {feed / 60:g} {self._settings.unit}/s, and it moves at most"
                f" {fastest / 60:g}; turn more slowly, or raise $11{self._index()}"
            )
        return min(feed, fastest)

    def _duration_s(self, distance: float, course: Course | None = None) -> float:
        """A trapezoid's, or more than a triangle's."""
        return 60 * distance / self._feed_per_min(course) + self._braking_s()

    def _braking_s(self) -> float:
        if self._identity is None:
            return 1.0
        return self._feed_per_min() / 60 / self._talk.rate(120 + self._index())


def _nothing() -> None:
    """Nobody looks on."""
