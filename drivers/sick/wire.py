r"""Frames of the SICK Profiler 2's serial protocol, both directions; no clock.

After the operating instructions 8017035/ZMO9/2017-06-08 (pages 111 to 123)::

    STX 02 | length 1, in words of data | command 2 | data 0 to 510 | ETX 03 | check 1
             \---------- check: their exclusive or ----------/

A reply names the command that it answers, or E001 to E008. Nothing is escaped: 02 may stand
anywhere, so that only length, ETX and check together tell a frame from noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import reduce
from operator import xor
from typing import Final

STX: Final = 0x02
ETX: Final = 0x03
MOST_DATA: Final = 510
AROUND: Final = 6  # bytes of a frame beside its data

PROFILE_ADDRESS: Final = 0x400B
READ_MEMORY: Final = 0x0002
ERRORS: Final = {
    0xE001: "an unknown command",
    0xE002: "a wrong parameter",
    0xE003: "a wrong packet, or one that took too long",
    0xE004: "a wrong check",
    0xE005: "a wrong frame",
    0xE006: "its flash memory failed",
    0xE007: "a collision on the line",
    0xE008: "not allowed while it measures",
}
# What a damaged request is answered with: worth asking again.
MISHEARD: Final = (0xE001, 0xE003, 0xE004, 0xE005, 0xE007)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of which length, ETX and check are right."""

    command: int
    data: bytes = b""

    def __post_init__(self) -> None:
        if not 0 <= self.command <= 0xFFFF:
            raise ValueError(f"sick: {self.command:#x} is no command of 16 bits")
        if len(self.data) > MOST_DATA or len(self.data) % 2:
            raise ValueError(
                f"sick: {len(self.data)} B of data; give whole words, {MOST_DATA} B at most"
            )


class Size(IntEnum):
    """What one element of a memory read is: the high nibble of its mode."""

    WORD = 1
    POINT = 2  # two words


def encoded(frame: Frame) -> bytes:
    """Write a frame."""
    body = bytes([len(frame.data) // 2]) + frame.command.to_bytes(2, "big") + frame.data
    return bytes([STX]) + body + bytes([ETX, check_of(body)])


def check_of(body: bytes) -> int:
    """Exclusive or of the bytes from the length to the end of the data."""
    return reduce(xor, body, 0)


def memory_read(address: int, count: int, size: Size, step: int = 1) -> Frame:
    """Ask for `count` elements from an address on, of which each `step`-th is sent.

    Raises
    ------
    ValueError
        More than a reply holds, or an address that the frame does not.
    """
    most = 0x7E if size is Size.POINT else 0xFF
    if not (0 <= address < 1 << 32 and 1 <= count <= most and 1 <= step <= 15):
        raise ValueError(
            f"sick: {count} elements by {step} from {address:#x}; give 1 to {most} by 1 to 15"
        )
    return Frame(READ_MEMORY, address.to_bytes(4, "big") + bytes([count, size << 4 | step]))


class Decoder:
    """Frames out of bytes in any chunking; after noise it drops one byte and hunts the next STX.

    Noise that looks like the beginning of a long frame holds back what follows it until as many
    bytes have come, or until `flush` says that nothing more will.
    """

    def __init__(self) -> None:
        self.dropped = 0  # bytes that belonged to no frame
        self._held = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Yield the frames that `data` completes."""
        self._held += data
        yield from self._hunted(final=False)

    def flush(self) -> Iterator[Frame]:
        """Yield what is whole of what was held back, and forget the rest: the line is quiet."""
        yield from self._hunted(final=True)

    def _hunted(self, *, final: bool) -> Iterator[Frame]:
        held = self._held
        while held:
            whole = AROUND + 2 * held[1] if len(held) > 1 else AROUND
            if held[0] == STX and len(held) < whole and not final:
                return
            frame = _framed(bytes(held[:whole]))
            taken = whole if frame else 1
            self.dropped += 0 if frame else 1
            del held[:taken]
            if frame:
                yield frame


def _framed(data: bytes) -> Frame | None:
    if len(data) < AROUND or data[0] != STX or len(data) != AROUND + 2 * data[1]:
        return None
    if data[-2] != ETX or check_of(data[1:-2]) != data[-1]:
        return None
    return Frame(int.from_bytes(data[2:4], "big"), data[4:-2])
