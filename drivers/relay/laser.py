"""Switching the laser's supply or interlock by a Modbus output: guarded, or plain.

`WatchedBlock` drops its outputs by itself when nobody talks to it any more; `PlainRelay` keeps
them for ever. Both read back what they switched, and neither believes its own memory: off is sent
whatever the state is thought to be. Software-off is no safety function; see
docs/protocols/relay.md for who guarantees what.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.axis import Identity
from drivers.bus import Bus
from drivers.endings import insist_dark, unless_done
from drivers.errors import Refused
from drivers.laser import Guarantee
from drivers.modbus_recipes import coil_is_open, without_bits, write_coil, write_register
from drivers.recipes import Order, Recipe, Word
from drivers.relay.registers import IDENTIFIER_WORDS, Register, text_of, watchdog_word

_FOLLOWS_WITHIN_S = 0.1
_POLL_S = 0.01
_TIMED_FROM = 0x0200
_TIMED_WORD, _TIMED_UNIT_S = 3, 0.1  # three times the longest wait of a loop, and some
_NOT_THERE = (2, 3)  # Modbus exceptions: illegal address, illegal value

Clock = Callable[[], float]
Sleep = Callable[[float], None]


class Output(Protocol):
    """One output of a device, written and read back."""

    def write(self, bus: Bus, device_id: int, *, closed: bool) -> None:
        """Write it in one frame."""
        ...

    def is_closed(self, bus: Bus, device_id: int) -> bool:
        """Read it back."""
        ...

    def open_words(self, bus: Bus, device_id: int) -> tuple[Word, Word]:
        """How to open it, and how to see that it is open."""
        ...


@dataclass(frozen=True, slots=True)
class Coil:
    """An output with a coil of its own (functions 5 and 1)."""

    number: int = 0

    def write(self, bus: Bus, device_id: int, *, closed: bool) -> None:
        """Write it in one frame."""
        bus.write_coil(device_id, self.number, closed)

    def is_closed(self, bus: Bus, device_id: int) -> bool:
        """Read it back."""
        (closed,) = bus.read_coils(device_id, self.number, 1)
        return closed

    def open_words(self, bus: Bus, device_id: int) -> tuple[Word, Word]:
        """How to open it, and how to see that it is open."""
        return (
            write_coil(bus, device_id, self.number, 0),
            coil_is_open(bus, device_id, self.number),
        )


@dataclass(frozen=True, slots=True)
class OutputBit:
    """One bit of an output register (functions 6 and 3) that is the laser's alone.

    The other bits are written 0: off must not wait for a read of what they are.
    """

    bit: int = 0
    register: int = Register.OUTPUTS

    def __post_init__(self) -> None:
        if not 0 <= self.bit < 16:
            raise ValueError(f"bit {self.bit} of a register: there are 0 to 15")

    def write(self, bus: Bus, device_id: int, *, closed: bool) -> None:
        """Write it in one frame."""
        bus.write_register(device_id, self.register, closed << self.bit)

    def is_closed(self, bus: Bus, device_id: int) -> bool:
        """Read it back."""
        (word,) = bus.read_holding(device_id, self.register, 1)
        return bool(word >> self.bit & 1)

    def open_words(self, bus: Bus, device_id: int) -> tuple[Word, Word]:
        """How to open it, and how to see that it is open: the whole word is 0 then."""
        return (
            write_register(bus, device_id, self.register, 0),
            without_bits(bus, device_id, 3, self.register, 0xFF),
        )


class _Contact:
    """An output that is never believed: every switching is read back."""

    def __init__(
        self, bus: Bus, device_id: int, output: Output, *, name: str, clock: Clock, sleep: Sleep
    ) -> None:
        self._bus = bus
        self._device_id = device_id
        self._output = output
        self._name = name
        self._clock = clock
        self._sleep = sleep

    def close(self) -> None:
        """Close it and read back."""
        self._output.write(self._bus, self._device_id, closed=True)
        if not self._follows(closed=True):
            raise Refused(
                f"{self._name}: the output did not go on within {_FOLLOWS_WITHIN_S} s; "
                "check its supply and who else may write it"
            )

    def open(self) -> None:
        """Open it and read back; see `insist_dark`."""
        insist_dark(self._open_once, self._name)

    def _open_once(self) -> bool:
        self._output.write(self._bus, self._device_id, closed=False)
        return self._follows(closed=False)

    def is_closed(self) -> bool:
        """Read it back."""
        return self._output.is_closed(self._bus, self._device_id)

    def recipes(self) -> tuple[Recipe, ...]:
        """Open, and read back."""
        off, is_off = self._output.open_words(self._bus, self._device_id)
        wire_s = self._bus.wire_s(len(off.send))
        quiet_s = self._bus.quiet_s
        return (Recipe(self._name, Order.LASER, (off,), (is_off,), quiet_s, wire_s),)

    def _follows(self, *, closed: bool) -> bool:
        deadline_s = self._clock() + _FOLLOWS_WITHIN_S
        while self.is_closed() is not closed:
            if self._clock() >= deadline_s:
                return False
            self._sleep(_POLL_S)
        return True


class WatchedBlock:
    """An I/O block with a communication watchdog of its own, as Turck's multiprotocol blocks."""

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        output: Output,
        *,
        watchdog_s: float,
        name: str = "laser relay",
        clock: Clock = time.monotonic,
        sleep: Sleep = time.sleep,
    ) -> None:
        self._bus = bus
        self._device_id = device_id
        self._name = name
        self._asked_ms = watchdog_word(watchdog_s)
        self._promised_ms = 0
        self._contact = _Contact(bus, device_id, output, name=name, clock=clock, sleep=sleep)

    def identify(self) -> Identity:
        """Station identifier and mapping revision, where the block has them."""
        try:
            first, count = Register.STATION_IDENTIFIER, IDENTIFIER_WORDS
            model = text_of(self._bus.read_holding(self._device_id, first, count))
            (revision,) = self._bus.read_holding(self._device_id, Register.MAPPING_REVISION, 1)
        except Refused as refused:
            if refused.code not in _NOT_THERE:
                raise
            return Identity(family="turck", model="I/O block without identity", firmware="")
        return Identity(family="turck", model=model, firmware=f"register mapping {revision}")

    def guarantee(self) -> Guarantee:
        """Write the watchdog's time, read it back; guarded by what was read, if above 0."""
        self._promised_ms = 0
        try:
            self._bus.write_register(self._device_id, Register.WATCHDOG_MS, self._asked_ms)
            self._promised_ms = self._watchdog_ms()
        except Refused as refused:
            return self._unguarded(f"it refused to set its watchdog ({refused})")
        if self._promised_ms == 0:
            return self._unguarded(f"its watchdog reads 0 ms after {self._asked_ms} were written")
        watchdog_s = self._promised_ms / 1000.0
        return Guarantee(
            watchdog_s,
            f"{self._name}: the block switches the laser off {watchdog_s} s after the last word "
            "from this program",
        )

    def standing_guarantee(self) -> Guarantee:
        """What its watchdog reads now; `guarantee` sets it. See `drivers.inspection`."""
        try:
            found_ms = self._watchdog_ms()
        except Refused as refused:
            return self._unguarded(f"it has no watchdog to read ({refused})")
        set_ms = f"its watchdog reads {found_ms} ms, a scan sets {self._asked_ms} ms"
        if not found_ms:
            return Guarantee(None, f"{self._name}: {set_ms} before anything is lit")
        return Guarantee(found_ms / 1000.0, f"{self._name}: {set_ms}")

    def on(self) -> None:
        """Switch on and read back; off again where that fails.

        Under a promised watchdog it is read before: the block forgets it at power-off.

        Raises
        ------
        Refused
            The output did not follow, or the block forgot its watchdog (it was restarted).
        """
        with unless_done(self._contact.open):
            self._must_still_be_watched()
            self._contact.close()

    def off(self) -> None:
        """Switch off, three tries, each confirmed within 100 ms; see `LaserSwitch.off`."""
        self._contact.open()

    def is_on(self) -> bool:
        """Read the output back."""
        return self._contact.is_closed()

    def recipes(self) -> tuple[Recipe, ...]:
        """Off, and read back; see `drivers.recipes`."""
        return self._contact.recipes()

    def _must_still_be_watched(self) -> None:
        if self._promised_ms and (found_ms := self._watchdog_ms()) != self._promised_ms:
            raise Refused(
                f"{self._name}: its watchdog reads {found_ms} ms, {self._promised_ms} were "
                "promised; was the block restarted? set it again before lighting the laser"
            )

    def _watchdog_ms(self) -> int:
        (found_ms,) = self._bus.read_holding(self._device_id, Register.WATCHDOG_MS, 1)
        return found_ms

    def _unguarded(self, reason: str) -> Guarantee:
        return Guarantee(
            None,
            f"{self._name}: {reason}; nothing turns the laser off when this program is dead",
        )


