"""The AZ axis at the simulated drive, whose register map was written down a second time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.axis import Axis, Kind, Motion
from drivers.errors import LinkLost, NoReply, Refused
from drivers.loopback import loopback
from drivers.modbus import ModbusBus
from drivers.oriental import AzAxis, Settings, Turning
from drivers.oriental.registers import DirectData, Operation, alarm_name, direct_block
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.oriental import AzDrive, AzSettings
from tests.sim.judges import Rig, world_axis

# By ymsk-sky/orientalmotorSerial @bdd0298, sent to a real AZD: 8500 steps on, at 2000 Hz.
GOLDEN = bytes.fromhex(
    "01 10 0058 0010 20 00000000 00000002 00002134 000007D0 000005DC 000005DC 000003E8 000000011C08"
)
STEPS_PER_DEG = 100.0  # a gear of 36 : 1
TURN = 36_000
TABLE = Settings(
    name="table",
    kind=Kind.ROTARY,
    steps_per_unit=STEPS_PER_DEG,
    lower=-math.tau,
    upper=2.0 * math.tau,
    speed=math.radians(90.0),
    acceleration=math.radians(900.0),
    tolerance=math.radians(0.03),
    home_position=math.radians(20.0),  # neither zero nor sign may be muddled
)
MADE = AzSettings(
    steps_per_unit=math.degrees(STEPS_PER_DEG), home_at=0.5, stored={0x390: 360},
)  # fmt: skip
NEAREST = replace(TABLE, turning=Turning.WRAP_PROXIMITY)


class Wire(Rig):
    """A drive at id 3, the driver's bus, and every frame that wrote something."""

    def __init__(self, made: AzSettings = MADE) -> None:
        self.axis = world_axis("table", 1.0, Limits(10.0, 100.0))
        self.drive = AzDrive(self.axis, made)
        self.written: list[bytes] = []
        self.lose: Callable[[bytes], str] = lambda frame: ""
        self._server = RtuServer({3: self.drive})
        super().__init__(self)

    def receive(self, data: bytes, now_s: float) -> bytes:
        if not data:
            return self._server.receive(data, now_s)
        lost = self.lose(data)
        if data[1] != 3:
            self.written.append(data)
        if lost == "request":
            return b""
        said = self._server.receive(data, now_s)
        return b"" if lost == "answer" else said

    def tick(self, now_s: float) -> bytes:
        return self._server.tick(now_s)

    def table(self, settings: Settings = TABLE) -> AzAxis:
        return AzAxis(self.bus(), 3, settings, clock=self.clock)

    def turned(self) -> float:
        return self.axis.motor(self.now_s) - MADE.home_at + TABLE.home_position

    def moves(self) -> list[bytes]:
        return [frame for frame in self.written if frame[2:4] in (b"\x00\x58", b"\x00\x78")]


@pytest.fixture
def wire() -> Wire:
    return Wire()


def test_the_one_frame_move_is_the_published_one_byte_for_byte() -> None:
    near, far = loopback(wait=lambda _: None)
    bus = ModbusBus(near, timeout_s=0.01, slowest_reply_s=0.0, clock=iter(range(99)).__next__)
    data = DirectData(Operation.RELATIVE, 8500, 2000, start_rate=1500, stop_rate=1500)
    with pytest.raises(NoReply):
        bus.write_registers(1, 0x0058, direct_block(data))
    assert far.read(0.0) == GOLDEN


def test_the_published_frame_moves_the_simulated_drive() -> None:
    axis = world_axis("az", 0.0, Limits(1e5, 1e6))
    server = RtuServer({1: AzDrive(axis, AzSettings(steps_per_unit=1.0))})
    assert server.receive(GOLDEN, 1000.0)[:6] == GOLDEN[:6]
    server.tick(1000.01)
    server.tick(1010.0)
    assert axis.motor(1010.0) == 8500.0
    assert axis.ends_s() - 1000.0 > 8500 / 2000 + 2000 / 1500  # at 2000 Hz, with ramps of 1.5 kHz/s


def test_it_is_an_axis(wire) -> None:
    axis: Axis = wire.table()
    assert axis.kind is Kind.ROTARY


