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
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim.axes import (
    Stage,
    StageFamily,
    Table,
    TableFamily,
    build_stage,
    build_table,
    lines_of,
    stage_toml,
    table_toml,
)
from sim.cabling import Cabling
from sim.crooked import CrookedBench, Crookedness
from sim.cuts import Cut, kinematics_toml, meridian_toml, standing, stripe_toml
from sim.device import Device, ModbusUnit
from sim.faults import Breath, Faults, Silent, Speaker
from sim.grbl import GrblBoard
from sim.lasers import LaserWiring, Slow, laser_table, relay_settings, spindle_board
from sim.modbus import RtuServer, TcpSession
from sim.motion import AxisMotion, Limits, Play
from sim.optics import OpticalBench, OpticsSettings
from sim.profilers import (
    ProfilerFamily,
    SimProfiler,
    build_profiler,
    connect_profiler,
    profiler_toml,
)
from sim.relay import RelayBlock
from sim.sensor import Flaws, Mounting, Sensor
from sim.serving import Server
from sim.solids import Part
from sim.wires import Pty, TcpListener
from sim.witness import Witness
from sim.world import Pace, World, WorldAxis

_TABLE_BAUD = 115200
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
    table_family: TableFamily = TableFamily.GRBL
    stage_family: StageFamily = StageFamily.LEADSHINE
    profiler_family: ProfilerFamily = ProfilerFamily.BAUMER_OX
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
    cut: Cut = Cut.RINGS
    crooked: Crookedness | None = None  # stands otherwise than its station.toml says
    profiler_port: int = 0  # of each port, 0 is any that is free
    profiles_port: int = 0
    relay_port: int = 0

    def __post_init__(self) -> None:
        own = self.laser is LaserWiring.HOKUYO
        if own != (self.profiler_family is ProfilerFamily.HOKUYO):
            raise ValueError(
                f"laser {self.laser.value}, profiler {self.profiler_family.value}: a hokuyo lights"
                " its own laser and nobody else's; choose hokuyo for both or for neither"
            )

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
        if self.cut is not Cut.RINGS:
            return standoff_mm - self.sensor.near_mm
        aside_mm = standoff_mm * self.sensor.steepest - abs(self.mounting.side_mm)
        return min(standoff_mm - self.sensor.near_mm, aside_mm)


@dataclass(frozen=True, slots=True, eq=False)
class Devices:
    """The devices of one station and what they share."""

    world: World
    table: Table
    stage: Stage
    profiler: SimProfiler
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
        build_table(layout, world),
        build_stage(layout, world),
        build_profiler(layout, world),
        RelayBlock(world, relay_settings(layout.laser)),
        spindle_board(world, witness),
        Breath(faults.silent_after.get(Speaker.RELAY, _FOR_EVER)),
    )


def connect(
    devices: Devices, layout: Layout, cabling: Cabling, server: Server, folder: Path
) -> Addresses:
    """Put the devices on wires that the server serves; serial ports get their names in a folder.

    Raises
    ------
    OSError
        A port is taken.
    """
    table, stage = _serial_lines(devices, layout, cabling, server, folder)
    profiler, profiles = connect_profiler(
        devices.profiler, layout, cabling, server, folder, devices.laser_cable
    )
    server.tell_time(devices.relay.tick)  # its watchdog bites whether or not it has a connection
    return Addresses(
        table=table,
        stage=stage,
        profiler=profiler,
        profiles=profiles,
        laser=profiler
        if layout.laser is LaserWiring.HOKUYO
        else _laser_address(devices, layout, cabling, server, folder),
    )


def _laser_address(
    devices: Devices, layout: Layout, cabling: Cabling, server: Server, folder: Path
) -> str:
    """Put what switches the laser on its wire; empty where nothing does."""
    if layout.laser is LaserWiring.NONE:
        return ""
    breath = devices.laser_cable
    if (baud := layout.laser.baud) is None:
        cable = cabling.tcp(Speaker.RELAY, breath)
        return _listen(devices.relay, cable, layout.relay_port, server)
    grbl = layout.laser is LaserWiring.GRBL
    device: Device = devices.laser_board if grbl else RtuServer({_DEVICE_ID: devices.relay})
    line = cabling.serial(Silent(device, breath), Speaker.RELAY)
    return _serve(Slow(line, baud), server, folder / "laser", baud)


