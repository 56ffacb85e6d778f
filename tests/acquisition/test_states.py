"""The station's states: every pair of state and event, and a hundred thousand random lives.

What is judged is what an executor would do that knows nothing but the actions: it may light from
PERMIT_LASER on until FORBID_LASER.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import replace

import pytest

from acquisition.safety.states import (
    ASKED,
    AT_REST,
    FAULTS,
    LATCHED,
    PERMITTING,
    REPORTED,
    WRONG,
    Action,
    Event,
    Rules,
    Situation,
    State,
)
from acquisition.safety.stepping import _ROWS, step

RULES = Rules()
SEQUENCES, LENGTH = 100_000, 7
FLAGS = ("identified", "homed", "dark", "estop_pressed", "interlock_open", "key_on", "cause_gone")


def situations(state: State) -> Iterator[Situation]:
    """Every combination of what is remembered."""
    for values in itertools.product((False, True), repeat=len(FLAGS)):
        yield Situation(state=state, since_s=0.0, **dict(zip(FLAGS, values, strict=True)))


def after(state: State, *events: Event, at_s: float = 100.0, **known: bool) -> Situation:
    now = Situation(state=state, since_s=0.0, **{"identified": True, "dark": True, **known})
    for event in events:
        now, _ = step(now, event, at_s)
    return now


@pytest.mark.parametrize("state", State)
def test_every_event_has_an_outcome_in_every_state_that_permits_nothing_it_should_not(
    state: State,
) -> None:
    for now in situations(state):
        for event, time_s in itertools.product(Event, (4.0, 1000.0)):
            later, actions = step(now, event, time_s)
            assert len(set(actions)) == len(actions)
            if Action.PERMIT_LASER in actions:
                assert later.laser_permitted
                assert Action.REFUSE not in actions
            if now.laser_permitted and not later.laser_permitted:
                assert actions[:2] == (Action.FORBID_LASER, Action.LASER_OFF)
            if later.laser_permitted:
                assert later.state in PERMITTING
                assert later.inputs_well
            if event is Event.STOP:
                assert set(AT_REST) <= set(actions)
                assert later.state not in PERMITTING


@pytest.mark.parametrize("state", State)
def test_a_stop_reaches_a_safe_state_from_everywhere(state: State) -> None:
    for now in situations(state):
        stopped, _ = step(now, Event.STOP, 1.0)
        stopped, _ = step(stopped, Event.OFF_CONFIRMED, 1.0)
        if stopped.state is State.STOPPING:
            stopped, _ = step(stopped, Event.STANDS_ELSEWHERE, 1.1)
        assert stopped.state in {
            State.BOOT, State.DISCONNECTED, State.IDENTIFYING, State.SAFE, State.READY,
            State.PAUSED_LINK, State.SHUTDOWN, *LATCHED,
        }  # fmt: skip
        assert not stopped.laser_permitted


def test_in_a_hundred_thousand_random_lives_nothing_is_lit_outside_armed_and_scanning() -> None:
    rng = random.Random(20)
    events = list(Event)
    tried: set[tuple[State, Event]] = set()
    for _ in range(SEQUENCES):
        now, time_s, allowed = Situation(state=rng.choice(list(State))), 0.0, False
        if now.state in PERMITTING:  # such a life begins where the laser is permitted
            now = replace(now, identified=True, homed=True, dark=True)
            allowed = True
        for _ in range(LENGTH):
            likely = list(_ROWS.get(now.state, {}))
            event = rng.choice(likely if likely and rng.random() < 0.6 else events)
            time_s += rng.choice((0.01, 0.5, 3.5, 70.0))
            before, (now, actions) = now, step(now, event, time_s)
            tried.add((before.state, event))
            if Action.FORBID_LASER in actions:
                allowed = False
            if Action.PERMIT_LASER in actions:
                allowed = True
                assert before.state not in LATCHED
            assert allowed == now.laser_permitted, (before, event)
            assert not allowed or now.state in (State.ARMED, State.SCANNING)
            if now.state is State.ARMED and before.state is not State.ARMED:
                assert (before.state, event) == (State.ARMING, Event.CONFIRM)
                assert time_s - before.since_s >= RULES.warning_s
            if now.state is State.SCANNING and before.state is not State.SCANNING:
                assert before.state in (State.ARMED, State.PAUSED)
            if before.state is State.ESTOP and now.state is not State.ESTOP:
                assert event in (Event.ACKNOWLEDGE, Event.CLOSE)
                assert not (event is Event.ACKNOWLEDGE and now.homed)
    assert len(tried) == len(State) * len(Event)


# --- the table of the states ----------------------------------------------------------------------


def test_the_events_are_asked_reported_or_wrong() -> None:
    assert set(Event) == ASKED | REPORTED | WRONG
    assert not ASKED & REPORTED
    assert {Event.STOP, Event.ACKNOWLEDGE} <= ASKED
    assert {Event.HOMED, Event.TICK} <= REPORTED
    assert {Event.ESTOP_PRESSED, Event.INTERNAL_ERROR} <= WRONG


def test_the_ordinary_life_goes_from_boot_to_a_scan_and_back() -> None:
    life = (
        (Event.SELF_TESTED, State.DISCONNECTED),
        (Event.CONNECT, State.IDENTIFYING),
        (Event.OFF_CONFIRMED, State.IDENTIFYING),
        (Event.IDENTIFIED, State.SAFE),
        (Event.HOME, State.HOMING),
        (Event.HOMED, State.READY),
        (Event.VALIDATE, State.CHECK),
        (Event.VALIDATED, State.READY),
        (Event.ARM, State.ARMING),
        (Event.CONFIRM, State.ARMED),
        (Event.START, State.SCANNING),
        (Event.PAUSE, State.PAUSED),
        (Event.RESUME, State.SCANNING),
        (Event.COMPLETE, State.COMPLETING),
        (Event.STANDS, State.READY),
        (Event.CLOSE, State.SHUTDOWN),
    )
    now = Situation()
    for time_s, (event, state) in enumerate(life):
        now, _ = step(now, event, 4.0 * time_s)
        assert now.state is state, event


def test_connecting_sends_off_and_stop_before_anything_is_asked() -> None:
    _, actions = step(Situation(state=State.DISCONNECTED), Event.CONNECT, 0.0)
    assert actions == (Action.LASER_OFF, Action.STOP_AXES)
    doubtful = after(State.IDENTIFYING, Event.IDENTIFIED, dark=False)
    assert doubtful.state is State.FAULT_LASER


@pytest.mark.parametrize("state", State)
def test_an_absolute_move_is_refused_unless_homed_and_ready(state: State) -> None:
    now = Situation(state=state, identified=True, dark=True)
    later, actions = step(now, Event.MOVE, 0.0)
    if state is State.READY:
        assert later.state is State.MOVING
    else:
        assert (later.state, actions) == (state, (Action.REFUSE,))


def test_arming_is_announced_and_confirmed_after_the_warning_and_not_too_late() -> None:
    arming, actions = step(after(State.READY, homed=True), Event.ARM, 100.0)
    assert Action.ANNOUNCE in actions
    assert step(arming, Event.CONFIRM, 102.9)[1] == (Action.REFUSE,)
    assert step(arming, Event.CONFIRM, 103.0)[0].state is State.ARMED
    assert step(arming, Event.TICK, 108.1)[0].state is State.READY
    assert step(arming, Event.CANCEL, 101.0)[0].state is State.READY


def test_armed_and_idle_for_a_minute_it_disarms() -> None:
    armed = after(State.ARMED, homed=True)
    armed, _ = step(armed, Event.EXPOSED, 30.0)
    assert step(armed, Event.TICK, 89.0)[0].state is State.ARMED
    idle, actions = step(armed, Event.TICK, 90.1)
    assert idle.state is State.READY
    assert actions == (Action.FORBID_LASER, Action.LASER_OFF)


def test_an_unhomed_station_may_be_armed_to_look_but_not_to_scan() -> None:
    armed = after(State.ARMED)
    later, actions = step(armed, Event.START, 1.0)
    assert (later.state, actions) == (State.ARMED, (Action.REFUSE,))


def test_a_long_pause_ends_by_arming_anew() -> None:
    paused = after(State.PAUSED, homed=True)
    assert step(paused, Event.RESUME, 59.0)[0].state is State.SCANNING
    assert step(paused, Event.RESUME, 61.0)[0].state is State.ARMING


# --- the table of the faults ----------------------------------------------------------------------


@pytest.mark.parametrize("press", [Event.ESTOP_PRESSED, Event.INTERLOCK_OPENED])
def test_an_emergency_stop_is_latched_until_it_is_reset_and_then_acknowledged(press: Event) -> None:
    release = {
        Event.ESTOP_PRESSED: Event.ESTOP_RELEASED,
        Event.INTERLOCK_OPENED: Event.INTERLOCK_CLOSED,
    }[press]
    pressed = after(State.SCANNING, press, homed=True)
    assert (pressed.state, pressed.homed) == (State.ESTOP, False)
    assert after(State.SCANNING, press, Event.ACKNOWLEDGE, homed=True).state is State.ESTOP
    # An acknowledgement that was held down from before the release does not count.
    held = after(State.SCANNING, press, Event.ACKNOWLEDGE, release, homed=True)
    assert held.state is State.ESTOP
    done = after(State.SCANNING, press, release, Event.ACKNOWLEDGE, homed=True)
    assert (done.state, done.homed) == (State.SAFE, False)


def test_one_that_was_pressed_before_the_start_is_found_when_the_devices_are_known() -> None:
    now = after(State.IDENTIFYING, dark=True, estop_pressed=True)
    assert step(now, Event.IDENTIFIED, 0.0)[0].state is State.ESTOP


def test_a_key_that_is_turned_pauses_a_scan_that_only_arming_goes_on_with() -> None:
    off, actions = step(after(State.SCANNING, homed=True), Event.KEY_OFF, 10.0)
    assert off.state is State.PAUSED
    assert set(AT_REST) <= set(actions)
    assert step(off, Event.RESUME, 11.0)[1] == (Action.REFUSE,)
    on, _ = step(off, Event.KEY_ON, 12.0)
    assert step(on, Event.RESUME, 13.0)[0].state is State.ARMING
    assert after(State.ARMED, Event.KEY_OFF, homed=True).state is State.READY


def test_a_lost_link_pauses_and_only_the_stages_costs_the_position() -> None:
    for lost, homed in (
        (Event.LASER_LINK_LOST, True),
        (Event.SENSOR_LINK_LOST, True),
        (Event.AXIS_LINK_LOST, False),
    ):
        now, actions = step(after(State.SCANNING, homed=True), lost, 1.0)
        assert (now.state, now.homed) == (State.PAUSED_LINK, homed)
        assert actions.index(Action.LASER_OFF) < actions.index(Action.STOP_AXES)
        assert now.dark == (lost is not Event.LASER_LINK_LOST)
        again, _ = step(now, Event.CONNECT, 2.0)
        assert again.state is State.IDENTIFYING


@pytest.mark.parametrize(
    ("event", "fault", "homed", "action"),
    [
        (Event.OFF_UNCONFIRMED, State.FAULT_LASER, True, Action.ALARM),
        (Event.POSITION_LOST, State.FAULT_POSITION, False, Action.STOP_AXES),
        (Event.LIMIT_SWITCH, State.FAULT_LIMIT, False, Action.STOP_AXES),
        (Event.WIRE_UNSOUND, State.FAULT_COMM, False, Action.QUARANTINE),
        (Event.WATCHDOG_BIT, State.FAULT_WATCHDOG, False, Action.LASER_OFF),
        (Event.STORAGE_FAILED, State.FAULT_STORAGE, True, Action.LASER_OFF),
        (Event.INTERNAL_ERROR, State.FAULT_INTERNAL, False, Action.LASER_OFF),
    ],
)
def test_a_fault_is_latched_with_its_reaction(
    event: Event,
    fault: State,
    homed: bool,  # noqa: FBT001
    action: Action,
) -> None:
    now, actions = step(after(State.SCANNING, homed=True), event, 1.0)
    assert (now.state, now.homed) == (fault, homed)
    assert set(AT_REST) <= set(actions)
    assert action in actions
    assert step(now, Event.ACKNOWLEDGE, 2.0)[0].state is fault  # its cause is there still
    gone, _ = step(now, Event.CAUSE_GONE, 3.0)
    out, _ = step(gone, Event.ACKNOWLEDGE, 4.0)
    assert out.state in (State.SAFE, State.READY, State.IDENTIFYING)
    assert (out.state is State.READY) == (homed and fault is not State.FAULT_LASER)


@pytest.mark.parametrize("fault", sorted(LATCHED, key=lambda state: state.name))
def test_a_latched_state_is_left_by_nothing_but_a_person_or_for_worse(fault: State) -> None:
    for now in situations(fault):
        for event in Event:
            later, _ = step(now, event, math.inf)
            if later.state is fault:
                continue
            worse = later.state in (State.ESTOP, State.FAULT_LASER, State.SHUTDOWN)
            assert worse or event is Event.ACKNOWLEDGE
            assert later.state not in PERMITTING


def test_the_first_cause_stays_the_one_that_is_told() -> None:
    now = after(State.SCANNING, Event.STORAGE_FAILED, Event.INTERNAL_ERROR, homed=True)
    assert now.state is State.FAULT_STORAGE
    assert after(now.state, Event.OFF_UNCONFIRMED).state is State.FAULT_LASER
    assert after(now.state, Event.ESTOP_PRESSED).state is State.ESTOP


def test_who_leaves_pauses_an_attended_scan_and_back_pressure_any() -> None:
    scanning = after(State.SCANNING, homed=True)
    assert step(scanning, Event.CONTROL_LOST, 1.0)[0].state is State.PAUSED
    alone = Rules(attended=False)
    assert step(scanning, Event.CONTROL_LOST, 1.0, alone)[0].state is State.SCANNING
    assert step(scanning, Event.BACK_PRESSURE, 1.0, alone)[0].state is State.PAUSED


def test_a_plan_that_is_refused_moves_nothing_and_is_no_fault() -> None:
    now, actions = step(after(State.CHECK, homed=True), Event.PLAN_REFUSED, 1.0)
    assert (now.state, actions) == (State.READY, (Action.REFUSE,))


def test_a_stop_that_is_asked_for_again_raises_the_alarm() -> None:
    _, actions = step(after(State.STOPPING), Event.STOP, 1.0)
    assert Action.ALARM in actions


@pytest.mark.parametrize("state", [State.BOOT, State.IDENTIFYING, State.READY, State.SCANNING])
def test_a_report_that_does_not_fit_is_an_internal_fault(state: State) -> None:
    assert after(state, Event.HOMED).state is State.FAULT_INTERNAL


def test_every_fault_has_its_row() -> None:
    assert {state for state in FAULTS if Event.ACKNOWLEDGE in _ROWS[state]} == FAULTS
