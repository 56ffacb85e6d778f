"""What a device must be told when nobody is left to drive it: bytes, and the answers that are due.

A recipe is said by a process that knows no protocol (`acquisition.safety.guard`), on the open
descriptor of the device's link, after the program that owned it is dead::

    ~~ late answers ~~|  quiet_s  | off  off  off | read back
                      flushed       each: send, wait until `reply` is found or `within_s` is over

So everything that a driver knows of its device's protocol is spent here, beforehand: a new device
needs a `recipe` of its own and nothing else.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol, runtime_checkable


class Order(IntEnum):
    """Which device is told first, where several share a link."""

    LASER = 0
    AXIS = 1
    SENSOR = 2


@dataclass(frozen=True, slots=True)
class Word:
    """One thing to say.

    `reply` is a regular expression over bytes, looked for in everything that came since the word
    was sent; an empty one means that no answer is due.
    """

    send: bytes
    reply: bytes
    within_s: float

    def __post_init__(self) -> None:
        re.compile(self.reply, re.DOTALL)
        if not (self.send and 0.0 <= self.within_s <= 1.0):
            raise ValueError(
                f"recipe: {self.send.hex(' ') or 'nothing'} within {self.within_s} s; a word has"
                " bytes and waits for at most 1 s"
            )


@dataclass(frozen=True, slots=True)
class Recipe:
    """How one device is brought to rest by somebody who does not know it.

    `words` are said in turn, three times over; then `check`, three times at least and until
    each answer is found or `rest_s` is over.
    """

    device: str  # for the report, such as "laser relay"
    order: Order
    words: tuple[Word, ...]
    check: tuple[Word, ...]
    quiet_s: float = 0.0  # silence on the line before the first word: late answers go by
    wire_s: float = 0.0  # what the first word takes on the wire
    rest_s: float = 0.0  # how long the device may take to come to rest


@runtime_checkable
class Recited(Protocol):
    """A device that says how it is brought to rest without its driver."""

    def recipes(self) -> tuple[Recipe, ...]:
        """Give the bytes, gentle ones first; asks the device nothing."""
        ...


def exactly(reply: bytes) -> bytes:
    """The pattern of an answer that is known to the last byte."""
    return re.escape(reply)
