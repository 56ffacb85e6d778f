"""A whole simulated station behind virtual wires, in time that passes only while somebody waits.

The simulator's devices, the program's drivers, and between them links that hand bytes over at the
step of the clock at which they are due. A run depends on its seed alone, and hours take minutes.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field

from acquisition.opening import OpenStation, open_station
from acquisition.safety.guarding import NoGuard
from acquisition.station import Station, parse_station
from drivers.links import ByteLink
from sim.axes import lines_of
from sim.device import Broadcaster, Device
from sim.faulty_wire import FaultyNetwork, Plug
from sim.modbus import TcpSession
from sim.profilers import SimProfiler
from sim.riftek import HttpSession, RfSensor
from sim.solids import Part
from sim.stations import Addresses, Devices, Layout, build, station_toml
from sim.wire_faults import WireFaults
from sim.witness import Memory

STEP_S = 0.001
START_S = 1000.0
ADDRESSES = Addresses(
    table="serial:///virtual/table?baud=115200",
    stage="serial:///virtual/stage?baud=115200",
    profiler="tcp://192.0.2.1:80",
    profiles="udp://192.0.2.2:9000",
    laser="tcp://192.0.2.3:502",
)


@dataclass
class Room:
    """The clock, and every link whose other end lives while it goes on."""

    now_s: float = START_S
    links: list[VirtualLink | VirtualNetwork] = field(default_factory=list)
    watch: Callable[[], object] = lambda: None  # called after each step

    def clock(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self.now_s < until_s:
            self.step(until_s)

    def step(self, until_s: float) -> None:
        self.now_s = min(self.now_s + STEP_S, until_s)
        for link in self.links:
            link.tick(self.now_s)
        self.watch()


@dataclass
class VirtualLink:
    """A serial line or a connection."""

    room: Room
    device: Device
    address: str
    heard: bytes = b""

    def tick(self, now_s: float) -> None:
        self.heard += self.device.tick(now_s)

    def write(self, data: bytes) -> None:
        self.heard += self.device.receive(data, self.room.now_s)

    def read(self, timeout_s: float) -> bytes:
        until_s = self.room.now_s + timeout_s
        while not self.heard and self.room.now_s < until_s:
            self.room.step(until_s)
        heard, self.heard = self.heard, b""
        return heard

    def close(self) -> None:
        if self in self.room.links:
            self.room.links.remove(self)


@dataclass
class VirtualNetwork:
    """Datagrams that take a little longer now and then, and stay in order."""

    room: Room
    source: Broadcaster
    dice: random.Random
    address: str = ADDRESSES.profiles
    coming: deque[tuple[float, bytes]] = field(default_factory=deque)
    last_s: float = 0.0

    def tick(self, now_s: float) -> None:
        for datagram in self.source.datagrams(now_s):
            self.last_s = max(self.last_s, now_s + self.dice.expovariate(1.0 / 0.0005))
            self.coming.append((self.last_s, datagram))

    def write(self, data: bytes) -> None:
        raise AssertionError("nobody answers a datagram")

    def read(self, timeout_s: float) -> bytes:
        until_s = self.room.now_s + timeout_s
        while not self._due() and self.room.now_s < until_s:
            self.room.step(until_s)
        return self.coming.popleft()[1] if self._due() else b""

    def close(self) -> None:
        if self in self.room.links:
            self.room.links.remove(self)

    def _due(self) -> bool:
        return bool(self.coming) and self.coming[0][0] <= self.room.now_s


@dataclass
class VirtualStation:
    """What a test holds: both ends."""

    station: OpenStation
    settings: Station
    devices: Devices
    room: Room
    witness: Memory


@contextmanager
def virtual_station(
    layout: Layout, part: Part, *, lost: float = 0.0, settings: Station | None = None
) -> Iterator[VirtualStation]:
    """Open a station of this layout; each datagram of its profiler is lost by that chance."""
    room, witness = Room(), Memory()
    devices = build(layout, part, witness, room.now_s)
    said = settings or parse_station(station_toml(layout, ADDRESSES, part.name))
    lines = lines_of(devices.table, devices.stage, layout.stage_baud)
    dice = random.Random(f"{layout.seed} network")
    faults = WireFaults(chances={"drop": lost} if lost else {})
    broadcaster = FaultyNetwork(devices.profiler, faults, Plug("profiler"), dice)  # type: ignore[arg-type]

    def link(address: str) -> ByteLink:
        made: VirtualLink | VirtualNetwork
        if address == said.table.address:
            made = VirtualLink(room, lines.table, address)
        elif address == said.stage.address:
            made = VirtualLink(room, lines.stage, address)
        elif address == said.profiler.address:
            made = VirtualLink(room, _session(devices.profiler), address)
        elif address == ADDRESSES.profiles:
            made = VirtualNetwork(room, broadcaster, dice)
        else:
            made = VirtualLink(room, TcpSession({1: devices.relay}), address)
        room.links.append(made)
        return made

    with open_station(
        said,
        clock=room.clock,
        sleep=room.sleep,
        links=link,
        guarding=lambda *_: nullcontext(NoGuard()),
    ) as station:
        yield VirtualStation(station, said, devices, room, witness)


def _session(profiler: SimProfiler) -> Device:
    if isinstance(profiler, RfSensor):
        return HttpSession(profiler)
    return TcpSession({1: profiler})  # type: ignore[dict-item]
