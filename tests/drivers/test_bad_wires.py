"""Ten thousand questions over a bad wire: no wrong value is returned as a good one.

The answering end is the simulator's, the wire `sim.faulty_wire`'s, the time virtual; `make wires`
does the same over real ptys and TCP connections. Each register holds a number of its own, so that
an answer to another question shows.
"""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import pytest

from drivers.errors import DriverError, LinkLost
from drivers.modbus import Framing, ModbusBus
from sim.device import ModbusRefusal
from sim.faulty_wire import FaultyLine, Plug
from sim.modbus import RtuServer, TcpSession
from sim.wire_faults import Carrier, WireFaults
from tests.drivers.virtual_wire import Clock, Slow, VirtualWire

QUESTIONS = 10_000
LATENCY_S = 0.002
# Late there, late back and doubled twice is 0.302 s: the slowest reply.
# Late, overtaken, doubled and split on both ways is 0.402 s: the slowest reply of this wire.
TIMEOUT_S, LATE_S, SLOWEST_S = 0.1, 0.12, 0.42
ASKED = {"late": 0.2, "flip": 0.05, "twice": 0.1}
ALL = {**ASKED, "drop": 0.02, "cut": 0.05, "swap": 0.02, "split": 0.1, "noise": 0.05, "mute": 0.001}


class Numbers:
    """A unit whose registers hold a hash of their address; they cannot be written."""

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        del now_s
        return [number(first + k) for k in range(count)]

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        return self.read_holding(first, count, now_s)

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        return [bool(each & 1) for each in self.read_holding(first, count, now_s)]

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        return self.read_coils(first, count, now_s)

    def write_registers(self, first: int, values: Sequence[int], now_s: float) -> None:
        raise ModbusRefusal(2)

    def write_coils(self, first: int, values: Sequence[bool], now_s: float) -> None:
        raise ModbusRefusal(2)

    def heard(self, now_s: float) -> None:
        pass

    def tick(self, now_s: float) -> None:
        pass


def number(address: int) -> int:
    return address * 2654435761 >> 7 & 0xFFFF


@dataclass
class BadBus:
    """A bus to the numbers over a bad wire; connected again when the connection is lost."""

    framing: Framing
    chances: dict[str, float]
    seed: int = 20
    clock: Clock = field(default_factory=Clock)
    plug: Plug = field(default_factory=lambda: Plug("bus", away_s=0.5))
    connections: int = 0

    def connect(self) -> ModbusBus:
        self.connections += 1
        rtu = self.framing is Framing.RTU
        server = RtuServer({1: Numbers()}) if rtu else TcpSession({1: Numbers()})
        faults = WireFaults(chances=MappingProxyType(self.chances), late_s=LATE_S)
        dice = random.Random(f"{self.seed} {self.connections}")
        carrier = Carrier.SERIAL if rtu else Carrier.TCP
        line = FaultyLine(Slow(server, LATENCY_S), faults, carrier, self.plug, dice)
        wire = VirtualWire(self.clock, line)
        return ModbusBus(
            wire,
            self.framing,
            timeout_s=TIMEOUT_S,
            slowest_reply_s=SLOWEST_S,
            clock=self.clock,
            sleep=wire.sleep,
        )

    def ask_much(self) -> Counter[str]:
        """Ask ten thousand times; count what came of it."""
        asking, came, bus = random.Random(7), Counter[str](), self.connect()
        for _ in range(QUESTIONS):
            first, count = asking.randrange(60_000), asking.randrange(1, 5)
            try:
                values = bus.read_holding(1, first, count)
            except DriverError as error:
                came["error"] += 1
                # A stream that was cut amid a message is out of step until somebody connects again.
                if isinstance(error, LinkLost) or self.framing is Framing.TCP:
                    bus = self.connect()
            else:
                right = values == tuple(number(first + k) for k in range(count))
                came["right" if right else "wrong"] += 1
        return came


@pytest.mark.parametrize("chances", [ASKED, ALL], ids=["late bent doubled", "everything"])
@pytest.mark.parametrize("framing", Framing)
def test_no_wrong_register_is_returned_as_good(framing, chances):
    bad = BadBus(framing, chances)
    came = bad.ask_much()
    assert came["wrong"] == 0
    assert came["right"] > 0.7 * QUESTIONS  # the wire is bad, not dead
    assert bad.plug.happened["late"] > QUESTIONS / 5


def test_without_doubt_of_what_was_heard_before_wrong_registers_come_through(monkeypatch):
    monkeypatch.setattr(ModbusBus, "_is_anothers", lambda *_: False)
    assert BadBus(Framing.RTU, ASKED).ask_much()["wrong"] > 20


def test_a_sound_line_is_asked_once_a_question():
    bad = BadBus(Framing.RTU, {})
    assert bad.ask_much() == {"right": QUESTIONS}
    # The answer, 2 ms, and the silence that makes it good.
    assert bad.clock() - 1000.0 < QUESTIONS * (LATENCY_S + 0.0055)
