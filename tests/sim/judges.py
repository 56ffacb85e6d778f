"""A driver and the simulated device at one wire, judged by the World and not by each other.

Each `judge_...` is a normal test of one driver; with a misreading planted in the driver it must
fail. One thread, and a time that passes only while somebody waits.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.axis import Kind, Motion
from drivers.baumer_ox import BaumerOx
from drivers.baumer_ox import Settings as OxDriverSettings
from drivers.grbl import GrblAxis
from drivers.grbl import Settings as GrblDriverSettings
from drivers.leadshine import (
    Homing,
    HomingMethod,
    HomingSense,
    LeadshineStage,
    Model,
    StageSettings,
)
from drivers.loopback import Carrying, loopback
from drivers.modbus import Framing, ModbusBus
from drivers.relay import Coil, WatchedBlock
from drivers.relay.laser import Output
from sim import AxisMotion, Limits, OpticalBench, OpticsSettings, Sensor
from sim.baumer_ox import OxSensor
from sim.device import Device
from sim.grbl import GrblBoard, GrblSettings
from sim.leadshine import LeadshineDrive, LeadshineSettings
from sim.modbus import RtuServer, TcpSession
from sim.relay import RelayBlock, RelaySettings
from sim.witness import Memory
from sim.world import Pace, World, WorldAxis
from tests.sim.optics_cases import peg

START_S = 1000.0
STAGE_ID = 7
LEAD_MM = 5.0

STAGE = StageSettings(
    model=Model.CS2RS,
    pulses_per_rev=10_000,
    lead_mm=LEAD_MM,
    low_mm=-5.0,
    high_mm=300.0,
    speed_mm_s=20.0,
    tolerance_mm=0.01,
    # The switch is the world's 0; called -3 here, so that neither zero nor sign may be muddled.
    homing=Homing(
        HomingMethod.HOME_SWITCH, HomingSense.NEGATIVE, fast_mm_s=25.0, slow_mm_s=5.0,
        reference_mm=-3.0,
    ),
)  # fmt: skip
TABLE = GrblDriverSettings(
    name="table",
    kind=Kind.ROTARY,
    letter="X",
    steps_per_unit=80.0,
    lower=-math.tau,
    upper=2.0 * math.tau,
    speed=math.radians(90.0),
    tolerance=math.radians(0.05),
)
# x and z differ in scale and offset, and z is above 32 767 counts everywhere.
EYE = Sensor(
    points=120,
    near_mm=190.0,
    far_mm=260.0,
    width_mm=40.0,
    x_mm_per_count=0.002,
    z_mm_per_count=0.005,
    x_offset_mm=1.5,
    z_offset_mm=20.0,
)


class Rig:
    """Both ends of a wire; who waits at the near one lets the device at the far one live."""

    def __init__(self, device: Device) -> None:
        self.now_s = START_S
        self._device = device
        self.link, self._far = loopback("sim", wait=self._until_said)

    def clock(self) -> float:
        return self.now_s

    def pause(self, seconds: float) -> None:
        """Let time pass, 1 ms at a time."""
        ends_s = self.now_s + seconds
        while self.now_s < ends_s:
            self._step(ends_s)

    def bus(self, framing: Framing = Framing.RTU) -> ModbusBus:
        return ModbusBus(
            self.link, framing, timeout_s=0.3, slowest_reply_s=0.1, clock=self.clock,
            sleep=self.pause,
        )  # fmt: skip

    def _until_said(self, seconds: float) -> None:
        ends_s = self.now_s + seconds
        while self.now_s < ends_s and not self._step(ends_s):
            pass

    def _step(self, ends_s: float) -> bool:
        self.now_s = min(self.now_s + 0.001, ends_s)
        said = self._device.receive(self._far.read(0.0), self.now_s)
        said += self._device.tick(self.now_s)
        if said:
            self._far.write(said)
        return bool(said)


def world_axis(name: str, at: float, limits: Limits, *, pace: Pace | None = None) -> WorldAxis:
    pace = pace or Pace(START_S)
    return WorldAxis(name, AxisMotion.standing(at, limits), pace, Memory())


def dark_world(bench: OpticalBench | None = None) -> World:
    """A world for whoever only switches or looks; its sheet stands 5 mm above the plate."""
    limits, witness = Limits(20.0, 200.0), Memory()
    table = WorldAxis("table", AxisMotion.standing(0.0, limits), Pace(), witness)
    stage = WorldAxis("stage", AxisMotion.standing(5.0, limits), Pace(), witness)
    bench = bench or OpticalBench(peg(), OpticsSettings())
    return World(bench, table, stage, Pace(), witness)


class StageRig(Rig):
    """A Leadshine drive on its axis, and the driver that commands it."""

    def __init__(
        self,
        at_mm: float = 37.0,
        told: LeadshineSettings | None = None,
        settings: StageSettings = STAGE,
        pace: Pace | None = None,
    ) -> None:
        self.axis = world_axis("stage", at_mm, Limits(100.0, 2000.0), pace=pace)
        self.drive = LeadshineDrive(self.axis, told)
        super().__init__(RtuServer({STAGE_ID: self.drive}))
        self.stage = LeadshineStage(self.bus(), STAGE_ID, settings, clock=self.clock)

    @property
    def truth_mm(self) -> float:
        """Where the carriage is, as the station's settings name it."""
        return self.axis.motor(self.now_s) + STAGE.homing.reference_mm


