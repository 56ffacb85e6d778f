"""Opening a station on wires that this test answers; their journal is the witness.

Byte level on purpose: that the first bytes to the laser are off is said by the bytes. The coils and
registers are the manuals': coil 0xFF00 on and 0x0000 off (function 5), 0x1120 the block's watchdog,
0x6002 the drive's trigger with 0x40 for stop, 0x85 Grbl's jog cancel.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace

import pytest
from pymodbus.framer.rtu import FramerRTU

from acquisition.axes import grbl_settings, leadshine_settings
from acquisition.opening import OpenStation, at_rest_unless_done, open_station
from acquisition.plan import check_plan, ring
from acquisition.safety.guarding import unguarded
from acquisition.safety.resting import REOPEN_S
from acquisition.safety.states import State
from acquisition.station import (
    HomeMark,
    HomeWay,
    LeadshineModel,
    NoLaserSwitch,
    OutputBy,
    RelayFamily,
    RelayLaser,
    Station,
    TableZero,
)
from drivers import grbl, leadshine
from drivers.errors import DriverError, LinkLost, NoReply, PortBusy, Refused
from tests.acquisition.scan_cases import STATION

LASER, TABLE, STAGE = "tcp://192.0.2.8:502", STATION.table.address, STATION.stage.address
SENSOR, PROFILES = STATION.profiler.address, STATION.profiler.profiles
OFF, ON = b"\x05\x00\x00\x00\x00", b"\x05\x00\x00\xff\x00"
STOP = b"\x06\x60\x02\x00\x40"
GRBL_STOP = b"\x85"
OPEN, CLOSE = b"opened", b"closed"  # entries of the journal that were not sent


@dataclass
class Device:
    """A Modbus device by its manual's text: what is written can be read."""

    registers: dict[int, int] = field(default_factory=dict)
    coils: dict[int, bool] = field(default_factory=dict)

    def answer(self, pdu: bytes) -> bytes:
        function, first, second = struct.unpack(">BHH", pdu[:5])
        if function == 5:
            self.coils[first] = second == 0xFF00
            return pdu
        if function == 6:
            self.registers[first] = second
            return pdu
        if function == 1:
            return bytes([1, 1, self.coils.get(first, False)])
        words = [self.registers.get(first + k, 0) for k in range(second)]
        return bytes([function, 2 * second]) + struct.pack(f">{second}H", *words)


@dataclass
class Site:
    """All wires, the time, and the journal: what was opened, sent (its PDU) and closed."""

    now_s: float = 10.0
    journal: list[tuple[str, bytes]] = field(default_factory=list)
    devices: dict[tuple[str, int], Device] = field(default_factory=dict)
    missing: dict[str, LinkLost] = field(default_factory=dict)
    cut: dict[str, str] = field(default_factory=dict)  # by address: every write fails
    mended_s: float = math.inf  # when the cut ones are whole again
    stuck: set[str] = field(default_factory=set)  # by address: closing fails

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        assert 0.0 < seconds <= 0.05
        self.now_s += seconds

    def open(self, address: str) -> Wire:
        if address in self.missing:
            raise self.missing[address]
        self.journal.append((address, OPEN))
        speak = self.grbl if address == TABLE else self.rtu if "serial" in address else self.tcp
        return Wire(self, address, speak)

    def sent(self, address: str) -> list[bytes]:
        return [
            what for where, what in self.journal if where == address and what not in (OPEN, CLOSE)
        ]

    def doors(self, door: bytes) -> list[str]:
        return [where for where, what in self.journal if what == door]

    def tcp(self, address: str, data: bytes) -> bytes:
        transaction, _, _, device_id = struct.unpack(">HHHB", data[:7])
        reply = self.ask(address, device_id, data[7:])
        return struct.pack(">HHHB", transaction, 0, len(reply) + 1, device_id) + reply

    def rtu(self, address: str, data: bytes) -> bytes:
        reply = data[:1] + self.ask(address, data[0], data[1:-2])
        return reply + FramerRTU.compute_CRC(reply).to_bytes(2, "big")

    def ask(self, address: str, device_id: int, pdu: bytes) -> bytes:
        self.journal.append((address, pdu))
        return self.devices.setdefault((address, device_id), Device()).answer(pdu)

    def grbl(self, address: str, data: bytes) -> bytes:
        self.journal.append((address, data))
        return b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n" if data == b"?" else b""


