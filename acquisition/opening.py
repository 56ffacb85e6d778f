"""From what station.toml says to devices that answer, and back to a station at rest.

::

    way in    guard  >  laser: link, off, its watchdog  >  table  >  stage  >  profiler
    way out   laser off  >  stage stops  >  table stops  >  laser off again  >  links  >  guard

The first bytes to the laser are off. Every way out is gone to its end: what fails there does not
keep the rest from being done, the first error is the one that is raised, the others are its notes.
Opening moves nothing, and asks only the laser's switch anything.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace

from acquisition.axes import stage_maker, table_maker
from acquisition.errors import GuardLost
from acquisition.lease import TTL_S, Lease
from acquisition.ports import check_ports
from acquisition.profiler_settings import Hokuyo
from acquisition.profilers import profiler_maker
from acquisition.safety.guarding import AttendedLink, Guard, NoGuard, first_word_s, guarded
from acquisition.safety.places import Place, lock_all, places_of
from acquisition.safety.resting import Line, Rest
from acquisition.safety.states import Event, Rules, State
from acquisition.safety.supervising import PermittedLaser, Supervisor
from acquisition.safety.switches import switch_of
from acquisition.station import NoLaserSwitch, Station
from drivers import hokuyo, zaber
from drivers.addresses import SerialAddress, TcpAddress, UdpAddress, parse_address
from drivers.axis import Axis
from drivers.endings import at_last, unless_done
from drivers.errors import PortBusy
from drivers.inspection import Counted
from drivers.laser import Guarantee
from drivers.links import ByteLink, open_link
from drivers.modbus import Framing, ModbusBus, rtu_silence_s
from drivers.profiler import Profiler
from drivers.recipes import Recipe, Recited
from drivers.tcp_link import LONGEST_CONNECT_S

Clock = Callable[[], float]
Sleep = Callable[[float], None]
Guarding = Callable[[Sequence[Place], Sleep], AbstractContextManager[Guard]]
_Address = SerialAddress | TcpAddress | UdpAddress

_REPLY_S = {Framing.RTU: 0.2, Framing.TCP: 0.5}  # a network's worst is worse than a cable's
_SLOWEST_REPLY_S = {Framing.RTU: 0.3, Framing.TCP: 0.5}


@dataclass(frozen=True, slots=True, eq=False)
class OpenStation:
    """A station whose links are open; made by `open_station`."""

    settings: Station
    table: Axis
    stage: Axis
    profiler: Profiler
    laser: PermittedLaser
    guarantee: Guarantee  # what the laser's switch promised when it was opened
    clock: Clock
    sleep: Sleep
    lease: Lease
    guard: Guard
    guarded: Mapping[str, float]  # by device: s from a death or a hang to the guard's word to it
    safety: Supervisor
    rest: Rest
    reopen_lost: Callable[[], None] = lambda: None  # every link; moves nothing, raises LinkLost


@contextmanager
def open_station(
    station: Station,
    *,
    clock: Clock = time.monotonic,
    sleep: Sleep = time.sleep,
    links: Callable[[str], ByteLink] = open_link,
    guarding: Guarding = guarded,
) -> Iterator[OpenStation]:
    """Open every device; laser off, axes stopped and links closed on every way out.

    Parameters
    ----------
    clock, sleep
        Monotonic seconds, and how to let some pass.
    links
        Opens an address; a wire log or a test's loopbacks come in here.
    guarding
        Starts who watches over this program, with the places that are to be its alone.

    Raises
    ------
    ValueError
        The station holds what a driver cannot do; nothing has been opened.
    DriverError
        A device is not there or said no; names it.
    GuardLost
        It could not be started.
    """
    check_ports(station)
    make_table, make_stage = table_maker(station.table), stage_maker(station.stage)
    make_profiler = profiler_maker(station.profiler)
    safety = _supervisor(station, clock)
    with ExitStack() as endings:
        endings.callback(safety.tell, Event.CLOSE)
        guard = endings.enter_context(guarding(places_of(_addresses(station)), sleep))
        doors = endings.enter_context(ExitStack())
        wires = Wires(links, clock, sleep, doors, guard, safety, station)
        switch, inputs = switch_of(station.laser, wires)
        laser = PermittedLaser(switch, safety, wires.line(getattr(station.laser, "address", "")))
        rest = Rest(laser, safety)
        endings.enter_context(at_last(laser.off))
        endings.enter_context(at_last(rest.come))
        laser.off()
        guarantee = laser.guarantee()
        wires.hand_over(switch, getattr(station.laser, "address", ""))
        safety.watch(inputs)
        table = make_table(wires)
        rest.add("table", table, wires.line(station.table.address))
        wires.hand_over(table, station.table.address)
        stage = make_stage(wires)
        rest.add("stage", stage, wires.line(station.stage.address))
        wires.hand_over(stage, station.stage.address)
        profiler = make_profiler(wires)
        wires.hand_over(profiler, station.profiler.address)
        lease = Lease(TTL_S, clock, guard)
        endings.enter_context(_telling(safety))  # the first to hear, and nothing is lit after
        yield OpenStation(
            station, table, stage, profiler, laser, guarantee, clock, wires.sleep, lease, guard,
            wires.guarded, safety, rest, wires.reopen_lost,
        )  # fmt: skip


@contextmanager
def open_wires(
    station: Station,
    *,
    clock: Clock = time.monotonic,
    sleep: Sleep = time.sleep,
    links: Callable[[str], ByteLink] = open_link,
) -> Iterator[Wires]:
    """A station's wires and nothing more: nothing is said on them, nobody guards.

    For whoever only asks. Links are opened at the first use, and closed with the block.
    """
    with ExitStack() as endings:
        yield Wires(links, clock, sleep, endings, NoGuard(), _supervisor(station, clock), station)


@contextmanager
def at_rest_unless_done(station: OpenStation) -> Iterator[None]:
    """Laser off, then the axes stopped, if the block is left by anything but its end."""
    with (
        _standing_after(station.safety),
        unless_done(station.rest.come),
        _telling(station.safety),
    ):
        yield


@contextmanager
def _telling(safety: Supervisor) -> Iterator[None]:
    """Whatever passes here is told to the state machine before anybody acts on it."""
    try:
        yield
    except BaseException as error:
        safety.fail(error)
        raise


@contextmanager
def _standing_after(safety: Supervisor) -> Iterator[None]:
    """A stop that was gone to its end has stopped; drivers know whether they know where."""
    try:
        yield
    except BaseException:
        if safety.state in (State.STOPPING, State.COMPLETING):
            safety.tell(Event.STANDS)
        raise


def _supervisor(station: Station, clock: Clock) -> Supervisor:
    """The state machine of a station whose file has been read."""
    safety = Supervisor(clock, Rules(warning_s=getattr(station.laser, "warning_s", 0.0)))
    safety.tell(Event.SELF_TESTED)
    safety.ask(Event.CONNECT)
    return safety


class Wires:
    """Each link opened once and closed on the way out; devices at one address share its bus.

    Whoever reads or sleeps here is alive: the guard is told.
    """

    def __init__(
        self,
        links: Callable[[str], ByteLink],
        clock: Clock,
        sleep: Sleep,
        endings: ExitStack,
        guard: Guard,
        safety: Supervisor,
        station: Station,
    ) -> None:
        self.clock = clock
        self.guarded: dict[str, float] = {}
        self._sleep = sleep
        self._links = links
        self._endings = endings
        self._guard = guard
        self._safety = safety
        self._roles = _roles(station)
        self._station = station
        self._opened: dict[_Address, AttendedLink] = {}
        self._lines: dict[_Address, Line] = {}
        self._places: dict[_Address, list[Place]] = {}  # as they were when it was opened
        self._recipes: dict[_Address, tuple[Recipe, ...]] = {}
        self._buses: dict[_Address, ModbusBus] = {}
        self._chains: dict[_Address, zaber.Chain] = {}
        self._scips: dict[_Address, hokuyo.ScipLine] = {}

    def sleep(self, seconds: float) -> None:
        """Let some time pass; 50 ms at most between two renewals."""
        self._sleep(seconds)
        self._guard.attend()

    def link(self, address: str) -> ByteLink:
        """Open an address."""
        link = self.brief_link(address)
        self._endings.enter_context(at_last(link.close))
        self._opened[_place(address)] = link
        self._places[_place(address)] = places_of([address])
        return link

    def brief_link(self, address: str) -> AttendedLink:
        """Open an address for somebody who closes it."""
        place = _place(address)
        role = self._roles.get(place, "sensor")

        def lost() -> None:
            self._safety.lost_role = role
            with suppress(GuardLost):
                self._leave(place)

        return AttendedLink(lambda: self._links(address), self._guard, lost)

    def line(self, address: str) -> Line | None:
        """The link that is open at an address, as one that can be opened again."""
        place = _place(address) if address else None
        if place not in self._opened:
            return None
        if place not in self._lines:
            self._lines[place] = Line(
                self._opened[place],
                before=lambda: self._let_go(place),
                after=lambda: self._take_up(place),
                clock=self.clock,
                sleep=self.sleep,
            )
        return self._lines[place]

    def reopen_lost(self) -> None:
        """Open every lost link again."""
        for address in [link.address for link in self._opened.values() if link.is_lost]:
            if (line := self.line(address)) is not None:
                line.say_again(lambda: None)

    def _let_go(self, place: _Address) -> None:
        """A port opens again only when nobody else has it open; connecting may take its time."""
        if self._roles.get(place) == "laser":  # which the guard could not reach either
            self._guard.renew(TTL_S + LONGEST_CONNECT_S)
        self._guard.drop(self._opened[place])
        self._move_lock(place)

    def _leave(self, place: _Address) -> None:
        """A name that is gone may be somebody else's at any time."""
        before = self._places.get(place)
        if before and places_of([self._opened[place].address]) != before:
            self._guard.unlock([str(each.file) for each in before])
            self._places[place] = []

    def _move_lock(self, place: _Address) -> None:
        """What is plugged in again may have another name.

        Off and stop do not wait for its lock: that nobody else has the port, the kernel says.
        """
        self._leave(place)
        now = places_of([self._opened[place].address])
        if now != self._places[place]:
            with suppress(PortBusy):
                lock_all(now, self._guard.lock)
                self._places[place] = now

    def _take_up(self, place: _Address) -> None:
        if place in self._buses:
            self._buses[place].begin_anew()
        self._guard.hold(self._opened[place], self._recipes.get(place, ()))

    def chain(self, address: str) -> zaber.Chain:
        """A chain of Zaber devices; both axes may be on one."""
        place = _place(address)
        if place not in self._chains:
            self._chains[place] = zaber.Chain(self.link(address), clock=self.clock)
        return self._chains[place]

    def scip(self, address: str) -> hokuyo.ScipLine:
        """A Hokuyo scanner's line; a switch-off waits no longer than its longest reply takes."""
        place = _place(address)
        if place not in self._scips:
            self._scips[place] = scip_line(self._station, self.link(address), self.clock)
        return self._scips[place]

    def counters(self, address: str) -> Mapping[str, int]:
        """How a line fares that several devices may share; empty where a driver has it alone."""
        place = _place(address)
        lines: tuple[Mapping[_Address, Counted], ...] = (self._buses, self._chains, self._scips)
        return next((each[place].counters() for each in lines if place in each), {})

    def hand_over(self, device: object, address: str) -> None:
        """Give the guard what it must know of a device to bring it to rest."""
        if not isinstance(device, Recited):
            return
        place, recipes = _place(address), device.recipes()
        self._recipes[place] = (*self._recipes.get(place, ()), *recipes)
        if self._guard.hold(self._opened[place], self._recipes[place]):
            self.guarded |= {
                each.device: first_word_s(TTL_S, each.quiet_s, each.wire_s) for each in recipes
            }

    def bus(self, address: str) -> ModbusBus:
        """Modbus RTU on a serial port, Modbus TCP over TCP."""
        place = _place(address)
        if place not in self._buses:
            serial = isinstance(place, SerialAddress)
            framing = Framing.RTU if serial else Framing.TCP
            self._buses[place] = ModbusBus(
                self.link(address),
                framing,
                timeout_s=_REPLY_S[framing],
                slowest_reply_s=_SLOWEST_REPLY_S[framing],
                silence_s=rtu_silence_s(place.baud) if isinstance(place, SerialAddress) else 0.0,
                baud=place.baud if isinstance(place, SerialAddress) else 9600,
                clock=self.clock,
                sleep=self.sleep,
            )
        return self._buses[place]


def _place(address: str) -> _Address:
    """An address however it is spelled."""
    return replace(parse_address(address), text="")


def _roles(station: Station) -> dict[_Address, str]:
    """What it means for the station when a link is lost; the laser's before all others."""
    roles = {_place(each.address): "axis" for each in (station.table, station.stage)}
    if not isinstance(station.laser, NoLaserSwitch):
        roles[_place(station.laser.address)] = "laser"
    return roles


def scip_line(station: Station, link: ByteLink, clock: Clock) -> hokuyo.ScipLine:
    """The line of a station's Hokuyo; a switch-off waits behind its longest reply."""
    if not isinstance(station.profiler, Hokuyo):
        return hokuyo.ScipLine(link, clock=clock)
    told = station.profiler.driver_settings
    return hokuyo.ScipLine(link, longest_reply_s=told.wire_s, baud=told.baud, clock=clock)


def _addresses(station: Station) -> list[str]:
    tables = (station.table, station.stage, station.profiler, station.laser)
    return [each.address for each in tables if not isinstance(each, NoLaserSwitch)]
