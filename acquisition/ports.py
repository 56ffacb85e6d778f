"""Who may be on one serial port with whom, told before anything is opened.

A Grbl board has its port to itself. Modbus devices share a line, and Zaber devices a chain, if all
of them say the same of it: a line has one speed and one parity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from acquisition.motion_settings import ZaberStage, ZaberTable
from acquisition.station import GrblTable, NoLaserSwitch, Station
from drivers.addresses import SerialAddress, parse_address

_ALONE = "Grbl"


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
        if use.language != other.language or use.language == _ALONE:
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
    if isinstance(device, GrblTable):
        return _ALONE
    return "Zaber ASCII" if isinstance(device, ZaberTable | ZaberStage) else "Modbus"
