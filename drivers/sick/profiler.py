r"""A SICK Profiler 2 as a profiler: a whole profile by reads of its memory.

After 8017035/ZMO9 (pages 111 to 123)::

    400B -> address      word at it: size; size / 32 = points
                         address + 4 : X Y X Y ..., 16 bits each, signed; 7FFF is no measurement
    0002 -> at most 126 points at a time; the address grows by two words a point

The manual names neither the order of the bytes of a word, nor the unit, nor whether addresses count
words or bytes: they are settings, and all of this is inferred until a sensor was heard. The reads
of one profile take long, and what the sensor measures meanwhile may be mixed in: only for a part
that stands still. It documents no switch of its laser, no identity, and no number of a profile.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.axis import Identity
from drivers.errors import FrameError, NoReply
from drivers.profiler import Profile, Reason, Tally
from drivers.sick.line import Question, SickLine, turn_s
from drivers.sick.wire import AROUND, PROFILE_ADDRESS, Frame, Size, memory_read

NO_MEASUREMENT: Final = 0x7FFF
_POINTS_A_READ: Final = 126
_WORDS_A_POINT: Final = 2
_POINTS_AT: Final = 4  # from the profile's address on
_SIZE_A_POINT: Final = 32
_MOST_POINTS: Final = 2047  # what a size of 16 bits can say
_READ_BYTES: Final = AROUND + 6  # of a request for memory
_BITS_A_CHARACTER: Final = 10
_HOST_S: Final = 0.002  # of a host and its adapter, for each question


class ByteOrder(Enum):
    """How a word of the memory is sent."""

    BIG = ">i2"
    LITTLE = "<i2"


class Addresses(Enum):
    """What an address counts, by how many of them a word takes."""

    WORDS = 1
    BYTES = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What the sensor does not say: the scale of its counts, and how its memory is read."""

    x_mm_per_count: float
    z_mm_per_count: float
    x_offset_mm: float = 0.0
    z_offset_mm: float = 0.0
    byte_order: ByteOrder = ByteOrder.BIG
    addresses: Addresses = Addresses.WORDS
    points: int | None = None  # the sensor must say so many; None: any
    thinning: int = 1  # every so many-th point is read

    def __post_init__(self) -> None:
        for name in ("x_mm_per_count", "z_mm_per_count"):
            scale = getattr(self, name)
            if not math.isfinite(scale) or scale == 0.0:
                raise ValueError(f"sick: {name} = {scale}; it must be finite and not 0")
        if not 1 <= self.thinning <= 15:
            raise ValueError(f"sick: every {self.thinning}-th point; give 1 to 15")


