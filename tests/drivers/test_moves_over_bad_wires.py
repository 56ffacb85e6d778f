"""A move that returns has arrived, whatever the wire does to its words and to its answers.

Grbl's lines carry no checksum: a bent digit of a command is obeyed, one of a report is believed.
What holds all the same: a move is over only when the position read back is the one that was asked
for, so that a wrong one needs two digits bent alike. The world says where the axis truly is.
"""

from __future__ import annotations

import math
import random
from collections import Counter
from types import MappingProxyType

import pytest

from drivers.axis import Kind
from drivers.errors import DriverError
from sim.faulty_wire import FaultyLine, Plug
from sim.wire_faults import Carrier, WireFaults
from tests.drivers.motion_cases import FAMILIES, Bench

MOVES = 150
CHANCES = MappingProxyType({"late": 0.05, "flip": 0.02, "twice": 0.05, "cut": 0.01, "noise": 0.01})
_LATE_S = 0.03  # within the slowest reply of the bench's bus


class BadBench:
    """An axis whose wire goes bad once it is homed for the first time."""

    def __init__(self, name: str, seed: int) -> None:
        self.bench = Bench(FAMILIES[name])
        self.axis = self.bench.driver()
        self.axis.home(self.bench.pause)
        self._zero = self._motor() - self.axis.state().position
        self.plug = Plug(name)
        faults = WireFaults(chances=CHANCES, late_s=_LATE_S)
        line = FaultyLine(
            self.bench, faults, Carrier.SERIAL, self.plug, random.Random(f"{name} {seed}")
        )
        self.bench._device = line

    def move(self, target: float) -> str:
        """Move, and say what became of it; an error is followed by a new driver that homes."""
        try:
            if not self.axis.state().homed:
                self.axis.home(self.bench.pause)
            self.axis.move_to(target, self.bench.pause)
        except DriverError as error:
            self.axis = self.bench.driver()
            return type(error).__name__
        off = self._motor() - self._zero - target
        if self.axis.kind is Kind.ROTARY:
            off = math.remainder(off, math.tau)  # homing ends at a switch, in whatever turn
        off = abs(off)
        return "arrived" if off < 0.06 * self.bench.family.unit else "elsewhere"

    def _motor(self) -> float:
        return float(self.bench.axis.motor(self.bench.now_s))


SEEDS = MappingProxyType({"grbl": 1, "grblhal": 1, "leadshine": 4, "oriental": 4, "zaber": 4})


@pytest.mark.parametrize(
    ("name", "seed"), [(name, 1 + k) for name in FAMILIES for k in range(SEEDS[name])]
)
def test_a_move_that_returns_has_arrived(name, seed):
    bad, where = BadBench(name, seed), random.Random(3)
    unit = bad.bench.family.unit
    came = Counter(bad.move(where.uniform(1.0, 19.0) * unit) for _ in range(MOVES))
    assert came["elsewhere"] == 0
    assert came["arrived"] > MOVES / 3  # the wire is bad, not dead
    assert bad.plug.happened["flip"] > MOVES / 10
