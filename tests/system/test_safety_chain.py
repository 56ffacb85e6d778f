"""Emergency stop, interlock and key, pressed amid a scan of a simulated station, by its witness."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Literal

import pytest

from acquisition.errors import InputTripped, NotNow
from acquisition.plan import Plan, Ring, StepAndShoot
from acquisition.safety.states import State
from loftscan import Station, scan, simulate
from loftscan.simulation import Simulated
from tests.campaigns.testimony import Event, lit, moving, over_after_s, read_all

PLAN = Plan(
    ring=Ring(first_mm=6.0, last_mm=10.0, step_mm=2.0, profiles_per_turn=4),
    step_and_shoot=StepAndShoot(settle_s=0.02),
)
BUSY_S = 2.0
Contact = Literal["estop", "interlock", "key"]


def pressed_soon(station: Simulated, contact: Contact) -> tuple[threading.Thread, list[float]]:
    at_s: list[float] = []

    def press() -> None:
        time.sleep(0.05)
        at_s.append(time.monotonic())
        station.press(contact)

    thread = threading.Thread(target=press)
    thread.start()
    return thread, at_s


@pytest.mark.parametrize(
    ("contact", "state", "said"),
    [
        ("estop", State.ESTOP, "emergency stop"),
        ("interlock", State.ESTOP, "interlock"),
        ("key", State.PAUSED, "key"),
    ],
)
def test_what_is_pressed_amid_a_scan_ends_it_and_only_a_person_leads_on(
    contact: Contact, state: State, said: str, place: Path
) -> None:
    with simulate("cylinder", scale=8.0, seed=2) as simulated, Station.open(simulated) as station:
        taken = scan(station, PLAN, out=place / "part.scan")
        next(taken)
        thread, at_s = pressed_soon(simulated, contact)
        with pytest.raises(InputTripped, match=said):
            list(taken)
        thread.join()
        events: list[Event] = read_all(simulated.witness)
        assert over_after_s(lit(events), at_s[0]) < BUSY_S
        assert over_after_s(moving(events, "table", "stage"), at_s[0]) < BUSY_S
        assert station.devices.safety.state is state
        if state is State.ESTOP:
            with pytest.raises(InputTripped, match=said):
                station.acknowledge()
            simulated.release(contact)
            with pytest.raises(NotNow, match="release and reset it"):
                station.home()
            station.acknowledge()
            assert station.devices.safety.state is State.SAFE
        else:
            simulated.release(contact)
        sweeps = scan(station, PLAN, out=place / "part.scan", resume=True)
        assert [sweep.index for sweep in sweeps] == [0, 1, 2]
        assert station.devices.safety.state is State.READY
