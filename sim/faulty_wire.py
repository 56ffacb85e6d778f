"""A wire between a program and a device that loses, bends, delays and repeats what it carries.

::

    program --Way--> inner.receive             a message is what was said at once: a request, an
            <--Way-- answers, inner.tick       answer, a datagram
             '-- Plug: the cable, in or out --'

Everything follows from the seed, the messages and the times: a run that fails fails again. What is
said is kept in order, late or not, as a wire does; only *swap* overtakes, and datagrams do.
"""

from __future__ import annotations

import heapq
import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from sim.device import Broadcaster, Device
from sim.wire_faults import Carrier, WireFaults

_AGAIN_S = (0.001, 0.03)  # how long after itself a message comes again
_PIECES_S = (0.001, 0.02)  # between the pieces of one
_OVERTAKEN_S = 0.03
_NOISE_BYTES = range(1, 12)

Note = Callable[[float, str], object]


@dataclass(slots=True, eq=False)
class Plug:
    """A cable of one device, for all its connections: in or out, and whether it carries.

    Attributes
    ----------
    happened : Counter
        How often each fault struck, by its name.
    """

    name: str
    away_s: float = 0.5
    pulled_after_s: float | None = None
    note: Note = lambda _time_s, _fault: None
    happened: Counter[str] = field(default_factory=Counter)
    _out_until_s: float = -1.0
    _mute_until_s: float = -1.0
    _pull_at_s: float | None = None

    def pull(self, now_s: float) -> None:
        """Pull it; it is put back by itself."""
        self._out_until_s = now_s + self.away_s
        self.strike("unplug", now_s)

    def hush(self, now_s: float) -> None:
        """Let it carry nothing for a while, with the cable in."""
        self._mute_until_s = now_s + self.away_s
        self.strike("mute", now_s)

    def strike(self, fault: str, now_s: float) -> None:
        """Count a fault."""
        self.happened[fault] += 1
        self.note(now_s, fault)

    def is_out(self, now_s: float) -> bool:
        """Whether the cable is out."""
        if self._pull_at_s is not None and now_s >= self._pull_at_s:
            self._pull_at_s = None
            self.pull(now_s)
        return now_s < self._out_until_s

    def carries(self, now_s: float) -> bool:
        """Whether what is said now arrives; the first word starts the clock of a planned pull."""
        if self.pulled_after_s is not None:
            self._pull_at_s, self.pulled_after_s = now_s + self.pulled_after_s, None
        return not self.is_out(now_s) and now_s >= self._mute_until_s


