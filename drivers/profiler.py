"""Delivering profiles: the Protocol that every line profiler keeps, and its value.

A `Profile` is what the sensor said, in the sensor's own integers: scale and offset stand beside
them, millimetres are derived. Nothing is dropped: a point without a measurement keeps its place and
says why::

          z (away from the sensor is the sensor's own sense)
          |        laser plane, seen along the sheet's normal
    ------+------ x
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray, frozen
from drivers.axis import Identity


class Reason(IntEnum):
    """Why a point has no measurement."""

    MEASURED = 0
    NO_RETURN = 1  # too little light came back
    SATURATED = 2
    OUT_OF_RANGE = 3
    LOST = 4  # a block of the profile did not arrive
    UNKNOWN = 5  # the sensor says invalid and no more


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """One line of points in the laser plane.

    ``points_mm = counts * scale_mm + offset_mm``; rows whose reason is not MEASURED are no points.
    """

    counts: NDArray[np.int32]  # (n, 2), the sensor's own integers x, z
    scale_mm: tuple[float, float]  # mm a count, of x and of z
    offset_mm: tuple[float, float]
    reasons: NDArray[np.uint8]  # (n,), of `Reason`
    intensity: NDArray[np.uint16]  # (n,), or (0,) where the sensor sends none
    sensor_time_s: float  # the sensor's own clock
    encoder: int  # the sensor's encoder input, 0 where it has none
    frame: int  # the sensor's own number of this profile

    def __post_init__(self) -> None:
        object.__setattr__(self, "counts", frozen(self.counts, np.int32))
        object.__setattr__(self, "reasons", frozen(self.reasons, np.uint8))
        object.__setattr__(self, "intensity", frozen(self.intensity, np.uint16))
        if self.counts.shape != (len(self.reasons), 2):
            raise ValueError(f"profile: {self.counts.shape} counts, {len(self.reasons)} reasons")

    @property
    def points_mm(self) -> FloatArray:
        """The measured points in the laser plane, (m, 2) float64 in mm, m <= n."""
        measured = self.counts[self.reasons == Reason.MEASURED]
        return np.asarray(measured * np.array(self.scale_mm) + np.array(self.offset_mm))


@dataclass(frozen=True, slots=True)
class Tally:
    """What a stream of profiles lost, counted since the profiler was opened."""

    profiles: int = 0
    lost_profiles: int = 0  # numbers that never came
    torn_profiles: int = 0  # came with blocks missing
    bad_frames: int = 0  # bytes that were no frame


class Profiler(Protocol):
    """A line profiler behind its links."""

    def identify(self) -> Identity:
        """Ask the sensor who it is."""
        ...

    def profiles(self, timeout_s: float) -> Iterator[Profile]:
        """Yield profiles as they come, oldest first.

        Raises
        ------
        NoReply
            When none came for `timeout_s`; says what to check (laser, trigger, network).
        """
        ...

    def discard(self) -> None:
        """Throw away what has arrived and was not yielded: profiles of before the exposure."""
        ...

    def tally(self) -> Tally:
        """What was lost so far."""
        ...
