"""[profiler] of station.toml, family by family: read, written, refused in one line, made."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from acquisition.ports import check_ports
from acquisition.profiler_settings import (
    BannerEzArray,
    Hokuyo,
    HokuyoPort,
    RegisterProfiler,
    Riftek,
    RiftekTrigger,
    SickAddresses,
    SickByteOrder,
    SickProfiler2,
)
from acquisition.profilers import as_it_is, lost_profile, patience_s, profiler_maker
from acquisition.station import (
    GrblLaser,
    HokuyoLaser,
    NoLaserSwitch,
    Station,
    parse_station,
    write_station,
)
from drivers import sick
from drivers.profiler import Reason
from drivers.register_profiler import Flag, Packing, Table, Trigger, WordOrder
from drivers.riftek import Sync
from tests.acquisition.scan_cases import STATION

REGISTERS = RegisterProfiler(
    address="serial:///dev/ttyUSB2?baud=115200&parity=E",
    first_register=16,
    rate_hz=50.0,
    points_per_profile=320,
    z_mm_per_count=0.01,
    z_offset_mm=150.0,
    column_pitch_mm=0.25,
    first_column_mm=-40.0,
    no_return_value=65_535,
    sequence_register=1,
)
RIFTEK = Riftek(
    address="tcp://192.168.1.30:80",
    profiles="udp://:50001",
    rate_hz=490.0,
    points_per_profile=648,
    set_rate=True,
    exposure_us=300.0,
    trigger=RiftekTrigger.SOFTWARE,
    z_offset_mm=75.0,
)
SCREEN = BannerEzArray(
    address="tcp://192.168.1.31:502", rate_hz=20.0, points_per_profile=120, channel_pitch_mm=5.0
)
HOKUYO = Hokuyo(address="serial:///dev/ttyUSB2?baud=750000", first_step=304, last_step=464)
SICK = SickProfiler2(
    address="serial:///dev/ttyUSB3?baud=2000000",
    points=832,
    x_mm_per_count=0.0005,
    z_mm_per_count=-0.0005,
    z_offset_mm=150.0,
)
EVERY = [STATION.profiler, REGISTERS, RIFTEK, SCREEN, HOKUYO, SICK]
OWN = HokuyoLaser(address=HOKUYO.address)


def station_with(profiler: object) -> Station:
    return replace(STATION, profiler=profiler)  # type: ignore[arg-type]


@pytest.mark.parametrize("profiler", EVERY)
def test_a_station_with_this_profiler_is_written_and_read_back(profiler) -> None:
    station = station_with(profiler)
    text = write_station(station)
    assert parse_station(text) == station
    assert f'[profiler]\nfamily = "{profiler.family}"' in text


def test_what_the_file_says_of_registers_is_what_the_driver_reads_by() -> None:
    layout = replace(
        REGISTERS, function=3, words_per_value=2, signed=True, saturated_value=-1,
        ready_register=4, ready_bit=3, trigger_register=9, trigger_value=7,
    ).layout  # fmt: skip
    assert (layout.table, layout.packing) == (Table.HOLDING, Packing.TWO_WORDS)
    assert (layout.word_order, layout.signed) == (WordOrder.HIGH_FIRST, True)
    assert layout.registers == range(16, 16 + 640)
    assert layout.missing == ((65_535, Reason.NO_RETURN), (-1, Reason.SATURATED))
    assert (layout.sequence_register, layout.ready, layout.trigger) == (
        1,
        Flag(4, 3),
        Trigger(9, 7),
    )
    assert (layout.column_pitch_mm, layout.first_column_mm) == (0.25, -40.0)
    assert (layout.z_mm_per_count, layout.z_offset_mm) == (0.01, 150.0)


def test_what_is_written_to_a_riftek_is_in_its_units_and_can_be_left_out() -> None:
    told = RIFTEK.driver_settings
    assert (told.rate_hz, told.exposure_us, told.sync) == (490, 300.0, Sync.SOFTWARE)
    plain = as_it_is(RIFTEK)
    assert isinstance(plain, Riftek)
    assert plain.driver_settings.parameters == {}
    assert as_it_is(REGISTERS) is REGISTERS


@pytest.mark.parametrize("profiler", EVERY)
def test_a_lost_profile_has_every_place_of_this_family(profiler) -> None:
    lost = lost_profile(profiler)
    assert np.all(lost.reasons == Reason.LOST)
    assert len(lost.reasons) == profiler.points_per_profile


@pytest.mark.parametrize(
    ("profiler", "pattern", "instead", "said"),
    [
        (REGISTERS, 'family = "registers"', 'family = "modbus"', "family: 'modbus' is not"),
        (REGISTERS, "function = 4", "function = 6", "profiler.function: 6 is out of bounds"),
        (REGISTERS, "first_register = 16", "first_register = 65500",
         "profiler.first_register: 320 columns from 65500 on end at 65819; the last register is"),
        (REGISTERS, "first_register = 16", "first_register = -1", "profiler.first_register: -1 is"),
        (REGISTERS, "points_per_profile = 320", "points_per_profile = 0",
         "profiler.points_per_profile: 0 is out of bounds"),
        (REGISTERS, "words_per_value = 1", "words_per_value = 3", "words_per_value: 3 is out of"),
        (REGISTERS, "z_mm_per_count = 0.01", "z_mm_per_count = 0.0",
         "profiler.z_mm_per_count = 0.0; it must be finite and not 0"),
        (REGISTERS, "z_mm_per_count = 0.01", "z_mm_per_count = nan",
         "profiler.z_mm_per_count: nan is out of bounds"),
        (REGISTERS, "column_pitch_mm = 0.25", "column_pitch_mm = 0", "column_pitch_mm = 0.0; it"),
        (REGISTERS, "no_return_value = 65535", "no_return_value = 65536",
         "profiler.no_return_value: 65536; write a whole number from 0 to 65535"),
        (REGISTERS, "# saturated_value =", "saturated_value = 65535 #",
         "profiler.saturated_value: 65535 stands for no_return_value, too"),
        (REGISTERS, "sequence_register = 1 ", "sequence_register = 20 ",
         "profiler.sequence_register: 20 holds a column"),
        (REGISTERS, "^sequence_register = 1 .*", "",
         "profiler.points_per_profile: 320 registers are more than one frame's 125"),
        (REGISTERS, "^sequence_register = 1 .*", "trigger_register = 3",
         "profiler.trigger_register: nothing tells when the profile is there"),
        (REGISTERS, "ready_bit = 0", "ready_bit = 16", "profiler.ready_bit: 16 is out of bounds"),
        (REGISTERS, 'word_order = "high first"', 'word_order = "big"', "word_order: 'big' is not"),
        (SCREEN, "points_per_profile = 120", "points_per_profile = 481", "481 is out of bounds"),
        (SCREEN, "channel_pitch_mm = 5.0", "channel_pitch_mm = 0.0", "column_pitch_mm = 0.0"),
        (RIFTEK, "rate_hz = 490.0", "rate_hz = 490.5", "profiler.rate_hz: 490.5; the sensor takes"),
        (RIFTEK, "rate_hz = 490.0", "rate_hz = 20001.0", "profiler.rate_hz: 20001; the sensor"),
        (RIFTEK, "exposure_us = 300.0", "exposure_us = 1.0", "exposure_us: 1.0 is out of bounds"),
        (RIFTEK, 'address = "tcp://192.168.1.30:80"', 'address = "http://192.168.1.30"',
         "profiler.address: 'http://192.168.1.30' is no address; begin it with one of tcp://"),
        (HOKUYO, "last_step = 464", "last_step = 300",
         "profiler.first_step: 304 is above last_step 300; swap them"),
        (HOKUYO, "cluster = 1", "cluster = 0", "profiler.cluster: 0 is out of bounds"),
        (HOKUYO, "baud=750000", "baud=19200", 'raise the baud rate; or write port = "usb"'),
        (HOKUYO, 'port = "rs-232"', 'port = "serial"', "profiler.port: 'serial' is not known"),
        (SICK, 'address = "serial:[^"]*"', 'address = "tcp://192.168.1.30:502"',
         "profiler.address: 'tcp://192.168.1.30:502' is no address; begin it with one of serial://"),
        (SICK, "thinning = 1", "thinning = 16", "profiler.thinning: 16 is out of bounds"),
        (SICK, "points = 832", "points = 2048", "profiler.points: 2048 is out of bounds"),
        (SICK, "x_mm_per_count = 0.0005", "x_mm_per_count = 0.0", "x_mm_per_count: 0.0 is out"),
        (SICK, "z_mm_per_count = -0.0005", "z_mm_per_count = 0.0",
         "z_mm_per_count = 0.0; it must be finite and not 0"),
        (SICK, 'byte_order = "high byte first"', 'byte_order = "big"', "byte_order: 'big' is not"),
        (RIFTEK, 'profiles = "udp://:50001"', 'profiles = "udp://"', "profiler.profiles: address"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_in_one_line(profiler, pattern, instead, said) -> None:
    text = write_station(station_with(profiler))
    head, table, rest = text.partition("[profiler]")
    changed, count = re.subn(pattern, instead, rest, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    with pytest.raises(ValueError, match=re.escape(said)) as refused:
        parse_station(head + table + changed)
    assert str(refused.value).startswith("station.toml: profiler.")
    assert "\n" not in str(refused.value)


def test_a_maker_checks_its_settings_and_opens_nothing() -> None:
    for profiler in EVERY:
        assert callable(profiler_maker(profiler))


# -- Hokuyo and SICK ------------------------------------------------------------------------------


def test_what_the_file_says_of_a_hokuyo_is_what_its_driver_asks_by() -> None:
    told = replace(HOKUYO, cluster=3, serial="H1", firmware="3.")
    driver = told.driver_settings
    assert (driver.first_step, driver.last_step, driver.cluster) == (304, 464, 3)
    assert (driver.baud, driver.serial, driver.firmware) == (750_000, "H1", "3.")
    assert told.points_per_profile == 54  # 161 steps by three
    # On USB and on a network bytes take no time, whatever rate the address has.
    assert replace(HOKUYO, port=HokuyoPort.USB).driver_settings.baud is None
    assert replace(HOKUYO, address="tcp://192.168.0.10:10940").driver_settings.baud is None


def test_what_the_file_says_of_a_sick_is_what_its_driver_reads_by() -> None:
    told = replace(SICK, thinning=4, byte_order=SickByteOrder.LITTLE, addresses=SickAddresses.BYTES)
    driver = told.driver_settings
    assert (driver.points, driver.thinning, told.points_per_profile) == (832, 4, 208)
    assert (driver.byte_order, driver.addresses) == (sick.ByteOrder.LITTLE, sick.Addresses.BYTES)
    assert (driver.x_mm_per_count, driver.z_mm_per_count) == (0.0005, -0.0005)


def test_a_sick_is_as_fast_as_its_line() -> None:
    """832 points are 3328 bytes, and about 8 questions; the manual's own arithmetic."""
    slow = replace(SICK, address="serial:///dev/ttyUSB3?baud=115200")
    assert 1.0 / slow.rate_hz == pytest.approx(0.31, abs=0.03)
    assert 1.0 / SICK.rate_hz == pytest.approx(0.037, abs=0.005)
    # A lost answer costs 2 s, until the sensor has forgotten the question: that is waited for.
    assert patience_s(SICK) > 2.0 + 2.0 / SICK.rate_hz
    assert patience_s(HOKUYO) == pytest.approx(0.55)


