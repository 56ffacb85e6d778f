"""What a file format owes to a cloud, and how it says that a file is damaged.

A format knows bytes and counts, not where they came from: it raises `Damaged` with what is wrong
and the remedy, and `cloud.py` puts the file's name in front, in one place for all formats.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Protocol

from reconstruction.arrays import FloatArray

AGAIN: Final = "copy or export it again"
HEAD_BYTES: Final = 1 << 20  # a header longer than this is no header


class Damaged(Exception):  # noqa: N818 (the house names errors after the fact)
    """A file's bytes are wrong; the message says what, where, and what to do."""


class Source(Protocol):
    """Rows of three numbers, from the first to the last, as often as asked."""

    @property
    def format(self) -> str:
        """The format's name for a reader, such as ``ply ascii``."""

    @property
    def point_count(self) -> int | None:
        """How many rows there are, None where the file does not say."""

    def rows(self, points: int) -> Iterator[FloatArray]:
        """Fresh arrays (k, 3), k <= points, invalid rows included; raises `Damaged`, `OSError`."""


def truncated(promised: int, there: int, *, by: str = "header", unit: str = "points") -> Damaged:
    """Make the complaint about a file that ends too early."""
    return Damaged(
        f"truncated: {by} promises {grouped(promised)} {unit}, {grouped(there)} are there; {AGAIN}"
    )


def grouped(count: int) -> str:
    """Digits in groups of three, as the operator reads them: 52 782."""
    return f"{count:,}".replace(",", " ")


def shortened(text: bytes, limit: int = 24) -> str:
    """At most `limit` bytes of a file, quoted, printable on one line."""
    shown = text[:limit].decode("ascii", errors="backslashreplace")
    return repr(shown + ("..." if len(text) > limit else ""))


def whole_number(text: bytes, what: str) -> int:
    """Read a header's count; refuse what is negative, no integer, or beyond any disk.

    Raises
    ------
    Damaged
        With `what` as the subject.
    """
    if not text.isdigit() or len(text) > 18:
        raise Damaged(f"{what} is {shortened(text)}, not a sensible count; {AGAIN}")
    return int(text)