@dataclass
class Wire:
    site: Site
    address: str
    speak: Callable[[str, bytes], bytes]
    inbox: bytes = b""
    lost: str = ""

    def read(self, timeout_s: float) -> bytes:
        if self.lost:
            raise LinkLost(self.lost)
        if not self.inbox:
            self.site.now_s += timeout_s
        data, self.inbox = self.inbox, b""
        return data

    def write(self, data: bytes) -> None:
        if self.address in self.site.cut and self.site.now_s < self.site.mended_s:
            self.lost = self.site.cut[self.address]
        if self.lost:
            raise LinkLost(self.lost)
        self.inbox += self.speak(self.address, data)

    def close(self) -> None:
        self.site.journal.append((self.address, CLOSE))
        if self.address in self.site.stuck:
            raise LinkLost(f"{self.address}: does not close")


def opened(site: Site, station: Station = STATION) -> AbstractContextManager[OpenStation]:
    return open_station(
        station, clock=site.clock, sleep=site.sleep, links=site.open, guarding=unguarded
    )


def test_the_first_bytes_to_the_laser_are_off_and_nothing_else_is_asked() -> None:
    site = Site()
    with opened(site) as station:
        assert site.sent(LASER)[0] == OFF
        assert site.journal[0] == (LASER, OPEN)
        assert ON not in site.sent(LASER)
        for quiet in (TABLE, STAGE, SENSOR, PROFILES):
            assert site.sent(quiet) == []
        assert station.guarantee.watchdog_s == 0.25
        assert site.devices[LASER, 1].registers[0x1120] == 250


def test_on_the_way_out_the_laser_is_off_first_then_the_axes_stop_then_links_close() -> None:
    site = Site()
    with opened(site) as station:
        station.laser.switch.on()
        assert site.devices[LASER, 1].coils[0]
        before = len(site.journal)
    ways_out = site.journal[before:]
    order = [ways_out.index(each) for each in ((LASER, OFF), (STAGE, STOP), (TABLE, GRBL_STOP))]
    assert order == sorted(order)
    assert order[0] == 0
    assert not site.devices[LASER, 1].coils[0]
    assert site.doors(CLOSE) == site.doors(OPEN)[::-1]
    assert ways_out.count((LASER, OFF)) == 2
    assert (LASER, OFF) in ways_out[order[2] :]  # again, when the axes stand


@pytest.mark.parametrize("reason", [KeyboardInterrupt, RuntimeError, SystemExit, Refused])
def test_whatever_is_raised_inside_ends_with_laser_off_and_axes_stopped(
    reason: type[BaseException],
) -> None:
    site = Site()
    with pytest.raises(reason, match="inside"), opened(site) as station:  # noqa: PT012
        station.laser.switch.on()
        raise reason("inside")
    assert not site.devices[LASER, 1].coils[0]
    assert STOP in site.sent(STAGE)
    assert GRBL_STOP in site.sent(TABLE)
    assert len(site.doors(CLOSE)) == 5


@pytest.mark.parametrize("gone", [TABLE, STAGE, SENSOR, PROFILES])
def test_a_device_that_is_not_there_finds_the_laser_off_and_leaves_nothing_open(gone: str) -> None:
    site = Site(missing={gone: PortBusy(f"{gone}: held by process 7")})
    site.devices[LASER, 1] = Device(coils={0: True})  # somebody left it on
    with pytest.raises(PortBusy, match="process 7"), opened(site):
        pytest.fail("the station was opened")
    assert not site.devices[LASER, 1].coils[0]
    assert site.doors(CLOSE) == site.doors(OPEN)[::-1]


def test_a_laser_that_is_not_there_opens_nothing_else() -> None:
    site = Site(missing={LASER: LinkLost("no connection")})
    with pytest.raises(LinkLost, match="no connection"), opened(site):
        pytest.fail("the station was opened")
    assert site.journal == []


def test_a_way_out_that_fails_does_not_keep_the_others_back_and_the_first_error_wins() -> None:
    site = Site(stuck={PROFILES, STAGE})
    with pytest.raises(LinkLost, match="stage's cable") as lost, opened(site) as station:  # noqa: PT012
        station.laser.switch.on()
        site.cut[STAGE] = "the stage's cable is out"
    assert not site.devices[LASER, 1].coils[0]
    assert GRBL_STOP in site.sent(TABLE)
    assert sorted(site.doors(CLOSE)) == sorted(site.doors(OPEN))
    assert any("does not close" in note for note in lost.value.__notes__)


