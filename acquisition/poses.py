"""Where the axes stood, and the sweep: what one slice's exposure gave, untouched by calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray, frozen
from drivers.profiler import Profile


@dataclass(frozen=True, slots=True)
class Pose:
    """Axis positions read back for one profile, never the commanded ones.

    Of a table that turned, interpolated between positions read back; `Timing` says how well.
    """

    table_rad: float  # unwrapped: ten turns are 20 pi
    stage_mm: float
    time_s: float  # of the station's clock, when they were read; or the profile was taken


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timing:
    """What the poses of a turning table were made of, and how far each part of it can be off."""

    arrived_s: FloatArray  # (profiles,) of the station's clock; nan for one that never came
    asked_s: FloatArray  # (k,) when the table was asked where it is
    asked_rad: FloatArray  # (k,) what it said
    speed_rad_s: float  # as planned; both senses have it
    latency_s: float  # taken off every time; nan: the part did not tell it, and none was
    latency_sd_s: float  # one standard deviation; inf where it was not told
    drift_ppm: float  # how fast the sensor's clock is
    clock_late_s: float  # median of how late what was heard first was, after the line under all
    table_rms_rad: float  # of the positions read back, around the poses
    apart_mm: float  # rms between the two senses after correction, noise and all; nan: one sense
    noise_mm: float  # what noise alone makes of that; nan likewise
    lost: int  # profiles that were numbered and never came: marked, point by point

    def __post_init__(self) -> None:
        for name in ("arrived_s", "asked_s", "asked_rad"):
            object.__setattr__(self, name, frozen(getattr(self, name), np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The profiles of one slice, each with the pose it was taken at."""

    index: int
    profiles: tuple[Profile, ...]
    poses: tuple[Pose, ...]
    timing: Timing | None = None  # of a table that turned; None where it stood

    def __post_init__(self) -> None:
        if self.index < 0:
            raise ValueError(f"sweep: index {self.index} is negative")
        if len(self.profiles) != len(self.poses):
            raise ValueError(
                f"sweep {self.index}: {len(self.profiles)} profiles, {len(self.poses)} poses"
            )
        if self.timing is not None and len(self.timing.arrived_s) != len(self.poses):
            raise ValueError(
                f"sweep {self.index}: {len(self.poses)} poses, {len(self.timing.arrived_s)} times"
            )
