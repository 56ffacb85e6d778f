"""mbpoll (libmodbus) at the simulated devices: what it reads is written here, from the manuals.

Nothing of ours stands between: neither a driver nor pymodbus, which both ends could misuse alike.
Addresses and values: Leadshine's PR registers, Turck's I/O block, Baumer's OX200.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from acquisition.station import RelayLaser, read_station
from loftscan import simulate
from loftscan.simulation import Simulated

pytestmark = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not installed: apt-get install mbpoll"
)

PATIENCE_S = 30.0  # for a machine that does a lot else
COILS, INPUTS, HOLDING = "0", "3", "4"
COUNTS_PER_MM = 10_000 / 5.0  # pulses of a turn, over the screw's lead
SWITCH_MM = -2.0  # where the simulated stage has its limit switch


@dataclass(frozen=True)
class Master:
    """One mbpoll a call; PDU addresses, one try, five seconds for an answer."""

    where: str
    options: tuple[str, ...]

    def run(self, table: str, first: int, *more: object) -> subprocess.CompletedProcess[str]:
        words = ("mbpoll", *self.options, "-0", "-1", "-o", 5, "-t", table, "-r", first, *more)
        return subprocess.run(
            [str(word) for word in words], capture_output=True, text=True, check=False,
            timeout=PATIENCE_S,
        )  # fmt: skip

    def read(self, table: str, first: int, count: int = 1, *options: object) -> list[str]:
        ran = self.run(table, first, "-c", count, *options, self.where)
        assert ran.returncode == 0, ran.stderr
        return re.findall(r"^\[\d+\]:\s+(\S+)", ran.stdout, re.MULTILINE)

    def write(self, table: str, first: int, *values: int) -> None:
        ran = self.run(table, first, self.where, "--", *values)
        assert ran.returncode == 0, ran.stderr
        assert f"Written {len(values)} references." in ran.stdout

    def refused(self, table: str, first: int, *more: object) -> str:
        """Why the device did not do it."""
        ran = self.run(table, first, *more)
        assert ran.returncode == 1, ran.stdout
        return ran.stderr.strip().partition(": ")[2]


@pytest.fixture(scope="module")
def station() -> Iterator[Simulated]:
    with simulate(seed=1, scale=20.0) as simulated:
        yield simulated


@pytest.fixture
def drive(station: Simulated) -> Master:
    port, _, rest = read_station(station.station).stage.address.partition("?baud=")
    options = ("-m", "rtu", "-b", rest, "-P", "none", "-a", "1")
    return Master(port.removeprefix("serial://"), options)


@pytest.fixture
def block(station: Simulated) -> Iterator[Master]:
    laser = read_station(station.station).laser
    assert isinstance(laser, RelayLaser)
    master = over_tcp(laser.address)
    yield master
    master.write(COILS, 0, 0)


@pytest.fixture
def sensor(station: Simulated) -> Master:
    return over_tcp(read_station(station.station).profiler.address)


def over_tcp(address: str) -> Master:
    host, _, port = address.removeprefix("tcp://").partition(":")
    return Master(host, ("-m", "tcp", "-p", port, "-a", "1"))


def witnessed(station: Simulated, what: str) -> list[dict[str, object]]:
    events = map(json.loads, station.witness.read_text().splitlines())
    return [event for event in events if event["what"] == what]


def soon(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


# -- the drive, on a serial line -------------------------------------------------------------------


def test_the_drive_tells_its_pulses_and_its_loop(drive: Master) -> None:
    assert drive.read(HOLDING, 0x0001) == ["10000"]
    assert drive.read(HOLDING, 0x0003) == ["2"]  # closed
    assert drive.read("4:hex", 0x2203) == ["0x0000"]  # no alarm


def test_the_drive_homes_and_moves_by_frames_of_the_manual(
    drive: Master, station: Simulated
) -> None:
    # Towards negative, by the limit switch, whose place is called -20000: 0xFFFFB1E0.
    drive.write(HOLDING, 0x600A, 0, 0xFFFF, 0xB1E0, 0xFFFF, 0xB1E0, 240, 60, 100, 100)
    drive.write(HOLDING, 0x6002, 0x0020)
    soon(lambda: int(drive.read("4:hex", 0x1003)[0], 16) & 0x44 == 0x40)  # homed and not running
    assert drive.read("4:int", 0x602C, 1, "-B") == ["-20000"]
    for counts, high, low in ((70_000, 0x0001, 0x1170), (-3_000, 0xFFFF, 0xF448)):
        drive.write(HOLDING, 0x6200, 1, high, low, 240, 100, 100, 0, 0x0010)
        soon(lambda: drive.read("4:hex", 0x1003) == ["0x0072"])  # the 0x0032 of the manual, homed
        assert drive.read("4:int", 0x602C, 1, "-B") == [str(counts)]
        assert drive.read("4:hex", 0x602C, 2) == [f"0x{high:04X}", f"0x{low:04X}"]
        (*_, moved) = [each for each in witnessed(station, "move") if each["axis"] == "stage"]
        assert moved["target"] == pytest.approx(SWITCH_MM + (counts + 20_000) / COUNTS_PER_MM)


def test_the_drive_refuses_what_it_has_not_and_is_silent_for_others(drive: Master) -> None:
    assert drive.refused(HOLDING, 0x7000, drive.where) == "Illegal data address"
    assert drive.refused(HOLDING, 0x7000, drive.where, "--", 1) == "Illegal data address"
    assert drive.refused(COILS, 0, drive.where) == "Illegal function"
    assert drive.refused(HOLDING, 0x0001, "-a", 9, "-o", 0.3, drive.where) == "Connection timed out"


# -- the block of outputs, over TCP ----------------------------------------------------------------


def test_the_block_switches_the_laser_and_only_that_output(
    block: Master, station: Simulated
) -> None:
    block.write(HOLDING, 0x1120, 0)  # without a watchdog the outputs hold
    before = len(witnessed(station, "laser"))
    block.write(COILS, 0, 1)
    assert block.read(COILS, 0, 8) == ["1", *"0000000"]
    assert block.read(HOLDING, 0x0800) == ["1"]
    block.write(COILS, 0, 0)
    assert block.read(COILS, 0, 8) == [*"00000000"]
    block.write(COILS, 7, 1)
    block.write(COILS, 7, 0)
    assert [each["on"] for each in witnessed(station, "laser")[before:]] == [True, False]


def test_the_block_drops_its_outputs_when_nobody_talks_to_it(
    block: Master, station: Simulated
) -> None:
    block.write(HOLDING, 0x1120, 300)
    assert block.read(HOLDING, 0x1120) == ["300"]
    block.write(COILS, 0, 1)
    soon(lambda: not witnessed(station, "laser")[-1]["on"])
    on, off = witnessed(station, "laser")[-2:]
    assert on["on"]
    assert float(str(off["time_s"])) - float(str(on["time_s"])) > 0.299
    assert off["why"] == "watchdog"
    assert block.read(COILS, 0) == ["0"]


def test_the_block_refuses_what_it_has_not(block: Master) -> None:
    assert block.refused(COILS, 0, "-c", 9, block.where) == "Illegal data address"
    assert block.refused(COILS, 8, block.where, "--", 1) == "Illegal data address"
    assert block.refused(HOLDING, 0x7000, block.where) == "Illegal data address"


# -- the sensor, over TCP --------------------------------------------------------------------------


def test_the_sensor_tells_who_it_is(sensor: Master) -> None:
    assert sensor.read("3:hex", 0, 3) == ["0x4261", "0x756D", "0x6572"]  # Ba um er
    words = [int(word, 16) for word in sensor.read("3:hex", 40, 49)]
    text = b"".join(word.to_bytes(2, "big") for word in words)
    assert text[9:74].startswith(b"OX200")  # after the product's id, 9 bytes
    assert text[74:94].rstrip(b"\0") == b"SIM0001"


def test_the_sensor_tells_its_readings_the_low_word_first(sensor: Master) -> None:
    status, quality, outputs = map(int, sensor.read(INPUTS, 200, 3))
    assert not status & 0b0111  # not being set up, no NTP, nothing valid to be measured
    assert (quality, outputs) == (2, 0)  # not lit: no signal
    assert sensor.read("3:float", 217) == ["100"]
    assert sensor.read("3:hex", 217, 2) == ["0x0000", "0x42C8"]  # 100 Hz is 0x42C80000
    before, after = (int(sensor.read("3:int", 219)[0]) for _ in range(2))  # seconds
    assert 0 <= before <= after < 1 << 16


def test_the_sensor_loads_a_setup_in_its_parametrisation(sensor: Master) -> None:
    for setup in (2, 1):
        sensor.write(HOLDING, 0, 1)
        sensor.write(HOLDING, 501, setup)
        sensor.write(HOLDING, 1, 1)
        assert sensor.read(INPUTS, 401) == [str(setup)]


def test_the_sensor_refuses_what_it_has_not(sensor: Master) -> None:
    assert sensor.refused(INPUTS, 300, sensor.where) == "Illegal data address"
    assert sensor.refused(HOLDING, 7, sensor.where) == "Illegal data address"
    assert sensor.refused(COILS, 0, sensor.where) == "Illegal function"
