"""LZF, the compression inside binary .pcd files, unpacked as a stream.

The format of Marc Lehmann's liblzf: a control byte, then

    000LLLLL                    L + 1 literal bytes follow
    LLLooooo oooooooo           L + 2 bytes again, from o + 1 bytes back (L = 1..6)
    111ooooo LLLLLLLL oooooooo  L + 9 bytes again, from o + 1 bytes back

Nothing is farther back than 8192 bytes, so no more than that is kept of what went before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numba import njit

from reconstruction.clouds.numerals import Bytes
from reconstruction.clouds.source import AGAIN, Damaged

LARGEST_RATIO: Final = 88  # three bytes say 264
_HISTORY: Final = 8192
_LONGEST: Final = 264
_PIECE: Final = 1 << 18


def unpacked(blocks: Iterable[bytes]) -> Iterator[Bytes]:
    """Unpack a stream that comes in blocks, in pieces of at most 256 KB.

    A piece is a view that the next one overwrites.

    Raises
    ------
    Damaged
        If the stream refers to bytes before its start, or ends within an instruction.
    """
    window = np.empty(_HISTORY + _PIECE + _LONGEST, np.uint8)
    oldest = filled = _HISTORY
    rest = b""
    for block in blocks:
        packed = np.frombuffer(rest + block, np.uint8)
        at, more = 0, True
        while more:
            at, filled, sound = unpack_lzf(packed, at, window, oldest, filled, _HISTORY + _PIECE)
            if not sound:
                raise Damaged(f"its packed data are damaged; {AGAIN}")
            more = filled >= _HISTORY + _PIECE
            if filled > _HISTORY:
                yield window[_HISTORY:filled]
            oldest = max(0, oldest - (filled - _HISTORY))
            window[:_HISTORY] = window[filled - _HISTORY : filled].copy()
            filled = _HISTORY
        rest = packed[at:].tobytes()
    if rest:
        raise Damaged(f"its packed data break off; {AGAIN}")


@njit(cache=True)
def unpack_lzf(
    packed: Bytes, at: int, window: Bytes, oldest: int, filled: int, enough: int
) -> tuple[int, int, bool]:
    """Carry out whole instructions from packed[at:] until `enough` bytes of the window are filled.

    Returns
    -------
    Where to go on in `packed`, where in `window`, and whether all references were to bytes from
    window[oldest:] on. The window has room for one instruction beyond `enough`.
    """
    while at < len(packed) and filled < enough:
        control = int(packed[at])
        if control < 32:
            end = at + 2 + control
            if end > len(packed):
                break
            for place in range(at + 1, end):
                window[filled] = packed[place]
                filled += 1
            at = end
            continue
        head = 3 if control >> 5 == 7 else 2
        if at + head > len(packed):
            break
        length = (control >> 5) + 2
        if head == 3:
            length += int(packed[at + 1])
        source = filled - ((control & 31) << 8) - int(packed[at + head - 1]) - 1
        if source < oldest:
            return at, filled, False
        for place in range(source, source + length):
            window[filled] = window[place]
            filled += 1
        at += head
    return at, filled, True
