"""A Modbus block of outputs, one of which is the laser's supply or interlock.

After the manuals of Turck's multiprotocol blocks (TBEN-S 1181682 p72-75, TBEN-L p64, FGEN p124):
a register 0x1120 of milliseconds that the block waits for the next request before it switches all
outputs off by itself; 0 is never. Other substitute values than off are impossible there. Outputs
that were dropped stay off until somebody writes them again: that is all the re-arming there is.

A plain relay board has the coils and nothing else; a timed one also switches an output on for so
many tenths of a second, by a word of function 5 at 0x0200 and up (Waveshare's "flash on").

The manuals that could be had do not say where the coils lie; here coil n is output n, as it is on
the plain boards. Nor do they say how 0x1020 counts: here it is what is left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from sim.device import ModbusRefusal
from sim.world import World

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3

_INPUTS = range(0x0000, 0x0200)
_OUTPUTS = range(0x0800, 0x0A00)
_OUTPUTS_AGAIN = range(0x9000, 0x9200)
_IDENTIFIER = range(0x1000, 0x100C)
_STATUS = 0x100C
_MAPPING_REVISION = 0x1017
_WATCHDOG_LEFT_MS = 0x1020
_WATCHDOG_MS = 0x1120
_CONNECTION_MODE = 0x1130
_CONNECTION_TIMEOUT_S = 0x1131
_PARAMETERS = (_WATCHDOG_MS, _CONNECTION_MODE, _CONNECTION_TIMEOUT_S)
_RESTORE = (0x113C, 0x113D)
_SAVE = (0x113E, 0x113F)

_REVISION = 2
_LO_AD = (0x6C6F, 0x6164)
_SA_VE = (0x7361, 0x7665)
_PASSWORD_S = 30.0
_MODES = range(4)
_FLASH, _FLASH_S = 0x0200, 0.1


class Block(Enum):
    """What kind of block it is."""

    WATCHED = "Turck multiprotocol, with a communication watchdog"
    PLAIN = "relay board: coils, no watchdog"
    TIMED = "relay board: coils, and a timed on of each"


class Contact(Enum):
    """A contact of the safety chain, by the input that it closes while all is well."""

    ESTOP = 0
    INTERLOCK = 1
    KEY = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class RelaySettings:
    """How a block leaves its maker, and what is wired to it."""

    block: Block = Block.WATCHED
    outputs: int = 8
    laser_output: int = 0
    watchdog_ms: int = 0  # at power-up; 500 on the newer TBEN-S
    name: str = "TBEN-S1-8DOP"

    def __post_init__(self) -> None:
        if not 1 <= self.outputs <= 16:
            raise ValueError(f"relay: {self.outputs} outputs; a block has from 1 to 16")
        if not 0 <= self.laser_output < self.outputs:
            raise ValueError(
                f"relay: the laser on output {self.laser_output} of {self.outputs}, counted from 0"
            )
        if not 0 <= self.watchdog_ms <= 0xFFFF:
            raise ValueError(f"relay: a watchdog of {self.watchdog_ms} ms; it is 0 to 65535")


class RelayBlock:
    """The block; a `sim.device.ModbusUnit`."""

    def __init__(self, world: World, settings: RelaySettings | None = None) -> None:
        self._world = world
        self._settings = settings or RelaySettings()
        self._outputs = [False] * self._settings.outputs
        self._saved = self._as_delivered()
        self._parameters = dict(self._saved)
        self._heard_s: float | None = None  # None: nothing yet, so nothing to lose
        self._drops_s = [math.inf] * self._settings.outputs  # when a timed on is over
        self._open: set[Contact] = set()
        self._half: tuple[int, int, float] | None = None  # a password's register, half and time

    def heard(self, now_s: float) -> None:
        """Restart the watchdog; one that has run out bites first."""
        self.tick(now_s)
        self._heard_s = now_s

    def tick(self, now_s: float) -> None:
        """Drop the outputs if the watchdog has run out."""
        if self._left_s(now_s) <= 0.0 and any(self._outputs):
            self._switch([False] * len(self._outputs), now_s, why="watchdog")
        due = [ends_s <= now_s for ends_s in self._drops_s]
        if any(due):
            kept = [on and not over for on, over in zip(self._outputs, due, strict=True)]
            ends_s = min(self._drops_s)
            self._drops_s = [
                math.inf if over else end for end, over in zip(self._drops_s, due, strict=True)
            ]
            self._switch(kept, ends_s, why="timed on is over")

    def flash(self, address: int, word: int, now_s: float) -> None:
        """Do function 5 at 0x0200 + n: on for `word` times 100 ms, counted anew each time."""
        number = address - _FLASH
        if self._settings.block is not Block.TIMED or number not in range(len(self._outputs)):
            raise ModbusRefusal(_ILLEGAL_ADDRESS)
        self.tick(now_s)
        self._drops_s[number] = now_s + word * _FLASH_S
        after = list(self._outputs)
        after[number] = word > 0
        self._switch(after, now_s, why=f"timed on of {number}")

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """The outputs."""
        self._check_coils(first, count)
        self.tick(now_s)
        return self._outputs[first : first + count]

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """Switch some outputs."""
        self._check_coils(first, len(states))
        after = list(self._outputs)
        after[first : first + len(states)] = states
        self._drops_s[first : first + len(states)] = [math.inf] * len(states)
        self._switch(after, now_s, why=f"coil {self._settings.laser_output}")

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """Inputs: the safety chain's contacts, and beyond them nothing is wired."""
        self._check_registers()
        if first + count > 16 * len(_INPUTS):
            raise ModbusRefusal(_ILLEGAL_ADDRESS)
        return [bool(self._inputs() >> number & 1) for number in range(first, first + count)]

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Process data, identity, watchdog."""
        self._check_registers()
        self.tick(now_s)
        return [self._word(address, now_s) for address in range(first, first + count)]

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """The same by function 4."""
        return self.read_holding(first, count, now_s)

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Outputs as words, parameters, passwords."""
        self._check_registers()
        written = dict(enumerate(words, first))
        for address, word in written.items():
            _check_writable(address, word)
        for address, word in written.items():
            self._write(address, word, now_s)

    def power_up(self, now_s: float) -> None:
        """Off and on again: outputs off, parameters as they were saved."""
        self._parameters = dict(self._saved)
        self._heard_s = None
        self._switch([False] * len(self._outputs), now_s, why="power")

    def press(self, contact: Contact) -> None:
        """Open a contact of the safety chain: press the button, open the door, turn the key off."""
        self._open.add(contact)

    def release(self, contact: Contact) -> None:
        """Close it again."""
        self._open.discard(contact)

    def _inputs(self) -> int:
        return sum(1 << each.value for each in Contact if each not in self._open)

    def _as_delivered(self) -> dict[int, int]:
        delivered = dict.fromkeys(_PARAMETERS, 0)
        return delivered | {_WATCHDOG_MS: self._settings.watchdog_ms}

    def _check_coils(self, first: int, count: int) -> None:
        if first + count > len(self._outputs):
            raise ModbusRefusal(_ILLEGAL_ADDRESS)

    def _check_registers(self) -> None:
        if self._settings.block is not Block.WATCHED:
            raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def _switch(self, outputs: list[bool], now_s: float, *, why: str) -> None:
        self._outputs = outputs
        self._world.switch_laser(now_s, on=outputs[self._settings.laser_output], why=why)

    def _left_s(self, now_s: float) -> float:
        """Until the watchdog bites; infinite when it does not watch."""
        watchdog_ms = self._parameters[_WATCHDOG_MS]
        if watchdog_ms == 0 or self._heard_s is None or self._settings.block is not Block.WATCHED:
            return float("inf")
        return self._heard_s + watchdog_ms / 1000.0 - now_s

    def _word(self, address: int, now_s: float) -> int:
        if address in (_OUTPUTS[0], _OUTPUTS_AGAIN[0]):
            return sum(state << k for k, state in enumerate(self._outputs))
        if address == _INPUTS[0]:
            return self._inputs()
        if address in _IDENTIFIER:
            return _text_word(self._settings.name, address - _IDENTIFIER[0])
        if address == _WATCHDOG_LEFT_MS:
            left_s = self._left_s(now_s)
            return 0 if left_s == float("inf") else max(round(left_s * 1000.0), 0)
        if address == _MAPPING_REVISION:
            return _REVISION
        if address in self._parameters:
            return self._parameters[address]
        if address in (_STATUS, *_RESTORE, *_SAVE) or _is_process_data(address):
            return 0
        raise ModbusRefusal(_ILLEGAL_ADDRESS)

    def _write(self, address: int, word: int, now_s: float) -> None:
        if address in (_OUTPUTS[0], _OUTPUTS_AGAIN[0]):
            states = [bool(word >> k & 1) for k in range(len(self._outputs))]
            self._switch(states, now_s, why=f"register {address:#06x}")
        elif address in self._parameters:
            self._parameters[address] = word
        elif self._password(address, word, now_s, _RESTORE, _LO_AD):
            self._parameters = self._as_delivered()
        elif self._password(address, word, now_s, _SAVE, _SA_VE):
            self._saved = dict(self._parameters)

    def _password(
        self, address: int, word: int, now_s: float, where: tuple[int, int], words: tuple[int, int]
    ) -> bool:
        """Whether this word completes a password, both halves of it within 30 s."""
        if address == where[0]:
            self._half = (address, word, now_s)
        if address != where[1] or self._half is None:
            return False
        (place, half, then_s), self._half = self._half, None
        in_time = now_s - then_s <= _PASSWORD_S
        return place == where[0] and (half, word) == words and in_time


def _check_writable(address: int, word: int) -> None:
    """Refuse before anything is changed."""
    if not (
        address in _PARAMETERS
        or address in _OUTPUTS
        or address in _OUTPUTS_AGAIN
        or address in (*_RESTORE, *_SAVE)
    ):
        raise ModbusRefusal(_ILLEGAL_ADDRESS)
    if address == _CONNECTION_MODE and word not in _MODES:
        raise ModbusRefusal(_ILLEGAL_VALUE)


def _is_process_data(address: int) -> bool:
    return address in _INPUTS or address in _OUTPUTS or address in _OUTPUTS_AGAIN


def _text_word(text: str, index: int) -> int:
    """Two characters of a text."""
    pair = text.encode("ascii")[2 * index : 2 * index + 2].ljust(2, b"\0")
    return int.from_bytes(pair, "big")
