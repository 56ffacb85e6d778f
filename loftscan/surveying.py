"""Who answers at a station: every device is tried, whatever the others do.

`survey` only asks: nothing is reset, set, switched, lit or moved, so that it may be done beside
whoever owns the station. `halt` goes in as a scan does, by `open_station`: laser off first. Where a
link cannot be opened, a stand-in takes its place that says why at each use, so that the rest is
still reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from acquisition.axes import stage_maker, table_maker
from acquisition.lease import LONGEST_WAIT_S
from acquisition.opening import OpenStation, Wires, open_station, open_wires
from acquisition.ports import check_ports
from acquisition.profilers import as_it_is, profiler_maker
from acquisition.safety.guarding import unguarded
from acquisition.safety.places import holder_at
from acquisition.safety.switches import switch_of
from acquisition.station import NoLaserSwitch, Station
from drivers.addresses import SerialAddress, parse_address
from drivers.axis import Axis, AxisState, Identity, Motion
from drivers.errors import DriverError, LinkLost
from drivers.grbl import GrblAxis
from drivers.inspection import Counted, Inspected, Watched
from drivers.laser import Guarantee, LaserSwitch
from drivers.links import ByteLink, open_link
from drivers.profiler import Profiler
from drivers.serial_link import NO_PORT
from drivers.tiers import tier_of, tier_of_switch
from loftscan.machine import ports

_BRAKING_S = 5.0


@dataclass(frozen=True, slots=True)
class Finding:
    """What one device said of itself, or why it said nothing."""

    role: str
    family: str
    addresses: tuple[str, ...]
    tier: str
    identity: Identity | None = None
    state: AxisState | None = None  # of an axis
    guarantee: Guarantee | None = None  # of a laser switch
    counters: Mapping[str, int] = field(default_factory=dict)  # how its line fared meanwhile
    advice: str = ""  # what is to be done before it can be used
    trouble: str = ""  # why it cannot be used, and the remedy

    @property
    def position(self) -> str:
        """An axis's position for a person; empty for the others."""
        if self.state is None or math.isnan(self.state.position):
            return ""
        if self.role == "table":
            return f"{math.degrees(self.state.position):.3f} deg"
        return f"{self.state.position:.3f} mm"


@dataclass(frozen=True, slots=True)
class Halt:
    """What came of stopping one device."""

    role: str
    said: str  # as it was read back
    trouble: str = ""


@dataclass(frozen=True, slots=True)
class Reached:
    """A station as far as it answers."""

    devices: OpenStation
    lost: dict[str, str]  # by address: why its link is not open
    laser_trouble: str  # why the laser's switch was left out; empty where it was not


class AbsentLink:
    """Stands in for a link that could not be opened, and says so at each use."""

    def __init__(self, address: str, why: str) -> None:
        self._address = address
        self._why = why

    @property
    def address(self) -> str:
        """The address that was tried."""
        return self._address

    def read(self, timeout_s: float) -> bytes:
        """Raise LinkLost."""
        raise LinkLost(self._why)

    def write(self, data: bytes) -> None:
        """Raise LinkLost."""
        raise LinkLost(self._why)

    def close(self) -> None:
        """Nothing was opened."""


@contextmanager
def reached(station: Station, *, links: Callable[[str], ByteLink] = open_link) -> Iterator[Reached]:
    """Open what can be opened; on the way out everything that answers is at rest.

    Nothing is lit and nothing moves, so nobody guards, and no place is locked: "stop" is for a
    station that somebody else has, too.

    What the way out has to complain of is raised, even where it is of a device that never answered.
    """
    unsaid = _Unreached(links)
    # A setup of the sensor that cannot be loaded is no reason to leave the axes unreached.
    plain = replace(station, profiler=as_it_is(station.profiler))
    with ExitStack() as way_out:
        trouble = ""
        try:
            devices = way_out.enter_context(
                open_station(plain, links=unsaid.opened, guarding=unguarded)
            )
        except DriverError as failed:
            trouble = str(failed)
            unlit = replace(plain, laser=NoLaserSwitch())
            devices = way_out.enter_context(
                open_station(unlit, links=unsaid.opened, guarding=unguarded)
            )
        yield Reached(devices, unsaid.lost, trouble)


