r"""Lines of SCIP 2.0 as the sensor writes them (C-42-03320B, sections 6 and 7).

A line of text ends with its check and ``\n``; those of VV, PP and II have a `;` before the check,
which is not summed. A reply ends with an empty line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_DATA_IN_A_LINE = 64


def summed(text: str) -> str:
    """The check character of a text."""
    total = 0
    for letter in text:
        total = (total + ord(letter)) % 64
    return chr(total + 0x30)


def characters(value: int, count: int) -> str:
    """Write a value by six bits a character, the highest first."""
    bits = format(value, f"0{6 * count}b")
    return "".join(chr(int(bits[k : k + 6], 2) + 0x30) for k in range(0, 6 * count, 6))


def plain(echo: str, status: str, body: Iterable[str] = ()) -> bytes:
    """A reply whose lines carry their check behind the text."""
    lines = [echo, *(text + summed(text) for text in (status, *body))]
    return ("\n".join(lines) + "\n\n").encode("latin-1")


def named(echo: str, pairs: Sequence[tuple[str, object]]) -> bytes:
    """A reply of names and values."""
    texts = [f"{name}:{value}" for name, value in pairs]
    lines = [echo, "00P", *(f"{text};{summed(text)}" for text in texts)]
    return ("\n".join(lines) + "\n\n").encode("latin-1")


def scan(echo: str, status: str, stamp_ms: int, ranges: Iterable[int], width: int) -> bytes:
    """A reply of ranges, `width` characters each."""
    data = "".join(characters(value, width) for value in ranges)
    cut = [data[k : k + _DATA_IN_A_LINE] for k in range(0, len(data), _DATA_IN_A_LINE)]
    return plain(echo, status, [characters(stamp_ms % 2**24, 4), *cut])
