"""Zaber's own client, `zaber-motion`, at our simulated devices, and its bytes beside our driver's.

The client sends ids and checks by itself, and refuses a reply whose id or check is wrong: what it
takes from the simulator is a reply as its maker means it. It has no database of devices here (that
is on the network), so it speaks in microsteps.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from drivers.axis import Kind
from drivers.links import open_link
from drivers.zaber import Chain, Settings, ZaberAxis
from sim.motion import Limits
from sim.serving import Ending, Server
from sim.wires import TcpListener
from sim.world import Pace
from sim.zaber import ZaberChain, ZaberDevice, ZaberSettings
from tests.sim.judges import world_axis

zaber_motion = pytest.importorskip("zaber_motion", reason="zaber-motion has no wheel here")
from zaber_motion import ascii as maker  # noqa: E402
from zaber_motion.exceptions import CommandFailedException, RequestTimeoutException  # noqa: E402

HOST = "127.0.0.1"


@dataclass
class Served:
    """A chain on a port, and every line that came."""

    port: int
    chain: ZaberChain
    lines: list[bytes] = field(default_factory=list)

    def receive(self, data: bytes, now_s: float) -> bytes:
        self.lines += data.splitlines(keepends=True)
        return self.chain.receive(data, now_s)

    def tick(self, now_s: float) -> bytes:
        return self.chain.tick(now_s)


@contextmanager
def serving(*, checks: bool) -> Iterator[Served]:
    pace = Pace(time.monotonic())
    made = ZaberSettings(microsteps_per_unit=2000.0, home_at=1.0, checks=checks, maxspeed=600_000)
    devices = {
        k: ZaberDevice(world_axis(f"axis {k}", 10.0, Limits(400.0, 20_000.0), pace=pace), made)
        for k in (1, 2)
    }
    listener = TcpListener(0)
    served = Served(int(listener.address.rpartition(":")[2]), ZaberChain(devices))
    ending = Ending()
    with Server() as server:
        server.serve_tcp(listener, lambda: served)
        thread = threading.Thread(target=server.run, args=[ending])
        thread.start()
        try:
            yield served
        finally:
            ending.ask()
            thread.join()


@pytest.mark.parametrize("checks", [True, False], ids=["with checks", "without"])
def test_the_makers_client_homes_moves_and_stops_our_simulated_devices(checks) -> None:
    with serving(checks=checks) as served, maker.Connection.open_tcp(HOST, served.port) as line:
        for number in (1, 2):
            axis = line.get_device(number).get_axis(1)
            assert "WR" in axis.warnings.get_flags()
            assert not axis.is_homed()
            axis.home()
            assert axis.is_homed()
            assert axis.get_position() == 0
            axis.move_absolute(30_000)
            assert axis.get_position() == 30_000
            axis.move_relative(-1_234)
            assert axis.get_position() == 28_766
            axis.move_velocity(200_000)
            assert axis.is_busy()
            time.sleep(0.05)  # time to get somewhere
            axis.stop()
            assert not axis.is_busy()
            assert axis.get_position() > 28_766


def test_what_our_simulator_rejects_the_makers_client_names() -> None:
    with serving(checks=True) as served, maker.Connection.open_tcp(HOST, served.port) as line:
        axis = line.get_device(1).get_axis(1)
        axis.home()
        with pytest.raises(CommandFailedException, match="BADDATA"):
            axis.move_absolute(10**8)
        with pytest.raises(CommandFailedException, match="BADCOMMAND"):
            axis.generic_command("dance")
        with pytest.raises(CommandFailedException, match="BADAXIS"):
            line.get_device(1).get_axis(3).generic_command("get pos")
        line.default_request_timeout = 200
        with pytest.raises(RequestTimeoutException):
            line.get_device(7).get_axis(1).generic_command("get pos")


def test_the_makers_client_hears_the_alert_of_a_movements_end() -> None:
    with serving(checks=True) as served, maker.Connection.open_tcp(HOST, served.port) as line:
        axis = line.get_device(1).get_axis(1)
        axis.generic_command("set comm.alert 1")
        heard = threading.Event()
        found: list[tuple[int, int, str, str]] = []

        def alerted(event: object) -> None:
            found.append(
                (event.device_address, event.axis_number, event.status, event.warning_flag)  # type: ignore[attr-defined]
            )
            heard.set()

        line.alert.subscribe(alerted)
        axis.home(wait_until_idle=False)
        assert heard.wait(10.0)
        assert found[0] == (1, 1, "IDLE", "--")


def test_our_driver_sends_the_bytes_that_the_makers_client_sends_for_the_same_commands() -> None:
    settings = Settings(
        name="stage", kind=Kind.LINEAR, microsteps_per_unit=2000.0, lower=0.0, upper=70.0,
        speed=200.0, tolerance=0.002,
    )  # fmt: skip
    with serving(checks=True) as served:
        link = open_link(f"tcp://{HOST}:{served.port}")
        stage = ZaberAxis(Chain(link), settings)
        stage.home(_pause)
        stage.move_to(20.0, _pause)
        stage.stop()
        link.close()
        ours = [line.decode() for line in served.lines]
        commands = [line.split(":")[0].split(" ", 3) for line in ours]
        served.lines.clear()
        with maker.Connection.open_tcp(HOST, served.port) as line:
            for _, axis, _, *command in commands:
                # As fast as it can, so that a move follows a homing that is not over.
                told = command[0] if command else ""
                line.generic_command(told, device=1, axis=int(axis), check_errors=False)
            theirs = [sent.decode() for sent in served.lines]
    assert ours == theirs
    said = {" ".join(command) for _, _, _, *command in commands}
    assert {"home", "move abs 40000", "stop", "get pos", "warnings", "warnings clear", ""} <= said


def _pause(seconds: float) -> None:
    time.sleep(seconds)