class TimedRelay:
    """A Modbus relay that is only ever switched on for a time: the lease lives in the relay, too.

    After Waveshare's "flash on": function 5 at 0x0200 + n, the word times 100 ms, counted anew each
    time. That was not read in a manual, and nothing can be read back of it: no guarantee that
    would do for an unattended run.
    """

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        coil: int = 0,
        *,
        name: str = "laser relay",
        clock: Clock = time.monotonic,
        sleep: Sleep = time.sleep,
    ) -> None:
        self._bus = bus
        self._device_id = device_id
        self._name = name
        self._coil = coil
        output = Coil(coil)
        self._contact = _Contact(bus, device_id, output, name=name, clock=clock, sleep=sleep)

    def identify(self) -> Identity:
        """Such a relay has no name; that its coil can be read is all there is."""
        self._contact.is_closed()
        return Identity(family="relay", model=f"timed relay, coil {self._coil}", firmware="")

    def guarantee(self) -> Guarantee:
        """Say what the relay should do; nothing is sent."""
        timed_s = _TIMED_WORD * _TIMED_UNIT_S
        return Guarantee(
            None,
            f"{self._name}: a timed relay drops {timed_s:g} s after the last word from this program"
            ", if it is as its seller says: try it before you rely on it, stay at the station",
        )

    def on(self) -> None:
        """Switch on for 300 ms and read back, off again where that fails; see `LaserSwitch.on`."""
        with unless_done(self._contact.open):
            self._bus.write_coil_word(self._device_id, _TIMED_FROM + self._coil, _TIMED_WORD)
            if not self._contact.is_closed():
                raise Refused(f"{self._name}: the timed on did nothing; is the relay a plain one?")

    def off(self) -> None:
        """Switch off, three tries, each confirmed within 100 ms; see `LaserSwitch.off`."""
        self._contact.open()

    def is_on(self) -> bool:
        """Read the output back."""
        return self._contact.is_closed()

    def recipes(self) -> tuple[Recipe, ...]:
        """Off, and read back; see `drivers.recipes`."""
        return self._contact.recipes()


