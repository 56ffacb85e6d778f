"""The simulated RF62X and register sensor, with our drivers at the other end of their wires."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from drivers.errors import NoReply, Refused
from drivers.modbus import Framing, ModbusBus, rtu_silence_s
from drivers.profiler import Profile, Reason
from drivers.register_profiler import Flag, Layout, RegisterProfiler, Trigger
from drivers.riftek import Riftek, Settings, WebApi
from drivers.riftek import Sync as RfSync
from sim.device import ModbusRefusal
from sim.modbus import RtuServer, TcpSession
from sim.register_profiler import Measuring, RegisterSensor, RegisterSettings
from sim.riftek import HttpSession, RfSensor, RfSettings
from tests.drivers.virtual_wire import Clock, Slow, VirtualWire
from tests.sim.test_ox_sensor import lit_world, peg_bench, world_of

# The peg of the bench: a radius of 10 mm, its front at z = 213, its middle at x = -1.
FRONT_MM, MIDDLE_MM, RADIUS_MM = 213.0, -1.0, 10.0
DATA_SHEET = Layout(
    first_register=16,
    columns=401,
    z_mm_per_count=0.005,
    column_pitch_mm=0.05,
    first_column_mm=-10.0,
    missing=((0xFFFF, Reason.NO_RETURN), (0xFFFE, Reason.OUT_OF_RANGE)),
    sequence_register=1,
)
HELD = Layout(
    first_register=16,
    columns=401,
    z_mm_per_count=0.005,
    column_pitch_mm=0.05,
    first_column_mm=-10.0,
    missing=((0xFFFF, Reason.NO_RETURN), (0xFFFE, Reason.OUT_OF_RANGE)),
    ready=Flag(0, 0),
    trigger=Trigger(0),
)


def told(measuring: Measuring, rate_hz: float = 10.0) -> RegisterSettings:
    return RegisterSettings(columns=401, pitch_mm=0.05, rate_hz=rate_hz, measuring=measuring)


def off_the_peg_mm(points_mm: np.ndarray) -> float:
    """Largest distance of points from the front of the peg."""
    x, z = points_mm.T
    return float(np.abs(np.hypot(x - MIDDLE_MM, z - FRONT_MM - RADIUS_MM) - RADIUS_MM).max())


class Registers:
    """Sensor and driver on a TCP connection, or on a serial line of 115200 baud."""

    def __init__(
        self, layout: Layout, settings: RegisterSettings, framing: Framing, late_s: float = 0.0
    ) -> None:
        self.clock = Clock()
        self.world = lit_world(peg_bench())
        self.sensor = RegisterSensor(self.world, settings)
        rtu = framing is Framing.RTU
        server = RtuServer({1: self.sensor}) if rtu else TcpSession({1: self.sensor})
        self.wire = VirtualWire(self.clock, Slow(server, late_s) if late_s else server)
        self.bus = ModbusBus(
            self.wire, framing, timeout_s=0.3, slowest_reply_s=0.1,
            silence_s=rtu_silence_s(115_200), baud=115_200, clock=self.clock,
            sleep=self.wire.sleep,
        )  # fmt: skip
        self.profiler = RegisterProfiler(
            self.bus, 1, layout, period_s=1.0 / settings.rate_hz, clock=self.clock,
            pause=self.wire.sleep,
        )  # fmt: skip

    def take(self, count: int = 1) -> list[Profile]:
        return list(islice(self.profiler.profiles(2.0), count))


@pytest.mark.parametrize("framing", [Framing.TCP, Framing.RTU])
@pytest.mark.parametrize(
    ("layout", "measuring"),
    [(DATA_SHEET, Measuring.BY_ITSELF), (HELD, Measuring.WHEN_TRIGGERED)],
)
def test_what_is_read_from_the_registers_lies_on_the_part(layout, measuring, framing) -> None:
    at = Registers(layout, told(measuring), framing)
    for profile in at.take(3):
        points_mm = profile.points_mm
        assert len(points_mm) > 100
        assert off_the_peg_mm(points_mm) < 0.03  # 1 mm chords: 0.013 mm; steps of 0.005
        assert set(profile.reasons.tolist()) == {Reason.MEASURED, Reason.NO_RETURN}


def test_a_sensor_faster_than_its_line_is_torn_and_its_trigger_helps() -> None:
    fast = told(Measuring.BY_ITSELF, rate_hz=200.0)  # 5 ms, of which four frames take eight
    at = Registers(DATA_SHEET, fast, Framing.TCP, late_s=0.002)
    with pytest.raises(NoReply, match="torn reads"):
        at.take()
    assert at.profiler.reads().torn > 10
    held = Registers(HELD, told(Measuring.WHEN_TRIGGERED, 200.0), Framing.TCP, late_s=0.002)
    assert off_the_peg_mm(held.take()[0].points_mm) < 0.03


def test_in_the_dark_the_register_sensor_measures_nothing() -> None:
    at = Registers(HELD, told(Measuring.WHEN_TRIGGERED), Framing.TCP)
    at.world.switch_laser(at.clock(), on=False, why="test")
    (dark,) = at.take()
    assert np.all(dark.reasons == Reason.NO_RETURN)


def test_the_register_sensor_refuses_what_its_data_sheet_has_not() -> None:
    sensor = RegisterSensor(world_of(peg_bench()))
    for wrong in (
        lambda: sensor.read_input(2, 1, 0.0),
        lambda: sensor.read_input(16, 482, 0.0),
        lambda: sensor.read_holding(2, 1, 0.0),
        lambda: sensor.write_registers(16, [1], 0.0),
        lambda: sensor.write_registers(0, [2], 0.0),
        lambda: sensor.read_coils(0, 1, 0.0),
    ):
        with pytest.raises(ModbusRefusal):
            wrong()
    with pytest.raises(ValueError, match="do not fit its registers"):
        RegisterSettings(columns=1)


class Udp:
    """What the sensor broadcasts, one datagram a read; every n-th is lost."""

    address = "udp://virtual"

    def __init__(self, clock: Clock, sensor: RfSensor, lose_every: int = 0) -> None:
        self.clock, self.sensor, self.lose_every = clock, sensor, lose_every
        self.sent = 0
        self.waiting: list[bytes] = []

    def read(self, timeout_s: float) -> bytes:
        ends_s = self.clock() + timeout_s
        while True:
            for datagram in self.sensor.datagrams(self.clock()):
                self.sent += 1
                if not self.lose_every or self.sent % self.lose_every:
                    self.waiting.append(datagram)
            if self.waiting:
                return self.waiting.pop(0)
            if self.clock() >= ends_s:
                return b""
            self.clock.now_s += 0.002

    def write(self, data: bytes) -> None:
        raise AssertionError("nothing is ever sent to the sensor's stream")

    def close(self) -> None:
        pass


def rf(settings: Settings, lose_every: int = 0) -> tuple[Riftek, RfSensor]:
    clock = Clock()
    sensor = RfSensor(lit_world(peg_bench()), RfSettings(rate_hz=100.0))
    web = WebApi(lambda: VirtualWire(clock, HttpSession(sensor)), "tcp://virtual:80", clock=clock)
    return Riftek(web, Udp(clock, sensor, lose_every), settings, clock=clock), sensor


def test_what_the_rf62x_sends_lies_on_the_part() -> None:
    riftek, _ = rf(Settings(z_offset_mm=190.0))  # where the bench's range begins
    assert riftek.identify().model == "RF627"
    for profile in islice(riftek.profiles(0.5), 3):
        assert len(profile.points_mm) > 20
        assert off_the_peg_mm(profile.points_mm) < 0.01  # 70 mm over 16 384
        assert len(profile.intensity) == len(profile.reasons) == 120


def test_every_third_datagram_lost_is_counted_as_such() -> None:
    riftek, _ = rf(Settings(), lose_every=3)
    frames = [profile.frame for profile in islice(riftek.profiles(0.5), 6)]
    assert frames == [0, 1, 3, 4, 6, 7]
    assert riftek.tally().lost_profiles == 2


def test_software_triggers_one_profile_each() -> None:
    riftek, sensor = rf(Settings(sync=RfSync.SOFTWARE, rate_hz=50, exposure_us=120.0))
    riftek.set_up()
    assert [profile.frame for profile in islice(riftek.profiles(0.5), 3)] == [0, 1, 2]
    assert sensor.values(["user_sensor_framerate"]) == {"user_sensor_framerate": 50}


def test_the_rf62x_says_why_it_does_not_take_a_parameter() -> None:
    riftek, sensor = rf(Settings(exposure_us=120.0))
    for name, text, code in (
        ("user_sensor_framerate", "0", "RF_OUT_OF_BOUNDS"),
        ("user_sensor_exposure1", "3050", "RF_NOT_IN_STEP"),
        ("user_sensor_exposure1", "x", "RF_WRONG_DATA_TYPE"),
        ("fact_general_serial", "1", "RF_NOT_AUTHORIZED"),
        ("user_sensor", "1", "RF_PARAM_NOT_FOUND"),
    ):
        assert sensor.write(name, text) == code
    assert sensor.write("user_streams_udpEnabled", "0") == "RF_OK"
    with pytest.raises(Refused, match="its UDP stream is off"):
        riftek.identify()
    with pytest.raises(NoReply, match="address and port set"):
        next(riftek.profiles(0.5))