def survey(
    station: Station, *, links: Callable[[str], ByteLink] = open_link, times: int = 1
) -> tuple[Finding, ...]:
    """Ask every device who it is and how it stands; see the module.

    Parameters
    ----------
    times
        How often each is asked how it stands: many times tell a bad cable by the counters.

    Raises
    ------
    ValueError
        The station holds what a driver cannot do; nothing was asked.
    """
    check_ports(station)
    unsaid = _Unreached(links)
    made = (
        ("laser", lambda at: switch_of(station.laser, at)[0], _laser),
        ("table", table_maker(station.table), _axis),
        ("stage", stage_maker(station.stage), _axis),
        ("profiler", profiler_maker(as_it_is(station.profiler)), _profiler),
    )
    with open_wires(station, links=unsaid.opened) as wires:
        return tuple(
            _found(_blank(station, role), make, ask, wires, unsaid, times)
            for role, make, ask in made
        )


class _Unreached:
    """Opens links, and remembers why one could not be."""

    def __init__(self, links: Callable[[str], ByteLink]) -> None:
        self.lost: dict[str, str] = {}
        self._links = links

    def opened(self, address: str) -> ByteLink:
        """The link, or a stand-in that says at each use why there is none."""
        try:
            return self._links(address)
        except DriverError as gone:
            self.lost[address] = str(gone)
            return AbsentLink(address, str(gone))

    def why(self, addresses: Iterable[str]) -> str:
        """Why a device cannot be asked at its addresses; empty where it can be."""
        return "; ".join(self.lost[each] for each in addresses if each in self.lost)


def _found(
    blank: Finding,
    make: Callable[[Wires], Any],
    ask: Callable[[Finding, Any, int], Finding],
    wires: Wires,
    unsaid: _Unreached,
    times: int,
) -> Finding:
    """Make a device's driver and ask; what it complains of is its trouble, and its alone."""
    # The kernel locks a serial port, and its name is soon another's; a network device nobody locks.
    for address in blank.addresses:
        if not isinstance(parse_address(address), SerialAddress) and (holder := holder_at(address)):
            return replace(blank, trouble=f"{address}: held by {holder}; end it first")
    try:
        device = make(wires)
    except DriverError as failed:
        return replace(blank, trouble=str(failed))
    if why := unsaid.why(blank.addresses):
        return replace(blank, trouble=why + _ports_here(why))
    try:
        told = ask(blank, device, times)
    except DriverError as failed:
        told = replace(blank, trouble=str(failed))
    line = device.counters() if isinstance(device, Counted) else {}
    shared = wires.counters(blank.addresses[0]) if blank.addresses else {}
    return replace(told, counters={**shared, **line, **told.counters})


def _ports_here(why: str) -> str:
    """Which ports there are, for somebody whose port is not there."""
    if NO_PORT not in why:
        return ""
    nameless = ("", "n/a")
    names = [
        each.device if each.description in nameless else f"{each.device} ({each.description})"
        for each in ports()
    ]
    return f" here are {', '.join(names)}" if names else ""


def _who(device: Any) -> Identity:  # noqa: ANN401 (any driver)
    who: Identity = device.inspect() if isinstance(device, Inspected) else device.identify()
    return who


def _laser(blank: Finding, laser: LaserSwitch, times: int) -> Finding:
    who = _who(laser)
    for _ in range(times):
        lit = laser.is_on()
    promise = laser.standing_guarantee() if isinstance(laser, Watched) else laser.guarantee()
    switched = blank.family != "none"
    advice = "the laser is on: keep out of its plane" if lit and switched else ""
    return replace(blank, identity=who, guarantee=promise, advice=advice)