class PlainRelay:
    """A Modbus relay that keeps its contact for ever: coil, read back, and no watchdog."""

    def __init__(
        self,
        bus: Bus,
        device_id: int,
        coil: int = 0,
        *,
        name: str = "laser relay",
        clock: Clock = time.monotonic,
        sleep: Sleep = time.sleep,
    ) -> None:
        self._name = name
        self._coil = coil
        output = Coil(coil)
        self._contact = _Contact(bus, device_id, output, name=name, clock=clock, sleep=sleep)

    def identify(self) -> Identity:
        """Such a relay has no name; that its coil can be read is all there is."""
        self._contact.is_closed()
        return Identity(family="relay", model=f"plain relay, coil {self._coil}", firmware="")

    def guarantee(self) -> Guarantee:
        """Promise nothing; nothing is sent."""
        return Guarantee(
            None,
            f"{self._name}: a plain relay keeps its contact; nothing turns the laser off when "
            "this program is dead: stay at the station",
        )

    def on(self) -> None:
        """Switch on and read back, off again where that fails; see `LaserSwitch.on`."""
        with unless_done(self._contact.open):
            self._contact.close()

    def off(self) -> None:
        """Switch off, three tries, each confirmed within 100 ms; see `LaserSwitch.off`."""
        self._contact.open()

    def is_on(self) -> bool:
        """Read the output back."""
        return self._contact.is_closed()

    def recipes(self) -> tuple[Recipe, ...]:
        """Off, and read back; see `drivers.recipes`."""
        return self._contact.recipes()
