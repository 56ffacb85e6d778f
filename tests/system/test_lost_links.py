"""A cable that is pulled, and put back: off and stop are said as soon as somebody can hear them.

The station is a process, its relay and axes hang on ptys and TCP, and its witness says what the
laser and the axes truly did. Off after a loss is this program's: the relays here have no watchdog.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from threading import Timer

import pytest

from acquisition.errors import AcquisitionError
from acquisition.safety.places import places_of
from acquisition.safety.resting import REOPEN_S
from acquisition.safety.states import State
from acquisition.station import read_station
from drivers.addresses import SerialAddress, parse_address
from drivers.errors import DriverError, LinkLost, Refused
from drivers.tcp_link import LONGEST_CONNECT_S
from loftscan import Station, simulate
from loftscan.simulation import Simulated
from tests.campaigns.testimony import Event, Witnessed, lit, moving

SCALE = 8.0
AWAY_S = 0.5
BUSY_S = 2.0  # of a machine that tests much else beside


def pulled_s(events: list[Event]) -> float:
    return next(each["time_s"] for each in events if each.get("fault") == "unplug")


def warm(at: Station) -> None:
    """Let the simulator draw its first picture, for which it compiles and hears nobody."""
    for _ in range(5):
        try:
            at.profile()
        except (AcquisitionError, DriverError):
            at.acknowledge()
        else:
            return


def look_until_lost(at: Station, simulated: Simulated, *wires: str) -> DriverError:
    """Light the laser, pull cables, and look until something is raised."""
    warm(at)
    with pytest.raises(DriverError) as lost, at.lit() as look:  # noqa: PT012
        look()
        simulated.unplug(*wires)  # type: ignore[arg-type]
        for _ in range(1000):
            look()
    return lost.value


@pytest.mark.parametrize("laser", ["plain", "plain-tcp", "grbl", "timed"])
def test_a_laser_whose_cable_was_pulled_is_off_as_soon_as_the_cable_is_back(laser: str) -> None:
    with (
        simulate("cylinder", scale=SCALE, seed=3, laser=laser) as simulated,
        Station.open(simulated) as at,
    ):
        witnessed, told = Witnessed(simulated.witness), list[str]()
        at.devices.safety.announce = told.append
        lost = look_until_lost(at, simulated, "relay")
        assert isinstance(lost, LinkLost)
        assert told[-1] == "laser: its link was lost; off was confirmed over a new one"
        assert "press the emergency stop" not in f"{lost} {getattr(lost, '__notes__', ())}"
        events = witnessed.listen()  # and nobody has left the station yet
        assert lit(events)[-1].ended_s - pulled_s(events) < AWAY_S + BUSY_S
        assert at.devices.safety.state is State.PAUSED_LINK
        assert at.acknowledge().laser_on is False
        at.profile()
        assert all(span.ended_s < float("inf") for span in lit(witnessed.listen()))


def test_a_laser_whose_cable_stays_out_is_told_to_be_stopped_by_hand_soon() -> None:
    with (  # noqa: PT012
        pytest.raises(DriverError) as left,
        simulate(
            "cylinder", scale=SCALE, seed=3, laser="plain", faults="away-ms=60000"
        ) as simulated,
        Station.open(simulated) as at,
    ):
        begun_s = time.monotonic()
        lost = look_until_lost(at, simulated, "relay")
        assert "press the emergency stop" in f"{lost} {getattr(lost, '__notes__', ())}"
        assert time.monotonic() - begun_s < REOPEN_S + LONGEST_CONNECT_S + BUSY_S
        assert at.devices.safety.state is State.FAULT_LASER
        with pytest.raises(Refused, match="emergency stop"):
            at.acknowledge()
    assert "press the emergency stop" in str(left.value)


@pytest.mark.parametrize("stage", ["leadshine", "zaber", "oriental"])
def test_a_stage_whose_cable_was_pulled_amid_a_move_is_stopped_when_it_is_back(stage: str) -> None:
    with (
        simulate("cylinder", seed=3, stage=stage, faults="away-ms=300") as simulated,
        Station.open(simulated) as at,
    ):
        at.home()
        witnessed = Witnessed(simulated.witness)
        Timer(0.3, simulated.unplug, ["stage"]).start()
        with pytest.raises(LinkLost) as lost:
            at.jog(stage_mm=100.0)  # five seconds long
        assert (
            "press the emergency stop" not in f"{lost.value} {getattr(lost.value, '__notes__', ())}"
        )
        events = witnessed.listen()
        (move,) = moving(events, "stage")
        assert move.ended_s - pulled_s(events) < 0.3 + 0.5 + BUSY_S  # quarantine, braking
        assert at.devices.safety.state is State.PAUSED_LINK
        at.acknowledge()
        assert not at.stop().stage.homed
        with pytest.raises(Refused, match="not homed"):
            at.jog(stage_mm=5.0)
        assert len(moving(witnessed.listen(), "stage")) == 1  # a reconnect moves nothing
        at.home()
        assert at.jog(stage_mm=5.0).stage_mm == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("table", ["grbl", "zaber", "oriental"])
def test_a_table_whose_cable_was_pulled_amid_a_move_is_stopped_when_it_is_back(table: str) -> None:
    with (
        simulate("cylinder", seed=3, table=table, faults="away-ms=300") as simulated,
        Station.open(simulated) as at,
    ):
        at.home()
        witnessed = Witnessed(simulated.witness)
        Timer(0.3, simulated.unplug, ["table", "relay"]).start()  # two at once
        with pytest.raises(LinkLost) as lost:
            at.jog(table_deg=350.0)
        assert (
            "press the emergency stop" not in f"{lost.value} {getattr(lost.value, '__notes__', ())}"
        )
        events = witnessed.listen()
        (move,) = moving(events, "table")
        assert move.ended_s - pulled_s(events) < 0.3 + 0.5 + BUSY_S
        assert at.devices.safety.state is State.PAUSED_LINK
        at.acknowledge()
        assert not at.stop().table.homed
        at.home()
        assert at.jog(table_deg=30.0).table_deg == pytest.approx(30.0, abs=0.1)


def test_a_port_that_comes_back_by_another_name_leaves_its_old_one_to_others() -> None:
    with (
        simulate("cylinder", seed=3, faults="away-ms=300") as simulated,
        Station.open(simulated) as at,
    ):
        (before,) = places_of([at.settings.stage.address])
        at.home()
        simulated.unplug("stage")
        with pytest.raises(LinkLost):  # noqa: PT012
            for number in range(20):
                at.jog(stage_mm=5.0 + number % 2)
        (now,) = places_of([at.settings.stage.address])
        own = f"{os.getpid()}\n"
        assert now.file.read_text() == own
        others = before.file != now.file and before.file.exists()  # the kernel may reuse a number
        assert not (others and before.file.read_text() == own)


def test_the_ports_of_a_simulator_that_was_killed_are_gone_and_never_anothers() -> None:
    with simulate("cylinder", scale=SCALE) as station:
        settings = read_station(station.station)
        addresses = [parse_address(each.address) for each in (settings.table, settings.stage)]
        names = [Path(each.device) for each in addresses if isinstance(each, SerialAddress)]
        assert len(names) == 2
        assert all(each.is_symlink() for each in names)
        os.kill(station.pid, signal.SIGKILL)
        deadline_s = time.monotonic() + 5.0
        while any(each.is_symlink() for each in names) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        assert not any(each.is_symlink() for each in names)
