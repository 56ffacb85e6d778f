"""The profilers of a simulated station by family: devices, their wires, their tables.

::

    baumer_ox   Modbus TCP, and datagrams
    riftek      HTTP, and datagrams
    registers   Modbus TCP alone: it waits for its trigger, and holds what it measured

The texts are written here, word by word, and not by the program that reads them.
"""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from sim.baumer_ox import OxSensor, OxSettings
from sim.cabling import Cabling
from sim.device import Device
from sim.faults import Speaker
from sim.modbus import TcpSession
from sim.register_profiler import RegisterSensor, RegisterSettings
from sim.riftek import HttpSession, RfSensor, RfSettings
from sim.serving import Server
from sim.wires import TcpListener, UdpSender
from sim.world import World

if TYPE_CHECKING:
    from sim.stations import Layout

_DEVICE_ID = 1


class ProfilerFamily(Enum):
    """What measures."""

    BAUMER_OX = "baumer_ox"
    RIFTEK = "riftek"
    REGISTERS = "registers"


SimProfiler = OxSensor | RfSensor | RegisterSensor


def build_profiler(layout: Layout, world: World) -> SimProfiler:
    """The device that measures."""
    if layout.profiler_family is ProfilerFamily.RIFTEK:
        return RfSensor(world, RfSettings(rate_hz=layout.rate_hz))
    if layout.profiler_family is ProfilerFamily.REGISTERS:
        return RegisterSensor(world, RegisterSettings(rate_hz=layout.rate_hz))
    return OxSensor(world, OxSettings(rate_hz=layout.rate_hz))


def connect_profiler(
    profiler: SimProfiler, layout: Layout, cabling: Cabling, server: Server
) -> tuple[str, str]:
    """Serve it; where it is asked, and where its profiles arrive: empty where they do not."""
    listener = TcpListener(layout.profiler_port)
    cable = cabling.tcp(Speaker.PROFILER)
    server.serve_tcp(listener, lambda: cable(_session(profiler)))
    if isinstance(profiler, RegisterSensor):
        server.tell_time(profiler.tick)
        return listener.address, ""
    profiles = UdpSender(layout.profiles_port)
    server.broadcast(profiles, cabling.network(profiler, Speaker.PROFILER))
    return listener.address, profiles.address


def _session(profiler: SimProfiler) -> Device:
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


_WRITERS = {
    ProfilerFamily.BAUMER_OX: _baumer_ox,
    ProfilerFamily.RIFTEK: _riftek,
    ProfilerFamily.REGISTERS: _registers,
}
