"""Every motion family behind one face: its axis at its simulated device, and the wire between."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.axis import Axis, Kind
from drivers.grbl import GrblAxis
from drivers.leadshine import LeadshineStage
from drivers.oriental import AzAxis
from drivers.oriental import Settings as AzDriverSettings
from drivers.zaber import Chain, ZaberAxis
from drivers.zaber import Settings as ZaberDriverSettings
from sim.device import Device
from sim.grbl import GrblBoard, GrblSettings
from sim.leadshine import LeadshineDrive, LeadshineSettings
from sim.modbus import RtuServer
from sim.motion import Limits
from sim.oriental import AzDrive, AzSettings
from sim.world import WorldAxis
from sim.zaber import ZaberChain, ZaberDevice, ZaberSettings
from tests.sim.judges import LEAD_MM, STAGE, STAGE_ID, TABLE, Rig, world_axis

DEG = math.radians(1.0)
AZ_PER_DEG, ZABER_PER_DEG = 100.0, 6400.0 / 9.0
AZ = AzDriverSettings(
    name="table", kind=Kind.ROTARY, steps_per_unit=AZ_PER_DEG, lower=-math.tau,
    upper=2.0 * math.tau, speed=90.0 * DEG, acceleration=900.0 * DEG, tolerance=0.03 * DEG,
)  # fmt: skip
ZABER = ZaberDriverSettings(
    name="table", kind=Kind.ROTARY, microsteps_per_unit=ZABER_PER_DEG, lower=-math.tau,
    upper=2.0 * math.tau, speed=90.0 * DEG, tolerance=0.02 * DEG, encoder=True,
)  # fmt: skip


@dataclass(frozen=True)
class Family:
    """How to make one, and what on its wire moves something."""

    name: str
    unit: float  # a degree or a mm, in the axis's own unit
    lower: float
    upper: float
    make: Callable[[Bench, float], tuple[Device, Callable[[], Axis]]]
    moves: Callable[[bytes], bool]
    asks: Callable[[bytes], bool]


class Bench(Rig):
    """A device on its axis, a wire that can lose things, and as many drivers as one likes."""

    def __init__(self, family: Family, scale: float = 1.0) -> None:
        """`scale`: how many steps the device has by its settings, over what the station says."""
        self.family = family
        self.axis: WorldAxis
        self.sent: list[bytes] = []
        self.lose: Callable[[bytes], str] = lambda words: ""
        self._end, self._driver = family.make(self, scale)
        super().__init__(self)

    def driver(self) -> Axis:
        """A new connection."""
        return self._driver()

    def receive(self, data: bytes, now_s: float) -> bytes:
        if not data:
            return self._end.receive(data, now_s)
        self.sent.append(data)
        lost = self.lose(data)
        if lost == "request":
            return b""
        said = self._end.receive(data, now_s)
        return b"" if lost == "answer" else said

    def tick(self, now_s: float) -> bytes:
        return self._end.tick(now_s)

    def moves(self) -> list[bytes]:
        """What was sent that moves something."""
        return [words for words in self.sent if self.family.moves(words)]


def _grbl(bench: Bench, scale: float, *, hal: bool = False) -> tuple[Device, Callable[[], Axis]]:
    letter = "A" if hal else "X"
    bench.axis = world_axis("table", 0.3, Limits(math.pi, 30.0))
    board = GrblBoard(bench.axis, GrblSettings(letter=letter, hal=hal))
    if scale != 1.0:
        board.receive(f"${103 if hal else 100}={80.0 * scale:.3f}\n".encode(), 999.0)
    settings = replace(TABLE, letter=letter, tolerance=0.05 * DEG)
    return board, lambda: GrblAxis(bench.link, settings, clock=bench.clock)


def _grblhal(bench: Bench, scale: float) -> tuple[Device, Callable[[], Axis]]:
    return _grbl(bench, scale, hal=True)


def _leadshine(bench: Bench, scale: float) -> tuple[Device, Callable[[], Axis]]:
    bench.axis = world_axis("stage", 37.0, Limits(100.0, 2000.0))
    made = LeadshineSettings(screw_lead_mm=LEAD_MM, pulses_per_turn=round(10_000 * scale))
    line = RtuServer({STAGE_ID: LeadshineDrive(bench.axis, made)})
    return line, lambda: LeadshineStage(bench.bus(), STAGE_ID, STAGE, clock=bench.clock)


def _zaber(bench: Bench, scale: float) -> tuple[Device, Callable[[], Axis]]:
    bench.axis = world_axis("table", 1.0, Limits(10.0, 100.0))
    made = ZaberSettings(
        microsteps_per_unit=math.degrees(ZABER_PER_DEG), home_at=0.4, travel=(-20.0, 40.0),
        encoder=True, detects_stalls=False, resolution=round(64 * scale),
    )  # fmt: skip
    chain = ZaberChain({1: ZaberDevice(bench.axis, made)})
    return chain, lambda: ZaberAxis(Chain(bench.link, clock=bench.clock), ZABER)


def _oriental(bench: Bench, scale: float) -> tuple[Device, Callable[[], Axis]]:
    bench.axis = world_axis("table", 1.0, Limits(10.0, 100.0))
    made = AzSettings(
        steps_per_unit=math.degrees(AZ_PER_DEG), home_at=0.5, tells_deviation=False,
        stored={0x380: 1000, 0x382: round(1000 * scale)},
    )  # fmt: skip
    line = RtuServer({3: AzDrive(bench.axis, made)})
    return line, lambda: AzAxis(bench.bus(), 3, AZ, clock=bench.clock)


def _grbl_moves(words: bytes) -> bool:
    return b"G53" in words or b"$H" in words


FAMILIES = {
    each.name: each
    for each in (
        Family("grbl", DEG, TABLE.lower, TABLE.upper, _grbl, _grbl_moves, lambda w: w == b"?"),
        Family("grblhal", DEG, TABLE.lower, TABLE.upper, _grblhal, _grbl_moves,
               lambda w: w == b"?"),
        Family("leadshine", 1.0, STAGE.low_mm, STAGE.high_mm, _leadshine,
               lambda w: w[2:4] == b"\x62\x00" or (w[2:4] == b"\x60\x02" and w[5] == 0x20),
               lambda w: w[1] == 3),
        Family("zaber", DEG, ZABER.lower, ZABER.upper, _zaber,
               lambda w: b" move " in w or b" home" in w,
               lambda w: b" get " in w or w.count(b" ") == 2),
        Family("oriental", DEG, AZ.lower, AZ.upper, _oriental,
               lambda w: w[1] == 16 and (w[2:4] == b"\x00\x58" or w[10:11] == b"\x10"),
               lambda w: w[1] == 3),
    )
}  # fmt: skip
