"""A profiler that is read register by register, and keeps what a torn read would have lost.

One profile takes several frames, and the device goes on measuring meanwhile. So the number of its
profile is read before and after; where it changed, columns of two profiles were mixed::

    number 41   columns 0..124   columns 125..249   number 42     torn: counted, and read again

A device without such a number must hold its profile between two triggers, or send it in one frame;
`Layout` of another one is refused. Each step is one request, so that whoever waits gets its turn in
between; a trigger is sent once, whatever becomes of its answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, replace

from drivers.axis import Identity, Pause
from drivers.bus import Bus
from drivers.errors import FrameError, NoReply
from drivers.profiler import Profile, Tally
from drivers.register_profiler.layout import Layout, Table, decoded

MOST_WORDS = 125  # of one frame, by the Modbus standard
_LONGEST_FRAME_S = 0.04  # on the wire: the laser's lease is renewed between frames
_FRAME_BYTES = 13  # of a question and its answer, beside the words
_POLL_S = 0.005
_NUMBERS = 0x10000


@dataclass(frozen=True, slots=True)
class ReadTally:
    """What reading went through since the profiler was opened."""

    profiles: int = 0
    skipped: int = 0  # numbers that were never read whole: the device is faster than its line
    torn: int = 0  # reads in which the number changed
    failed: int = 0  # reads that ended without a sound answer


class RegisterProfiler:
    """A `drivers.profiler.Profiler`; the bus is closed by whoever opened it.

    Parameters
    ----------
    period_s : float
        Of the device's profiles: without a number and a trigger nothing else tells that what is
        read is new.
    pause
        Lets some time pass between two looks at a flag.

    Raises
    ------
    ValueError
        Nothing would tell a torn read, or when a triggered profile is there; nothing was sent.
    """

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        layout: Layout,
        *,
        period_s: float,
        family: str = "registers",
        clock: Callable[[], float] = time.monotonic,
        pause: Pause = time.sleep,
    ) -> None:
        must_tell_torn_reads(layout)
        self._bus = bus
        self._device_id = device_id
        self._layout = layout
        self._family = family
        self._period_s = period_s
        self._clock = clock
        self._pause = pause
        self._pieces = _pieces(layout, bus)
        self._reading: Generator[None, None, Profile] | None = None
        self._triggered = False
        self._fresh = True  # what was measured before now is not wanted
        self._newest: int | None = None  # the last number that is accounted for
        self._not_before_s = clock() + 2.0 * period_s
        self._counts = ReadTally()

    def identify(self) -> Identity:
        """Read each register once: such a device does not say who it is, but whether it is there.

        Raises
        ------
        NoReply
            Nobody answers.
        Refused
            There is no such register; names it.
        """
        for first, count in self._pieces:
            self._words(first, count)
        for register in self._signs():
            self._words(register, 1)
        return Identity(family=self._family, model="", firmware="", serial="")

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they are read, each number at most once.

        What a caller spends on a profile is not the device's silence. A read that is under way is
        gone on with by the next call.

        Raises
        ------
        NoReply
            None was read for `timeout_s`; says what kept it.
        """
        since_s, before = self._clock(), self._counts
        while True:
            profile = self._step()
            if profile is not None:
                yield profile
                since_s, before = self._clock(), self._counts
            elif self._clock() - since_s >= timeout_s:
                raise NoReply(self._silence(timeout_s, before))

    def discard(self) -> None:
        """Forget a read under way, and take nothing that the device has measured so far."""
        self._reading = None
        self._triggered = False
        self._fresh = True
        self._not_before_s = self._clock() + 2.0 * self._period_s

    def tally(self) -> Tally:
        """What was lost so far."""
        counts = self._counts
        return Tally(counts.profiles, counts.skipped, bad_frames=counts.failed)

    def reads(self) -> ReadTally:
        """How reading went so far: a torn read was repeated, so that it is no torn profile."""
        return self._counts

    def _step(self) -> Profile | None:
        """Make one request; a profile where it was the last that it needed."""
        reading, self._reading = self._reading or self._read(), None
        try:
            next(reading)
        except StopIteration as whole:
            profile: Profile = whole.value
            return profile
        except (NoReply, FrameError):
            self._counts = replace(self._counts, failed=self._counts.failed + 1)
            raise
        self._reading = reading
        return None

    def _read(self) -> Generator[None, None, Profile]:
        """Read one profile, a request at a time."""
        if self._fresh:
            self._newest = self._number()
            self._fresh = False
            yield
        yield from self._trigger()
        while True:
            yield from self._wait()
            before = self._number()
            words: list[int] = []
            yield
            for first, count in self._pieces:
                words.extend(self._words(first, count))
                yield
            after = self._number()
            if before == after:
                break
            self._counts = replace(self._counts, torn=self._counts.torn + 1)
            yield
        return self._told(words, after)

    def _trigger(self) -> Generator[None, None, None]:
        trigger = self._layout.trigger
        if trigger is None or self._triggered:
            return
        self._triggered = True  # whatever becomes of the answer
        self._bus.write_register(self._device_id, trigger.register, trigger.value)
        yield

    def _wait(self) -> Generator[None, None, None]:
        """Wait until there is a profile that was not told yet."""
        while not self._due():
            self._pause(_POLL_S)
            yield

    def _due(self) -> bool:
        layout = self._layout
        if layout.ready is not None:
            (word,) = self._words(layout.ready.register, 1)
            if not word >> layout.ready.bit & 1:
                return False
        if layout.sequence_register is not None:
            return self._number() != self._newest
        return layout.trigger is not None or self._clock() >= self._not_before_s

    def _told(self, words: list[int], number: int | None) -> Profile:
        """Account for a profile that was read whole."""
        counts = self._counts
        skipped = 0
        if number is not None and self._newest is not None:
            skipped = (number - self._newest - 1) % _NUMBERS
        self._counts = replace(
            counts, profiles=counts.profiles + 1, skipped=counts.skipped + skipped
        )
        self._newest, self._triggered = number, False
        self._not_before_s = self._clock() + self._period_s
        return decoded(words, self._layout, frame=counts.profiles if number is None else number)

    def _signs(self) -> Iterator[int]:
        if self._layout.sequence_register is not None:
            yield self._layout.sequence_register
        if self._layout.ready is not None:
            yield self._layout.ready.register

    def _number(self) -> int | None:
        register = self._layout.sequence_register
        return None if register is None else self._words(register, 1)[0]

    def _words(self, first: int, count: int) -> tuple[int, ...]:
        read = self._bus.read_input
        if self._layout.table is Table.HOLDING:
            read = self._bus.read_holding
        return read(self._device_id, first, count)

    def _silence(self, timeout_s: float, before: ReadTally) -> str:
        start = f"{self._family} at {self._bus.address}: no profile in {timeout_s:g} s"
        if (torn := self._counts.torn - before.torn) > 0:
            return (
                f"{start}, {torn} torn reads; it measures faster than its line is read: lower its"
                " rate, raise the line's speed, or use its trigger"
            )
        return f"{start}; is the laser on, its trigger running, and the flag and number right?"


