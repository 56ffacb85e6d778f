"""Who answers at a station: every device is tried, whatever the others do.

The way in is the scan's own, `open_station`: laser off first. Where a link cannot be opened, a
stand-in takes its place that says why at each use, so that the rest is still reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from acquisition.lease import LONGEST_WAIT_S
from acquisition.opening import OpenStation, open_station
from acquisition.profilers import as_it_is
from acquisition.safety.guarding import unguarded
from acquisition.station import NoLaserSwitch, Station
from drivers.axis import Axis, AxisState, Identity, Motion
from drivers.errors import DriverError, LinkLost
from drivers.grbl import GrblAxis
from drivers.laser import Guarantee, LaserSwitch
from drivers.links import ByteLink, open_link
from drivers.profiler import Profiler
from drivers.tiers import tier_of

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
    lost: dict[str, str] = {}

    def opened(address: str) -> ByteLink:
        try:
            return links(address)
        except DriverError as gone:
            lost[address] = str(gone)
            return AbsentLink(address, str(gone))

    # A setup of the sensor that cannot be loaded is no reason to leave the axes unreached.
    plain = replace(station, profiler=as_it_is(station.profiler))
    with ExitStack() as way_out:
        trouble = ""
        try:
            devices = way_out.enter_context(open_station(plain, links=opened, guarding=unguarded))
        except DriverError as failed:
            trouble = str(failed)
            unlit = replace(plain, laser=NoLaserSwitch())
            devices = way_out.enter_context(open_station(unlit, links=opened, guarding=unguarded))
        yield Reached(devices, lost, trouble)


def survey(
    station: Station, *, links: Callable[[str], ByteLink] = open_link
) -> tuple[Finding, ...]:
    """Ask every device who it is and how it stands; none is lit, nothing moves."""
    findings: list[Finding] = []
    try:
        with reached(station, links=links) as found:
            at = found.devices
            findings.append(_laser(station, at.laser, at.guarantee, found))
            for role, axis in (("table", at.table), ("stage", at.stage)):
                findings.append(_axis(_blank(station, role), axis, found))
            findings.append(_profiler(_blank(station, "profiler"), at.profiler, found))
    except DriverError:
        # The way out switches off and stops: of who is silent that is told already.
        if not any(each.trouble for each in findings):
            raise
    return tuple(findings)


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
    return Finding(role, str(family), addresses, tier_of(family).value)


def _laser(station: Station, laser: LaserSwitch, promise: Guarantee, found: Reached) -> Finding:
    blank = _blank(station, "laser")
    if found.laser_trouble:
        return replace(blank, trouble=_lost(blank, found) or found.laser_trouble)
    try:
        return replace(blank, identity=laser.identify(), guarantee=promise)
    except DriverError as failed:
        return replace(blank, guarantee=promise, trouble=str(failed))


def _axis(blank: Finding, axis: Axis, found: Reached) -> Finding:
    if why := _lost(blank, found):
        return replace(blank, trouble=why)
    try:
        identified = replace(blank, identity=axis.identify())
        state = axis.state()
    except DriverError as failed:
        return replace(blank, trouble=str(failed))
    told = replace(identified, state=state)
    if state.motion is not Motion.ALARM:
        return told
    alarm = f"{state.alarm or 'in alarm'}; remove the cause, then home it"
    # A Grbl with a switch begins locked, and homing is what unlocks it: no trouble at all.
    if isinstance(axis, GrblAxis):
        return replace(told, advice=alarm)
    return replace(told, trouble=alarm)


def _profiler(blank: Finding, profiler: Profiler, found: Reached) -> Finding:
    if why := _lost(blank, found):
        return replace(blank, trouble=why)
    try:
        return replace(blank, identity=profiler.identify())
    except DriverError as failed:
        return replace(blank, trouble=str(failed))


def _lost(blank: Finding, found: Reached) -> str:
    return "; ".join(found.lost[each] for each in blank.addresses if each in found.lost)
