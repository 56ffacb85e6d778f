"""Several drives on one RS-485 line: one bus, one holder of the port, ids apart."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.axis import Axis, Motion
from drivers.errors import NoReply
from drivers.leadshine import LeadshineStage
from drivers.modbus import ModbusBus
from drivers.oriental import AzAxis
from sim.leadshine import LeadshineDrive
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.oriental import AzDrive, AzSettings
from sim.world import WorldAxis
from tests.drivers.motion_cases import AZ, AZ_PER_DEG
from tests.sim.judges import STAGE, Rig, world_axis


class Line(Rig):
    """Drives by their id, each on an axis of its own, and one bus for all their drivers."""

    def __init__(self, *kinds: str) -> None:
        self.worlds: list[WorldAxis] = []
        units = {}
        for device_id, kind in enumerate(kinds, start=1):
            if kind == "leadshine":
                world = world_axis(f"{device_id}", 37.0, Limits(100.0, 2000.0))
                units[device_id] = LeadshineDrive(world)
            else:
                world = world_axis(f"{device_id}", 1.0, Limits(10.0, 100.0))
                made = AzSettings(steps_per_unit=math.degrees(AZ_PER_DEG), home_at=0.5)
                units[device_id] = AzDrive(world, made)
            self.worlds.append(world)
        super().__init__(RtuServer(units))
        self.one_bus = self.bus()
        self.axes = [self._driver(k, kind) for k, kind in enumerate(kinds, start=1)]

    def _driver(self, device_id: int, kind: str) -> Axis:
        bus: ModbusBus = self.one_bus
        if kind == "leadshine":
            return LeadshineStage(bus, device_id, STAGE, name=f"{device_id}", clock=self.clock)
        return AzAxis(bus, device_id, replace(AZ, name=f"{device_id}"), clock=self.clock)


MIXES = [("leadshine", "leadshine"), ("oriental", "oriental"), ("oriental", "leadshine")]


@pytest.mark.parametrize("mix", MIXES, ids="+".join)
def test_each_moves_and_the_other_stands(mix) -> None:
    line = Line(*mix)
    homes = [axis.home(line.pause).position for axis in line.axes]
    zeros = [world.motor(line.now_s) - home for world, home in zip(line.worlds, homes, strict=True)]
    places = list(homes)
    for turn in range(6):
        k = turn % 2
        places[k] = homes[k] + 0.4 * (turn + 1)
        assert line.axes[k].move_to(places[k], line.pause).position == pytest.approx(
            places[k], abs=1e-3
        )
        for world, zero, place in zip(line.worlds, zeros, places, strict=True):
            assert world.motor(line.now_s) - zero == pytest.approx(place, abs=1e-3)
    assert line.one_bus.tally().retries == 0


@pytest.mark.parametrize("mix", MIXES, ids="+".join)
def test_while_one_moves_the_other_is_asked_and_a_stop_stops_only_its_own(mix) -> None:
    line = Line(*mix)
    for axis in line.axes:
        axis.home(line.pause)
    first, second = line.axes
    seen: list[Motion] = []

    def pause(seconds: float) -> None:
        line.pause(seconds)
        seen.append(second.state().motion)
        second.stop()

    target = first.state().position + 6.0
    state = first.move_to(target, pause)
    assert state.position == pytest.approx(target, abs=1e-3)
    assert set(seen) == {Motion.STANDING}
    assert len(seen) > 5


@pytest.mark.parametrize("mix", MIXES, ids="+".join)
def test_one_that_is_silent_leaves_the_other_as_it_was(mix) -> None:
    line = Line(*mix)
    first, second = line.axes
    first.home(line.pause)
    missing = LeadshineStage(line.one_bus, 9, STAGE, name="9", clock=line.clock)
    for ask in (missing.state, missing.stop):
        call: Callable[[], object] = ask
        with pytest.raises(NoReply, match="device 9"):
            call()
    assert first.state().homed
    assert second.home(line.pause).homed
