"""What this machine has for a station: ports, permissions, libraries, and whose our names are."""

from __future__ import annotations

import ctypes
import grp
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import packages_distributions
from pathlib import Path

from drivers.holders import holders_of

PACKAGES = ("drivers", "acquisition", "reconstruction", "sim", "loftscan")
_OURS = "loftscan"
_LIBRARIES = {"libGL.so.1": "libgl1", "libOpenGL.so.0": "libopengl0"}


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port, who has it open, and what keeps us from it."""

    device: str
    description: str
    serial: str
    held_by: tuple[str, ...]
    trouble: str = ""  # and the remedy


@dataclass(frozen=True, slots=True)
class Check:
    """Something that a machine should have."""

    what: str
    trouble: str = ""  # and the remedy; empty when all is well


def ports() -> tuple[Port, ...]:
    """Every serial port that the system knows of."""
    from serial.tools import list_ports  # type: ignore[import-untyped]

    return tuple(
        inspected_port(each.device, each.description or "", each.serial_number or "")
        for each in sorted(list_ports.comports())
    )


def inspected_port(device: str, description: str = "", serial: str = "") -> Port:
    """Say who holds a port and whether it may be used."""
    held_by = tuple(str(holder) for holder in holders_of(device))
    trouble = _not_permitted(device)
    if not trouble and held_by:
        trouble = f"held by {' and '.join(held_by)}; end it first"
    return Port(device, description, serial, held_by, trouble)


def checks() -> tuple[Check, ...]:
    """Libraries and packages."""
    shipped = packages_distributions()
    return (
        *(library_check(name, package) for name, package in _LIBRARIES.items()),
        *(names_check(name, shipped) for name in PACKAGES),
    )


def library_check(name: str, package: str) -> Check:
    """A system library that pymeshlab needs."""
    try:
        ctypes.CDLL(name)
    except OSError:
        remedy = f"run: apt-get install {package}"
        return Check(f"{name} (mesh cleanup)", f"is not installed; {remedy}")
    return Check(f"{name} (mesh cleanup)")


def names_check(name: str, shipped: Mapping[str, Sequence[str]]) -> Check:
    """One of our import names, which are generic: nobody else may ship it."""
    rivals = sorted(set(shipped.get(name, ())) - {_OURS})
    if not rivals:
        return Check(f"import name {name}")
    listed = " and ".join(rivals)
    return Check(
        f"import name {name}",
        f"is shipped by {listed}, too; give loftscan an environment of its own, or run:"
        f" pip uninstall {' '.join(rivals)}",
    )


def _not_permitted(device: str) -> str:
    if os.access(device, os.R_OK | os.W_OK):
        return ""
    try:
        group = grp.getgrgid(Path(device).stat().st_gid).gr_name
    except (OSError, KeyError):
        group = "dialout"
    return f"not permitted; run: sudo adduser $USER {group}, then log in again"
