"""What the laser hangs on: an I/O block, a relay board, a Grbl board's output, or nothing.

Each is a choice of `--laser`, served on a wire of its kind; a serial one takes the time of its baud
rate, which a pty does not.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum

from sim.device import Device
from sim.grbl import GrblBoard, GrblSettings
from sim.motion import AxisMotion, Limits
from sim.relay import Block, Contact, RelaySettings
from sim.witness import Witness
from sim.world import World, WorldAxis

_BITS_A_CHARACTER = 10
_UNWARNED = "warning_s = 0.0  # nobody stands at a simulated laser"


class LaserWiring(Enum):
    """What switches the laser."""

    TURCK = "turck"  # Modbus TCP, with a watchdog
    PLAIN_TCP = "plain-tcp"  # a relay board behind a gateway, without one
    PLAIN = "plain"  # the same on a serial line of 115200 baud
    PLAIN_9600 = "plain-9600"
    TIMED = "timed"  # a relay board with a timed on
    GRBL = "grbl"  # the spindle output of a board of its own
    HOKUYO = "hokuyo"  # the scanner that measures, by itself
    NONE = "none"  # it is on as long as the station has power

    @property
    def baud(self) -> int | None:
        """Of its serial line; None where it is on the network, or nowhere."""
        bauds = {self.PLAIN: 115200, self.PLAIN_9600: 9600, self.TIMED: 115200, self.GRBL: 115200}
        return bauds.get(self)


def relay_settings(wiring: LaserWiring) -> RelaySettings:
    """The block or board of a wiring."""
    blocks = {LaserWiring.TURCK: Block.WATCHED, LaserWiring.TIMED: Block.TIMED}
    return RelaySettings(block=blocks.get(wiring, Block.PLAIN))


def spindle_board(world: World, witness: Witness) -> GrblBoard:
    """A board that moves nothing and whose spindle output is the laser."""
    nothing = AxisMotion.standing(0.0, Limits(math.radians(90.0), math.radians(900.0)))
    axis = WorldAxis("spare", nothing, world.pace, witness)

    def drive(now_s: float, on: bool) -> None:  # noqa: FBT001 (an output is one)
        world.switch_laser(now_s, on=on, why="spindle")

    return GrblBoard(axis, GrblSettings(homing=False), spindle=drive)


def laser_table(wiring: LaserWiring, address: str, *, device_id: int, watchdog_s: float) -> str:
    """The keys of station.toml's table [laser]."""
    if wiring is LaserWiring.NONE:
        return 'switch = "none"'
    if wiring in (LaserWiring.GRBL, LaserWiring.HOKUYO):
        return f'switch = "{wiring.value}"\naddress = "{address}"\n{_UNWARNED}'
    family = {LaserWiring.TURCK: "turck", LaserWiring.TIMED: "timed"}.get(wiring, "plain")
    lines = [
        'switch = "relay"',
        f'family = "{family}"',
        f'address = "{address}"',
        f"device_id = {device_id}",
        'output_by = "coil"',
        "output = 0",
        _UNWARNED,
    ]
    if family == "turck":
        lines.append(f"watchdog_s = {watchdog_s}")
        lines += [f"{each.name.lower()}_input = {each.value}" for each in Contact]
    return "\n".join(lines)


class Slow:
    """A serial line in front of a device: bytes arrive when the last of them has passed."""

    def __init__(self, device: Device, baud: int) -> None:
        self._device = device
        self._byte_s = _BITS_A_CHARACTER / baud
        self._inward: deque[tuple[float, bytes]] = deque()
        self._outward: deque[tuple[float, bytes]] = deque()
        self._free_s = [-math.inf, -math.inf]  # when each way has room for the next byte

    @property
    def lost(self) -> bool:
        """Whether its cable is out."""
        return bool(getattr(self._device, "lost", False))

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Begin to let bytes pass."""
        if data:
            self._inward.append((self._passed_s(0, data, now_s), data))
        return self.tick(now_s)

    def tick(self, now_s: float) -> bytes:
        """Hand over what has passed by now; a pty shows it in one piece."""
        while self._inward and self._inward[0][0] <= now_s:
            due_s, data = self._inward.popleft()
            self._answer(self._device.receive(data, due_s), due_s)
        self._answer(self._device.tick(now_s), now_s)
        if self.lost:
            self._inward.clear()
            self._outward.clear()
        said = b""
        while self._outward and self._outward[0][0] <= now_s:
            said += self._outward.popleft()[1]
        return said

    def _answer(self, data: bytes, now_s: float) -> None:
        if data:
            self._outward.append((self._passed_s(1, data, now_s), data))

    def _passed_s(self, way: int, data: bytes, now_s: float) -> float:
        begins_s = max(now_s, self._free_s[way])
        self._free_s[way] = begins_s + len(data) * self._byte_s
        return self._free_s[way]
