"""What a bad wire does, by name: ``late=0.05,flip=0.01,unplug-stage=12``.

Unlike the faults of `sim.faults`, which count, these roll dice, from a seed: each message on a
wire, in either direction, meets each fault by its own chance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

_LONGEST_MS = 60_000.0


class Carrier(Enum):
    """What a wire is, which says what can happen to it."""

    SERIAL = "serial"
    TCP = "tcp"
    UDP = "udp"


@dataclass(frozen=True, slots=True, kw_only=True)
class WireFaults:
    """The chances, a message, and how long what takes time takes."""

    chances: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    late_s: float = 0.15
    away_s: float = 0.5  # how long a cable is out, or a line mute
    unplug_after_s: Mapping[str, float] = field(  # by the wire's name, from its first message on
        default_factory=lambda: MappingProxyType({})
    )

    def on(self, carrier: Carrier) -> WireFaults:
        """What of it can happen on a carrier; the rest is left out."""
        chances = {name: p for name, p in self.chances.items() if name not in _SPARED[carrier]}
        return replace(self, chances=MappingProxyType(chances))


CHANCES: Mapping[str, str] = MappingProxyType(
    {
        "late": "comes late-ms later, and what follows waits behind it",
        "drop": "is lost",
        "flip": "has one bit wrong",
        "cut": "loses its end; on TCP, with the connection",
        "twice": "comes again a moment later",
        "swap": "is overtaken by the next",
        "split": "comes in two pieces some ms apart",
        "noise": "has garbage before it",
        "mute": "is the last for away-ms",
        "unplug": "is the last before the cable is out, for away-ms",
    }
)
# TCP's own sums and order leave a peer or a gateway that is late, repeats itself, stops amid a
# message or resets; a datagram comes whole or not at all.
_SPARED: Mapping[Carrier, tuple[str, ...]] = {
    Carrier.SERIAL: (),
    Carrier.TCP: ("drop", "flip", "swap", "noise"),
    Carrier.UDP: ("split", "noise"),
}
WIRE_FAULTS: Mapping[str, str] = MappingProxyType(
    {
        **{f"{name}=P": f"chance, from 0 to 1, that a message {meaning}"
           for name, meaning in CHANCES.items()},
        "late-ms=MS": "how late (150)",
        "away-ms=MS": "how long mute or unplugged (500)",
        "unplug-WIRE=S": "table, stage, profiler or relay: out once, S s after its first message",
    }
)  # fmt: skip
WIRES = ("table", "stage", "profiler", "relay")


def with_wire_fault(fault: str, faults: WireFaults) -> WireFaults | None:
    """Add a fault given as ``name=number``; None when the name is none of a wire's.

    Raises
    ------
    ValueError
        A name of a wire's with a number that it cannot have; says which it can.
    """
    name, _, number = fault.partition("=")
    if name in CHANCES:
        chance = _number(fault, number, 1.0, "a chance from 0 to 1")
        return replace(faults, chances=MappingProxyType({**faults.chances, name: chance}))
    if name == "late-ms":
        return replace(faults, late_s=_seconds(fault, number))
    if name == "away-ms":
        return replace(faults, away_s=_seconds(fault, number))
    wire = name.removeprefix("unplug-")
    if wire in WIRES and wire != name:
        after_s = _number(fault, number, math.inf, "seconds from 0 on")
        pulled = MappingProxyType({**faults.unplug_after_s, wire: after_s})
        return replace(faults, unplug_after_s=pulled)
    return None


def _seconds(fault: str, number: str) -> float:
    return _number(fault, number, _LONGEST_MS, f"ms from 0 to {_LONGEST_MS:g}") / 1000.0


def _number(fault: str, number: str, most: float, wanted: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not (0.0 <= value <= most and math.isfinite(value)):
        raise ValueError(f"fault {fault!r}: give {wanted} after the =")
    return value
