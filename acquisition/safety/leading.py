"""Leading a station from state to state: what is asked of it, in the order that the states want."""

from __future__ import annotations

from typing import TYPE_CHECKING

from acquisition.errors import NotNow
from acquisition.safety.states import Event, State
from drivers.axis import Pause

if TYPE_CHECKING:
    from acquisition.opening import OpenStation

_CLOCKS_S = 0.001  # sums of short waits fall short of the whole


def make_known(station: OpenStation) -> None:
    """Ask every device who it is, unless that was done.

    Raises
    ------
    NotNow
        They are known, and the emergency stop is pressed.
    DriverError
        One of them is somebody else, or silent.
    """
    if station.safety.state is State.IDENTIFYING:
        for device in (station.laser, station.profiler, station.table, station.stage):
            device.identify()
        known(station)


def known(station: OpenStation) -> None:
    """Tell that every device has said who it is; the safety chain is read before anything moves."""
    if station.safety.state is State.IDENTIFYING:
        station.safety.tell(Event.IDENTIFIED)
    station.safety.look()


def homed(station: OpenStation) -> None:
    """Tell what the axes say of themselves, after they looked for their references."""
    both = station.table.state().homed and station.stage.state().homed
    station.safety.tell(Event.HOMED if both else Event.HOMED_IN_PART)


def begin_homing(station: OpenStation) -> None:
    """Ask for it; out of an arming or a pause, too."""
    leave(station)
    station.safety.ask(Event.HOME)


def leave(station: OpenStation) -> None:
    """Out of what permits the laser, or of a scan that was left."""
    safety = station.safety
    if safety.state is State.ARMED:
        safety.ask(Event.DISARM)
    elif safety.state in (State.PAUSED, State.SCANNING):
        safety.tell(Event.STOP)  # everything is dark and stands: slices end so
        safety.tell(Event.STANDS)


def arm(station: OpenStation, pause: Pause) -> None:
    """Announce the laser, wait, and confirm; nothing to do where it is armed.

    Raises
    ------
    NotNow
        The state, the key or the chain does not allow it.
    """
    safety = station.safety
    safety.tell(Event.TICK)
    if safety.state is State.ARMED:
        return
    safety.ask(Event.ARM)
    if safety.rules.warning_s > 0.0:
        pause(safety.rules.warning_s + _CLOCKS_S)
    safety.ask(Event.CONFIRM)


def resume(station: OpenStation, pause: Pause) -> None:
    """Go on with a scan that was paused; announced anew where that was long ago.

    Raises
    ------
    NotNow
        The key, the chain or a lost position does not allow it.
    """
    safety = station.safety
    safety.ask(Event.RESUME)
    if safety.state is State.ARMING:
        if safety.rules.warning_s > 0.0:
            pause(safety.rules.warning_s + _CLOCKS_S)
        safety.ask(Event.CONFIRM)
        safety.ask(Event.START)


def acknowledge(station: OpenStation) -> None:
    """Out of a latched state, because a person says that its cause is gone, and devices agree.

    Links that were lost are opened again; nothing moves by it.

    Raises
    ------
    InputTripped, DriverError
        They do not.
    NotNow
        It is no such state.
    """
    safety = station.safety
    station.laser.off()
    station.reopen_lost()
    safety.look_now()
    for axis in (station.table, station.stage):
        axis.state()
    if safety.state is State.PAUSED_LINK:
        safety.ask(Event.CONNECT)
    else:
        safety.tell(Event.CAUSE_GONE)
        safety.ask(Event.ACKNOWLEDGE)
    if safety.state is State.BOOT:
        safety.tell(Event.SELF_TESTED)
    if safety.state is State.DISCONNECTED:
        safety.ask(Event.CONNECT)
    station.laser.off()
    make_known(station)
    if safety.situation.state not in (State.SAFE, State.READY):
        raise NotNow(f"station: {safety.state.value}, still; its cause is not gone")
