r"""The simulated station's optics as values: how it stands, what it sees, how badly, what it says.

Written from the physics, not from our drivers or frames: a misreading there must not confirm
itself here. The sheet of light is horizontal; the camera looks down into it from above::

    seen from the side                          seen from above, azimuth 0

                     (camera)                        y
                   . '  |  rise                      |        x of a RIGHT-handed sensor
       part     . '     |                         .--|--.          ^
      .----. . '        |                        /   o---\-- x     | [emitter]
      |    *<-----------E emitter, z = 0         \  axis /    z <--+
      |    |    sheet, height_mm + stage          '-----'
    ==plate==                                        |<-- standoff ->|
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
from numpy.typing import NDArray

from sim.arrays import ReasonArray, frozen


class Turning(Enum):
    """How the part turns, seen from above, when the table's angle grows."""

    COUNTER_CLOCKWISE = 1
    CLOCKWISE = -1


class Lifting(Enum):
    """Where the sheet goes on the part when the stage's position grows."""

    UP = 1
    DOWN = -1


class Hand(Enum):
    """Where the sensor's x points, for somebody who looks along the beam with z up."""

    RIGHT = 1
    LEFT = -1


class Reason(IntEnum):
    """What became of one beam: the truth, of which the device tells only "seen" or not."""

    MEASURED = 0
    OUTLIER = 1  # a value is delivered, and it is false
    NO_HIT = 2  # the beam passes the part
    GRAZING = 3  # too little light came back: the surface is too steep
    DARK = 4  # too little light came back: the surface is black
    OCCLUDED = 5  # lit, but the part hides it from the camera
    OUT_OF_RANGE = 6  # nearer or farther than the sensor measures


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """How the sensor stands to the table, in truth."""

    standoff_mm: float = 225.0  # from the sensor's z = 0 to the table's axis, along the beam
    side_mm: float = 0.0  # how far the middle beam passes the axis, to its left
    height_mm: float = 0.0  # of the sheet over the plate, stage at 0
    azimuth_rad: float = 0.0  # of the sensor around the axis, counter-clockwise from x
    turning: Turning = Turning.COUNTER_CLOCKWISE
    lifting: Lifting = Lifting.UP
    hand: Hand = Hand.RIGHT


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """What a faultless sensor sees and how it counts: mm = counts * scale + offset, i16 and u16."""

    points: int = 1280
    near_mm: float = 150.0
    far_mm: float = 300.0
    width_mm: float = 120.0  # of the field of view in the middle of the range
    triangulation_rad: float = math.radians(25.0)  # camera over sheet, seen from mid-range
    x_mm_per_count: float = 0.005
    z_mm_per_count: float = 0.005
    x_offset_mm: float = 0.0
    z_offset_mm: float = 0.0

    def __post_init__(self) -> None:
        if self.points < 2 or not 0.0 < self.near_mm < self.far_mm:
            raise ValueError(
                f"sensor: {self.points} points from {self.near_mm} to {self.far_mm} mm;"
                " give at least 2 points and 0 < near < far"
            )
        if not 0.0 < abs(self.triangulation_rad) < math.pi / 2:
            raise ValueError("sensor: triangulation_rad must lie between 0 and pi/2, either sign")
        half_mm = self.far_mm * self.steepest
        x = (np.array([-half_mm, half_mm]) - self.x_offset_mm) / self.x_mm_per_count
        z = (np.array([self.near_mm, self.far_mm]) - self.z_offset_mm) / self.z_mm_per_count
        if np.abs(x).max() >= 2**15 - 1:
            raise ValueError(f"sensor: x of ±{half_mm:g} mm does not fit int16; coarsen its scale")
        if z.min() < 1.0 or z.max() >= 2**16 - 1:
            raise ValueError("sensor: near to far does not fit uint16 from 1 on; coarsen z's scale")

    @property
    def middle_mm(self) -> float:
        """The middle of the range."""
        return (self.near_mm + self.far_mm) / 2.0

    @property
    def steepest(self) -> float:
        """The outermost beam's x over z."""
        return self.width_mm / 2.0 / self.middle_mm

    @property
    def rise_mm(self) -> float:
        """How far the camera stands above the emitter."""
        return self.middle_mm * math.tan(self.triangulation_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class Flaws:
    """What a real sensor adds. Everything random follows from `seed` and the profile's key."""

    cloud_width_mm: float = 0.0  # across the contour, 4 sigma; along the beam sigma/cos(incidence)
    speckle_points: int = 1  # neighbours that share a speckle: noise correlates as 1 - lag/points
    steepest_incidence_rad: float = math.radians(80.0)
    faintest: float = 0.02  # reflectance * cos(incidence) below which nothing comes back
    outlier_rate: float = 0.0  # of the measured points
    full_intensity: int = 1000  # counts, of a white surface met squarely
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0.0 < self.steepest_incidence_rad < math.radians(89.9):
            raise ValueError("flaws: steepest_incidence_rad must lie between 0 and 89.9 degrees")
        if not 0.0 <= self.outlier_rate <= 1.0 or self.cloud_width_mm < 0.0:
            raise ValueError(
                "flaws: outlier_rate is a share, 0 to 1; cloud_width_mm is not negative"
            )
        if self.speckle_points < 1 or not 0 <= self.full_intensity < 2**16:
            raise ValueError("flaws: speckle_points is at least 1; full_intensity fits uint16")
        if not 0 <= self.seed < 2**64:
            raise ValueError(f"flaws: seed {self.seed}; it is 0 to 2**64 - 1")


@dataclass(frozen=True, slots=True)
class SeedKey:
    """Which profile of a scan: with the seed, all that chance depends on."""

    slice_index: int
    profile_index: int

    def __post_init__(self) -> None:
        if min(self.slice_index, self.profile_index) < 0:
            raise ValueError(f"{self}: indices are not negative")


@dataclass(frozen=True, slots=True, eq=False)
class SimProfile:
    """One profile: the sensor's integers, and why a beam has none (then both counts are 0)."""

    counts: NDArray[np.int32]  # (n, 2); x fits int16, z fits uint16 and is 0 only where unseen
    reasons: ReasonArray  # (n,), of `Reason`
    intensity: NDArray[np.uint16]  # (n,)

    def __post_init__(self) -> None:
        object.__setattr__(self, "counts", frozen(self.counts, np.int32))
        object.__setattr__(self, "reasons", frozen(self.reasons, np.uint8))
        object.__setattr__(self, "intensity", frozen(self.intensity, np.uint16))

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Where the device delivers a value, true or false."""
        return self.reasons <= Reason.OUTLIER
