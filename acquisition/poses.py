"""Where the axes stood, and the sweep: what one slice's exposure gave, untouched by calibration."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.profiler import Profile


@dataclass(frozen=True, slots=True)
class Pose:
    """Axis positions read back for one profile, never the commanded ones."""

    table_rad: float  # unwrapped: ten turns are 20 pi
    stage_mm: float
    time_s: float  # of the station's clock, when they were read


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """The profiles of one slice, each with the pose it was taken at."""

    index: int
    profiles: tuple[Profile, ...]
    poses: tuple[Pose, ...]

    def __post_init__(self) -> None:
        if self.index < 0:
            raise ValueError(f"sweep: index {self.index} is negative")
        if len(self.profiles) != len(self.poses):
            raise ValueError(
                f"sweep {self.index}: {len(self.profiles)} profiles, {len(self.poses)} poses"
            )
