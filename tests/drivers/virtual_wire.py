"""A simulated device behind a bad wire as a ByteLink, in time that passes only while one waits."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.errors import LinkLost
from sim.device import Device

_TICK_S = 0.001


@dataclass
class Clock:
    """Seconds that pass only when somebody waits."""

    now_s: float = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Slow:
    """A device that takes its time to answer."""

    def __init__(self, device: Device, latency_s: float) -> None:
        self._device = device
        self._latency_s = latency_s
        self._due: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, now_s: float) -> bytes:
        if answer := self._device.receive(data, now_s):
            self._due.append((now_s + self._latency_s, answer))
        return b""

    def tick(self, now_s: float) -> bytes:
        said = self._device.tick(now_s)
        while self._due and self._due[0][0] <= now_s:
            said += self._due.pop(0)[1]
        return said


@dataclass
class VirtualWire:
    """What a driver is given in place of a port."""

    clock: Clock
    device: Device
    address: str = "virtual"
    written: list[bytes] = field(default_factory=list)
    _heard: bytes = b""

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self._heard += self.device.receive(data, self.clock())

    def read(self, timeout_s: float) -> bytes:
        until_s = self.clock() + timeout_s
        while not self._heard and self.clock() < until_s:
            self._step(until_s)
        if not self._heard and getattr(self.device, "lost", False):
            raise LinkLost(f"{self.address}: the device ended the connection")
        heard, self._heard = self._heard, b""
        return heard

    def sleep(self, seconds: float) -> None:
        """Let time pass for the device, too; what it says meanwhile is heard afterwards."""
        until_s = self.clock() + seconds
        while self.clock() < until_s:
            self._step(until_s)

    def close(self) -> None:
        pass

    def _step(self, until_s: float) -> None:
        self.clock.now_s = min(self.clock() + _TICK_S, until_s)
        self._heard += self.device.tick(self.clock())
