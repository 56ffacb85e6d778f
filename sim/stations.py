"""A station on simulated wires: what stands where, as settings, as devices, and as the files of it.

::

    Layout --build--> Devices: one World, four devices --connect--> wires of a Server --> Addresses
       '--------------------------- station_toml, plan_toml <-----------------------------'

The files are written here, word by word, and not by the program that reads them: what a layout
means and what station.toml says of it are compared by a test.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim.baumer_ox import OxSensor, OxSettings
from sim.device import Broadcaster, Device, ModbusUnit
from sim.faults import Breath, Dropping, Faults, Garbling, Silent, Speaker, Unsent
from sim.grbl import GrblBoard, GrblSettings
from sim.lasers import LaserWiring, Slow, laser_table, relay_settings, spindle_board
from sim.leadshine import Family, LeadshineDrive, LeadshineSettings
from sim.modbus import RtuServer, TcpSession
from sim.motion import AxisMotion, Limits, Play
from sim.optics import OpticalBench, OpticsSettings
from sim.relay import RelayBlock
from sim.sensor import Flaws, Mounting, Sensor
from sim.serving import Server
from sim.solids import Part
from sim.wires import Pty, TcpListener, UdpSender
from sim.witness import Witness
from sim.world import Pace, World, WorldAxis

_STEPS_PER_DEG = 80.0
_TABLE_BAUD = 115200
_SEEK_DEG_S, _FIND_DEG_S, _PULL_OFF_DEG = 90.0, 10.0, 2.0
_PULSES_PER_TURN = 10_000
_SCREW_LEAD_MM = 5.0
_DEVICE_ID = 1
_CLEAR_OF_SWITCH_MM = 2.0
PLAN_RINGS, PLAN_STOPS = 40, 12
_SOUND = Faults()
_FOR_EVER = 1 << 62  # answers


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A laboratory's station, in truth; everything random follows from the seed.

    From full speed either axis stands after 100 ms at most.
    """

    seed: int = 1
    time_scale: float = 1.0
    cloud_width_mm: float = 0.1
    outlier_rate: float = 0.001
    speckle_points: int = 4
    # The sheet passes under the plate at stage 0, so that a ring may lie at the very foot.
    mounting: Mounting = field(default_factory=lambda: Mounting(height_mm=-3.0))
    sensor: Sensor = field(default_factory=lambda: Sensor(points=640))
    rate_hz: float = 100.0
    table_limits: Limits = field(
        default_factory=lambda: Limits(math.radians(180.0), math.radians(2000.0))
    )
    table_play_rad: float = 0.0
    table_stands_rad: float = math.radians(10.0)  # when the power comes on
    table_switch_deg: float = 30.0
    stage_limits: Limits = field(default_factory=lambda: Limits(20.0, 200.0))
    stage_play_mm: float = 0.02
    stage_stands_mm: float = 3.0
    stage_travel_mm: tuple[float, float] = (-2.0, 160.0)  # from limit switch to limit switch
    stage_baud: int = 115200
    watchdog_s: float = 0.25
    laser: LaserWiring = LaserWiring.TURCK
    profiler_port: int = 0  # of each port, 0 is any that is free
    profiles_port: int = 0
    relay_port: int = 0

    @property
    def optics(self) -> OpticsSettings:
        """The bench's settings."""
        flaws = Flaws(
            cloud_width_mm=self.cloud_width_mm,
            speckle_points=self.speckle_points,
            outlier_rate=self.outlier_rate,
            seed=self.seed,
        )
        return OpticsSettings(mounting=self.mounting, sensor=self.sensor, flaws=flaws)

    @property
    def reach_mm(self) -> float:
        """How far from the table's axis a part is still seen from all sides."""
        standoff_mm = self.mounting.standoff_mm
        aside_mm = standoff_mm * self.sensor.steepest - abs(self.mounting.side_mm)
        return min(standoff_mm - self.sensor.near_mm, aside_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Devices:
    """The devices of one station and what they share."""

    world: World
    table: GrblBoard
    stage: LeadshineDrive
    profiler: OxSensor
    relay: RelayBlock
    laser_board: GrblBoard  # speaks where its spindle output switches the laser
    laser_cable: Breath  # of whatever switches the laser; none is a cable that was pulled

    def lively(self, now_s: float) -> bool:
        """Whether anything moves or measures."""
        world = self.world
        return world.laser_on or not (world.table.stands(now_s) and world.stage.stands(now_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class Addresses:
    """Where the devices are reached, as station.toml says it."""

    table: str
    stage: str
    profiler: str
    profiles: str
    laser: str


def build(
    layout: Layout, part: Part, witness: Witness, now_s: float, *, faults: Faults = _SOUND
) -> Devices:
    """Put a part on the table and switch the power on.

    Raises
    ------
    ValueError
        The sensor cannot see so much of the part; says how much it can.
    """
    radius_mm = float(np.hypot(*part.vertices_mm.T[:2]).max())
    if radius_mm > layout.reach_mm:
        raise ValueError(
            f"part {part.name}: it reaches {radius_mm:g} mm from the table's axis, and the sensor"
            f" sees {layout.reach_mm:g}; scale it down"
        )
    world = _world(layout, part, witness, Pace(now_s, layout.time_scale))
    if layout.laser is LaserWiring.NONE:
        world.switch_laser(now_s, on=True, why="nothing switches it")
    if faults.stage_stalls_mm is not None:
        world.stage.obstacle = faults.stage_stalls_mm
    return Devices(
        world,
        GrblBoard(world.table, _grbl_settings(layout)),
        LeadshineDrive(world.stage, _leadshine_settings(layout)),
        OxSensor(world, OxSettings(rate_hz=layout.rate_hz)),
        RelayBlock(world, relay_settings(layout.laser)),
        spindle_board(world, witness),
        Breath(faults.silent_after.get(Speaker.RELAY, _FOR_EVER)),
    )


def connect(
    devices: Devices, layout: Layout, faults: Faults, server: Server, folder: Path
) -> Addresses:
    """Put the devices on wires that the server serves; serial ports get their names in a folder.

    Raises
    ------
    OSError
        A port is taken.
    """
    table, stage = Pty(folder / "table"), Pty(folder / "stage")
    server.serve_pty(table, _on_serial_line(devices.table, Speaker.TABLE, faults))
    drives = RtuServer({_DEVICE_ID: devices.stage})
    server.serve_pty(stage, _on_serial_line(drives, Speaker.STAGE, faults))
    profiles = UdpSender(layout.profiles_port)
    server.broadcast(profiles, _over_network(devices.profiler, faults))
    server.tell_time(devices.relay.tick)  # its watchdog bites whether or not it has a connection
    return Addresses(
        table=f"serial://{table.path}?baud={_TABLE_BAUD}",
        stage=f"serial://{stage.path}?baud={layout.stage_baud}",
        profiler=_listen(
            devices.profiler,
            Breath(faults.silent_after.get(Speaker.PROFILER, _FOR_EVER)),
            layout.profiler_port,
            server,
        ),
        profiles=profiles.address,
        laser=_laser_address(devices, layout, faults, server, folder),
    )


def _laser_address(
    devices: Devices, layout: Layout, faults: Faults, server: Server, folder: Path
) -> str:
    """Put what switches the laser on its wire; empty where nothing does."""
    if layout.laser is LaserWiring.NONE:
        return ""
    if (baud := layout.laser.baud) is None:
        return _listen(devices.relay, devices.laser_cable, layout.relay_port, server)
    grbl = layout.laser is LaserWiring.GRBL
    device: Device = devices.laser_board if grbl else RtuServer({_DEVICE_ID: devices.relay})
    pty = Pty(folder / "laser")
    server.serve_pty(pty, Slow(Silent(device, devices.laser_cable), baud))
    return f"serial://{pty.path}?baud={baud}"


def station_toml(layout: Layout, addresses: Addresses, part_name: str) -> str:
    """Write the station.toml of a layout, with comments."""
    mounting, sensor = layout.mounting, layout.sensor
    ramp_s = _SCREW_LEAD_MM * 1000.0 / 60.0 / layout.stage_limits.acceleration  # to 1000 rpm
    return _STATION.format(
        name=json.dumps(f"simulated station, {part_name}"),
        addresses=addresses,
        layout=layout,
        mounting=mounting,
        sensor=sensor,
        device_id=_DEVICE_ID,
        steps_per_deg=_STEPS_PER_DEG,
        table_deg_s=round(math.degrees(layout.table_limits.speed), 9),
        backlash_deg=round(math.degrees(layout.table_play_rad), 9),
        zero_deg=layout.table_switch_deg - _PULL_OFF_DEG,
        pulses_per_turn=_PULSES_PER_TURN,
        screw_lead_mm=_SCREW_LEAD_MM,
        home_fast_mm_s=layout.stage_limits.speed / 2.0,
        home_slow_mm_s=layout.stage_limits.speed / 10.0,
        ramp_ms=math.floor(1000.0 * ramp_s),
        lowest_mm=layout.stage_travel_mm[0] + _CLEAR_OF_SWITCH_MM,
        highest_mm=layout.stage_travel_mm[1] - _CLEAR_OF_SWITCH_MM,
        table_sense=mounting.turning.name.lower().replace("_", "-"),
        laser=laser_table(
            layout.laser, addresses.laser, device_id=_DEVICE_ID, watchdog_s=layout.watchdog_s
        ),
        stage_sense=mounting.lifting.name.lower(),
        sensor_x=mounting.hand.name.lower(),
        azimuth_deg=round(math.degrees(mounting.azimuth_rad), 9),
    )


def plan_toml(
    layout: Layout, part: Part, *, rings: int = PLAN_RINGS, stops: int = PLAN_STOPS
) -> str:
    """Write a plan.toml whose rings lie equidistant from a part's foot to its top."""
    height_mm = float(part.vertices_mm[:, 2].max())
    step_mm = height_mm / rings
    ends_mm = [
        layout.mounting.lifting.value * (ring_mm - layout.mounting.height_mm)
        for ring_mm in (step_mm / 2.0, height_mm - step_mm / 2.0)
    ]
    first_mm = max(min(ends_mm), layout.stage_travel_mm[0] + _CLEAR_OF_SWITCH_MM)
    last_mm = min(max(ends_mm), layout.stage_travel_mm[1] - _CLEAR_OF_SWITCH_MM)
    return _PLAN.format(
        part=part.name,
        first_mm=round(first_mm, 6),
        last_mm=round(last_mm, 6),
        step_mm=round(step_mm, 6),
        stops=stops,
    )


def truth_ply(part: Part) -> bytes:
    """Write a part as the simulator knows it: a PLY file of float64 in mm."""
    head = (
        "ply\nformat binary_little_endian 1.0\ncomment unit mm\n"
        f"element vertex {len(part.vertices_mm)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(part.faces)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(part.faces), [("corners", "u1"), ("corner", "<i4", 3)])
    faces["corners"], faces["corner"] = 3, part.faces
    return head.encode() + part.vertices_mm.astype("<f8").tobytes() + faces.tobytes()


def _world(layout: Layout, part: Part, witness: Witness, pace: Pace) -> World:
    table = AxisMotion.standing(
        layout.table_stands_rad, layout.table_limits, Play(layout.table_play_rad)
    )
    stage = AxisMotion.standing(
        layout.stage_stands_mm, layout.stage_limits, Play(layout.stage_play_mm)
    )
    return World(
        OpticalBench(part, layout.optics),
        WorldAxis("table", table, pace, witness),
        WorldAxis("stage", stage, pace, witness),
        pace,
        witness,
    )


def _grbl_settings(layout: Layout) -> GrblSettings:
    return GrblSettings(
        steps_per_deg=_STEPS_PER_DEG,
        max_rate_deg_min=60.0 * math.degrees(layout.table_limits.speed),
        acceleration_deg_s2=math.degrees(layout.table_limits.acceleration),
        homing_seek_deg_min=60.0 * _SEEK_DEG_S,
        homing_feed_deg_min=60.0 * _FIND_DEG_S,
        pull_off_deg=_PULL_OFF_DEG,
        switch_deg=layout.table_switch_deg,
    )


def _leadshine_settings(layout: Layout) -> LeadshineSettings:
    return LeadshineSettings(
        family=Family.CS2RS,  # the one that notices when its motor is held
        pulses_per_turn=_PULSES_PER_TURN,
        screw_lead_mm=_SCREW_LEAD_MM,
        travel_mm=layout.stage_travel_mm,
    )


def _on_serial_line(device: Device, speaker: Speaker, faults: Faults) -> Device:
    if speaker in faults.silent_after:
        device = Silent(device, Breath(faults.silent_after[speaker]))
    return Garbling(device, faults.garble_every) if faults.garble_every else device


def _over_network(source: Broadcaster, faults: Faults) -> Broadcaster:
    if not faults.profiles:
        source = Unsent(source)
    return Dropping(source, faults.drop_every) if faults.drop_every else source


def _listen(unit: ModbusUnit, breath: Breath, port: int, server: Server) -> str:
    """Give one unit a port of its own; all its connections share one breath."""

    def session() -> Device:
        return Silent(TcpSession({_DEVICE_ID: unit}), breath)

    listener = TcpListener(port)
    server.serve_tcp(listener, session)
    return listener.address


_STATION = """\
# A simulated station, read by loftscan. Its addresses live as long as the simulator does.
# Lengths are mm, angles degrees, times s: every key says so.
name = {name}

# what turns the part: a Grbl board, whose "mm" are degrees
[table]
family = "grbl"
address = "{addresses.table}"
letter = "X"
steps_per_deg = {steps_per_deg}  # the board's $100
speed_deg_s = {table_deg_s}
tolerance_deg = 0.05
backlash_deg = {backlash_deg}
zero = "switch"  # found again after a power cycle, so that a scan can be resumed
zero_deg = {zero_deg}  # where it rests after homing: a pull-off before the switch
lowest_deg = -360.0
highest_deg = 3600.0  # ten turns

# what lifts the laser plane: a Leadshine drive on Modbus RTU
[stage]
family = "leadshine"
address = "{addresses.stage}"
device_id = {device_id}
model = "cs2rs"
pulses_per_turn = {pulses_per_turn}
screw_lead_mm = {screw_lead_mm}
speed_mm_s = {layout.stage_limits.speed}
home_mark = "limit switch"
home_way = "negative"
home_fast_mm_s = {home_fast_mm_s}
home_slow_mm_s = {home_slow_mm_s}
home_position_mm = {layout.stage_travel_mm[0]}  # where the limit switch is
ramp_ms_per_1000_rpm = {ramp_ms}
tolerance_mm = 0.02
lowest_mm = {lowest_mm}
highest_mm = {highest_mm}

# what measures: a Baumer OX200
[profiler]
family = "baumer_ox"
address = "{addresses.profiler}"
device_id = {device_id}
profiles = "{addresses.profiles}"  # our end of the wire: here they arrive
rate_hz = {layout.rate_hz}
points_per_profile = {sensor.points}
x_mm_per_count = {sensor.x_mm_per_count}
z_mm_per_count = {sensor.z_mm_per_count}
x_offset_mm = {sensor.x_offset_mm}
z_offset_mm = {sensor.z_offset_mm}

# what switches the laser; a Turck block drops its outputs when nobody talks to it
[laser]
{laser}

# how axes and sensor stand: the truth, as far as a ruler could tell it
[kinematics]
kind = "nominal"
table_sense = "{table_sense}"
stage_sense = "{stage_sense}"
height_mm = {mounting.height_mm}
standoff_mm = {mounting.standoff_mm}
side_mm = {mounting.side_mm}
sensor_x = "{sensor_x}"
azimuth_deg = {azimuth_deg}
"""

_PLAN = """\
# Rings over the whole height of the part {part}; positions are the stage's own, in mm.

[ring]
first_mm = {first_mm}
last_mm = {last_mm}
step_mm = {step_mm}
profiles_per_turn = {stops}

[step_and_shoot]
settle_s = 0.0  # the simulated axes do not swing after they have stopped
profiles_per_stop = 1
"""
