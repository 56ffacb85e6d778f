"""What stands between a wire and the World: devices that are handed bytes, and never wait.

No device opens a port, looks at a clock or sleeps: bytes and the time come in, bytes go out. So a
test runs one without a wire, and `sim.serving` runs them all in one thread.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Device(Protocol):
    """One end of one connection."""

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Take bytes off the wire, in whatever pieces they come; return the answers."""
        ...

    def tick(self, now_s: float) -> bytes:
        """Do what time has brought, and return what is said unasked; called every few ms."""
        ...


class Broadcaster(Protocol):
    """Sends datagrams unasked, such as profiles."""

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """What is due by now, oldest first; never what was due long ago."""
        ...


class ModbusRefusal(Exception):  # noqa: N818 (the protocol's word)
    """The unit answers with an exception; `code` is Modbus's."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class ModbusUnit(Protocol):
    """One device id on a Modbus wire: its registers and coils, as its manual numbers them."""

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Words of function 3; raises `ModbusRefusal`."""
        ...

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Words of function 4; raises `ModbusRefusal`."""
        ...

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """States of function 1; raises `ModbusRefusal`."""
        ...

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """States of function 2; raises `ModbusRefusal`."""
        ...

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Do functions 6 and 16; raises `ModbusRefusal` and then has changed nothing."""
        ...

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """Do functions 5 and 15; raises `ModbusRefusal` and then has changed nothing."""
        ...

    def heard(self, now_s: float) -> None:
        """Note that a whole frame for this unit came: what a communication watchdog waits for."""
        ...

    def tick(self, now_s: float) -> None:
        """Do what time has brought, such as a watchdog that ran out."""
        ...