def test_it_homes_and_turns_unwrapped_to_where_the_world_says(wire) -> None:
    table = wire.table()
    home = table.home(wire.pause)
    assert (home.homed, home.motion) == (True, Motion.STANDING)
    assert math.isclose(home.position, TABLE.home_position)
    for target_rad in (1.0, 7.0, -2.0, 0.0):
        state = table.move_to(target_rad, wire.pause)
        assert wire.axis.stands(wire.now_s)
        assert math.isclose(wire.turned(), target_rad, abs_tol=1e-4)
        assert math.isclose(state.position, target_rad, abs_tol=1e-4)


def test_by_wrap_proximity_it_takes_the_shorter_way_and_keeps_the_name_that_was_asked_for() -> None:
    wire = Wire()
    table = wire.table(NEAREST)
    table.home(wire.pause)
    turned = wire.turned()
    for target_deg, way_deg in ((350.0, -30.0), (0.0, 10.0), (120.0, 120.0), (290.0, 170.0)):
        state = table.move_to(math.radians(target_deg), wire.pause)
        assert math.isclose(state.position, math.radians(target_deg), abs_tol=1e-4)
        assert math.isclose(wire.turned() - turned, math.radians(way_deg), abs_tol=2e-4)
        turned = wire.turned()
        assert math.isclose(table.state().position, math.radians(target_deg), abs_tol=1e-4)


def test_by_wrap_absolute_it_never_crosses_the_border_of_the_drives_turn() -> None:
    wire = Wire()
    table = wire.table(replace(TABLE, turning=Turning.WRAP_ABSOLUTE))
    table.home(wire.pause)
    # Home is 20 deg, and the drive's turn is from -180 to 180 around it: -160 to 200 by name.
    for target_deg, stands_deg in ((190.0, 190.0), (210.0, -150.0), (0.0, 0.0), (359.0, -1.0)):
        state = table.move_to(math.radians(target_deg), wire.pause)
        assert math.isclose(wire.turned(), math.radians(stands_deg), abs_tol=2e-4)
        assert math.isclose(state.position, math.radians(target_deg), abs_tol=1e-4)


def test_nothing_is_sent_for_a_target_outside_the_limits_or_before_homing(wire) -> None:
    table = wire.table()
    heard: list[bytes] = []
    wire.lose = lambda frame: heard.append(frame) or ""
    for outside in (-6.4, 13.0):
        with pytest.raises(Refused, match="soft limits"):
            table.move_to(outside, wire.pause)
    with pytest.raises(ValueError, match="no position"):
        table.move_to(math.inf, wire.pause)
    with pytest.raises(Refused, match="not homed"):
        table.move_to(1.0, wire.pause)
    assert heard == []


def test_it_jogs_unhomed_by_a_degree_and_no_more(wire) -> None:
    table = wire.table()
    here, stood = table.state().position, wire.axis.motor(wire.now_s)
    table.jog_to(here + math.radians(0.9), wire.pause)
    assert math.isclose(wire.axis.motor(wire.now_s) - stood, math.radians(0.9), abs_tol=2e-4)
    with pytest.raises(Refused, match="jogs at most"):
        table.jog_to(here + 1.0, wire.pause)


@pytest.mark.parametrize(
    ("stored", "settings", "words"),
    [
        ({0x382: 2}, TABLE, "2000 steps a turn of the motor"),
        ({0x390: 10}, NEAREST, "wraps at 1000 steps"),
        ({0x390: 360, 0x38E: 0}, NEAREST, "wraps at 0 steps"),
    ],
)
def test_a_drive_whose_scale_is_not_the_stations_is_refused_and_nothing_moves(
    stored, settings, words
) -> None:
    wire = Wire(replace(MADE, stored=stored))
    table = wire.table(settings)
    for refused in (table.identify, lambda: table.home(wire.pause)):
        with pytest.raises(Refused, match=words):
            refused()
    assert wire.moves() == []


def test_a_drive_that_does_not_tell_its_gear_says_so() -> None:
    wire = Wire(replace(MADE, tells_parameters=False))
    assert wire.table(NEAREST).identify().model == "AZ, gear not told, wrap not told"
    assert Wire().table(NEAREST).identify().model == "AZ, 1000 steps/rev, wraps at 36000"