class Way:
    """One direction: messages go in, and come out when they are due.

    Parameters
    ----------
    faults
        What can happen on `carrier`; see `WireFaults.on`.
    dice
        Of this direction alone.
    """

    def __init__(
        self, faults: WireFaults, carrier: Carrier, plug: Plug, dice: random.Random
    ) -> None:
        self._faults = faults.on(carrier)
        self._in_order = carrier is not Carrier.UDP
        self._whole = carrier is Carrier.TCP
        self.broken = False  # a TCP stream that was cut has no rest
        self._plug = plug
        self._dice = dice
        self._coming: list[tuple[float, int, bytes]] = []
        self._last_due_s = -1.0
        self._count = 0

    def put(self, message: bytes, now_s: float) -> None:
        """Hand it a message."""
        if not message or self.broken or not self._plug.carries(now_s):
            return
        if self._struck("drop", now_s):
            return
        bent = self._bent(message, now_s)
        delay_s = self._faults.late_s if self._struck("late", now_s) else 0.0
        overtaken = self._struck("swap", now_s)
        self._send(bent, now_s + delay_s + overtaken * _OVERTAKEN_S, overtaken, now_s)
        cut_off = self._whole and len(bent) < len(message)
        if not cut_off and self._struck("twice", now_s):
            self._queue(bent, now_s + delay_s + self._dice.uniform(*_AGAIN_S), self._in_order)
        if self._struck("mute", now_s):
            self._plug.hush(now_s)
        if self._struck("unplug", now_s):
            self._plug.pull(now_s)

    def due(self, now_s: float) -> list[bytes]:
        """What has arrived by now, oldest first; nothing survives a cable that is out."""
        if self._plug.is_out(now_s):
            self._coming.clear()
        arrived = []
        while self._coming and self._coming[0][0] <= now_s:
            arrived.append(heapq.heappop(self._coming)[2])
        return arrived

    def next_due_s(self) -> float | None:
        """When the next piece arrives."""
        return self._coming[0][0] if self._coming else None

    def _struck(self, fault: str, now_s: float) -> bool:
        chance = self._faults.chances.get(fault, 0.0)
        if not chance or self._dice.random() >= chance:
            return False
        if fault not in ("mute", "unplug"):  # the plug counts those
            self._plug.strike(fault, now_s)
        return True

    def _bent(self, message: bytes, now_s: float) -> bytes:
        if self._struck("flip", now_s):
            hit = self._dice.randrange(len(message))
            wrong = message[hit] ^ 1 << self._dice.randrange(8)
            message = message[:hit] + bytes([wrong]) + message[hit + 1 :]
        if self._struck("cut", now_s):
            message = message[: self._dice.randrange(len(message))]
            self.broken = self._whole
        if self._struck("noise", now_s):
            message = self._dice.randbytes(self._dice.choice(_NOISE_BYTES)) + message
        return message

    def _send(self, message: bytes, due_s: float, overtaken: bool, now_s: float) -> None:  # noqa: FBT001
        in_order = self._in_order and not overtaken
        if len(message) < 2 or not self._struck("split", now_s):  # no piece is empty
            self._queue(message, due_s, in_order)
            return
        at = self._dice.randrange(1, len(message))
        self._queue(message[:at], due_s, in_order)
        self._queue(message[at:], due_s + self._dice.uniform(*_PIECES_S), in_order)

    def _queue(self, piece: bytes, due_s: float, in_order: bool) -> None:  # noqa: FBT001
        if not piece:
            return
        if in_order:
            due_s = self._last_due_s = max(due_s, self._last_due_s)
        self._count += 1
        heapq.heappush(self._coming, (due_s, self._count, piece))


class FaultyLine:
    """A connection of a device over a bad wire; a `sim.device.Device` itself."""

    def __init__(
        self, device: Device, faults: WireFaults, carrier: Carrier, plug: Plug, dice: random.Random
    ) -> None:
        self._device = device
        self._plug = plug
        self._there = Way(faults, carrier, plug, random.Random(dice.random()))
        self._back = Way(faults, carrier, plug, random.Random(dice.random()))
        self._out = False

    @property
    def lost(self) -> bool:
        """Whether the connection is to be closed, or the cable is out."""
        broken = self._there.broken or self._back.broken
        return self._out or broken or bool(getattr(self._device, "lost", False))

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Carry a request there; return what has come back by now."""
        self._there.put(data, now_s)
        return self._carried(now_s)

    def tick(self, now_s: float) -> bytes:
        """Let time go on for the device and the wire."""
        self._back.put(self._device.tick(now_s), now_s)
        return self._carried(now_s)

    def _carried(self, now_s: float) -> bytes:
        self._out = self._plug.is_out(now_s)
        for request in self._there.due(now_s):
            self._back.put(self._device.receive(request, now_s), now_s)
        return b"".join(self._back.due(now_s))


class FaultyNetwork:
    """Datagrams over a bad network; a `sim.device.Broadcaster` itself."""

    def __init__(
        self, source: Broadcaster, faults: WireFaults, plug: Plug, dice: random.Random
    ) -> None:
        self._source = source
        self._way = Way(faults, Carrier.UDP, plug, dice)

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """Pass on what has arrived by now."""
        for datagram in self._source.datagrams(now_s):
            self._way.put(datagram, now_s)
        return self._way.due(now_s)
