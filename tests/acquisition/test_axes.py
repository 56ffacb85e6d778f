"""[table] and [stage] of other families: what the file says is what the driver is given."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pytest

from acquisition.axes import (
    az_stage_settings,
    az_table_settings,
    zaber_stage_settings,
    zaber_table_settings,
)
from acquisition.motion_settings import (
    AzStage,
    AzTable,
    ReadBack,
    TableTurning,
    ZaberStage,
    ZaberTable,
)
from acquisition.opening import open_station
from acquisition.ports import check_ports
from acquisition.station import parse_station, write_station
from drivers import oriental
from drivers.links import ByteLink
from sim.motion import Limits
from sim.zaber import ZaberChain, ZaberDevice
from tests.acquisition.scan_cases import STATION
from tests.acquisition.test_opening import Site
from tests.sim.judges import Rig, world_axis

ZABER = "serial:///dev/ttyUSB7?baud=115200"
ZABER_TABLE = ZaberTable(
    address=ZABER,
    device=2,
    microsteps_per_deg=711.0,
    read_back=ReadBack.ENCODER,
    speed_deg_s=90.0,
    zero_deg=45.0,
    lowest_deg=-10.0,
    highest_deg=370.0,
)
ZABER_STAGE = ZaberStage(
    address="serial:///dev/ttyUSB7", microsteps_per_mm=2000.0, speed_mm_s=20.0, lowest_mm=0.0,
    highest_mm=100.0, home_position_mm=-3.0, serial="33001",
)  # fmt: skip


def test_a_station_of_zaber_axes_is_written_and_read_back() -> None:
    station = replace(STATION, table=ZABER_TABLE, stage=ZABER_STAGE)
    assert parse_station(write_station(station)) == station


def test_the_files_zaber_axes_are_the_drivers() -> None:
    table, stage = zaber_table_settings(ZABER_TABLE), zaber_stage_settings(ZABER_STAGE)
    assert table.upper == pytest.approx(math.tau * 37 / 36)
    assert table.speed == pytest.approx(math.tau / 4)
    assert table.home_position == pytest.approx(math.tau / 8)
    assert (table.device, table.encoder, table.microsteps_per_unit) == (2, True, 711.0)
    assert (stage.lower, stage.upper, stage.home_position) == (0.0, 100.0, -3.0)
    assert (stage.serial, stage.encoder, stage.device) == ("33001", False, 1)


AZ_TABLE = AzTable(
    address="serial:///dev/ttyUSB8?parity=E", device_id=3, steps_per_deg=100.0,
    turning=TableTurning.WRAP_PROXIMITY, speed_deg_s=90.0, acceleration_deg_s2=360.0, zero_deg=45.0,
    lowest_deg=-10.0, highest_deg=370.0,
)  # fmt: skip
AZ_STAGE = AzStage(
    address="serial:///dev/ttyUSB8?parity=E", device_id=4, steps_per_mm=200.0, speed_mm_s=20.0,
    acceleration_mm_s2=100.0, home_position_mm=-3.0, lowest_mm=0.0, highest_mm=100.0,
)  # fmt: skip


def test_a_station_of_az_axes_is_written_and_read_back_and_means_what_it_says() -> None:
    station = replace(STATION, table=AZ_TABLE, stage=AZ_STAGE)
    assert parse_station(write_station(station)) == station
    table, stage = az_table_settings(AZ_TABLE), az_stage_settings(AZ_STAGE)
    assert (table.speed_hz, table.rate, table.turn_steps) == (9000, 36_000, 36_000)
    assert table.turning is oriental.Turning.WRAP_PROXIMITY
    assert table.home_position == pytest.approx(math.tau / 8)
    assert (stage.speed_hz, stage.rate, stage.home_position) == (4000, 20_000, -3.0)
    assert (stage.lower, stage.upper) == (0.0, 100.0)


def test_two_axes_on_one_zaber_chain_have_one_holder_of_the_port() -> None:
    station = replace(STATION, table=ZABER_TABLE, stage=ZABER_STAGE)
    devices = {k: ZaberDevice(world_axis(f"{k}", 10.0, Limits(100.0, 1000.0))) for k in (1, 2)}
    heard: list[bytes] = []

    class Noting(ZaberChain):
        def receive(self, data: bytes, now_s: float) -> bytes:
            heard.append(data)
            return super().receive(data, now_s)

    site, rig = Site(), Rig(Noting(devices))
    opened: list[str] = []

    def links(address: str) -> ByteLink:
        opened.append(address)
        return rig.link if "ttyUSB7" in address else site.open(address)

    with open_station(station, clock=rig.clock, sleep=rig.pause, links=links) as at:
        assert b"".join(heard) == b""  # opening asks nothing
        at.table.stop()
    assert sum("ttyUSB7" in address for address in opened) == 1
    stops = re.findall(rb"/(\d) 1 \d\d stop:..\n", b"".join(heard))
    assert stops == [b"2", b"1", b"2"]  # on the way out the stage first


# --- who may be on one port with whom --------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "stage", "said"),
    [
        (
            STATION.table,
            replace(STATION.stage, address=STATION.table.address),
            r"stage\.address: /dev/ttyUSB0 is the table's port, too, and Grbl and Modbus cannot",
        ),
        (ZABER_TABLE, replace(AZ_STAGE, address=ZABER), "Zaber ASCII and Modbus cannot share one"),
        (
            AZ_TABLE,
            replace(AZ_STAGE, address="serial:///dev/ttyUSB8"),
            "with other settings; write the same address for both",
        ),
    ],
    ids=["a board and a bus", "a chain and a bus", "two parities"],
)
def test_a_port_that_is_used_in_two_ways_is_refused_before_anything_is_opened(
    table, stage, said
) -> None:
    site = Site()
    station = replace(STATION, table=table, stage=stage)
    with (
        pytest.raises(ValueError, match=said),
        open_station(station, clock=site.clock, sleep=site.sleep, links=site.open),
    ):
        pass
    assert site.journal == []


@pytest.mark.parametrize(
    ("table", "stage"),
    [(ZABER_TABLE, ZABER_STAGE), (AZ_TABLE, AZ_STAGE), (STATION.table, AZ_STAGE)],
)
def test_who_speaks_the_same_may_share_a_port(table, stage) -> None:
    check_ports(replace(STATION, table=table, stage=stage))
