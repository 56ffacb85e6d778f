"""Devices whose answers are numbers that follow from the question, in every protocol."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from sim.device import ModbusRefusal
from sim.hokuyo.lines import plain, scan
from sim.sick import SickProfiler
from sim.zaber.device import Answer


def number(place: int) -> int:
    """A hash of a place, of 16 bits."""
    return place * 2654435761 >> 7 & 0xFFFF


def range_of(step: int) -> int:
    """A hash of a step, as a range in mm that is no code."""
    return 20 + number(step) % 5000


class NumberedUnit:
    """A Modbus unit whose registers cannot be written."""

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


class NumberedStage:
    """What a `ZaberChain` needs of a device: ``get number.7`` is answered with number(7)."""

    sends_checks = True

    def tick(self, now_s: float) -> Iterable[tuple[int, str, str]]:
        del now_s
        return ()

    def seen(self, now_s: float) -> tuple[str, str]:
        del now_s
        return "IDLE", "--"

    def do(self, axis: int, words: Sequence[str], now_s: float) -> Answer:
        del axis, now_s
        match list(words):
            case ["get", name] if name.startswith("number.") and name[7:].isdecimal():
                return Answer(taken=True, data=str(number(int(name[7:]))))
        return Answer(taken=False, data="BADCOMMAND")


class Memory(SickProfiler):
    """A Profiler 2 whose memory holds a number at every address."""

    def __init__(self) -> None:
        super().__init__(None)  # type: ignore[arg-type] # it looks at no world

    def _at(self, buffers: object, address: int) -> list[int]:
        del buffers
        return [number(address + k) for k in range(256)]


class NumberedScanner:
    """A scanner that answers GD with a number for every step, and nothing else.

    Laxer than the specification: it takes any string behind the command, half another among it.
    """

    def __init__(self) -> None:
        self._line = b""

    def receive(self, data: bytes, now_s: float) -> bytes:
        del now_s
        *lines, self._line = (self._line + data).replace(b"\r", b"\n").split(b"\n")
        return b"".join(self._heard(line.decode("latin-1")) for line in lines if line)

    def tick(self, now_s: float) -> bytes:
        del now_s
        return b""

    def _heard(self, line: str) -> bytes:
        command = line.partition(";")[0]
        if command[:2] != "GD" or not (command[2:].isdecimal() and len(command) == 12):
            return plain(line, "0E")
        first, last = int(command[2:6]), int(command[6:10])
        if not first <= last <= 725:
            return plain(line, "04")
        return scan(line, "00", 0, [range_of(step) for step in range(first, last + 1)], 3)
