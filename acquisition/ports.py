"""Who may be on one serial port with whom, told before anything is opened.

A Grbl board has its port to itself, and so has a SICK sensor. Modbus devices share a line, Zaber
devices a chain, a Hokuyo's profiles and its laser's switch their scanner's port, if all of them say
the same of it: a line has one speed and one parity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from acquisition.motion_settings import ZaberStage, ZaberTable
from acquisition.profiler_settings import Hokuyo, SickProfiler2
from acquisition.station import GrblLaser, GrblTable, HokuyoLaser, NoLaserSwitch, Station
from drivers.addresses import SerialAddress, parse_address

_GRBL, _SICK = "Grbl", "SICK's protocol"
_ALONE = (_GRBL, _SICK)


@dataclass(frozen=True, slots=True)
class _Use:
    """One device's use of a port."""

    role: str
    port: SerialAddress
    language: str


def check_ports(station: Station) -> None:
    """Refuse a port that is used in two ways.

    Raises
    ------
    ValueError
        Names both devices and the port; nothing was opened.
    """
    first: dict[str, _Use] = {}
    for use in _uses(station):
        other = first.setdefault(use.port.device, use)
        if other is use:
            continue
        both = f"{use.role}.address: {use.port.device} is the {other.role}'s port, too"
        if use.language != other.language or use.language in _ALONE:
            raise ValueError(
                f"{both}, and {other.language} and {use.language} cannot share one; give it its own"
            )
        if replace(use.port, text="") != replace(other.port, text=""):
            raise ValueError(f"{both}, with other settings; write the same address for both")


def _uses(station: Station) -> Iterator[_Use]:
    for role in ("table", "stage", "profiler", "laser"):
        device = getattr(station, role)
        if isinstance(device, NoLaserSwitch):
            continue
        port = parse_address(device.address)
        if isinstance(port, SerialAddress):
            yield _Use(role, port, _language(device))


def _language(device: object) -> str:
    match device:
        case GrblTable() | GrblLaser():
            return _GRBL
        case SickProfiler2():
            return _SICK
        case ZaberTable() | ZaberStage():
            return "Zaber ASCII"
        case Hokuyo() | HokuyoLaser():
            return "SCIP"
        case _:
            return "Modbus"