class SickProfiler2:
    """A `drivers.profiler.Profiler`; the line's link is closed by whoever opened it."""

    def __init__(self, line: SickLine, settings: Settings) -> None:
        self._line = line
        self._settings = settings
        self._reading: Iterator[Profile | None] | None = None
        self._profiles = 0

    def identify(self) -> Identity:
        """Read the address and the size of a profile: no command for an identity is documented.

        Raises
        ------
        FrameError
            Another number of points than the settings', or none that a profile has.
        """
        address = self._address_of(self._line.ask(_ADDRESS))
        points = self._points_of(self._line.ask(_size_at(address)))
        return Identity(family="sick", model=f"Profiler 2, {points} points", firmware="")

    def counters(self) -> dict[str, int]:
        """How the line fares; see `drivers.inspection`."""
        return self._line.counters()

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they are read.

        The state is the driver's: a read that took longer than `timeout_s` goes on with the next
        call, so that leaving this iterator and asking for another loses nothing.

        Raises
        ------
        NoReply
            No profile was whole within `timeout_s`.
        FrameError, Refused, LinkLost
            A read failed twice, or the sensor said no.
        """
        since_s = self._line.clock()
        while True:
            profile = self._stepped()
            if profile is not None:
                yield profile
                since_s = self._line.clock()
            elif self._line.clock() >= since_s + timeout_s:
                raise NoReply(
                    f"sick at {self._line.address}: no whole profile in {timeout_s:g} s; it takes"
                    " about 0.3 s at 115200 baud: raise the baud rate or thin the points"
                )

    def discard(self) -> None:
        """Begin anew: what was read so far may be of before the exposure."""
        if self._reading is not None:
            self._line.rest()
        self._reading = None

    def tally(self) -> Tally:
        """What was lost so far; what the sensor measured between two reads is no loss."""
        return Tally(self._profiles, 0, 0, self._line.bad)

    def _stepped(self) -> Profile | None:
        """Go on by one short wait."""
        reading = self._reading = self._reading or self._read()
        try:
            profile = next(reading)
        except BaseException:
            self._reading = None  # a generator that raised is over
            raise
        if profile is not None:
            self._reading = None
        return profile

    def _read(self) -> Generator[Profile | None, None, None]:
        """Read one profile; None after each short wait."""
        address = self._address_of((yield from self._line.steps(_ADDRESS)))
        points = self._points_of((yield from self._line.steps(_size_at(address))))
        data = b""
        for question in self._pieces(address, points):
            data += yield from self._line.steps(question)
        self._profiles += 1
        words = np.frombuffer(data, dtype=self._settings.byte_order.value)
        stamp_s = self._line.clock()
        yield profile_of(words.reshape(-1, 2), self._settings, stamp_s, self._profiles - 1)

    def _pieces(self, address: int, points: int) -> Iterator[Question]:
        thinning, unit = self._settings.thinning, self._settings.addresses.value
        first = 0
        for count in piece_counts(-(-points // thinning)):
            offset = first * thinning * _WORDS_A_POINT * unit
            request = memory_read(address + _POINTS_AT + offset, count, Size.POINT, thinning)
            yield Question(request, count * 2 * _WORDS_A_POINT)
            first += count

    def _address_of(self, answer: bytes) -> int:
        return int.from_bytes(answer, "big")

    def _points_of(self, answer: bytes) -> int:
        (size,) = np.frombuffer(answer, dtype=self._settings.byte_order.value).astype(np.uint16)
        points, rest = divmod(int(size), _SIZE_A_POINT)
        due = self._settings.points
        if rest or not 1 <= points <= _MOST_POINTS or due not in (None, points):
            raise FrameError(
                f"sick at {self._line.address}: a profile of size {int(size):#06x} is {points}"
                f" points and {rest}/{_SIZE_A_POINT}; {'whole ones' if due is None else due} were"
                " due: is the byte order right?"
            )
        return points


_ADDRESS: Final = Question(Frame(PROFILE_ADDRESS), 4)


def _size_at(address: int) -> Question:
    return Question(memory_read(address, 1, Size.WORD), 2)


def piece_counts(points: int) -> list[int]:
    """Cut a profile into reads of at most 126 points, of which no three in a row are alike.

    An answer does not say which memory it is of. So its length must: one that comes late, or twice,
    is taken for none of the next two.
    """
    counts: list[int] = []
    while points:
        longest = min(points, _POINTS_A_READ)
        counts.append(next(c for c in range(longest, 0, -1) if c not in counts[-2:]))
        points -= counts[-1]
    return counts


def reading_s(points: int, baud: int) -> float:
    """What one profile takes: its bytes on the wire, and a turn of the line for each question."""
    pieces = piece_counts(points)
    asked = AROUND + (1 + len(pieces)) * _READ_BYTES
    answered = (2 + len(pieces)) * AROUND + 4 + 2 + 2 * _WORDS_A_POINT * points
    turns_s = (2 + len(pieces)) * (turn_s(baud) + _HOST_S)
    return (asked + answered) * _BITS_A_CHARACTER / baud + turns_s


def profile_of(
    points: NDArray[np.int16], settings: Settings, time_s: float, number: int
) -> Profile:
    """Return the profile of the sensor's points, (n, 2) X and Y; Y is our z.

    The time is the host's, of the last read: where the sensor keeps its own stamp is not known.
    """
    invalid = np.any(points == NO_MEASUREMENT, axis=1)
    return Profile(
        counts=np.where(invalid[:, None], 0, points).astype(np.int32),
        scale_mm=(settings.x_mm_per_count, settings.z_mm_per_count),
        offset_mm=(settings.x_offset_mm, settings.z_offset_mm),
        reasons=np.where(invalid, Reason.UNKNOWN, Reason.MEASURED).astype(np.uint8),
        intensity=np.empty(0, dtype=np.uint16),
        sensor_time_s=time_s,
        encoder=0,
        frame=number,
    )