def station_toml(layout: Layout, addresses: Addresses, part_name: str) -> str:
    """Write the station.toml of a layout, with comments."""
    mounting = layout.mounting
    return _STATION.format(
        name=json.dumps(f"simulated station, {part_name}"),
        table=table_toml(layout, addresses.table),
        stage=stage_toml(layout, addresses.stage),
        profiler=profiler_toml(layout, addresses.profiler, addresses.profiles),
        mounting=mounting,
        table_sense=mounting.turning.name.lower().replace("_", "-"),
        laser=laser_table(
            layout.laser, addresses.laser, device_id=_DEVICE_ID, watchdog_s=layout.watchdog_s
        ),
        stage_sense=mounting.lifting.name.lower(),
        kinematics_kind="nominal" if layout.crooked else "simulated",
        kinematics_say="what a ruler could tell" if layout.crooked else "as simulated, exactly",
        sensor_x=mounting.hand.name.lower(),
        azimuth_deg=round(math.degrees(mounting.azimuth_rad), 9),
        upright=kinematics_toml(layout.cut),
    )


def plan_toml(
    layout: Layout, part: Part, *, rings: int = PLAN_RINGS, stops: int = PLAN_STOPS
) -> str:
    """Write a plan.toml whose slices lie equidistant over the part: rings from foot to top."""
    if layout.cut is Cut.MERIDIANS:
        pattern = meridian_toml(layout.mounting, layout.sensor, part, rings)
        return _OTHER_PLAN.format(cut="Meridians", part=part.name, pattern=pattern)
    if layout.cut is Cut.STRIPES:
        pattern = stripe_toml(layout.mounting, part, rings)
        return _OTHER_PLAN.format(cut="Stripes", part=part.name, pattern=pattern)
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
        OpticalBench(part, layout.optics)
        if (stands := standing(layout.cut, layout.crooked)) is None
        else CrookedBench(part, layout.optics, stands),
        WorldAxis("table", table, pace, witness),
        WorldAxis("stage", stage, pace, witness),
        pace,
        witness,
    )


def _serial_lines(
    devices: Devices, layout: Layout, cabling: Cabling, server: Server, folder: Path
) -> tuple[str, str]:
    """Serve the lines of both axes; their addresses, the same where they share one."""
    lines = lines_of(devices.table, devices.stage, layout.stage_baud)
    if lines.table is lines.stage:
        both = cabling.serial(lines.table, Speaker.TABLE, Speaker.STAGE)
        return (_serve(both, server, folder / "axes", lines.baud),) * 2
    table = cabling.serial(lines.table, Speaker.TABLE)
    stage = cabling.serial(lines.stage, Speaker.STAGE)
    return (
        _serve(table, server, folder / "table", _TABLE_BAUD),
        _serve(stage, server, folder / "stage", lines.baud),
    )


def _serve(device: Device, server: Server, name: Path, baud: int) -> str:
    port = Pty(name, baud)
    server.serve_pty(port, device)
    return f"serial://{port.path}?baud={baud}"


def _listen(unit: ModbusUnit, cable: Callable[[Device], Device], port: int, server: Server) -> str:
    """Give one unit a port of its own."""
    listener = TcpListener(port)
    server.serve_tcp(listener, lambda: cable(TcpSession({_DEVICE_ID: unit})))
    return listener.address


_STATION = """\
# A simulated station, read by loftscan. Its addresses live as long as the simulator does.
# Lengths are mm, angles degrees, times s: every key says so.
name = {name}

{table}
{stage}
{profiler}
# what switches the laser; a Turck block drops its outputs when nobody talks to it
[laser]
{laser}

# how axes and sensor stand: {kinematics_say}
[kinematics]
kind = "{kinematics_kind}"
table_sense = "{table_sense}"
stage_sense = "{stage_sense}"
height_mm = {mounting.height_mm}
standoff_mm = {mounting.standoff_mm}
side_mm = {mounting.side_mm}
sensor_x = "{sensor_x}"
azimuth_deg = {azimuth_deg}
{upright}"""

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

_OTHER_PLAN = """\
# {cut} of the part {part}; positions are the stage's own, in mm.

{pattern}

[step_and_shoot]
settle_s = 0.0  # the simulated axes do not swing after they have stopped
profiles_per_stop = 1
"""
