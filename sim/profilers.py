"""The profilers of a simulated station by family: devices, their wires, their tables.

::

    baumer_ox   Modbus TCP, and datagrams
    riftek      HTTP, and datagrams
    registers   Modbus TCP alone: it waits for its trigger, and holds what it measured
    hokuyo      a serial port, on which its own laser is switched, too
    sick        RS-485: reads of its memory

The texts are written here, word by word, and not by the program that reads them.
"""

from __future__ import annotations

import math
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from sim.baumer_ox import OxSensor, OxSettings
from sim.cabling import Cabling
from sim.device import Device
from sim.faults import Breath, Silent, Speaker
from sim.hokuyo import HokuyoScanner, ScannerSettings
from sim.lasers import Slow
from sim.modbus import TcpSession
from sim.register_profiler import RegisterSensor, RegisterSettings
from sim.riftek import HttpSession, RfSensor, RfSettings
from sim.serving import Server
from sim.sick import ProfilerSettings, SickProfiler
from sim.wires import Pty, TcpListener, UdpSender
from sim.world import World

if TYPE_CHECKING:
    from sim.stations import Layout

_DEVICE_ID = 1
_HOKUYO_BAUD, _SICK_BAUD = 750_000, 2_000_000


class ProfilerFamily(Enum):
    """What measures."""

    BAUMER_OX = "baumer_ox"
    RIFTEK = "riftek"
    REGISTERS = "registers"
    HOKUYO = "hokuyo"
    SICK = "sick"


SimProfiler = OxSensor | RfSensor | RegisterSensor | HokuyoScanner | SickProfiler


def build_profiler(layout: Layout, world: World) -> SimProfiler:
    """The device that measures."""
    if layout.profiler_family is ProfilerFamily.RIFTEK:
        return RfSensor(world, RfSettings(rate_hz=layout.rate_hz, clock=layout.sensor_clock))
    if layout.profiler_family is ProfilerFamily.REGISTERS:
        return RegisterSensor(world, RegisterSettings(rate_hz=layout.rate_hz))
    if layout.profiler_family is ProfilerFamily.HOKUYO:
        return HokuyoScanner(world, ScannerSettings())
    if layout.profiler_family is ProfilerFamily.SICK:
        return SickProfiler(world, ProfilerSettings(points=layout.sensor.points))
    return OxSensor(world, OxSettings(rate_hz=layout.rate_hz, clock=layout.sensor_clock))


def connect_profiler(
    profiler: SimProfiler,
    layout: Layout,
    cabling: Cabling,
    server: Server,
    folder: Path,
    laser_cable: Breath,
) -> tuple[str, str]:
    """Serve it; where it is asked, and where its profiles arrive: empty where they do not."""
    if isinstance(profiler, SickProfiler):
        line = cabling.serial(Slow(profiler, _SICK_BAUD), Speaker.PROFILER)
        return _serial(line, server, folder, _SICK_BAUD), ""
    if isinstance(profiler, HokuyoScanner):
        both = Silent(Slow(profiler, _HOKUYO_BAUD), laser_cable)
        line = cabling.serial(both, Speaker.PROFILER, Speaker.RELAY)
        return _serial(line, server, folder, _HOKUYO_BAUD), ""
    listener = TcpListener(layout.profiler_port)
    cable = cabling.tcp(Speaker.PROFILER)
    server.serve_tcp(listener, lambda: cable(_session(profiler)))
    if isinstance(profiler, RegisterSensor):
        server.tell_time(profiler.tick)
        return listener.address, ""
    profiles = UdpSender(layout.profiles_port)
    server.broadcast(profiles, cabling.network(profiler, Speaker.PROFILER))
    return listener.address, profiles.address


def _serial(line: Device, server: Server, folder: Path, baud: int) -> str:
    port = Pty(folder / "profiler", baud)
    server.serve_pty(port, line)
    return f"serial://{port.path}?baud={baud}"


def _session(profiler: OxSensor | RfSensor | RegisterSensor) -> Device:
    if isinstance(profiler, RfSensor):
        return HttpSession(profiler)
    return TcpSession({_DEVICE_ID: profiler})


def profiler_toml(layout: Layout, address: str, profiles: str) -> str:
    """Write [profiler]."""
    return _WRITERS[layout.profiler_family](layout, address, profiles)


def _baumer_ox(layout: Layout, address: str, profiles: str) -> str:
    sensor = layout.sensor
    return f"""\
# what measures: a Baumer OX200
[profiler]
family = "baumer_ox"
address = "{address}"
device_id = {_DEVICE_ID}
profiles = "{profiles}"  # our end of the wire: here they arrive
rate_hz = {layout.rate_hz}
points_per_profile = {sensor.points}
x_mm_per_count = {sensor.x_mm_per_count}
z_mm_per_count = {sensor.z_mm_per_count}
x_offset_mm = {sensor.x_offset_mm}
z_offset_mm = {sensor.z_offset_mm}
"""


def _riftek(layout: Layout, address: str, profiles: str) -> str:
    return f"""\
# what measures: a RIFTEK RF62X
[profiler]
family = "riftek"
address = "{address}"
profiles = "{profiles}"  # our end of the wire: here they arrive
rate_hz = {layout.rate_hz}
points_per_profile = {layout.sensor.points}
z_offset_mm = {layout.sensor.near_mm}  # where its range begins
"""


def _registers(layout: Layout, address: str, profiles: str) -> str:
    del profiles
    sensor = RegisterSettings()
    return f"""\
# what measures: a sensor whose columns stand in Modbus registers
[profiler]
family = "registers"
address = "{address}"
device_id = {_DEVICE_ID}
function = 4
first_register = 16
rate_hz = {layout.rate_hz}
points_per_profile = {sensor.columns}
z_mm_per_count = {sensor.z_mm_per_count}
column_pitch_mm = {sensor.pitch_mm}
first_column_mm = {sensor.first_column_mm}
no_return_value = 65535
out_of_range_value = 65534
sequence_register = 1
ready_register = 0
ready_bit = 0
trigger_register = 0
"""


def _hokuyo(layout: Layout, address: str, profiles: str) -> str:
    del profiles
    told = ScannerSettings()
    seen = math.floor(math.atan(layout.sensor.steepest) / (math.tau / told.steps_a_turn))
    return f"""\
# what measures: a Hokuyo scanner, whose own laser it lights itself
[profiler]
family = "hokuyo"
address = "{address}"
port = "rs-232"
first_step = {told.front_step - seen}
last_step = {told.front_step + seen}
rate_hz = {told.rpm / 60.0}
serial = "{told.serial}"
"""


def _sick(layout: Layout, address: str, profiles: str) -> str:
    del profiles
    told = ProfilerSettings()
    return f"""\
# what measures: a SICK Profiler 2
[profiler]
family = "sick"
address = "{address}"
points = {layout.sensor.points}
x_mm_per_count = {told.x_mm_per_count}
z_mm_per_count = {told.z_mm_per_count}
z_offset_mm = {told.z_offset_mm}  # the middle of its range
"""


_WRITERS = {
    ProfilerFamily.BAUMER_OX: _baumer_ox,
    ProfilerFamily.RIFTEK: _riftek,
    ProfilerFamily.REGISTERS: _registers,
    ProfilerFamily.HOKUYO: _hokuyo,
    ProfilerFamily.SICK: _sick,
}