def test_a_lost_answer_to_a_move_decides_by_the_position_and_is_not_sent_again(wire) -> None:
    table = wire.table()
    table.home(wire.pause)
    wire.written.clear()
    wire.lose = lambda frame: "answer" if frame[1:4] == b"\x10\x00\x58" else ""
    assert math.isclose(table.move_to(1.0, wire.pause).position, 1.0, abs_tol=1e-4)
    assert len(wire.moves()) == 1
    wire.lose = lambda frame: "request" if frame[1:4] == b"\x10\x00\x58" else ""
    with pytest.raises(NoReply, match="not sent again"):
        table.move_to(2.0, wire.pause)
    # One move each, and the stop that follows a failure.
    assert [frame[2:4] for frame in wire.moves()] == [b"\x00\x58", b"\x00\x58", b"\x00\x78"]


def test_a_stop_brakes_and_is_repeated_until_acknowledged(wire) -> None:
    table = wire.table()
    table.home(wire.pause)
    wire.written.clear()
    losses = iter(["request", "request", ""])
    wire.lose = lambda frame: next(losses) if frame[2:4] == b"\x00\x78" else ""

    def pause(seconds: float) -> None:
        wire.pause(seconds)
        if wire.turned() > 1.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        table.move_to(6.0, pause)
    assert [frame[2:4] for frame in wire.moves()] == [b"\x00\x58"] + 3 * [b"\x00\x78"]
    wire.pause(0.5)
    assert wire.axis.stands(wire.now_s)
    assert wire.turned() < 6.0
    assert not wire.table().state().homed  # a new connection knows no home


def test_a_held_shaft_is_a_named_alarm_and_homed_is_lost(wire) -> None:
    table = wire.table()
    table.home(wire.pause)
    wire.axis.obstacle = 1.2
    with pytest.raises(Refused, match="0x10 excessive position deviation") as refused:
        table.move_to(3.0, wire.pause)
    assert refused.value.code == 0x10
    state = table.state()
    assert (state.motion, state.homed) == (Motion.ALARM, False)
    with pytest.raises(Refused, match="not homed"):
        table.move_to(0.5, wire.pause)
    wire.axis.obstacle = None
    table.clear_alarm()
    assert table.home(wire.pause).homed


def test_a_held_shaft_of_which_the_drive_says_nothing_is_found_by_the_position() -> None:
    wire = Wire(replace(MADE, tells_deviation=False))
    table = wire.table()
    table.home(wire.pause)
    wire.axis.obstacle = MADE.home_at - TABLE.home_position + 3.0 - math.radians(0.05)
    with pytest.raises(Refused, match="stands at"):
        table.move_to(3.0, wire.pause)
    assert not table.state().homed


def test_a_sensor_without_a_home_is_alarm_4a(wire) -> None:
    wire = Wire(replace(MADE, home_set=False))
    with pytest.raises(Refused, match="0x4A move before homing"):
        wire.table().home(wire.pause)


def test_a_lost_link_forgets_homed(wire) -> None:
    table = wire.table()
    table.home(wire.pause)
    wire.link.close()
    with pytest.raises(LinkLost):
        table.state()
    with pytest.raises(Refused, match="not homed"):
        table.move_to(1.0, wire.pause)


def test_an_alarm_of_the_list_has_its_name_and_another_its_number() -> None:
    assert alarm_name(0x33) == "0x33 absolute position lost"
    assert alarm_name(0x99) == "0x99 unknown alarm"


@pytest.mark.parametrize(
    "changed",
    [
        {"steps_per_unit": 0.0}, {"lower": 20.0}, {"tolerance": 1e-6}, {"speed": 1e9},
        {"acceleration": 1e9}, {"upper": 1e9}, {"settle_s": 0.0},
        {"turning": Turning.WRAP_ABSOLUTE, "steps_per_unit": 100.0 / 7},
        {"turning": Turning.WRAP_ABSOLUTE, "kind": Kind.LINEAR},
    ],
)  # fmt: skip
def test_settings_that_make_no_axis_are_the_callers_mistake(changed) -> None:
    with pytest.raises(ValueError, match=r"table|fit"):
        replace(TABLE, **changed)
