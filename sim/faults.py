"""Faults that can be planted by name: ``--faults drop-blocks=50,stall-stage=12``.

None of these rolls dice: each counts, so that the same run fails in the same way again. Those of
`sim.wire_faults`, which are given in the same list, do, from a seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

from sim.device import Broadcaster, Device
from sim.wire_faults import WIRE_FAULTS, WireFaults, with_wire_fault


class Speaker(Enum):
    """Whose answers a fault is about."""

    TABLE = "table"
    STAGE = "stage"
    PROFILER = "profiler"
    RELAY = "relay"


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """Everything that is wrong with a station."""

    silent_after: Mapping[Speaker, int] = field(  # whole answers; the device is dead from then on
        default_factory=lambda: MappingProxyType({})
    )
    profiles: bool = True  # whether any is sent
    drop_every: int | None = None  # datagrams: each of that number is lost
    garble_every: int | None = None  # answers on serial lines: each of that number has a bit wrong
    stage_stalls_mm: float | None = None  # nothing above is reached
    wires: WireFaults = field(default_factory=WireFaults)


FAULTS: Mapping[str, str] = MappingProxyType(
    {
        "silent-table[=N]": "does not answer, or no longer after N answers",
        "silent-stage[=N]": "does not answer, or no longer after N answers",
        "silent-profiler[=N]": "does not answer, or no longer after N answers",
        "silent-relay[=N]": "does not answer, or no longer after N answers",
        "no-profiles": "the profiler answers, but sends no profile",
        "drop-blocks=N": "every N-th datagram of the profiles is lost",
        "stall-stage=MM": "the stage cannot go above that position",
        "garbage=N": "every N-th answer on a serial line has a wrong bit",
        **WIRE_FAULTS,
    }
)


def parse_faults(text: str) -> Faults:
    """Read a comma list of names; an empty one plants none.

    Raises
    ------
    ValueError
        One line: the name, and those that are known.
    """
    faults = Faults()
    for each in filter(None, (word.strip() for word in text.split(","))):
        faults = _planted(each, faults)
    return faults


def _planted(fault: str, faults: Faults) -> Faults:
    if (wires := with_wire_fault(fault, faults.wires)) is not None:
        return replace(faults, wires=wires)
    name, equals, number = fault.partition("=")
    if name in _SILENT:
        answers = _natural(fault, number, at_least=0) if equals else 0
        after = {**faults.silent_after, _SILENT[name]: answers}
        return replace(faults, silent_after=MappingProxyType(after))
    match name:
        case "no-profiles" if not equals:
            return replace(faults, profiles=False)
        case "drop-blocks":
            return replace(faults, drop_every=_natural(fault, number, at_least=1))
        case "garbage":
            return replace(faults, garble_every=_natural(fault, number, at_least=1))
        case "stall-stage":
            return replace(faults, stage_stalls_mm=_finite(fault, number))
    raise ValueError(f"fault {fault!r} is not known; known are {', '.join(FAULTS)}")


_SILENT = {f"silent-{each.value}": each for each in Speaker}


def _natural(fault: str, number: str, *, at_least: int) -> int:
    if not (number.isascii() and number.isdigit() and int(number) >= at_least):
        raise ValueError(f"fault {fault!r}: give a whole number from {at_least} on after the =")
    return int(number)


def _finite(fault: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"fault {fault!r}: give a number after the =")
    return value


@dataclass(slots=True, eq=False)
class Breath:
    """How many answers a device still gives, over all its connections."""

    answers: int


class Silent:
    """A connection of a device that, once out of breath, neither speaks nor hears."""

    def __init__(self, device: Device, breath: Breath) -> None:
        self._device = device
        self._breath = breath

    @property
    def lost(self) -> bool:
        """Whether the connection is to be closed."""
        return bool(getattr(self._device, "lost", False))

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Answer while there is breath."""
        return self._said(self._device.receive(data, now_s)) if self._breath.answers else b""

    def tick(self, now_s: float) -> bytes:
        """Let time go on, for the device's watchdogs, too."""
        return self._said(self._device.tick(now_s))

    def _said(self, words: bytes) -> bytes:
        if not words or not self._breath.answers:
            return b""
        self._breath.answers -= 1
        return words


class Garbling:
    """A serial line that flips the uppermost bit of one byte of every n-th answer.

    A check sum notices it, and in a protocol of ASCII it cannot be taken for another letter.
    """

    def __init__(self, device: Device, every: int) -> None:
        self._device = device
        self._every = every
        self._answers = 0

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Pass the answer on."""
        return self._passed(self._device.receive(data, now_s))

    def tick(self, now_s: float) -> bytes:
        """Pass on what is said unasked."""
        return self._passed(self._device.tick(now_s))

    def _passed(self, words: bytes) -> bytes:
        self._answers += bool(words)
        if not words or self._answers % self._every:
            return words
        hit = self._answers // self._every % len(words)
        return words[:hit] + bytes([words[hit] ^ 0x80]) + words[hit + 1 :]


class Dropping:
    """A network that loses every n-th datagram."""

    def __init__(self, source: Broadcaster, every: int) -> None:
        self._source = source
        self._every = every
        self._sent = 0

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """Pass on what is not lost."""
        kept = []
        for datagram in self._source.datagrams(now_s):
            self._sent += 1
            if self._sent % self._every:
                kept.append(datagram)
        return kept


class Unsent:
    """A profiler that measures, as the witness sees, and sends nothing."""

    def __init__(self, source: Broadcaster) -> None:
        self._source = source

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """Measure; send nothing."""
        self._source.datagrams(now_s)
        return ()
