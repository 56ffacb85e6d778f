"""The sensor between its two wires and the World.

It measures at its rate in the station's time, and tells the newest of its profiles when it is
asked, so that a pause brings no burst. Blocks are numbered as they are sent (manual V4, page 44):
a dark period, or one that nobody asked for in time, takes no number, and is no loss.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.baumer_ox import registers
from sim.baumer_ox.frames import FEWEST_BYTES, Encoding, frames, profile_body
from sim.baumer_ox.reading import Quality, Reading
from sim.device import ModbusRefusal
from sim.sensor_clock import FreeRun, SensorClock
from sim.world import World

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _DEVICE_FAILURE = 1, 2, 3, 4
_SETUPS = range(1, 4)  # manual V2, page 21
_MOST_UDP_BYTES = 65507
_BLOCKS = 2**32
_COMMANDS = {registers.REQUEST_PARAMETRISATION: (0, 0), registers.LOAD_SETUP: (0,)}


@dataclass(frozen=True, slots=True, kw_only=True)
class OxSettings:
    """How the sensor was set up on its web page; its points are the bench's `Sensor.points`."""

    rate_hz: float = 100.0
    clock: SensorClock | None = None  # None: it measures when it is looked at
    encoding: Encoding = Encoding.ZI
    most_bytes: int = 1400  # of a datagram, its header included
    setup: int = 1
    serial: str = "SIM0001"
    vendor: str = "Baumer Electric AG"
    product_id: str = "00000200"
    sensor_type: str = "OX200 (simulated)"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate_hz) and self.rate_hz > 0.0):
            raise ValueError(f"OX200: a rate of {self.rate_hz} Hz; it must be finite and above 0")
        if not FEWEST_BYTES <= self.most_bytes <= _MOST_UDP_BYTES:
            raise ValueError(
                f"OX200: datagrams of {self.most_bytes} bytes;"
                f" give {FEWEST_BYTES} to {_MOST_UDP_BYTES}"
            )
        if self.setup not in _SETUPS:
            raise ValueError(f"OX200: setup {self.setup}; there are 1, 2 and 3")
        for name, size in _TEXT_BYTES.items():
            text = getattr(self, name)
            if not text.isascii() or len(text) > size:
                raise ValueError(f"OX200: {name} {text!r}; give at most {size} ASCII characters")


_TEXT_BYTES = {
    "vendor": registers.VENDOR_BYTES,
    "product_id": registers.PRODUCT_ID_BYTES,
    "sensor_type": registers.TYPE_BYTES,
    "serial": registers.SERIAL_BYTES,
}


class OxSensor:
    """One sensor: a `ModbusUnit` and a `Broadcaster`."""

    def __init__(self, world: World, settings: OxSettings | None = None) -> None:
        self._world = world
        self._settings = told = settings or OxSettings()
        self._identity = {
            registers.VENDOR: registers.vendor_words(told.vendor),
            registers.DEVICE_INFO: registers.device_info_words(
                told.product_id, told.sensor_type, told.serial
            ),
        }
        self._setup = told.setup
        self._parametrising = False
        self._free_run = FreeRun(told.clock)
        self._sent = 0  # blocks

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """Return the frames of the newest profiles, each once, and only of those that were lit."""
        station_s = self._world.pace.station_s(now_s)
        due = self._free_run.due(station_s, self._settings.rate_hz)
        return [frame for seen_s in due for frame in self._profile(seen_s, now_s)]

    def _profile(self, station_s: float, now_s: float) -> Sequence[bytes]:
        seen_s = self._world.pace.wall_s(station_s)
        profile = self._world.look(seen_s)
        if profile is None:
            return ()
        block, settings, world = self._sent % _BLOCKS, self._settings, self._world
        self._sent += 1
        seen = int(np.count_nonzero(profile.seen))
        world.witness.note(
            now_s, "profile", frame=block, table_rad=world.table.load(seen_s),
            stage_mm=world.stage.load(seen_s), seen=seen,
        )  # fmt: skip
        body = profile_body(self._reading(seen, station_s), profile, settings.encoding)
        return frames(body, block, settings.most_bytes)

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Commands, there to be written: what they read as is not documented, so 0."""
        del now_s
        return _words(_COMMANDS, first, count)

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Identity, readings, active setup."""
        areas = {**self._identity, registers.ACTIVE_SETUP: [self._setup]}
        if registers.READINGS <= first < registers.ACTIVE_SETUP:
            areas[registers.READINGS] = self._reading_words(now_s)
        return _words(areas, first, count)

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Request or leave parametrisation mode by any value, or load a setup in it."""
        _words(_COMMANDS, first, len(words))  # refuses other addresses
        if first == registers.LOAD_SETUP:
            self._load(words[0])
        else:
            last = first + len(words) - 1
            self._parametrising = last == registers.REQUEST_PARAMETRISATION

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def heard(self, now_s: float) -> None:
        """It has no watchdog."""

    def tick(self, now_s: float) -> None:
        """Nothing of it runs out."""

    def _load(self, setup: int) -> None:
        # The manual (V2, page 21) wants parametrisation mode, and does not tell what else comes.
        if not self._parametrising:
            raise ModbusRefusal(_DEVICE_FAILURE)
        if setup not in _SETUPS:
            raise ModbusRefusal(_ILLEGAL_VALUE)
        self._setup = setup

    def _reading_words(self, now_s: float) -> list[int]:
        profile = self._world.look(now_s)
        z = np.empty(0) if profile is None else profile.counts[profile.seen, 1]
        sensor = self._world.bench.settings.sensor
        nearest_mm = z.min() * sensor.z_mm_per_count + sensor.z_offset_mm if len(z) else math.nan
        station_s = self._world.pace.station_s(now_s)
        return registers.reading_words(self._reading(len(z), station_s), nearest_mm)

    def _reading(self, points_seen: int, station_s: float) -> Reading:
        return Reading(
            parametrising=self._parametrising,
            quality=Quality.OK if points_seen else Quality.NO_SIGNAL,
            rate_hz=self._settings.rate_hz,
            time_us=round(self._free_run.stamp_s(station_s) * 1e6),
        )


def _words(areas: Mapping[int, Sequence[int]], first: int, count: int) -> list[int]:
    words = registers.part_of(areas, first, count)
    if words is None:
        raise ModbusRefusal(_ILLEGAL_ADDRESS)
    return words
