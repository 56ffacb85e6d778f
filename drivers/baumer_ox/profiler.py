"""The Baumer OX200 as a profiler: Modbus TCP for who and how, UDP for the profiles.

The sensor streams by itself to the address set on its web page; there is nothing to start here. It
sends counts without their unit, so millimetres a count are a setting, and it has no documented
switch of its laser (`drivers.laser` is a relay's business).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.axis import Identity, Pause
from drivers.baumer_ox import registers
from drivers.baumer_ox.registers import Readings
from drivers.baumer_ox.wire import (
    Assembler,
    BadFrame,
    Content,
    Event,
    Gap,
    MeasurementMessage,
    ProfileMessage,
)
from drivers.bus import Bus
from drivers.errors import NoReply, Refused
from drivers.links import ByteLink
from drivers.modbus_recipes import without_bits, write_register
from drivers.profiler import Profile, Reason, Tally
from drivers.recipes import Order, Recipe

_SLICE_S = 0.05  # the longest single wait
_QUIET_S = 0.025  # frames of one block are back to back: a silence so long is its end
_MOST_WAITING = 32_768  # datagrams: above what a socket's buffer holds


@dataclass(frozen=True, slots=True)
class Settings:
    """What the sensor does not say about its counts.

    ``invalid_z`` names the z counts that stand for no measurement. That 0 is one is inferred, not
    documented; the scale is read off the sensor's page or its data sheet.
    """

    x_mm_per_count: float
    z_mm_per_count: float
    x_offset_mm: float = 0.0
    z_offset_mm: float = 0.0
    invalid_z: tuple[tuple[int, Reason], ...] = ((0, Reason.NO_RETURN),)
    device_id: int = 1
    setup_timeout_s: float = 3.0

    def __post_init__(self) -> None:
        for name in ("x_mm_per_count", "z_mm_per_count"):
            scale = getattr(self, name)
            if not math.isfinite(scale) or scale == 0.0:
                raise ValueError(f"baumer_ox: {name} = {scale}; it must be finite and not 0")


class BaumerOx:
    """A `drivers.profiler.Profiler`; `bus` and `link` are closed by whoever opened them."""

    def __init__(
        self,
        bus: Bus,
        link: ByteLink,
        settings: Settings,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = bus
        self._link = link
        self._settings = settings
        self._clock = clock
        self._assembler = Assembler()
        self._waiting: deque[Profile] = deque()
        self._heard_s = clock()
        self._counts = _Counts()

    def identify(self) -> Identity:
        """Ask the sensor who it is; it has no register for its firmware.

        Raises
        ------
        Refused
            Another maker's device answers at this address.
        """
        vendor = registers.vendor(self._read(registers.VENDOR))
        if "baumer" not in vendor.lower():
            raise Refused(
                f"{self._name}: the vendor is {vendor!r}, not Baumer; is the address right?"
            )
        who = registers.device(self._read(registers.DEVICE))
        model = f"{who.sensor_type} {who.product_id}".strip()
        return Identity(family="baumer_ox", model=model, firmware="", serial=who.serial)

    def status(self) -> Readings:
        """Ask for the sensor's state: whether values are valid, alarm, quality of the signal."""
        return registers.readings(self._read(registers.READINGS))

    def active_setup(self) -> int:
        """Ask which stored setup is active."""
        (number,) = self._bus.read_input(self._settings.device_id, registers.ACTIVE_SETUP, 1)
        return number

    def load_setup(self, number: int, pause: Pause) -> None:
        """Load a stored setup and wait until the sensor says that it is active.

        Nothing is written twice, and parametrisation is left on every way out.

        Raises
        ------
        Refused
            The sensor said no, or another setup was still active after `setup_timeout_s`.
        """
        if number not in registers.SETUPS:
            raise ValueError(f"setup {number}; a setup's number is 0 to {registers.SETUPS[-1]}")
        device_id = self._settings.device_id
        self._bus.write_register(device_id, registers.ENTER_PARAMETRISATION, 1)
        try:
            self._bus.write_register(device_id, registers.LOAD_SETUP, number)
        finally:
            self._bus.write_register(device_id, registers.LEAVE_PARAMETRISATION, 1)
        deadline_s = self._clock() + self._settings.setup_timeout_s
        while (active := self.active_setup()) != number or self.status().parametrising:
            if self._clock() >= deadline_s:
                raise Refused(
                    f"{self._name}: setup {active} is active {self._settings.setup_timeout_s:g} s "
                    f"after {number} was loaded; is it stored, and nobody on the sensor's page?"
                )
            pause(_SLICE_S)

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they come, oldest first.

        What a caller spends on a profile is not the sensor's silence. The state is the driver's:
        leaving this iterator and asking for another loses nothing.

        Raises
        ------
        NoReply
            No profile came for `timeout_s`; says what came instead and what to check.
        """
        since_s, before = self._clock(), self._counts.copied()
        while True:
            if self._waiting:
                yield self._waiting.popleft()
                since_s, before = self._clock(), self._counts.copied()
                continue
            left_s = since_s + timeout_s - self._clock()
            heard = self._listen(min(max(left_s, 0.0), _SLICE_S))
            # What is there already is taken first, but not for ever.
            if not self._waiting and left_s <= (-_SLICE_S if heard else 0.0):
                raise NoReply(self._silence(timeout_s, before))

    def discard(self) -> None:
        """Throw away what has arrived; the numbering begins anew, so that no loss is counted."""
        for _ in range(_MOST_WAITING):
            if not self._link.read(0.0):
                break
        self._waiting.clear()
        self._assembler.restart()

    def recipes(self) -> tuple[Recipe, ...]:
        """Leave parametrisation, in which a program may have died; see `drivers.recipes`."""
        device_id = self._settings.device_id
        leave = write_register(self._bus, device_id, registers.LEAVE_PARAMETRISATION, 1)
        left = without_bits(self._bus, device_id, 4, registers.READINGS.first, 1)
        name, quiet_s = "profiler", self._bus.quiet_s
        return (Recipe(name, Order.SENSOR, (leave,), (left,), quiet_s, rest_s=0.2),)

    def tally(self) -> Tally:
        """What was lost so far."""
        counts = self._counts
        return Tally(counts.profiles, counts.lost, counts.torn, counts.bad)

    @property
    def _name(self) -> str:
        return f"baumer_ox at {self._bus.address}"

    def _read(self, span: registers.Span) -> tuple[int, ...]:
        return self._bus.read_input(self._settings.device_id, span.first, span.count)

    def _listen(self, timeout_s: float) -> bool:
        """Take one datagram; a silence ends a block that waits for its last frames."""
        datagram = self._link.read(timeout_s)
        if datagram:
            self._heard_s = self._clock()
            self._take(self._assembler.feed(datagram))
        elif self._clock() - self._heard_s >= _QUIET_S:
            self._take(self._assembler.flush())
        return bool(datagram)

    def _take(self, events: Iterator[Event]) -> None:
        for event in events:
            match event:
                case ProfileMessage():
                    self._counts.profiles += 1
                    self._counts.torn += event.torn
                    self._waiting.append(profile_of(event, self._settings))
                case MeasurementMessage():
                    self._counts.measurements += 1
                case Gap():
                    self._counts.lost += event.lost
                case BadFrame():
                    self._counts.bad += 1

    def _silence(self, timeout_s: float, before: _Counts) -> str:
        start = f"baumer_ox at {self._link.address}: no profile in {timeout_s:g} s"
        if self._counts.measurements > before.measurements:
            return f"{start}, only measured values; choose a profile in the sensor's UDP output"
        if self._counts.bad > before.bad:
            return f"{start}, only bytes that are no frame of it; does another device send here?"
        if self._counts.lost > before.lost:
            return f"{start}, only pieces of some; is the network overloaded or a cable loose?"
        return (
            f"{start}; is the laser on, the trigger running, and this host's address and port set "
            "in the sensor's UDP output?"
        )


@dataclass(slots=True)
class _Counts:
    profiles: int = 0
    lost: int = 0
    torn: int = 0
    bad: int = 0
    measurements: int = 0

    def copied(self) -> _Counts:
        return _Counts(self.profiles, self.lost, self.torn, self.bad, self.measurements)


def profile_of(message: ProfileMessage, settings: Settings) -> Profile:
    """Return the profile of a block; without z (an intensity block) no point is a measurement."""
    counts = np.zeros((len(message.x), 2), dtype=np.int32)
    counts[:, 0] = message.x
    if message.content is not Content.INTENSITY:
        counts[:, 1] = message.z
    return Profile(
        counts=counts,
        scale_mm=(settings.x_mm_per_count, settings.z_mm_per_count),
        offset_mm=(settings.x_offset_mm, settings.z_offset_mm),
        reasons=_reasons(message, settings),
        intensity=message.intensity,
        sensor_time_s=message.state.seconds + message.state.microseconds * 1e-6,
        encoder=message.state.encoder,
        frame=message.block,
    )


def _reasons(message: ProfileMessage, settings: Settings) -> NDArray[np.uint8]:
    valid = Reason.UNKNOWN if message.content is Content.INTENSITY else Reason.MEASURED
    reasons = np.full(len(message.x), valid, dtype=np.uint8)
    if message.content is not Content.INTENSITY:
        for count, reason in settings.invalid_z:
            reasons[message.z == count] = reason
    if message.torn:
        reasons[~message.arrived] = Reason.LOST
    return reasons
