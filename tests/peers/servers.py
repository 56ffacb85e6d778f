"""Modbus servers of modbus-tk: plain banks of registers, and what a driver must see them do.

``servers.py KIND`` serves one on loopback until its stdin closes. Its first line says where; each
line after that is a request that writes, its PDU in hex.

::

    a driver --> pty <--pump--> pty <-- RtuServer       drive, turntable, contact
    a driver ---------------------> TcpServer           block, unwatched, sensor

The registers are written here from the manuals, as a third party would; nothing of ours is used.
"""

from __future__ import annotations

import os
import select
import struct
import sys
import threading
import time
import tty
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import modbus_tk.defines as tk
import serial
from modbus_tk.hooks import install_hook
from modbus_tk.modbus import Server, Slave
from modbus_tk.modbus_rtu import RtuServer
from modbus_tk.modbus_tcp import TcpServer

_BAUD = 115200
_WRITES = (5, 6, 15, 16)
_TABLES = {
    "coils": tk.COILS,
    "inputs": tk.ANALOG_INPUTS,
    "holding": tk.HOLDING_REGISTERS,
}

Words = Mapping[int, Sequence[int]]  # by the first of their addresses


def text(words: str, size: int) -> list[int]:
    """Two characters a word, the first in the high byte."""
    data = words.encode("ascii").ljust(size + size % 2, b"\0")
    return list(struct.unpack(f">{len(data) // 2}H", data))


def stores(slave: Slave, pdu: bytes) -> None:
    """What a plain bank does beside storing: nothing."""


class Moves:
    """A drive's 0x1003: after a start its bits drop late, stay down while it moves, come back."""

    # So long that a driver on a busy machine does not miss it.
    STALE_S, MOVING_S = 0.05, 0.75
    ENABLED, RUNNING, COMMAND_DONE, PATH_DONE, HOMED = 0x02, 0x04, 0x10, 0x20, 0x40

    def __init__(self) -> None:
        self._begun_s = -1.0
        self._bits = (0, 0, 0)  # before, meanwhile, afterwards
        self._counts: tuple[int, ...] = (0, 0)

    def __call__(self, slave: Slave, pdu: bytes) -> None:
        """Begin what a request asks for; tell how far the drive is."""
        function, first = struct.unpack_from(">BH", pdu)
        homed = self._bits[2] & self.HOMED
        if (function, first) == (16, 0x6200) and pdu.endswith(b"\x00\x10"):
            self._counts = struct.unpack_from(">HH", pdu, 8)
            self._begin(homed, homed | self.COMMAND_DONE | self.PATH_DONE)
        if (function, first) == (6, 0x6002) and pdu.endswith(b"\x00\x20"):
            self._counts = slave.get_values("holding 0x6000", 0x600B, 2)
            self._begin(0, self.COMMAND_DONE | self.HOMED)
        self._tell(slave, time.monotonic() - self._begun_s)

    def _begin(self, meanwhile: int, afterwards: int) -> None:
        self._begun_s = time.monotonic()
        self._bits = (self._bits[2], meanwhile | self.RUNNING, afterwards)

    def _tell(self, slave: Slave, since_s: float) -> None:
        phase = (since_s >= self.STALE_S) + (since_s >= self.STALE_S + self.MOVING_S)
        slave.set_values("holding 0x1003", 0x1003, self.ENABLED | self._bits[phase])
        if phase == 2:
            slave.set_values("holding 0x6000", 0x602C, self._counts)


class Turns:
    """An AZ drive's 0x007E: MOVE late after the start of a direct data operation, READY after."""

    STALE_S, MOVING_S = 0.03, 0.75
    HOME_END, READY, MOVE, IN_POSITION = 0x10, 0x20, 0x2000, 0x4000

    def __init__(self) -> None:
        self._begun_s = -1.0
        self._home = 0
        self._counts: tuple[int, ...] = (0, 0)

    def __call__(self, slave: Slave, pdu: bytes) -> None:
        """Begin what a request asks for; tell how far the drive is."""
        function, first = struct.unpack_from(">BH", pdu)
        if (function, first) == (16, 0x0058) and pdu.endswith(b"\x00\x00\x00\x01"):
            self._counts = struct.unpack_from(">HH", pdu, 14)
            self._begun_s = time.monotonic()
        if (function, first) == (16, 0x0078) and pdu.endswith(b"\x00\x10"):
            self._counts, self._home = (0, 0), self.HOME_END
            self._begun_s = time.monotonic()
        since_s = time.monotonic() - self._begun_s
        moves = self.STALE_S <= since_s < self.STALE_S + self.MOVING_S
        word = self._home | (self.MOVE if moves else self.READY | self.IN_POSITION)
        slave.set_values("holding 0x7e", 0x007E, (0, word))
        if since_s >= self.STALE_S + self.MOVING_S:
            slave.set_values("holding 0x120", 0x0120, self._counts)


