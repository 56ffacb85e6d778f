"""`step`: what becomes of the station when something happens; a pure function, time an argument.

Three kinds of events, three rules. What is **asked** for and does not fit is refused, and nothing
changes. What is **reported** and does not fit means that somebody has lost track: an internal
fault. What goes **wrong** has a reaction in every state; latched states stay, but for worse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from acquisition.safety.states import (
    ASKED,
    AT_REST,
    FAULTS,
    LATCHED,
    UNCONNECTED,
    WRONG,
    Action,
    Event,
    Rules,
    Situation,
    State,
)

Actions = tuple[Action, ...]
Step = tuple[Situation, Actions]

_REFUSED: Actions = (Action.REFUSE,)
_DARK: Actions = (Action.FORBID_LASER, Action.LASER_OFF)
USUAL = Rules()


def step(now: Situation, event: Event, time_s: float, rules: Rules = USUAL) -> Step:
    """Give the next situation and what is to be done.

    Every pair of state and event has an outcome; none raises.
    """
    after = _remembered(now, event)
    if event in WRONG:
        following, actions = _wrong(after, event, time_s, rules)
    elif event is Event.STOP:
        following, actions = _stopped(after, time_s)
    elif event is Event.CLOSE:
        following, actions = _to(after, State.SHUTDOWN, time_s), AT_REST
    elif (rule := _TABLE.get((after.state, event))) is not None:
        following, actions = rule(after, time_s, rules)
    elif event in ASKED:
        following, actions = after, _REFUSED
    elif event in _EVERYWHERE or after.state in (State.SHUTDOWN, *LATCHED):
        following, actions = after, ()
    else:
        following, actions = _to(after, State.FAULT_INTERNAL, time_s), AT_REST
    return following, _permission(now, following, actions)


_EVERYWHERE = (Event.TICK, Event.OFF_CONFIRMED, Event.CAUSE_GONE)


def _permission(before: Situation, after: Situation, actions: Actions) -> Actions:
    """Permission is given and taken by the state alone, whatever rule led there."""
    if after.laser_permitted and not before.laser_permitted:
        return (*actions, Action.PERMIT_LASER)
    if before.laser_permitted and not after.laser_permitted:
        return (*_DARK, *(each for each in actions if each not in _DARK))
    return actions


def _remembered(now: Situation, event: Event) -> Situation:
    """What an event says whatever the state is."""
    match event:
        case Event.ESTOP_PRESSED:
            return replace(now, estop_pressed=True)
        case Event.ESTOP_RELEASED:
            return replace(now, estop_pressed=False)
        case Event.INTERLOCK_OPENED:
            return replace(now, interlock_open=True)
        case Event.INTERLOCK_CLOSED:
            return replace(now, interlock_open=False)
        case Event.KEY_OFF:
            return replace(now, key_on=False, rearm=True)
        case Event.KEY_ON:
            return replace(now, key_on=True)
        case Event.OFF_CONFIRMED:
            return replace(now, dark=True)
        case Event.OFF_UNCONFIRMED | Event.LASER_LINK_LOST:
            return replace(now, dark=False)
        case Event.CAUSE_GONE:
            return replace(now, cause_gone=True)
        case _:
            return now


def _to(now: Situation, state: State, time_s: float) -> Situation:
    """Enter a state; a latched one begins with its cause there."""
    fresh = replace(now, state=state, since_s=time_s, cause_gone=False)
    return replace(fresh, rearm=False) if state is State.ARMED else fresh


def _home(now: Situation, time_s: float) -> Situation:
    """Where a station at rest belongs."""
    if not now.identified:
        return _to(now, State.DISCONNECTED, time_s)
    return _to(now, State.READY if now.homed else State.SAFE, time_s)


# --- gone wrong -----------------------------------------------------------------------------------

_FAULT_OF: Mapping[Event, State] = MappingProxyType(
    {
        Event.OFF_UNCONFIRMED: State.FAULT_LASER,
        Event.POSITION_LOST: State.FAULT_POSITION,
        Event.LIMIT_SWITCH: State.FAULT_LIMIT,
        Event.WIRE_UNSOUND: State.FAULT_COMM,
        Event.IDENTITY_WRONG: State.FAULT_IDENTITY,
        Event.HOMING_FAILED: State.FAULT_HOMING,
        Event.WATCHDOG_BIT: State.FAULT_WATCHDOG,
        Event.STORAGE_FAILED: State.FAULT_STORAGE,
        Event.CONFIG_INVALID: State.FAULT_CONFIG,
        Event.INTERNAL_ERROR: State.FAULT_INTERNAL,
    }
)
_KEEP_POSITION = (Event.OFF_UNCONFIRMED, Event.STORAGE_FAILED, Event.CONFIG_INVALID)
_BACK = (Event.ESTOP_RELEASED, Event.INTERLOCK_CLOSED, Event.KEY_ON)


def _wrong(now: Situation, event: Event, time_s: float, rules: Rules) -> Step:
    if now.state is State.SHUTDOWN:
        return now, (*AT_REST, Action.ALARM) if event is Event.OFF_UNCONFIRMED else ()
    if event in _BACK:
        return now, ()
    if event in (Event.ESTOP_PRESSED, Event.INTERLOCK_OPENED):
        return _to(replace(now, homed=False), State.ESTOP, time_s), AT_REST
    if event is Event.KEY_OFF:
        return _key_off(now, time_s)
    if event in _FAULT_OF:
        return _fault(now, event, time_s)
    if event in (Event.LASER_LINK_LOST, Event.AXIS_LINK_LOST, Event.SENSOR_LINK_LOST):
        return _link_lost(now, event, time_s)
    return _passing(now, event, time_s, rules)


def _fault(now: Situation, event: Event, time_s: float) -> Step:
    fault = _FAULT_OF[event]
    after = now if event in _KEEP_POSITION else replace(now, homed=False)
    actions: Actions = AT_REST
    if event is Event.OFF_UNCONFIRMED:
        actions = (*AT_REST, Action.ALARM)
    elif event is Event.WIRE_UNSOUND:
        actions = (*AT_REST, Action.QUARANTINE)
    worse = event is Event.OFF_UNCONFIRMED and now.state in FAULTS
    if now.state in LATCHED and not worse:  # the first cause is the one that is told
        return after, actions
    return _to(after, fault, time_s), actions


def _key_off(now: Situation, time_s: float) -> Step:
    match now.state:
        case State.SCANNING:
            return _to(now, State.PAUSED, time_s), AT_REST
        case State.ARMING | State.ARMED:
            return _home(now, time_s), _DARK
        case _:
            return now, _DARK


def _link_lost(now: Situation, event: Event, time_s: float) -> Step:
    """Laser off first; a lost stage has lost its place, a lost laser is possibly on."""
    after = replace(now, homed=now.homed and event is not Event.AXIS_LINK_LOST)
    if now.state in UNCONNECTED or now.state in LATCHED:
        return after, AT_REST
    return _to(replace(after, identified=False), State.PAUSED_LINK, time_s), AT_REST


def _passing(now: Situation, event: Event, time_s: float, rules: Rules) -> Step:
    """What is refused or waited for, and is no fault."""
    if event is Event.PLAN_REFUSED:
        return (_home(now, time_s) if now.state is State.CHECK else now), _REFUSED
    if event is Event.CONTROL_LOST and not rules.attended:
        return now, ()
    if now.state is State.SCANNING:  # back-pressure, or who watched has left
        return _to(now, State.PAUSED, time_s), AT_REST
    if now.state in (State.ARMING, State.ARMED):
        return _home(now, time_s), _DARK
    return now, ()


# --- stopped --------------------------------------------------------------------------------------


def _stopped(now: Situation, time_s: float) -> Step:
    match now.state:
        case State.STOPPING | State.COMPLETING:  # asked again: it does not come to rest
            return _to(now, State.STOPPING, time_s), (*AT_REST, Action.ALARM)
        case State.ARMING | State.CHECK:
            return _home(now, time_s), AT_REST
        case State.PAUSED | State.HOMING | State.MOVING | State.ARMED | State.SCANNING:
            return _to(now, State.STOPPING, time_s), AT_REST
        case _:
            return now, AT_REST


# --- the ordinary life ----------------------------------------------------------------------------

Rule = Callable[[Situation, float, Rules], Step]


def _goes(state: State, *actions: Action) -> Rule:
    return lambda now, time_s, _: (_to(now, state, time_s), actions)


def _rests(now: Situation, time_s: float, _: Rules) -> Step:
    return _home(now, time_s), ()


def _stays(now: Situation, _time_s: float, _rules: Rules) -> Step:
    return now, ()


def _identified(now: Situation, time_s: float, _: Rules) -> Step:
    known = replace(now, identified=True)
    if not now.dark:
        return _to(known, State.FAULT_LASER, time_s), (*AT_REST, Action.ALARM)
    if now.estop_pressed or now.interlock_open:
        return _to(replace(known, homed=False), State.ESTOP, time_s), AT_REST
    return _home(known, time_s), ()


def _homed(now: Situation, time_s: float, _: Rules) -> Step:
    return _home(replace(now, homed=True), time_s), ()


def _unhomed(now: Situation, time_s: float, _: Rules) -> Step:
    return _home(replace(now, homed=False), time_s), ()


def _arming(now: Situation, time_s: float, _: Rules) -> Step:
    if not (now.inputs_well and now.dark):
        return now, _REFUSED
    return _to(now, State.ARMING, time_s), (Action.LASER_OFF, Action.ANNOUNCE)


def _confirmed(now: Situation, time_s: float, rules: Rules) -> Step:
    early = time_s - now.since_s < rules.warning_s
    if early or not (now.inputs_well and now.dark):
        return now, _REFUSED
    return _to(now, State.ARMED, time_s), ()


def _arming_waits(now: Situation, time_s: float, rules: Rules) -> Step:
    over = time_s - now.since_s > rules.warning_s + rules.confirm_s
    return (_home(now, time_s), _DARK) if over else (now, ())


def _armed_waits(now: Situation, time_s: float, rules: Rules) -> Step:
    idle = time_s - now.since_s > rules.idle_s
    return (_home(now, time_s), _DARK) if idle else (now, ())


def _started(now: Situation, time_s: float, _: Rules) -> Step:
    return (_to(now, State.SCANNING, time_s), ()) if now.homed else (now, _REFUSED)


def _exposed(now: Situation, time_s: float, _: Rules) -> Step:
    return replace(now, since_s=time_s), ()


def _resumed(now: Situation, time_s: float, rules: Rules) -> Step:
    if not (now.inputs_well and now.dark and now.homed):
        return now, _REFUSED
    if now.rearm or time_s - now.since_s > rules.resume_s:
        return _arming(now, time_s, rules)
    return _to(now, State.SCANNING, time_s), ()


def _acknowledged(now: Situation, time_s: float, _: Rules) -> Step:
    """Out of a fault when its cause is gone: never into anything that lights or moves."""
    if not now.cause_gone:
        return now, _REFUSED
    match now.state:
        case State.FAULT_CONFIG:
            return _to(replace(now, identified=False), State.BOOT, time_s), AT_REST
        case State.FAULT_IDENTITY:
            return _to(replace(now, identified=False), State.DISCONNECTED, time_s), AT_REST
        case State.FAULT_LASER:
            return _to(replace(now, dark=False), State.IDENTIFYING, time_s), AT_REST
        case _:
            return _home(now, time_s), AT_REST


def _reset(now: Situation, time_s: float, _: Rules) -> Step:
    """Out of the emergency stop: the hardware was reset before, and a person says so after."""
    if now.estop_pressed or now.interlock_open:
        return now, _REFUSED
    return _home(replace(now, homed=False), time_s), AT_REST


_LOOKING: Mapping[Event, Rule] = {Event.ARM: _arming, Event.JOG: _goes(State.MOVING)}
_ROWS: Mapping[State, Mapping[Event, Rule]] = {
    State.BOOT: {Event.SELF_TESTED: _goes(State.DISCONNECTED)},
    State.DISCONNECTED: {
        Event.CONNECT: _goes(State.IDENTIFYING, Action.LASER_OFF, Action.STOP_AXES)
    },
    State.IDENTIFYING: {Event.IDENTIFIED: _identified},
    State.SAFE: {
        **_LOOKING,
        Event.HOME: _goes(State.HOMING),
        Event.DISCONNECT: _goes(State.DISCONNECTED),
        Event.STANDS: _stays,
        Event.STANDS_ELSEWHERE: _stays,
    },
    State.HOMING: {Event.HOMED: _homed, Event.HOMED_IN_PART: _unhomed},
    State.READY: {
        **_LOOKING,
        Event.HOME: _goes(State.HOMING),
        Event.MOVE: _goes(State.MOVING),
        Event.VALIDATE: _goes(State.CHECK),
        Event.DISCONNECT: _goes(State.DISCONNECTED),
        Event.STANDS: _stays,
        Event.STANDS_ELSEWHERE: _unhomed,
    },
    State.MOVING: {Event.ARRIVED: _rests},
    State.CHECK: {Event.VALIDATED: _rests},
    State.ARMING: {
        Event.CONFIRM: _confirmed,
        Event.CANCEL: lambda now, time_s, _: (_home(now, time_s), _DARK),
        Event.TICK: _arming_waits,
    },
    State.ARMED: {
        Event.START: _started,
        Event.EXPOSED: _exposed,
        Event.JOG: _stays,
        Event.MOVE: lambda now, _time_s, _: (now, () if now.homed else _REFUSED),
        Event.ARRIVED: _stays,
        Event.DISARM: lambda now, time_s, _: (_home(now, time_s), _DARK),
        Event.TICK: _armed_waits,
    },
    State.SCANNING: {
        Event.PAUSE: _goes(State.PAUSED, *AT_REST),
        Event.COMPLETE: _goes(State.COMPLETING, *AT_REST),
        Event.EXPOSED: _exposed,
    },
    State.PAUSED: {
        Event.RESUME: _resumed,
        Event.STANDS: _stays,
        Event.STANDS_ELSEWHERE: _unhomed,
    },
    State.PAUSED_LINK: {
        Event.CONNECT: _goes(State.IDENTIFYING, Action.LASER_OFF, Action.STOP_AXES),
        Event.STANDS: _stays,
        Event.STANDS_ELSEWHERE: _stays,
    },
    State.COMPLETING: {Event.STANDS: _rests, Event.STANDS_ELSEWHERE: _unhomed},
    State.STOPPING: {Event.STANDS: _rests, Event.STANDS_ELSEWHERE: _unhomed},
    **{fault: {Event.ACKNOWLEDGE: _acknowledged} for fault in FAULTS},
    State.ESTOP: {Event.ACKNOWLEDGE: _reset},
}
_TABLE: Mapping[tuple[State, Event], Rule] = MappingProxyType(
    {(state, event): rule for state, row in _ROWS.items() for event, rule in row.items()}
)