def test_off_is_said_over_a_new_link_after_the_axes_were_stopped() -> None:
    site = Site()
    with opened(site) as station:
        station.laser.switch.on()
        site.cut[LASER], site.mended_s = "the relay's cable is out", site.now_s + 1.0
        before = len(site.journal)
    way_out = site.journal[before:]
    assert not site.devices[LASER, 1].coils[0]
    order = [way_out.index(each) for each in ((TABLE, GRBL_STOP), (LASER, OPEN), (LASER, OFF))]
    assert order == sorted(order)
    assert station.safety.state is State.SHUTDOWN
    assert way_out[way_out.index((LASER, OFF)) - 1] == (LASER, OPEN)  # the first bytes are off


def test_an_axis_is_stopped_over_a_new_link_and_forgets_its_home() -> None:
    site = Site()
    with opened(site) as station:
        stage = station.stage
        stage._homed_at = stage._bus.losses  # type: ignore[attr-defined]
        site.cut[STAGE], site.mended_s = "the stage's cable is out", site.now_s + 1.0
        before = len(site.journal)
        with pytest.raises(DriverError, match="inside"), at_rest_unless_done(station):
            raise NoReply("inside")
        assert (STAGE, STOP) in site.journal[before:]
        assert not stage.state().homed
        moved = [pdu for _, pdu in site.journal[before:] if pdu[:3] == b"\x10\x62\x00"]
        assert moved == []


def test_a_link_that_stays_away_is_given_up_after_two_seconds_and_told() -> None:
    site = Site()
    with pytest.raises(Refused, match="press the emergency stop") as told, opened(site) as station:  # noqa: PT012
        site.cut[LASER] = "the relay's cable is out"
        opened_before = site.doors(OPEN).count(LASER)
    assert "not opened again in 2 s" in str(told.value)
    tries = site.doors(OPEN).count(LASER) - opened_before
    assert abs(tries - REOPEN_S / 0.05) <= 2  # and one more for the last off of all
    assert STOP in site.sent(STAGE)
    assert station.safety.situation.dark is False


def test_an_error_inside_is_the_one_that_is_raised_and_the_ways_out_are_its_notes() -> None:
    site = Site(stuck={PROFILES, SENSOR, STAGE, TABLE, LASER})
    with pytest.raises(ZeroDivisionError) as inside, opened(site):
        raise ZeroDivisionError
    assert inside.value.__notes__ == [
        f"{address}: does not close" for address in (PROFILES, SENSOR, STAGE, TABLE, LASER)
    ]


def test_devices_at_one_address_share_one_bus_however_it_is_spelled() -> None:
    same = "serial:///dev/ttyUSB1?parity=N&baud=115200"
    laser = RelayLaser(family=RelayFamily.PLAIN, address=same, device_id=9, output=3)
    site = Site()
    with opened(site, replace(STATION, laser=laser)) as station:
        station.laser.switch.on()
        assert not math.isnan(station.stage.state().position)
        assert station.guarantee.watchdog_s is None
    assert len(site.doors(OPEN)) == 4
    assert STAGE not in site.doors(OPEN)
    assert site.sent(same)[0] == b"\x05\x00\x03\x00\x00"
    assert site.devices[same, 9].coils == {3: False}


def test_an_output_bit_of_the_block_is_written_as_a_register() -> None:
    laser = replace(STATION.laser, output_by=OutputBy.REGISTER_BIT, output=4)  # type: ignore[type-var]
    site = Site()
    with opened(site, replace(STATION, laser=laser)) as station:
        station.laser.switch.on()
        assert site.devices[LASER, 1].registers[0x0800] == 1 << 4
    assert site.sent(LASER)[0] == b"\x06\x08\x00\x00\x00"
    assert site.devices[LASER, 1].registers[0x0800] == 0


def test_a_station_without_a_switch_says_so_and_opens() -> None:
    site = Site()
    with opened(site, replace(STATION, laser=NoLaserSwitch())) as station:
        assert station.guarantee.watchdog_s is None
        assert "nothing switches it" in station.guarantee.sentence
        station.laser.off()
        assert station.laser.is_on()
    assert LASER not in site.doors(OPEN)
    assert STOP in site.sent(STAGE)


def test_a_setup_of_the_sensor_is_loaded() -> None:
    site = Site()
    site.devices[SENSOR, 1] = Device(registers={401: 2})  # the active setup
    with opened(site, replace(STATION, profiler=replace(STATION.profiler, setup=2))):
        pass
    written = [struct.unpack(">HH", pdu[1:]) for pdu in site.sent(SENSOR) if pdu[0] == 6]
    assert [register for register, _ in written] == [0, 501, 1]  # enter, load, leave
    assert written[1] == (501, 2)


