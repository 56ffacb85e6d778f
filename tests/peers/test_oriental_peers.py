"""The AZ family at both Modbus peers: our driver at a server of modbus-tk, mbpoll at our drive.

Addresses and values are those of public lists of the AZ's registers; each is spelled out here.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.axis import Kind, Motion
from drivers.modbus import Framing
from drivers.oriental import AzAxis, Settings, Turning
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.oriental import AzDrive, AzSettings
from sim.serving import Ending, Server
from sim.wires import Pty
from sim.world import Pace
from tests.peers.test_modbus_tk import serving
from tests.sim.judges import world_axis

TABLE = Settings(
    name="table",
    kind=Kind.ROTARY,
    steps_per_unit=100.0,
    lower=-math.tau,
    upper=math.tau,
    speed=math.radians(90.0),
    acceleration=math.radians(300.0),
    tolerance=math.radians(0.02),
    turning=Turning.WRAP_PROXIMITY,
    settle_s=4.0,  # so long that only a MOVE that was seen ends a move in time
)


def test_the_table_homes_turns_and_stops_in_frames_that_are_spelled_out_here() -> None:
    with serving("turntable", Framing.RTU) as (peer, bus):
        table = AzAxis(bus, 5, TABLE)
        assert table.identify().model == "AZ, 1000 steps/rev, wraps at 36000"
        assert table.home(time.sleep).homed
        for target_deg in (90.0, -45.0):
            begun_s = time.monotonic()
            state = table.move_to(math.radians(target_deg), time.sleep)
            assert 0.77 < time.monotonic() - begun_s < 4.0  # not by the old READY, nor by settling
            assert math.isclose(state.position, math.radians(target_deg), abs_tol=1e-9)
            assert state.motion is Motion.STANDING
        table.stop()
        assert peer.written() == [
            "10 00 78 00 02 04 00 00 00 10",
            # wrap proximity, 9000 steps, 9000 Hz, 30 kHz/s twice, full current, go
            "10 00 58 00 10 20 00 00 00 00 00 00 00 09 00 00 23 28 00 00 23 28"
            " 00 00 75 30 00 00 75 30 00 00 03 e8 00 00 00 01",
            "10 00 58 00 10 20 00 00 00 00 00 00 00 09 ff ff ee 6c 00 00 23 28"
            " 00 00 75 30 00 00 75 30 00 00 03 e8 00 00 00 01",
            "10 00 78 00 02 04 00 00 00 20",
        ]


@contextmanager
def on_a_line(folder: Path) -> Iterator[tuple[Path, AzDrive]]:
    """A simulated drive of id 4 on a serial port."""
    pace = Pace(time.monotonic())
    axis = world_axis("az", 0.0, Limits(1e5, 1e7), pace=pace)
    drive = AzDrive(axis, AzSettings(steps_per_unit=1.0, stored={0x390: 10}))
    port, ending = Pty(folder / "az"), Ending()
    with Server() as server:
        server.serve_pty(port, RtuServer({4: drive}))
        thread = threading.Thread(target=server.run, args=[ending])
        thread.start()
        try:
            yield port.path, drive
        finally:
            ending.ask()
            thread.join()


def polled(port: Path, *options: object) -> str:
    words = [
        "mbpoll", "-m", "rtu", "-b", 115200, "-P", "even", "-a", 4, "-0", "-1", "-o", 5, "-t",
        *options,
    ]  # fmt: skip
    at = words.index("PORT")
    words[at] = port
    ran = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, timeout=30.0
    )
    return ran.stdout + ran.stderr


def numbers(told: str) -> list[str]:
    return re.findall(r"^\[\d+\]:\s+(\S+)", told, re.MULTILINE)


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_mbpoll_moves_the_simulated_drive_and_reads_where_it_is(tmp_path) -> None:
    with on_a_line(tmp_path) as (port, _):
        assert numbers(polled(port, "4:hex", "-r", 0x7E, "-c", 2, "PORT"))[1] == "0x4020"
        # relative, 8500 steps, 200 kHz, 1000 kHz/s
        words = [0, 0, 0, 2, 0, 8500, 3, 3392, 15, 16960, 15, 16960, 0, 1000, 0, 1]
        assert "Written 16" in polled(port, "4", "-r", 0x58, "PORT", "--", *words)
        deadline_s = time.monotonic() + 10.0
        while numbers(polled(port, "4:int", "-r", 0x120, "-B", "PORT")) != ["8500"]:
            assert time.monotonic() < deadline_s
        assert numbers(polled(port, "4:int", "-r", 0xCC, "-B", "PORT")) == ["-500"]  # in its turn
        # wrap proximity to 450 of 1000: fifty back, not 950 on
        words[3], words[5] = 9, 450
        polled(port, "4", "-r", 0x58, "PORT", "--", *words)
        while numbers(polled(port, "4:int", "-r", 0x120, "-B", "PORT")) != ["8450"]:
            assert time.monotonic() < deadline_s
        assert "Illegal data address" in polled(port, "4", "-r", 0x7000, "PORT")
        assert "Illegal function" in polled(port, "0", "-r", 0, "PORT")