def _axis(blank: Finding, axis: Axis, times: int) -> Finding:
    who = _who(axis)
    for _ in range(times):
        state = axis.state()
    told = replace(blank, identity=who, state=state)
    if state.motion is not Motion.ALARM:
        return told
    alarm = f"{state.alarm or 'in alarm'}; remove the cause, then home it"
    # A Grbl with a switch begins locked, and homing is what unlocks it: no trouble at all.
    if isinstance(axis, GrblAxis):
        return replace(told, advice=alarm)
    return replace(told, trouble=alarm)


def _profiler(blank: Finding, profiler: Profiler, times: int) -> Finding:
    for _ in range(times):
        who = _who(profiler)
    tally = profiler.tally()
    frames = {"dropped_frames": tally.lost_profiles, "torn_frames": tally.torn_profiles,
              "bad_frames": tally.bad_frames}  # fmt: skip
    return replace(blank, identity=who, counters=frames)


def halt(station: Station, *, links: Callable[[str], ByteLink] = open_link) -> tuple[Halt, ...]:
    """Laser off, then both axes stopped and seen to stand; what fails keeps nothing else back."""
    halts: list[Halt] = []
    try:
        with reached(station, links=links) as found:
            at = found.devices
            halts.append(_dark(station, at.laser, found))
            axes: dict[str, Axis] = {"stage": at.stage, "table": at.table}
            # Both are told before either is waited for.
            trouble = {
                name: _stopped(_blank(station, name), axis, found) for name, axis in axes.items()
            }
            for name, axis in axes.items():
                untold = Halt(name, "", trouble[name])
                halts.append(untold if trouble[name] else _standing(name, axis, at))
    except DriverError:
        if not any(each.trouble for each in halts):
            raise
    return tuple(halts)


def _dark(station: Station, laser: LaserSwitch, found: Reached) -> Halt:
    blank = _blank(station, "laser")
    if found.laser_trouble:
        return Halt("laser", "", _lost(blank, found) or found.laser_trouble)
    try:
        laser.off()
        lit = laser.is_on()
    except DriverError as failed:
        return Halt("laser", "", str(failed))
    if not lit:
        return Halt("laser", "off, read back")
    if isinstance(station.laser, NoLaserSwitch):
        return Halt("laser", found.devices.guarantee.sentence.removeprefix("laser: "))
    return Halt("laser", "", "it reads on after off was sent; press the emergency stop")


def _stopped(blank: Finding, axis: Axis, found: Reached) -> str:
    """Send the stop; why it failed, or nothing."""
    if why := _lost(blank, found):
        return why
    try:
        axis.stop()
    except DriverError as failed:
        return str(failed)
    return ""


def _standing(name: str, axis: Axis, at: OpenStation) -> Halt:
    """Wait until the axis stands."""
    deadline_s = at.clock() + _BRAKING_S
    try:
        while (state := axis.state()).motion in (Motion.MOVING, Motion.HOMING):
            if at.clock() >= deadline_s:
                return Halt(name, "", f"still moves after {_BRAKING_S} s; press the emergency stop")
            at.sleep(LONGEST_WAIT_S)
    except DriverError as failed:
        return Halt(name, "stop sent", str(failed))
    where = Finding(name, "", (), "", state=state).position
    alarm = f", alarm {state.alarm}" if state.alarm else ""
    return Halt(name, f"stands{' at ' + where if where else ''}{alarm}, read back")


def _blank(station: Station, role: str) -> Finding:
    settings = getattr(station, role)
    if isinstance(settings, NoLaserSwitch):
        return Finding(role, "none", (), "")
    family = settings.switch if role == "laser" else settings.family
    names = ("address", "profiles")
    addresses = tuple(getattr(settings, name) for name in names if hasattr(settings, name))
    tier = tier_of_switch(family) if role == "laser" else tier_of(family)
    return Finding(role, str(family), addresses, tier.value)


def _lost(blank: Finding, found: Reached) -> str:
    return "; ".join(found.lost[each] for each in blank.addresses if each in found.lost)