class RelayRig(Rig):
    """A block of outputs in a world, and the driver that switches its laser."""

    def __init__(self, output: Output | None = None, *, watchdog_s: float = 0.25) -> None:
        self.world = dark_world()
        self.block = RelayBlock(self.world, RelaySettings(laser_output=2))
        super().__init__(TcpSession({1: self.block}))
        self.laser = WatchedBlock(
            self.bus(Framing.TCP), 1, output or Coil(2), watchdog_s=watchdog_s, clock=self.clock,
            sleep=self.pause,
        )  # fmt: skip


def judge_stage() -> None:
    """Home and move; the carriage is, and rests, where it was asked to, when the driver says so."""
    rig = StageRig()
    home = rig.stage.home(rig.pause)
    assert home.position == STAGE.homing.reference_mm
    assert math.isclose(rig.truth_mm, STAGE.homing.reference_mm, abs_tol=0.001)
    for target_mm in (12.34, 250.0, -4.56, 87.6543, 0.0):
        here_mm, then_s = rig.truth_mm, rig.now_s
        state = rig.stage.move_to(target_mm, rig.pause)
        assert rig.axis.stands(rig.now_s)
        assert math.isclose(rig.truth_mm, target_mm, abs_tol=0.001)
        assert math.isclose(state.position, rig.truth_mm, abs_tol=0.001)
        assert (state.motion, state.homed) == (Motion.STANDING, True)
        ideal_s = abs(target_mm - here_mm) / STAGE.speed_mm_s + _RAMP_S
        assert ideal_s <= rig.now_s - then_s <= ideal_s + 0.15


# 200 ms a 1000 rpm, and 20 mm/s are 240 rpm: half of the ramps' 48 ms each is lost to the cruise.
_RAMP_S = 0.200 * 240.0 / 1000.0


def judge_relay(output: Output | None = None) -> None:
    """The laser follows the switch, stays lit while renewed, and dies in time when it is not."""
    rig = RelayRig(output)
    guarantee = rig.laser.guarantee()
    rig.laser.on()
    assert rig.world.laser_on
    rig.laser.off()
    assert not rig.world.laser_on
    rig.laser.on()
    for _ in range(20):
        rig.pause(0.1)
        assert rig.world.laser_on
        rig.laser.on()
    last_s = rig.now_s
    rig.pause(0.4)
    assert not rig.world.laser_on
    off = rig.world.witness.events[-1]
    assert off["why"] == "watchdog"
    assert 0.24 <= off["time_s"] - last_s <= 0.26
    assert guarantee.watchdog_s == 0.25
    assert not rig.laser.is_on()


def judge_table() -> None:
    """Home and turn; the table is where it was asked to be, counted from where home was found."""
    axis = world_axis("table", 0.3, Limits(math.pi, 30.0))
    rig = Rig(GrblBoard(axis, GrblSettings()))
    table = GrblAxis(rig.link, TABLE, clock=rig.clock)
    table.home(rig.pause)
    home_rad = axis.motor(rig.now_s)
    # The cam meets its switch at 30 degrees, and the table is pulled off it by two.
    assert math.isclose(math.remainder(home_rad, math.tau), math.radians(28.0), abs_tol=0.002)
    for target_rad in (0.5, -1.25, 7.0, 0.0):
        state = table.move_to(target_rad, rig.pause)
        assert axis.stands(rig.now_s)
        assert math.isclose(axis.motor(rig.now_s) - home_rad, target_rad, abs_tol=5e-4)
        assert math.isclose(state.position, target_rad, abs_tol=5e-4)


def judge_profiler() -> None:
    """The points lie on the peg of 10 mm whose middle is at x = -1, z = 223, on both flanks."""
    world = dark_world(OpticalBench(peg(2.0, -1.0), OpticsSettings(sensor=EYE)))
    world.switch_laser(START_S, on=True, why="test")
    near, far = loopback("ox", carrying=Carrying.DATAGRAMS, wait=lambda _: None)
    for datagram in OxSensor(world).datagrams(START_S):
        far.write(datagram)
    rig = Rig(TcpSession({1: OxSensor(world)}))
    layout = OxDriverSettings(0.002, 0.005, 1.5, 20.0)
    profiler = BaumerOx(rig.bus(Framing.TCP), near, layout, clock=rig.clock)
    x_mm, z_mm = next(profiler.profiles(0.5)).points_mm.T
    assert len(x_mm) > 40
    assert np.abs(np.hypot(x_mm + 1.0, z_mm - 223.0) - 10.0).max() < 0.006
    assert x_mm.min() < -8.0
    assert x_mm.max() > 6.0
    assert z_mm.max() < 223.0