def sets_up(slave: Slave, pdu: bytes) -> None:
    """Load a setup into the sensor, in its parametrisation and only there."""
    if pdu[0] == 6:
        register, value = struct.unpack_from(">HH", pdu, 1)
        if register in (0, 1):
            slave.set_values("inputs 0xc8", 200, 1 - register)
        elif slave.get_values("inputs 0xc8", 200) == (1,):
            slave.set_values("inputs 0x191", 401, value)


@dataclass(frozen=True)
class Bank:
    """What one device has."""

    device_id: int
    holding: Words = field(default_factory=dict)
    inputs: Words = field(default_factory=dict)
    coils: Words = field(default_factory=dict)
    does: Callable[[Slave, bytes], None] = stores


BANKS: Mapping[str, Callable[[], Bank]] = {
    # Leadshine: 10 000 pulses, closed loop, enabled; path 0 and what is around 0x6002.
    "drive": lambda: Bank(
        7,
        {0x0000: [0, 10_000, 0, 2], 0x1003: [2], 0x2203: [0], 0x6000: [0] * 48, 0x6200: [0] * 8},
        does=Moves(),
    ),
    # The same with the bits of a move that was long ago, and no motor behind it.
    "stuck": lambda: Bank(
        7,
        {0x0000: [0, 10_000, 0, 2], 0x1003: [0x72], 0x2203: [0], 0x6000: [0] * 48,
         0x6200: [0] * 8},
    ),
    # AZ: direct data, pulsed inputs, outputs and alarm, count, gear 1 : 1, wraps at 36 turns.
    "turntable": lambda: Bank(
        5,
        {0x0058: [0] * 16, 0x0078: [0, 0], 0x007E: [0, 0x20, 0, 0], 0x0120: [0, 0],
         0x0380: [0, 1, 0, 1], 0x038E: [0, 1, 0, 360]},
        does=Turns(),
    ),
    "contact": lambda: Bank(3, coils={0: [0] * 4}),
    "block": lambda: Bank(
        1,
        {0x0800: [0], 0x1000: text("TBEN-S1-8DOP", 14), 0x1017: [2], 0x1120: [0]},
        coils={0: [0] * 8},
    ),
    "unwatched": lambda: Bank(1, {0x0800: [0]}, coils={0: [0] * 8}),
    # OX200: status, quality, outputs; 123.456 is 0x42F6E979, -0.5 0xBF000000, 70 000 s 0x00011170.
    "sensor": lambda: Bank(
        1,
        {0: [0, 0], 501: [0]},
        {
            0: text("Baumer Electric AG", 66),
            40: text("11223344\0" + "OX200-R05A".ljust(65, "\0") + "C7H90001", 98),
            200: [0, 1, 0b10, 0xE979, 0x42F6, 0x0000, 0xBF00, *[0] * 10, 0x0000, 0x42C8,
                  0x1170, 0x0001, 0xA120, 0x0007, 0],
            401: [3],
        },
        does=sets_up,
    ),
}  # fmt: skip
_ON_A_LINE = ("drive", "stuck", "turntable", "contact")


def main(kind: str) -> None:
    """Serve until stdin closes."""
    bank = BANKS[kind]()
    server, address = _on_a_line() if kind in _ON_A_LINE else _over_tcp()
    slave = server.add_slave(bank.device_id)
    for table, block_type in _TABLES.items():
        for first, words in getattr(bank, table).items():
            slave.add_block(f"{table} {first:#x}", block_type, first, len(words))
            slave.set_values(f"{table} {first:#x}", first, list(words))

    def heard(request: tuple[Slave, bytes]) -> None:
        if request[1][0] in _WRITES:
            _say(request[1].hex(" "))
        bank.does(request[0], bytes(request[1]))

    install_hook("modbus.Slave.handle_request", heard)
    _say(address)
    sys.stdin.read()
    os._exit(0)  # its thread waits for a request that will not come


def _over_tcp() -> tuple[Server, str]:
    listening = threading.Event()

    class Listening(TcpServer):
        def _do_init(self) -> None:
            super()._do_init()
            listening.set()

    server = Listening(port=0, address="127.0.0.1")
    server.start()
    listening.wait()
    host, port = server._sock.getsockname()
    return server, f"tcp://{host}:{port}"


def _on_a_line() -> tuple[Server, str]:
    """Two ptys back to back, because modbus-tk opens a port by its name."""
    ends = [os.openpty() for _ in range(2)]
    for _, port in ends:
        tty.setraw(port)  # kept open: a driver that closes its end does not hang the line up
    masters = [master for master, _ in ends]
    threading.Thread(target=_pump, args=masters, daemon=True).start()
    near, far = (os.ttyname(port) for _, port in ends)
    # It ends a request after a silence of 10 ms instead of 1.75: a busy machine is no gap in it.
    server = RtuServer(serial.Serial(far, _BAUD), interframe_multiplier=20, interchar_multiplier=20)
    server.start()
    return server, f"serial://{near}?baud={_BAUD}"


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _pump(one: int, other: int) -> None:
    while True:
        for ready in select.select([one, other], [], [])[0]:
            os.write(other if ready == one else one, os.read(ready, 4096))


if __name__ == "__main__":
    main(sys.argv[1])
