"""The registers of a Turck multiprotocol I/O block (TBEN-S, TBEN-L, FGEN) behind a laser switch.

From the TBEN-L manual (pages 54, 64), the TBEN-S manual (pages 72, 75) and the FGEN manual (page
124, "error behavior"): with 0x1120 at 0 the outputs hold their value when the communication is
lost; above 0 they go to 0 after that time. The default is 0 on some blocks, 500 ms on others, and
what is written is forgotten at power-off unless saved: so it is written, and read back, at every
start.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum


class Register(IntEnum):
    """Holding registers by their protocol address."""

    INPUTS = 0x0000  # the first 16 inputs, bit 0 the first
    OUTPUTS = 0x0800  # the first 16 outputs, bit 0 the first
    STATION_IDENTIFIER = 0x1000  # to 0x1006
    MAPPING_REVISION = 0x1017
    WATCHDOG_MS = 0x1120


IDENTIFIER_WORDS = 7
_LONGEST_MS = 0xFFFF


def watchdog_word(watchdog_s: float) -> int:
    """Milliseconds for 0x1120, rounded down: never later than asked; ValueError outside its word.

    0 is outside too: it would switch the watchdog off.
    """
    if not 0.001 <= watchdog_s <= _LONGEST_MS / 1000.0:
        raise ValueError(f"watchdog {watchdog_s} s is outside 0.001 to {_LONGEST_MS / 1000.0} s")
    # A tenth of a microsecond against 0.29 * 1000 = 289.99999999999994.
    return int(watchdog_s * 1000.0 + 1e-4)


def text_of(words: Sequence[int]) -> str:
    """Text of registers, high byte first, up to the first byte that does not print."""
    octets = b"".join(word.to_bytes(2, "big") for word in words)
    text = octets.split(b"\0")[0].decode("ascii", errors="replace")
    return text.strip() if text.isprintable() else octets.hex()
