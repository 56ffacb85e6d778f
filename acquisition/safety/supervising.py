"""The state machine at a real station: it is told what happens, and decides what may.

::

    station.toml's switch --> PermittedLaser --on--> only where the state permits it
                                  '--off--> always; whether it was confirmed is told
    what was raised       --> `event_of`  --> tell(event); the way out does the rest
    e-stop, interlock, key --> `look`, in every wait --> tell(event), InputTripped

Nothing here waits, and nothing here sends but the laser's wrapper: stopping is the business of the
way out that every error takes (`acquisition.opening`), in its order, whatever fails on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Protocol

from acquisition.errors import AcquisitionError, InputTripped, NotNow, Stopped, StorageFailed
from acquisition.safety.states import Action, Event, Rules, Situation, State
from acquisition.safety.stepping import Actions, step
from drivers.axis import Identity
from drivers.errors import DriverError, FrameError, LinkLost, NoReply, Refused
from drivers.inputs import Inputs, SafetyInputs
from drivers.laser import Guarantee, LaserSwitch

_LOOK_EVERY_S = 0.04  # so that what the chain did is mirrored within 50 ms
_REMEDY: Mapping[State, str] = MappingProxyType(
    {
        State.ESTOP: "release and reset it, then acknowledge; nothing goes on by itself",
        State.FAULT_LASER: "press the emergency stop, find out why, then acknowledge",
        State.FAULT_STORAGE: "make room, then acknowledge and resume",
        State.SAFE: "home it first",
        State.SHUTDOWN: "open the station again",
    }
)
_ENDINGS = (Stopped, KeyboardInterrupt, SystemExit, GeneratorExit)


class Supervisor:
    """The situation of one open station, from its first byte to its last."""

    def __init__(self, clock: Callable[[], float], rules: Rules) -> None:
        self.rules = rules
        self.announce: Callable[[str], None] = lambda _: None  # who tells people
        self.lost_role = ""  # whose link was the last to be lost, as `_LOST` names them
        self._clock = clock
        self._now = Situation()
        self._told: BaseException | None = None
        self._inputs: SafetyInputs | None = None
        self._looked_s: float | None = None

    @property
    def situation(self) -> Situation:
        """Where the station stands, and what is known beside."""
        return self._now

    @property
    def state(self) -> State:
        """Where the station stands."""
        return self._now.state

    def tell(self, event: Event, *, since_s: float | None = None) -> Actions:
        """Tell what has happened, now or since a time; what is to be done about it."""
        time_s = self._clock() if since_s is None else since_s
        self._now, actions = step(self._now, event, time_s, self.rules)
        if Action.ANNOUNCE in actions and self.rules.warning_s > 0.0:
            self.announce(f"laser: it may be lit in {self.rules.warning_s:g} s")
        return actions

    def attend(self, *, attended: bool) -> None:
        """Say whether somebody stays at the station: then a scan pauses when that one leaves."""
        self.rules = replace(self.rules, attended=attended)

    def ask(self, event: Event) -> None:
        """Ask for something.

        Raises
        ------
        NotNow
            The state does not allow it; says which, and what to do.
        """
        if Action.REFUSE in self.tell(event):
            remedy = _REMEDY.get(self.state, "remove the cause, then acknowledge")
            wish = event.name.lower().replace("_", " ")
            raise NotNow(f"station: {self.state.value}: no {wish} now; {remedy}")

    def fail(self, error: BaseException) -> None:
        """Tell what was raised; once, however many blocks it passes on its way."""
        if error is not self._told:
            self._told = error
            self.tell(self._event_of(error))

    def watch(self, inputs: SafetyInputs) -> None:
        """Read these from now on."""
        self._inputs = inputs

    def look(self) -> None:
        """Read the safety chain, if it was not read a moment ago.

        Raises
        ------
        InputTripped
            The emergency stop is pressed, the interlock open or the key off.
        DriverError
            It cannot be read.
        """
        now_s = self._clock()
        recent = self._looked_s is not None and now_s - self._looked_s < _LOOK_EVERY_S
        if not recent:
            self.look_now()

    def look_now(self) -> None:
        """Read it; see `look`."""
        if self._inputs is None:
            return
        self._looked_s = self._clock()
        event = self._mirror(self._inputs.read())
        if event is not None:
            raise InputTripped(_SAID[event], event.name)

    def _mirror(self, found: Inputs) -> Event | None:
        """Tell what changed; what is not well now."""
        now = self._now
        for is_now, was, came, went in (
            (found.estop_pressed, now.estop_pressed, Event.ESTOP_PRESSED, Event.ESTOP_RELEASED),
            (
                found.interlock_open,
                now.interlock_open,
                Event.INTERLOCK_OPENED,
                Event.INTERLOCK_CLOSED,
            ),
            (not found.key_on, not now.key_on, Event.KEY_OFF, Event.KEY_ON),
        ):
            if is_now != was:
                self.tell(came if is_now else went)
        if found.estop_pressed:
            return Event.ESTOP_PRESSED
        if found.interlock_open:
            return Event.INTERLOCK_OPENED
        return None if found.key_on else Event.KEY_OFF

    def _event_of(self, error: BaseException) -> Event:
        """What an error means; what is of no kind that is known is an internal one."""
        match error:
            case InputTripped():
                return Event[error.event]
            case NotNow() | ValueError():
                return Event.TICK  # nothing was begun
            case LinkLost():
                return _LOST.get(self.lost_role, Event.WIRE_UNSOUND)
            case NoReply() | FrameError():
                return _FAILED_IN.get(self.state, Event.WIRE_UNSOUND)
            case Refused():
                return _REFUSED_IN.get(self.state, Event.POSITION_LOST)
            case StorageFailed():
                return Event.STORAGE_FAILED
            case _ if isinstance(error, _ENDINGS):
                return Event.STOP
            case AcquisitionError():
                return Event.INTERNAL_ERROR
            case _:
                return Event.INTERNAL_ERROR


_LOST: Mapping[str, Event] = MappingProxyType(
    {
        "laser": Event.LASER_LINK_LOST,
        "axis": Event.AXIS_LINK_LOST,
        "sensor": Event.SENSOR_LINK_LOST,
    }
)
# By hand a person stands there, and each move is stopped, read back and refused by its driver: that
# one answer did not come, or one target lies outside, is no reason to latch.
_FAILED_IN: Mapping[State, Event] = MappingProxyType(
    {State.MOVING: Event.STOP, State.ARMED: Event.STOP}
)
_REFUSED_IN: Mapping[State, Event] = MappingProxyType(
    {
        **_FAILED_IN,
        State.IDENTIFYING: Event.IDENTITY_WRONG,
        State.HOMING: Event.HOMING_FAILED,
        State.SAFE: Event.TICK,
        State.READY: Event.TICK,
    }
)
_SAID: Mapping[Event, str] = MappingProxyType(
    {
        Event.ESTOP_PRESSED: "emergency stop: it is pressed, so the laser is off and the axes are"
        " stopped; release it, then home and resume",
        Event.INTERLOCK_OPENED: "interlock: it is open, so the laser is off and the axes are"
        " stopped; close it, then home and resume",
        Event.KEY_OFF: "key: it is off, so the laser stays dark; turn it on, then resume",
    }
)


class Reopened(Protocol):
    """The link of a switch: `acquisition.safety.resting.Line`."""

    @property
    def is_lost(self) -> bool:
        """Whether nothing arrives over it any more."""
        ...

    def say_again(self, say: Callable[[], object]) -> None:
        """Open it again and say something over it."""
        ...


class PermittedLaser:
    """A `LaserSwitch` that lights only where the state permits it.

    Parameters
    ----------
    line
        Of the switch, opened again where off is not heard; None where nothing could be.
    """

    def __init__(
        self, switch: LaserSwitch, supervisor: Supervisor, line: Reopened | None = None
    ) -> None:
        self.switch = switch
        self._supervisor = supervisor
        self._line = line

    def identify(self) -> Identity:
        """Ask the switch who it is."""
        return self.switch.identify()

    def guarantee(self) -> Guarantee:
        """See `LaserSwitch.guarantee`."""
        return self.switch.guarantee()

    def on(self) -> None:
        """Switch on and read back.

        Raises
        ------
        NotNow
            The station is neither armed nor scanning; nothing was sent.
        Refused
            The output did not follow.
        """
        supervisor = self._supervisor
        supervisor.tell(Event.TICK)  # an arming that was forgotten is over
        if not supervisor.situation.laser_permitted:
            remedy = _REMEDY.get(supervisor.state, "arm it first")
            raise NotNow(f"laser: the station is {supervisor.state.value}; {remedy}")
        self.switch.on()

    def off(self) -> None:
        """Switch off and read back, in every state; tell whether it was confirmed.

        Over a lost link it is said again when that is open again.

        Raises
        ------
        LinkLost
            The link was lost just now; off was confirmed over a new one.
        DriverError
            Not confirmed: press the emergency stop.
        """
        known = self._is_lost
        try:
            self._off()
        except DriverError as failed:
            if self._line is None or not self._line.is_lost:
                raise
            self._off_over_a_new_link(self._line)
            if not known:
                raise LinkLost(f"{failed}; off was confirmed over a new link") from failed

    def off_where_heard(self) -> None:
        """Switch off as `off` does, but wait for no link: `off_where_unheard` is for that."""
        try:
            self._off()
        except DriverError:
            if not self._is_lost:
                raise

    def off_where_unheard(self) -> None:
        """Switch off where the link is lost; elsewhere that was done."""
        if self._is_lost:
            self.off()

    @property
    def _is_lost(self) -> bool:
        return self._line is not None and self._line.is_lost

    def _off(self) -> None:
        try:
            self.switch.off()
        except DriverError:
            if not self._is_lost:  # a lost link may be opened again
                self._supervisor.tell(Event.OFF_UNCONFIRMED)
            raise
        self._supervisor.tell(Event.OFF_CONFIRMED)

    def _off_over_a_new_link(self, line: Reopened) -> None:
        self._supervisor.tell(Event.LASER_LINK_LOST)
        try:
            line.say_again(self.switch.off)
        except DriverError as failed:
            self._supervisor.tell(Event.OFF_UNCONFIRMED)
            raise Refused(
                f"laser: its link was lost and off not confirmed over a new one ({failed}):"
                " press the emergency stop"
            ) from failed
        self._supervisor.tell(Event.OFF_CONFIRMED)
        self._supervisor.announce("laser: its link was lost; off was confirmed over a new one")

    def is_on(self) -> bool:
        """Read the output back."""
        return self.switch.is_on()
