"""Ten thousand questions over a bad wire: no wrong value is returned as a good one.

The answering end is the simulator's, the wire `sim.faulty_wire`'s, the time virtual; `make wires`
does the same over real ptys and TCP connections. Each register holds a number of its own, so that
an answer to another question shows.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import dataclass, field
from types import MappingProxyType

import pytest

from drivers.errors import DriverError, LinkLost
from drivers.hokuyo.line import ScipLine
from drivers.hokuyo.wire import Window, scan_command, scan_of
from drivers.modbus import Framing, ModbusBus
from sim.faulty_wire import FaultyLine, Plug
from sim.modbus import RtuServer, TcpSession
from sim.wire_faults import Carrier, WireFaults
from tests.campaigns.numbered import NumberedScanner, NumberedUnit, number, range_of
from tests.drivers.virtual_wire import Clock, Slow, VirtualWire

QUESTIONS = 10_000
LATENCY_S = 0.002
# Late there, late back and doubled twice is 0.302 s: the slowest reply.
# Late, overtaken, doubled and split on both ways is 0.402 s: the slowest reply of this wire.
TIMEOUT_S, LATE_S, SLOWEST_S = 0.1, 0.12, 0.42
ASKED = {"late": 0.2, "flip": 0.05, "twice": 0.1}
ALL = {**ASKED, "drop": 0.02, "cut": 0.05, "swap": 0.02, "split": 0.1, "noise": 0.05, "mute": 0.001}


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
        server = RtuServer({1: NumberedUnit()}) if rtu else TcpSession({1: NumberedUnit()})
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


# --- half a command ------------------------------------------------------------------------------


def ask_a_scanner(questions: int) -> Counter[str]:
    """Ask for the numbers of some steps; half a command stays in the sensor until its line ends."""
    clock, asking, came = Clock(), random.Random(5), Counter[str]()
    faults = WireFaults(chances=MappingProxyType(ALL), late_s=0.15)
    device = Slow(NumberedScanner(), LATENCY_S)
    line = FaultyLine(device, faults, Carrier.SERIAL, Plug("scanner"), random.Random(3))
    scanner = ScipLine(VirtualWire(clock, line), clock=clock)
    for _ in range(questions):
        first = asking.randrange(44, 700)
        window = Window(first, first + asking.randrange(1, 25))
        try:
            ranges = scan_of(scanner.ask(scan_command(window)), window).ranges.tolist()
        except DriverError:
            came["error"] += 1
        else:
            due = [range_of(step) for step in range(first, window.last + 1)]
            came["right" if ranges == due else "wrong"] += 1
    return came


def test_a_scan_of_other_steps_is_not_returned_as_good():
    came = ask_a_scanner(QUESTIONS)
    assert came["wrong"] == 0
    assert came["right"] > 0.6 * QUESTIONS


def test_where_half_a_command_is_not_ended_the_next_is_answered_with_its_scan(monkeypatch):
    monkeypatch.setattr(ScipLine, "end_torn_commands", lambda _: None)
    assert ask_a_scanner(QUESTIONS)["wrong"] > 0
