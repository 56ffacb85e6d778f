"""Our drivers at servers of modbus-tk, which shares no line of code with them.

The frames that the drivers sent are compared with PDUs that are spelled out here.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from drivers.axis import Motion
from drivers.baumer_ox import BaumerOx, Quality
from drivers.baumer_ox import Settings as OxSettings
from drivers.errors import NoReply, Refused
from drivers.leadshine import (
    Homing,
    HomingMethod,
    HomingSense,
    LeadshineStage,
    Model,
    StageSettings,
)
from drivers.links import open_link
from drivers.loopback import loopback
from drivers.modbus import Framing, ModbusBus
from drivers.relay import Coil, OutputBit, PlainRelay, WatchedBlock

PROGRAM = Path(__file__).with_name("servers.py")
PATIENCE_S = 30.0
LATE_S = 0.05  # how long after a request a reply may still come, in the bus's mind

STAGE = StageSettings(
    model=Model.CS2RS,
    pulses_per_rev=10_000,
    lead_mm=5.0,
    low_mm=-5.0,
    high_mm=300.0,
    speed_mm_s=20.0,
    tolerance_mm=0.001,
    homing=Homing(HomingMethod.HOME_SWITCH, HomingSense.NEGATIVE, 10.0, 2.5, reference_mm=-3.0),
    settle_s=2.0,  # so long that only bits that were seen to drop end a move in time
)


@dataclass(frozen=True)
class Peer:
    """A server in a process of its own."""

    process: subprocess.Popen[str]
    address: str

    def written(self) -> list[str]:
        """End it; the PDUs that wrote something."""
        stdout, _ = self.process.communicate("", timeout=PATIENCE_S)
        return stdout.splitlines()


@contextmanager
def serving(
    kind: str, framing: Framing, *, timeout_s: float = 3.0
) -> Iterator[tuple[Peer, ModbusBus]]:
    child = subprocess.Popen(
        [sys.executable, PROGRAM, kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        address = child.stdout.readline().strip()
        with closing(open_link(address)) as link:
            yield (
                Peer(child, address),
                ModbusBus(link, framing, timeout_s=timeout_s, slowest_reply_s=LATE_S),
            )
    finally:
        child.kill()
        child.communicate()


@pytest.fixture
def drive() -> Iterator[tuple[Peer, ModbusBus]]:
    with serving("drive", Framing.RTU) as served:
        yield served


@pytest.fixture
def sensor() -> Iterator[tuple[Peer, ModbusBus]]:
    with serving("sensor", Framing.TCP) as served:
        yield served


def ox(bus: ModbusBus) -> BaumerOx:
    return BaumerOx(bus, loopback("unused")[0], OxSettings(0.01, 0.005))


# -- the stage -------------------------------------------------------------------------------------


def test_the_stage_homes_moves_and_stops_in_the_frames_of_the_manual(drive) -> None:
    peer, bus = drive
    stage = LeadshineStage(bus, 7, STAGE)
    home = stage.home(time.sleep)
    assert (home.position, home.homed) == (-3.0, True)
    for target_mm in (35.0, -1.5):
        begun_s = time.monotonic()
        state = stage.move_to(target_mm, time.sleep)
        assert time.monotonic() - begun_s > 0.79  # not by the old "path complete"
        assert (state.motion, state.position, state.homed) == (Motion.STANDING, target_mm, True)
    stage.stop()
    assert peer.written() == [
        # home switch, negative; -6000 twice; 120 and 30 rpm; 200 ms twice
        "10 60 0a 00 09 12 00 04 ff ff e8 90 ff ff e8 90 00 78 00 1e 00 c8 00 c8",
        "06 60 02 00 20",
        # the drive minds the soft limits: 600 000 and -10 000
        "10 60 06 00 04 08 00 09 27 c0 ff ff d8 f0",
        "06 60 00 00 02",
        # absolute, 70 000, 240 rpm, 200 ms twice, no dwell, go
        "10 62 00 00 08 10 00 01 00 01 11 70 00 f0 00 c8 00 c8 00 00 00 10",
        "10 62 00 00 08 10 00 01 ff ff f4 48 00 f0 00 c8 00 c8 00 00 00 10",
        "06 60 02 00 40",
    ]


def test_the_stage_says_who_it_is_without_the_registers_it_lacks(drive) -> None:
    peer, bus = drive
    who = LeadshineStage(bus, 7, STAGE).identify()
    assert (who.model, who.firmware) == ("CS2RS, closed loop, 10000 pulses/rev", "")
    assert peer.written() == []
    assert bus.tally().refusals == 3  # direction, version and firmware: exception 2


def test_a_drive_that_goes_nowhere_is_not_believed_its_old_bits() -> None:
    with serving("stuck", Framing.RTU) as (peer, bus):
        stage = LeadshineStage(bus, 7, replace(STAGE, settle_s=0.1))
        with pytest.raises(Refused, match="homing found no reference"):
            stage.home(time.sleep)
        assert not stage.state().homed
        assert peer.written()[-1] == "06 60 02 00 40"


def test_a_device_of_another_id_is_silent_and_a_register_beyond_is_refused() -> None:
    with serving("drive", Framing.RTU, timeout_s=0.3) as (_, bus):
        with pytest.raises(NoReply, match="device 8, read 1 holding from 0x1003: no answer"):
            bus.read_holding(8, 0x1003, 1)
        with pytest.raises(Refused, match="illegal data address") as refused:
            bus.read_holding(7, 0x602F, 2)
        assert refused.value.code == 2
        assert bus.read_holding(7, 0x0000, 4) == (0, 10_000, 0, 2)


# -- the laser's switch ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("output", "on", "off"),
    [
        (Coil(2), "05 00 02 ff 00", "05 00 02 00 00"),
        (OutputBit(2), "06 08 00 00 04", "06 08 00 00 00"),
    ],
)
def test_a_watched_block_is_set_read_back_and_switched(output, on: str, off: str) -> None:
    with serving("block", Framing.TCP) as (peer, bus):
        laser = WatchedBlock(bus, 1, output, watchdog_s=0.25)
        who = laser.identify()
        assert (who.model, who.firmware) == ("TBEN-S1-8DOP", "register mapping 2")
        assert laser.guarantee().watchdog_s == 0.25
        assert not laser.is_on()
        laser.on()
        assert laser.is_on()
        laser.off()
        assert not laser.is_on()
        assert peer.written() == ["06 11 20 00 fa", on, off]


def test_a_block_that_has_no_watchdog_guarantees_nothing() -> None:
    with serving("unwatched", Framing.TCP) as (peer, bus):
        promise = WatchedBlock(bus, 1, Coil(0), watchdog_s=0.25).guarantee()
        assert promise.watchdog_s is None
        assert "it refused to set its watchdog" in promise.sentence
        assert "illegal data address" in promise.sentence
        assert peer.written() == ["06 11 20 00 fa"]


def test_a_plain_relay_on_a_serial_line_is_switched_and_read_back() -> None:
    with serving("contact", Framing.RTU) as (peer, bus):
        laser = PlainRelay(bus, 3, coil=1)
        laser.on()
        assert bus.read_coils(3, 0, 4) == (False, True, False, False)
        laser.off()
        assert not laser.is_on()
        with pytest.raises(Refused, match="illegal data address"):
            PlainRelay(bus, 3, coil=4).identify()
        assert peer.written() == ["05 00 01 ff 00", "05 00 01 00 00"]


# -- the profiler's registers ----------------------------------------------------------------------


def test_the_sensor_is_known_by_its_texts(sensor) -> None:
    who = ox(sensor[1]).identify()
    assert (who.family, who.model, who.serial) == ("baumer_ox", "OX200-R05A 11223344", "C7H90001")


def test_the_sensors_values_are_read_low_word_first(sensor) -> None:
    told = ox(sensor[1]).status()
    assert (told.parametrising, told.valid, told.alarm) == (False, False, False)
    assert (told.quality, told.outputs) == (Quality.WEAK_SIGNAL, (False, True))
    assert told.values[:2] == (pytest.approx(123.456), -0.5)
    assert told.rate_hz == 100.0
    assert (told.seconds, told.microseconds) == (70_000, 500_000)


def test_a_setup_is_loaded_in_the_order_of_the_manual(sensor) -> None:
    peer, bus = sensor
    profiler = ox(bus)
    assert profiler.active_setup() == 3
    profiler.load_setup(2, time.sleep)
    assert profiler.active_setup() == 2
    assert peer.written() == ["06 00 00 00 01", "06 01 f5 00 02", "06 00 01 00 01"]
