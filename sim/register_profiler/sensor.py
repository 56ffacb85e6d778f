"""A profile sensor without a stream: its columns stand in registers, for whoever reads them.

Its own data sheet, as a maker of such a sensor would write it::

    holding (3, 6, 16)   0  trigger: 1 measures once   1  mode: 0 by itself, 1 when triggered
    input (4)            0  bit 0 a profile is there, of after the last trigger
                         1  number of the profile, from 1 on, over 65535 to 0
                        16  first column; z in units of 5 um
                            65535 no return, 65534 out of range

It goes on measuring while it is read, unless it waits for its trigger. In the dark it measures, and
nothing returns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from sim.device import ModbusRefusal
from sim.register_profiler.columns import columns_of
from sim.world import World

_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE = 1, 2, 3
_TRIGGER, _MODE = 0, 1
_STATUS, _NUMBER, _COLUMNS = 0, 1, 16
_NUMBERS = 0x10000


class Measuring(Enum):
    """When it measures, by the word of its mode."""

    BY_ITSELF = 0
    WHEN_TRIGGERED = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterSettings:
    """What its maker and its owner gave it."""

    columns: int = 481
    pitch_mm: float = 0.25
    z_mm_per_count: float = 0.005
    rate_hz: float = 100.0
    measuring: Measuring = Measuring.WHEN_TRIGGERED

    def __post_init__(self) -> None:
        if not 2 <= self.columns <= 0x10000 - _COLUMNS:
            raise ValueError(f"register sensor: {self.columns} columns do not fit its registers")
        for name in ("pitch_mm", "z_mm_per_count", "rate_hz"):
            if not (math.isfinite(value := getattr(self, name)) and value > 0.0):
                raise ValueError(f"register sensor: {name} = {value}; it must be above 0")

    @property
    def first_column_mm(self) -> float:
        """Where the first column looks."""
        return -self.pitch_mm * (self.columns - 1) / 2.0


class RegisterSensor:
    """One sensor: a `ModbusUnit`."""

    def __init__(self, world: World, settings: RegisterSettings | None = None) -> None:
        self.settings = settings or RegisterSettings()
        self._world = world
        self._measuring = self.settings.measuring
        self._period: int | None = None
        self._due_s: float | None = None  # of a triggered exposure
        self._ready = False
        self._number = 0
        self._words = np.full(self.settings.columns, 0xFFFF, np.uint16)

    def read_holding(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Trigger, which reads as 0, and mode."""
        return _part({_TRIGGER: [0, self._measuring.value]}, first, count)

    def read_input(self, first: int, count: int, now_s: float) -> Sequence[int]:
        """Status, number, and columns."""
        self.tick(now_s)
        areas = {_STATUS: [int(self._ready), self._number], _COLUMNS: self._words.tolist()}
        return _part(areas, first, count)

    def read_coils(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def read_discrete(self, first: int, count: int, now_s: float) -> Sequence[bool]:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def write_registers(self, first: int, words: Sequence[int], now_s: float) -> None:
        """Trigger, or change the mode."""
        if not (first in (_TRIGGER, _MODE) and first + len(words) <= _MODE + 1):
            raise ModbusRefusal(_ILLEGAL_ADDRESS)
        if any(word not in (0, 1) for word in words):
            raise ModbusRefusal(_ILLEGAL_VALUE)
        told = dict(enumerate(words, start=first))
        self._measuring = Measuring(told.get(_MODE, self._measuring.value))
        if told.get(_TRIGGER) == 1:
            pace = self._world.pace
            lasts_s = 1.0 / self.settings.rate_hz
            self._ready, self._due_s = False, pace.wall_s(pace.station_s(now_s) + lasts_s)

    def write_coils(self, first: int, states: Sequence[bool], now_s: float) -> None:
        """It has none."""
        raise ModbusRefusal(_ILLEGAL_FUNCTION)

    def heard(self, now_s: float) -> None:
        """It has no watchdog."""

    def tick(self, now_s: float) -> None:
        """Measure what is due."""
        if self._measuring is Measuring.WHEN_TRIGGERED:
            if self._due_s is not None and now_s >= self._due_s:
                self._due_s = None
                self._measure(now_s)
            return
        period = math.floor(self._world.pace.station_s(now_s) * self.settings.rate_hz)
        if period != self._period:
            self._period = period
            self._measure(now_s)

    def _measure(self, now_s: float) -> None:
        world, own = self._world, self.settings
        profile = world.look(now_s)
        sensor = world.bench.settings.sensor
        self._words = columns_of(profile, sensor, own.columns, own.pitch_mm, own.z_mm_per_count)
        self._number = (self._number + 1) % _NUMBERS
        self._ready = True
        if profile is not None:
            world.witness.note(
                now_s, "profile", frame=self._number, table_rad=world.table.load(now_s),
                stage_mm=world.stage.load(now_s), seen=int(np.count_nonzero(profile.seen)),
            )  # fmt: skip


def _part(areas: dict[int, list[int]], first: int, count: int) -> list[int]:
    for start, words in areas.items():
        if start <= first and first + count <= start + len(words):
            return words[first - start : first - start + count]
    raise ModbusRefusal(_ILLEGAL_ADDRESS)