def must_tell_torn_reads(layout: Layout) -> None:
    """Refuse a layout whose profiles could not be told to be whole, or to be new.

    Raises
    ------
    ValueError
        One line, with the remedy.
    """
    numbered, triggered = layout.sequence_register is not None, layout.trigger is not None
    if layout.words > MOST_WORDS and not numbered and not triggered:
        raise ValueError(
            f"points_per_profile: {layout.words} registers are more than one frame's {MOST_WORDS},"
            " and nothing tells a torn read; give sequence_register, or trigger_register of a"
            " device that holds its profile"
        )
    if triggered and not numbered and layout.ready is None:
        raise ValueError(
            "trigger_register: nothing tells when the profile is there; give ready_register or"
            " sequence_register"
        )


def _pieces(layout: Layout, bus: Bus) -> list[tuple[int, int]]:
    """First register and count of each frame; short where the line is slow."""
    byte_s = bus.wire_s(1)
    most = MOST_WORDS
    if byte_s > 0.0 and layout.words > 1:
        held = layout.sequence_register is not None or layout.trigger is not None
        fitting = int((_LONGEST_FRAME_S / byte_s - _FRAME_BYTES) // 2)
        most = min(MOST_WORDS, max(2, fitting)) if held else MOST_WORDS
    if layout.words > most:
        most -= most % 2  # two words of one value are read together
    last = layout.first_register + layout.words
    return [(first, min(most, last - first)) for first in range(layout.first_register, last, most)]
