"""A Modbus bus as drivers see it: registers and coils of devices by their id."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Bus(Protocol):
    """One Modbus connection, RTU or TCP, that several devices may share.

    Addresses are the protocol's own, from 0. Reads are retried once after a quarantine, writes
    never. All of them raise `NoReply`, `FrameError`, `LinkLost`, or `Refused` with the exception
    code of the device.
    """

    @property
    def address(self) -> str:
        """The address of the link, for messages."""
        ...

    @property
    def losses(self) -> int:
        """How often the link was lost: whoever was homed before one is not any more."""
        ...

    def framed(self, device_id: int, pdu: bytes) -> bytes:
        """A frame for somebody else to send or to expect, of a PDU."""
        ...

    def wire_s(self, size: int) -> float:
        """Seconds that so many bytes take on the wire."""
        ...

    @property
    def quiet_s(self) -> float:
        """Silence after which nothing of a dead program is on its way any more."""
        ...

    def read_holding(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        """Holding registers (function 3); exactly `count` unsigned 16-bit values."""
        ...

    def read_input(self, device_id: int, first: int, count: int) -> tuple[int, ...]:
        """Input registers (function 4)."""
        ...

    def read_coils(self, device_id: int, first: int, count: int) -> tuple[bool, ...]:
        """Coils (function 1)."""
        ...

    def write_register(self, device_id: int, register: int, value: int) -> None:
        """One register (function 6)."""
        ...

    def write_registers(self, device_id: int, first: int, values: Sequence[int]) -> None:
        """Several registers in one frame (function 16)."""
        ...

    def write_coil_word(self, device_id: int, coil: int, word: int) -> None:
        """Function 5 with a word of the device's own, beside on and off."""
        ...

    def write_coil(self, device_id: int, coil: int, value: bool) -> None:  # noqa: FBT001 (a coil is one)
        """One coil (function 5)."""
        ...
