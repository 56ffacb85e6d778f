"""The sensor between its two wires and the World: it measures by itself, or when software says so.

A dark period is neither counted nor sent, and a parameter that is not here has no effect here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.riftek.frames import Count, datagram
from sim.sensor_clock import FreeRun, SensorClock
from sim.world import World

_INTERNAL, _SOFTWARE = 0, 2
_PROFILES = 17
# RIFTEK's bounds: least, largest, step
_BOUNDS = {
    "user_sensor_framerate": (1, 20_000, 1),
    "user_sensor_exposure1": (3_000, 300_000_000, 100),
    "user_sensor_syncSource": (0, 2, 1),
    "user_streams_udpEnabled": (0, 1, 1),
    "user_streams_format": (16, 17, 1),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RfSettings:
    """How the sensor was set up on its web page."""

    rate_hz: float = 100.0
    clock: SensorClock | None = None  # None: it measures when it is looked at
    serial: int = 627_001
    exposure_ns: int = 300_000

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate_hz) and 1.0 <= self.rate_hz <= 20_000.0):
            raise ValueError(f"RF62X: a rate of {self.rate_hz} Hz; give 1 to 20000")


class RfSensor:
    """One sensor: a `Broadcaster`, and `sim.riftek.web.Parameters`."""

    def __init__(self, world: World, settings: RfSettings | None = None) -> None:
        told = settings or RfSettings()
        self._world = world
        self._serial = told.serial
        self._fixed: dict[str, Any] = {
            "fact_general_deviceType": 627,
            "fact_general_serial": told.serial,
            "fact_general_firmwareVer": [2, 19, 3],
        }
        self._values = {
            "user_sensor_framerate": round(told.rate_hz),
            "user_sensor_exposure1": told.exposure_ns,
            "user_sensor_syncSource": _INTERNAL,
            "user_streams_udpEnabled": 1,
            "user_streams_format": _PROFILES,
        }
        self._free_run = FreeRun(told.clock)
        self._wished = 0  # profiles that software asked for
        self._measured = 0
        self._sent = 0

    def values(self, names: Sequence[str]) -> Mapping[str, Any]:
        """Parameters by name."""
        every = self._fixed | self._values
        return {name: every[name] for name in names or every if name in every}

    def write(self, name: str, text: str) -> str:
        """Write one within its bounds and steps."""
        if name in self._fixed:
            return "RF_NOT_AUTHORIZED"
        if name not in self._values:
            return "RF_PARAM_NOT_FOUND"
        if not text.isdecimal():
            return "RF_WRONG_DATA_TYPE"
        least, largest, step = _BOUNDS[name]
        if not least <= int(text) <= largest:
            return "RF_OUT_OF_BOUNDS"
        if int(text) % step:
            return "RF_NOT_IN_STEP"
        self._values[name] = int(text)
        return "RF_OK"

    def capture(self, count: int, now_s: float) -> str:
        """Measure so many times, where software triggers."""
        if self._values["user_sensor_syncSource"] != _SOFTWARE:
            return "RF_NOT_VALID"
        self._wished += count
        return "RF_OK"

    def datagrams(self, now_s: float) -> Sequence[bytes]:
        """Return the newest profiles, each once, and only of those that were lit."""
        station_s = self._world.pace.station_s(now_s)
        due = self._free_run.due(station_s, self._values["user_sensor_framerate"])
        return [each for seen_s in due if self._is_due() for each in self._profile(seen_s, now_s)]

    def _profile(self, station_s: float, now_s: float) -> Sequence[bytes]:
        world, seen_s = self._world, self._world.pace.wall_s(station_s)
        profile = world.look(seen_s)
        if profile is None or not self._streams:
            return ()
        count = Count(
            packet=self._sent,
            measure=self._measured,
            time_ns=round(self._free_run.stamp_s(station_s) * 1e9),
            exposure_ns=self._values["user_sensor_exposure1"],
        )
        self._sent += 1
        self._measured += 1
        world.witness.note(
            now_s, "profile", frame=count.packet, table_rad=world.table.load(seen_s),
            stage_mm=world.stage.load(seen_s), seen=int(np.count_nonzero(profile.seen)),
        )  # fmt: skip
        return (datagram(profile, world.bench.settings.sensor, self._serial, count),)

    def _is_due(self) -> bool:
        """Whether something starts a measurement; a wish is fulfilled by one."""
        if self._values["user_sensor_syncSource"] == _INTERNAL:
            return True
        if not self._wished:
            return False
        self._wished -= 1
        return True

    @property
    def _streams(self) -> bool:
        on, form = self._values["user_streams_udpEnabled"], self._values["user_streams_format"]
        return bool(on) and form == _PROFILES
