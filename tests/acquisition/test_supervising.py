"""The state machine at a station: what it lets pass, what it is told, the chain that it reads."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from acquisition.errors import (
    InputTripped,
    LeaseLapsed,
    NotNow,
    Stopped,
    StorageFailed,
)
from acquisition.safety.states import Event, Rules, State
from acquisition.safety.supervising import PermittedLaser, Supervisor
from drivers.axis import Identity
from drivers.errors import FrameError, LinkLost, NoReply, Refused
from drivers.inputs import Inputs
from drivers.laser import Guarantee

TO_READY = (
    Event.SELF_TESTED, Event.CONNECT, Event.OFF_CONFIRMED, Event.IDENTIFIED, Event.HOME,
    Event.HOMED,
)  # fmt: skip
TO_ARMED = (*TO_READY, Event.ARM, Event.CONFIRM)
TO_SCANNING = (*TO_ARMED, Event.START)


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Switch:
    lit: bool = False
    fails: bool = False

    def identify(self) -> Identity:
        return Identity("test", "switch", "")

    def guarantee(self) -> Guarantee:
        return Guarantee(None, "none")

    def on(self) -> None:
        self.lit = True

    def off(self) -> None:
        if self.fails:
            raise Refused("laser: off was not confirmed")
        self.lit = False

    def is_on(self) -> bool:
        return self.lit


@dataclass
class Chain:
    now: Inputs = field(default_factory=Inputs)
    reads: int = 0

    def read(self) -> Inputs:
        self.reads += 1
        return self.now


def supervisor(*events: Event, clock: Clock | None = None) -> Supervisor:
    made = Supervisor(clock or Clock(), Rules(warning_s=0.0))
    for event in events:
        made.ask(event)
    return made


@pytest.mark.parametrize("count", range(len(TO_SCANNING)))
def test_on_goes_out_only_where_the_state_permits_it_and_off_always(count: int) -> None:
    safety, switch = supervisor(*TO_SCANNING[:count]), Switch()
    laser = PermittedLaser(switch, safety)
    if safety.state in (State.ARMED, State.SCANNING):
        laser.on()
        assert switch.lit
    else:
        with pytest.raises(NotNow, match=f"the station is {safety.state.value}"):
            laser.on()
        assert not switch.lit
    switch.lit = True
    laser.off()
    assert not switch.lit


def test_an_arming_that_was_forgotten_lights_nothing() -> None:
    clock, switch = Clock(), Switch()
    laser = PermittedLaser(switch, supervisor(*TO_ARMED, clock=clock))
    laser.on()
    laser.off()
    clock.now_s += 61.0
    with pytest.raises(NotNow, match="ready; arm it first"):
        laser.on()
    assert not switch.lit


def test_an_off_that_is_not_confirmed_is_a_fault_that_lights_nothing() -> None:
    safety, switch = supervisor(*TO_ARMED), Switch(fails=True)
    laser = PermittedLaser(switch, safety)
    laser.on()
    with pytest.raises(Refused, match="not confirmed"):
        laser.off()
    assert safety.state is State.FAULT_LASER
    with pytest.raises(NotNow, match="press the emergency stop"):
        laser.on()


@pytest.mark.parametrize(
    ("error", "state"),
    [
        (KeyboardInterrupt(), State.STOPPING),
        (SystemExit(), State.STOPPING),
        (Stopped("stopped"), State.STOPPING),
        (NoReply("silent"), State.FAULT_COMM),
        (FrameError("noise"), State.FAULT_COMM),
        (Refused("held"), State.FAULT_POSITION),
        (StorageFailed("full"), State.FAULT_STORAGE),
        (LeaseLapsed("late"), State.FAULT_INTERNAL),
        (ZeroDivisionError(), State.FAULT_INTERNAL),
    ],
)
def test_what_is_raised_in_a_scan_leads_where_the_table_says(
    error: BaseException, state: State
) -> None:
    safety = supervisor(*TO_SCANNING)
    safety.fail(error)
    safety.fail(error)  # it passes more than one block on its way out
    assert safety.state is state
    assert not safety.situation.laser_permitted


@pytest.mark.parametrize(
    ("role", "homed", "dark"),
    [("laser", True, False), ("axis", False, True), ("sensor", True, True)],
)
def test_a_lost_link_is_told_by_what_hangs_on_it(
    role: str,
    homed: bool,  # noqa: FBT001
    dark: bool,  # noqa: FBT001
) -> None:
    safety = supervisor(*TO_SCANNING)
    safety.lost_role = role
    safety.fail(LinkLost("gone"))
    now = safety.situation
    assert (now.state, now.homed, now.dark) == (State.PAUSED_LINK, homed, dark)


def test_by_hand_one_refusal_is_no_fault() -> None:
    safety = supervisor(*TO_READY, Event.JOG)
    safety.fail(Refused("table: outside its soft limits"))
    safety.tell(Event.STANDS)
    assert safety.state is State.READY


@pytest.mark.parametrize(
    ("tripped", "state", "said"),
    [
        (Inputs(estop_pressed=True), State.ESTOP, "release it"),
        (Inputs(interlock_open=True), State.ESTOP, "close it"),
        (Inputs(key_on=False), State.PAUSED, "turn it on"),
    ],
)
def test_the_chain_is_mirrored_within_50_ms_and_latched(
    tripped: Inputs, state: State, said: str
) -> None:
    clock, chain = Clock(), Chain()
    safety = supervisor(*TO_SCANNING, clock=clock)
    safety.watch(chain)
    safety.look()
    chain.now = tripped
    looks_s = []
    with pytest.raises(InputTripped, match=said) as raised:  # noqa: PT012
        for _ in range(100):
            clock.now_s += 0.005
            looks_s.append(clock.now_s)
            safety.look()
    assert looks_s[-1] - looks_s[0] <= 0.05
    assert safety.state is state
    safety.fail(raised.value)
    chain.now = Inputs()
    clock.now_s += 1.0
    safety.look()
    assert safety.state is state  # well again, and nothing goes on by itself
    assert not safety.situation.laser_permitted


def test_the_chain_is_not_asked_more_often_than_it_must_be() -> None:
    clock, chain = Clock(), Chain()
    safety = supervisor(*TO_SCANNING, clock=clock)
    safety.watch(chain)
    for _ in range(100):
        safety.look()
        clock.now_s += 0.001
    assert chain.reads == 3


def test_an_emergency_stop_that_was_pressed_before_the_start_is_found() -> None:
    safety = supervisor(*TO_READY[:4])
    safety.watch(Chain(Inputs(estop_pressed=True)))
    with pytest.raises(InputTripped):
        safety.look()
    assert safety.state is State.ESTOP
    with pytest.raises(NotNow, match="release and reset it"):
        safety.ask(Event.HOME)


def test_the_laser_is_announced() -> None:
    said: list[str] = []
    safety = Supervisor(Clock(), Rules(warning_s=3.0))
    safety.announce = said.append
    for event in (*TO_READY, Event.ARM):
        safety.ask(event)
    assert said == ["laser: it may be lit in 3 s"]
    with pytest.raises(NotNow, match="arming"):
        safety.ask(Event.CONFIRM)