def test_a_hokuyo_switches_its_own_laser_and_nobody_elses() -> None:
    station = replace(STATION, profiler=HOKUYO, laser=OWN)
    assert parse_station(write_station(station)) == station
    with pytest.raises(ValueError, match=r"^laser\.switch: a sick profiler has no switch"):
        replace(station, profiler=SICK)
    with pytest.raises(ValueError, match=r"^laser\.address: serial.* is not the profiler's"):
        replace(station, laser=HokuyoLaser(address="serial:///dev/ttyUSB9?baud=750000"))
    # A relay in its supply line may switch a sensor that measures as soon as it has power.
    replace(station, laser=STATION.laser)


def test_a_scanner_shares_its_port_with_its_own_laser_alone() -> None:
    own = replace(STATION, profiler=HOKUYO, laser=OWN)
    check_ports(own)
    bus = replace(STATION.stage, address=HOKUYO.address)
    with pytest.raises(ValueError, match="Modbus and SCIP cannot share one; give it its own"):
        check_ports(replace(own, stage=bus))


@pytest.mark.parametrize("role", ["table", "stage"])
def test_a_sick_shares_its_port_with_nobody(role: str) -> None:
    device = replace(getattr(STATION, role), address=SICK.address)
    crowded = replace(station_with(SICK), laser=NoLaserSwitch(), **{role: device})
    said = "profiler.address: /dev/ttyUSB3 is the .*SICK's protocol cannot share one"
    with pytest.raises(ValueError, match=said):
        check_ports(crowded)


def test_a_laser_board_shares_its_port_with_no_modbus_device() -> None:
    board = GrblLaser(address=STATION.stage.address)
    with pytest.raises(ValueError, match="Modbus and Grbl cannot share one; give it its own"):
        check_ports(replace(STATION, laser=board))
