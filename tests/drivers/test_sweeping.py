"""Tables that are swept: at the speed that was told, telling where they are, dark before a stop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from acquisition.station import parse_station
from drivers.errors import Refused
from drivers.sweeping import Course, Sweeper
from sim.axes import TableFamily
from sim.parts import cylinder
from sim.sensor import Sensor
from sim.stations import Layout, station_toml
from tests.acquisition.virtual_station import ADDRESSES, VirtualStation, virtual_station

SPEED = math.radians(60.0)
FAMILIES = [TableFamily.GRBL, TableFamily.GRBLHAL, TableFamily.ORIENTAL]


@dataclass
class Looking:
    """Who looks on, with the truth beside what was told."""

    at: VirtualStation
    asked: list[tuple[float, float, float]] = field(default_factory=list)
    failed_moving: bool | None = None

    def seen(self, asked_s: float, position: float) -> None:
        true = self.at.devices.world.table.motor(asked_s)
        self.asked.append((asked_s, position, true))

    def failing(self) -> None:
        self.failed_moving = not self.at.devices.world.table.stands(self.at.room.now_s)


@pytest.fixture(params=FAMILIES, ids=lambda family: family.value)
def at(request: pytest.FixtureRequest) -> Iterator[VirtualStation]:
    layout = Layout(table_family=request.param, sensor=Sensor(points=32))
    shared = request.param is TableFamily.ORIENTAL
    addresses = replace(ADDRESSES, stage=ADDRESSES.table) if shared else ADDRESSES
    text = station_toml(layout, addresses, "cylinder").replace("wrap proximity", "unwrapped")
    with virtual_station(layout, cylinder(20.0, 40.0), settings=parse_station(text)) as made:
        made.station.table.home(made.station.sleep)
        yield made


def sweeper(at: VirtualStation) -> Sweeper:
    table = at.station.table
    assert isinstance(table, Sweeper)
    return table


@pytest.mark.parametrize("to_deg", [375.0, -15.0])
def test_it_arrives_at_a_steady_speed_and_tells_where_it_is(
    at: VirtualStation, to_deg: float
) -> None:
    at.station.table.move_to(math.radians(360.0 - to_deg), at.station.sleep)
    looking = Looking(at)
    state = sweeper(at).sweep_to(math.radians(to_deg), Course(SPEED, looking), at.station.sleep)
    assert math.degrees(state.position) == pytest.approx(to_deg, abs=0.02)
    asked_s, told, true = np.array(looking.asked).T
    assert len(asked_s) > 100
    assert max(np.diff(asked_s)) < 0.1
    # The device's position is that of the question, but for the turn of its zero.
    assert np.ptp(told - true) < 1e-3
    amid = (np.degrees(told) > 10.0) & (np.degrees(told) < 350.0)
    slope = np.polyfit(asked_s[amid] - asked_s[0], told[amid], 1)[0]
    assert abs(slope) == pytest.approx(SPEED, rel=1e-3)


def test_who_gives_up_is_told_before_the_table_is_stopped(at: VirtualStation) -> None:
    looking, since_s = Looking(at), at.room.now_s

    def pause(seconds: float, /) -> None:
        at.room.sleep(seconds)
        if at.room.now_s > since_s + 2.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweeper(at).sweep_to(math.radians(375.0), Course(SPEED, looking), pause)
    assert looking.failed_moving is True
    at.room.sleep(0.5)
    assert at.devices.world.table.stands(at.room.now_s)


@pytest.mark.parametrize(
    ("to_deg", "speed_deg_s", "said"),
    [(375.0, 200.0, "200 deg/s"), (4000.0, 60.0, r"outside its (soft )?limits")],
)
def test_what_it_cannot_is_refused_and_nothing_moves(
    at: VirtualStation, to_deg: float, speed_deg_s: float, said: str
) -> None:
    begun = len(at.witness.events)
    course = Course(math.radians(speed_deg_s), Looking(at))
    with pytest.raises(Refused, match=said):
        sweeper(at).sweep_to(math.radians(to_deg), course, at.station.sleep)
    assert [e for e in at.witness.events[begun:] if e["what"] == "move"] == []
