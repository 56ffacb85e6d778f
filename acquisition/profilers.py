"""From [profiler] of station.toml to the profiler that it describes, whatever its family.

`profiler_maker` checks the settings at once and opens nothing; what it gives opens the links, or
takes its share of a bus that is open already.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from acquisition.profiler_settings import (
    BannerEzArray,
    Hokuyo,
    RegisterProfiler,
    Riftek,
    RiftekTrigger,
    SickProfiler2,
)
from acquisition.station import BaumerOx, ProfilerSettings
from drivers import baumer_ox, hokuyo, register_profiler, riftek, sick
from drivers.bus import Bus
from drivers.links import ByteLink
from drivers.profiler import Profile, Profiler, Reason

_PATIENCE_S = 0.25  # for a profile, beside three periods of the sensor


class Wires(Protocol):
    """Open links by their address; devices at one address share what can be shared."""

    @property
    def clock(self) -> Callable[[], float]:
        """Monotonic seconds."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let some time pass."""
        ...

    def link(self, address: str) -> ByteLink:
        """A link of the caller's own."""
        ...

    def brief_link(self, address: str) -> ByteLink:
        """A link that the caller closes, after one question."""
        ...

    def bus(self, address: str) -> Bus:
        """A Modbus bus."""
        ...

    def scip(self, address: str) -> hokuyo.ScipLine:
        """A Hokuyo scanner's line, which its profiles and its laser's switch share."""
        ...


def profiler_maker(settings: ProfilerSettings) -> Callable[[Wires], Profiler]:
    """What makes the profiler; ValueError where the driver cannot do what the file says."""
    match settings:
        case BaumerOx():
            scales = baumer_ox_settings(settings)
            return lambda at: _baumer_ox(settings, scales, at)
        case RegisterProfiler() | BannerEzArray():
            layout = settings.layout
            return lambda at: register_profiler.RegisterProfiler(
                at.bus(settings.address), settings.device_id, layout,
                period_s=1.0 / settings.rate_hz, family=settings.family, clock=at.clock,
                pause=at.sleep,
            )  # fmt: skip
        case Riftek():
            wanted = settings.driver_settings
            return lambda at: _riftek(settings, wanted, at)
        case Hokuyo():
            steps = settings.driver_settings
            return lambda at: hokuyo.Hokuyo(at.scip(settings.address), steps)
        case SickProfiler2():
            memory, baud = settings.driver_settings, settings.baud
            return lambda at: sick.SickProfiler2(
                sick.SickLine(at.link(settings.address), baud=baud, clock=at.clock), memory
            )


def as_it_is(settings: ProfilerSettings) -> ProfilerSettings:
    """Settings of the same profiler whose opening writes nothing to it."""
    match settings:
        case BaumerOx():
            return replace(settings, setup=None)
        case Riftek():
            return replace(settings, set_rate=False, exposure_us=None, trigger=RiftekTrigger.SENSOR)
        case _:
            return settings


def patience_s(settings: ProfilerSettings) -> float:
    """How long a profile is waited for: three of its periods, and what a lost answer costs."""
    recovery_s = sick.FORGETS_S if isinstance(settings, SickProfiler2) else 0.0
    return _PATIENCE_S + 3.0 / settings.rate_hz + recovery_s


def lost_profile(settings: ProfilerSettings) -> Profile:
    """Stand in for a profile that never came: its places, every one of them LOST."""
    points = settings.points_per_profile
    scale_mm, offset_mm = _scales(settings)
    return Profile(
        counts=np.zeros((points, 2), np.int32),
        scale_mm=scale_mm,
        offset_mm=offset_mm,
        reasons=np.full(points, Reason.LOST, np.uint8),
        intensity=np.empty(0, np.uint16),
        sensor_time_s=0.0,
        encoder=0,
        frame=-1,
    )


def baumer_ox_settings(profiler: BaumerOx) -> baumer_ox.Settings:
    """Scales that the sensor itself does not tell."""
    return baumer_ox.Settings(
        x_mm_per_count=profiler.x_mm_per_count,
        z_mm_per_count=profiler.z_mm_per_count,
        x_offset_mm=profiler.x_offset_mm,
        z_offset_mm=profiler.z_offset_mm,
        device_id=profiler.device_id,
    )


def _baumer_ox(settings: BaumerOx, scales: baumer_ox.Settings, at: Wires) -> Profiler:
    bus, link = at.bus(settings.address), at.link(settings.profiles)
    profiler = baumer_ox.BaumerOx(bus, link, scales, clock=at.clock)
    if settings.setup is not None:
        profiler.load_setup(settings.setup, at.sleep)
    return profiler


def _riftek(settings: Riftek, wanted: riftek.Settings, at: Wires) -> Profiler:
    web = riftek.WebApi(lambda: at.brief_link(settings.address), settings.address, clock=at.clock)
    profiler = riftek.Riftek(web, at.link(settings.profiles), wanted, clock=at.clock)
    profiler.set_up()
    return profiler


def _scales(settings: ProfilerSettings) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mm a count, and what is added; a RIFTEK's scale comes with its profiles."""
    match settings:
        case BaumerOx():
            scale_mm = (settings.x_mm_per_count, settings.z_mm_per_count)
            return scale_mm, (settings.x_offset_mm, settings.z_offset_mm)
        case RegisterProfiler() | BannerEzArray():
            layout = settings.layout
            scale_mm = (layout.column_pitch_mm, layout.z_mm_per_count)
            return scale_mm, (layout.first_column_mm, layout.z_offset_mm)
        case Riftek():
            return (1.0, 1.0), (settings.x_offset_mm, settings.z_offset_mm)
        case Hokuyo():
            return (hokuyo.MM_PER_COUNT, hokuyo.MM_PER_COUNT), (0.0, 0.0)
        case SickProfiler2():
            scale_mm = (settings.x_mm_per_count, settings.z_mm_per_count)
            return scale_mm, (settings.x_offset_mm, settings.z_offset_mm)
