r"""When a sensor that measures by itself does so, and what its own clock says of it.

::

    light is seen        stamped and sent          stamp = started_s + (1 + drift) (t + latency_s)
    ------o-------------------o-------- time
          t = k / rate        t + latency_s

The angle of the table that a profile truly shows is the one at t, whatever its stamp says. A sensor
without such a clock measures when it is looked at, once a period, which is as good at a stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_CATCH_UP_S = 0.0125  # of measurements that a busy simulator makes up for; older ones are not made


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorClock:
    """The sensor's clock beside the station's time."""

    latency_s: float = 0.0  # from the light to the stamp
    drift_ppm: float = 0.0  # fast where it is positive
    started_s: float = 0.0  # what it says at the station's time 0

    def __post_init__(self) -> None:
        if not 0.0 <= self.latency_s <= 1.0:
            raise ValueError(f"sensor clock: a latency of {self.latency_s} s; give 0 to 1")
        if not abs(self.drift_ppm) <= 1e5:
            raise ValueError(f"sensor clock: a drift of {self.drift_ppm} ppm; give -1e5 to 1e5")

    def stamp_s(self, seen_s: float) -> float:
        """What is stamped on what was seen then."""
        return self.started_s + (1.0 + self.drift_ppm * 1e-6) * (seen_s + self.latency_s)


class FreeRun:
    """Which measurements are due, each once, when somebody looks now and then."""

    def __init__(self, clock: SensorClock | None) -> None:
        self._clock = clock
        self._newest: int | None = None

    def due(self, station_s: float, rate_hz: float) -> Sequence[float]:
        """Times of what was seen and can be told by now, oldest first; what is long ago is not."""
        latency_s = 0.0 if self._clock is None else self._clock.latency_s
        newest = math.floor((station_s - latency_s) * rate_hz)
        if newest == self._newest:
            return ()
        if self._clock is None:
            self._newest = newest
            return (station_s,)
        most = max(1, math.floor(_CATCH_UP_S * rate_hz))
        before = self._newest if self._newest is not None and self._newest < newest else newest - 1
        self._newest = newest
        first = max(before + 1, newest - most + 1)
        return [number / rate_hz for number in range(first, newest + 1)]

    def stamp_s(self, seen_s: float) -> float:
        """What is stamped on what was seen then."""
        return seen_s if self._clock is None else self._clock.stamp_s(seen_s)
