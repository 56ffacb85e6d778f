"""From what station.toml says to devices that answer, and back to a station at rest.

::

    way in    laser: link, off, its watchdog  >  table  >  stage  >  profiler
    way out   laser off  <  stage stops  <  table stops  <  laser off again  <  its link closes

The first bytes to the laser are off. Every way out is gone to its end: what fails there does not
keep the rest from being done, the first error is the one that is raised, the others are its notes.
Opening moves nothing, and asks only the laser's switch anything.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from acquisition.axes import stage_maker, table_maker
from acquisition.ports import check_ports
from acquisition.station import (
    BaumerOx,
    NoLaserSwitch,
    OutputBy,
    RelayFamily,
    RelayLaser,
    Station,
)
from drivers import baumer_ox, relay, zaber
from drivers.addresses import SerialAddress, TcpAddress, UdpAddress, parse_address
from drivers.axis import Axis, Identity
from drivers.endings import at_last, unless_done
from drivers.laser import Guarantee, LaserSwitch
from drivers.links import ByteLink, open_link
from drivers.modbus import Framing, ModbusBus, rtu_silence_s
from drivers.profiler import Profiler

Clock = Callable[[], float]
Sleep = Callable[[float], None]

_REPLY_S = {Framing.RTU: 0.2, Framing.TCP: 0.5}  # a network's worst is worse than a cable's
_SLOWEST_REPLY_S = {Framing.RTU: 0.3, Framing.TCP: 0.5}


@dataclass(frozen=True, slots=True, eq=False)
class OpenStation:
    """A station whose links are open; made by `open_station`."""

    settings: Station
    table: Axis
    stage: Axis
    profiler: Profiler
    laser: LaserSwitch
    guarantee: Guarantee  # what the laser's switch promised when it was opened
    clock: Clock
    sleep: Sleep


@contextmanager
def open_station(
    station: Station,
    *,
    clock: Clock = time.monotonic,
    sleep: Sleep = time.sleep,
    links: Callable[[str], ByteLink] = open_link,
) -> Iterator[OpenStation]:
    """Open every device; laser off, axes stopped and links closed on every way out.

    Parameters
    ----------
    clock, sleep
        Monotonic seconds, and how to let some pass.
    links
        Opens an address; a wire log or a test's loopbacks come in here.

    Raises
    ------
    ValueError
        The station holds what a driver cannot do; nothing has been opened.
    DriverError
        A device is not there or said no; names it.
    """
    check_ports(station)
    make_table, make_stage = table_maker(station.table), stage_maker(station.stage)
    profiler_settings = baumer_ox_settings(station.profiler)
    with ExitStack() as endings:
        wires = _Wires(links, clock, sleep, endings)
        laser = _laser(station.laser, wires)
        endings.enter_context(at_last(laser.off))
        laser.off()
        guarantee = laser.guarantee()
        table = make_table(wires)
        endings.enter_context(at_last(table.stop))
        stage = make_stage(wires)
        endings.enter_context(at_last(stage.stop))
        profiler = _profiler(station.profiler, profiler_settings, wires)
        endings.enter_context(at_last(laser.off))  # before the axes, which may take their time
        yield OpenStation(station, table, stage, profiler, laser, guarantee, clock, sleep)


@contextmanager
def at_rest_unless_done(station: OpenStation) -> Iterator[None]:
    """Laser off, then the axes stopped, if the block is left by anything but its end."""
    table, stage, laser = station.table, station.stage, station.laser
    with unless_done(table.stop), unless_done(stage.stop), unless_done(laser.off):
        yield


def baumer_ox_settings(profiler: BaumerOx) -> baumer_ox.Settings:
    """Scales that the sensor itself does not tell."""
    return baumer_ox.Settings(
        x_mm_per_count=profiler.x_mm_per_count,
        z_mm_per_count=profiler.z_mm_per_count,
        x_offset_mm=profiler.x_offset_mm,
        z_offset_mm=profiler.z_offset_mm,
        device_id=profiler.device_id,
    )


class _Wires:
    """Each link opened once and closed on the way out; devices at one address share its bus."""

    def __init__(
        self, links: Callable[[str], ByteLink], clock: Clock, sleep: Sleep, endings: ExitStack
    ) -> None:
        self.clock = clock
        self.sleep = sleep
        self._links = links
        self._endings = endings
        self._buses: dict[SerialAddress | TcpAddress | UdpAddress, ModbusBus] = {}
        self._chains: dict[SerialAddress | TcpAddress | UdpAddress, zaber.Chain] = {}

    def link(self, address: str) -> ByteLink:
        link = self._links(address)
        self._endings.enter_context(at_last(link.close))
        return link

    def chain(self, address: str) -> zaber.Chain:
        """A chain of Zaber devices; both axes may be on one."""
        place = replace(parse_address(address), text="")
        if place not in self._chains:
            self._chains[place] = zaber.Chain(self.link(address), clock=self.clock)
        return self._chains[place]

    def bus(self, address: str) -> ModbusBus:
        """Modbus RTU on a serial port, Modbus TCP over TCP."""
        place = replace(parse_address(address), text="")  # however it is spelled
        if place not in self._buses:
            serial = isinstance(place, SerialAddress)
            framing = Framing.RTU if serial else Framing.TCP
            self._buses[place] = ModbusBus(
                self.link(address),
                framing,
                timeout_s=_REPLY_S[framing],
                slowest_reply_s=_SLOWEST_REPLY_S[framing],
                silence_s=rtu_silence_s(place.baud) if isinstance(place, SerialAddress) else 0.0,
                clock=self.clock,
                sleep=self.sleep,
            )
        return self._buses[place]


def _profiler(settings: BaumerOx, scales: baumer_ox.Settings, wires: _Wires) -> baumer_ox.BaumerOx:
    bus, link = wires.bus(settings.address), wires.link(settings.profiles)
    profiler = baumer_ox.BaumerOx(bus, link, scales, clock=wires.clock)
    if settings.setup is not None:
        profiler.load_setup(settings.setup, wires.sleep)
    return profiler


def _laser(settings: RelayLaser | NoLaserSwitch, wires: _Wires) -> LaserSwitch:
    if isinstance(settings, NoLaserSwitch):
        return _Unswitched()
    by_coil = settings.output_by is OutputBy.COIL
    if settings.family is RelayFamily.PLAIN and not by_coil:
        raise ValueError('laser.output_by: a plain relay has coils only; write "coil"')
    bus, device_id = wires.bus(settings.address), settings.device_id
    if settings.family is RelayFamily.PLAIN:
        return relay.PlainRelay(
            bus, device_id, settings.output, clock=wires.clock, sleep=wires.sleep
        )
    return relay.WatchedBlock(
        bus,
        device_id,
        relay.Coil(settings.output) if by_coil else relay.OutputBit(settings.output),
        watchdog_s=settings.watchdog_s or 0.0,
        clock=wires.clock,
        sleep=wires.sleep,
    )


class _Unswitched:
    """No switch: the laser is on while the sensor has power, and nobody claims otherwise."""

    def identify(self) -> Identity:
        return Identity(family="none", model="no laser switch", firmware="")

    def guarantee(self) -> Guarantee:
        return Guarantee(
            None,
            "laser: nothing switches it; it is on while the sensor has power: stay at the station",
        )

    def on(self) -> None:
        """Nothing to do."""

    def off(self) -> None:
        """Nothing that could be done."""

    def is_on(self) -> bool:
        return True
