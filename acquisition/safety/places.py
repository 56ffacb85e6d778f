"""One program at a station: a lock for every address that its devices are reached at.

A serial port is locked by the kernel, a TCP device by nobody; and a port that a dead program's
guard still speaks on is not free yet. So the guard holds a lock file for each address, from before
the first is opened until it has let go, whoever dies meanwhile. The files lie in a folder of the
user's own: two users of one machine do not see each other's.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.addresses import UdpAddress, parse_address
from drivers.errors import PortBusy
from drivers.holders import Holder, holder_of

_PATIENCE_S = 10.0  # for the guard of a program that is dead
_LOOK_S = 0.02


@dataclass(frozen=True, slots=True)
class Place:
    """An address, and the file whose lock stands for it."""

    address: str
    file: Path


def places_of(addresses: Sequence[str]) -> list[Place]:
    """Give the places of a station's addresses, each once; where profiles arrive is none."""
    folder = _folder()
    found: dict[Path, Place] = {}
    for address in addresses:
        parsed = parse_address(address)
        if not isinstance(parsed, UdpAddress):
            name = os.path.realpath(parsed.device) if hasattr(parsed, "device") else None
            spelled = name or f"{parsed.host}:{parsed.port}"  # type: ignore[union-attr]
            file = folder / (spelled.strip("/").replace("/", "-") + ".lock")
            found.setdefault(file, Place(address, file))
    return sorted(found.values(), key=lambda place: place.file)


def wait_for_its_turn(
    places: Sequence[Place],
    lock: Callable[[Sequence[str]], Mapping[str, Any]],
    sleep: Callable[[float], object],
) -> None:
    """Take every lock; a dead program's guard is waited for, a living program is not.

    Raises
    ------
    PortBusy
        Names the address and the process.
    """
    deadline_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            lock_all(places, lock)
        except _Dying as dying:
            if time.monotonic() >= deadline_s:
                raise PortBusy(
                    f"{dying}: the guard of a program that is dead has not let go in"
                    f" {_PATIENCE_S:g} s; press the emergency stop, then end that guard"
                ) from dying
        else:
            return
        sleep(_LOOK_S)


class _Dying(PortBusy):
    """A program is dead, its guard is not done."""


def lock_all(places: Sequence[Place], lock: Callable[[Sequence[str]], Mapping[str, Any]]) -> None:
    """Take every lock, now.

    Raises
    ------
    PortBusy
        Names the address and, where it is alive, the process.
    """
    addresses = {str(place.file): place.address for place in places}
    answer = lock(list(addresses))
    if answer["ok"]:
        return
    address, holder = addresses[answer["file"]], holder_of(answer["holder"])
    if holder is not None:
        raise PortBusy(f"{address}: held by {holder}; end it first")
    raise _Dying(address)


def holder_at(address: str) -> Holder | None:
    """The living program that has the place of an address, if one has; takes nothing."""
    for place in places_of([address]):
        try:
            descriptor = os.open(place.file, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        except OSError:  # nobody has it, or somebody whose files we may not see
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return holder_of(os.pread(descriptor, 20, 0).decode("ascii", "replace").strip())
        finally:
            os.close(descriptor)
    return None


def _folder() -> Path:
    """A folder that only this user can write."""
    own = Path(f"/run/user/{os.getuid()}")
    folder = own / "loftscan" if own.is_dir() else Path(f"/tmp/loftscan-{os.getuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise PortBusy(f"{folder}: belongs to somebody else; remove it, locks lie in it")
    return folder