@pytest.mark.parametrize(
    ("station", "said"),
    [
        (
            replace(
                STATION,
                laser=RelayLaser(
                    family=RelayFamily.PLAIN, address=LASER, output_by=OutputBy.REGISTER_BIT
                ),
            ),
            "a plain relay has coils only",
        ),
        (replace(STATION, stage=replace(STATION.stage, speed_mm_s=0.01)), "less than 1"),
    ],
)
def test_what_a_driver_cannot_do_is_refused_before_anything_is_opened(
    station: Station, said: str
) -> None:
    site = Site()
    with pytest.raises(ValueError, match=said), opened(site, station):
        pytest.fail("the station was opened")
    assert site.journal == []


def test_a_block_that_is_left_badly_finds_the_laser_off_and_the_axes_stopped() -> None:
    site = Site()
    with opened(site) as station:
        with at_rest_unless_done(station):
            pass
        assert STOP not in site.sent(STAGE)
        with pytest.raises(DriverError, match="inside"), at_rest_unless_done(station):  # noqa: PT012
            station.laser.switch.on()
            raise Refused("inside")
        assert not site.devices[LASER, 1].coils[0]
        assert STOP in site.sent(STAGE)
        assert GRBL_STOP in site.sent(TABLE)


# --- the file's values as the drivers' -------------------------------------------------------


def test_the_tables_degrees_are_the_drivers_radians() -> None:
    table = replace(
        STATION.table, backlash_deg=9.0, zero_deg=45.0, zero=TableZero.SWITCH, tolerance_deg=0.18
    )
    settings = grbl_settings(table)
    assert settings.lower == pytest.approx(-math.tau / 36)
    assert settings.upper == pytest.approx(math.tau * 37 / 36)
    assert settings.speed == pytest.approx(math.tau / 4)
    assert settings.tolerance == pytest.approx(math.tau / 2000)
    assert settings.backlash == pytest.approx(math.tau / 40)
    assert settings.home_position == pytest.approx(math.tau / 8)
    assert settings.homing is grbl.Homing.SWITCH
    assert settings.steps_per_unit == 88.9
    assert settings.letter == "X"
    assert grbl_settings(STATION.table).homing is grbl.Homing.SOFTWARE_ZERO


def test_a_turn_that_just_fits_the_file_fits_the_driver() -> None:
    for stops in range(3, 2000):
        last_deg = 360.0 * (stops - 1) / stops
        table = replace(STATION.table, lowest_deg=0.0, highest_deg=last_deg)
        check_plan(ring(1.0, 1.0, 1.0, stops), replace(STATION, table=table))
        assert math.tau * (stops - 1) / stops <= grbl_settings(table).upper


def test_a_backlash_that_just_fits_the_file_fits_the_driver() -> None:
    for hundredths in range(1, 1000):
        table = replace(STATION.table, lowest_deg=-hundredths / 100, backlash_deg=hundredths / 100)
        settings = grbl_settings(table)
        below = settings.from_wire(0.0 - settings.to_wire(settings.backlash))  # as it approaches 0
        assert below >= settings.lower


def test_the_stages_words_are_the_drives() -> None:
    stage = replace(
        STATION.stage,
        model=LeadshineModel.CS2RS,
        home_mark=HomeMark.TORQUE,
        home_way=HomeWay.UP,
        home_fast_mm_s=6.0,
        home_slow_mm_s=2.0,
        home_position_mm=290.0,
        ramp_ms_per_1000_rpm=150,
    )
    settings = leadshine_settings(stage)
    assert settings.model is leadshine.Model.CS2RS
    assert settings.homing == leadshine.Homing(
        leadshine.HomingMethod.TORQUE, leadshine.HomingSense.POSITIVE, 6.0, 2.0, 290.0
    )
    assert (settings.acceleration_ms, settings.deceleration_ms) == (150, 150)
    assert (settings.low_mm, settings.high_mm, settings.speed_mm_s) == (0.0, 300.0, 20.0)
    assert (settings.pulses_per_rev, settings.lead_mm) == (10_000, 5.0)
    down = leadshine_settings(STATION.stage).homing
    assert (down.method, down.sense) == (
        leadshine.HomingMethod.LIMIT_SWITCH,
        leadshine.HomingSense.NEGATIVE,
    )


@pytest.mark.parametrize("mark", HomeMark)
@pytest.mark.parametrize("way", HomeWay)
@pytest.mark.parametrize("model", LeadshineModel)
def test_every_word_of_the_file_means_something(
    mark: HomeMark, way: HomeWay, model: LeadshineModel
) -> None:
    stage = replace(STATION.stage, home_mark=mark, home_way=way, model=model)
    assert leadshine_settings(stage).homing.method.name == mark.name
