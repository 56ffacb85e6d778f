"""From the sensor's plane to the part, for ring plans with a nominal calibration.

The laser plane is horizontal and meets the table's axis; the stage lifts the sensor (or the plate)
and with it the plane. Drawn in docs/frames.md::

    seen from above                 seen from the side

         y                               z
         |                               |    ......... laser plane
         |  part                         |  part      <====[S] on the stage
         o ------ x  <====[S]            |            z = height_mm ± stage_mm
       table axis      |              ---o--- plate ------ x
             standoff_mm, side_mm

Station frame: origin on the table's axis at the plate, z up along the axis, x towards the sensor
(turned by azimuth_deg). Part frame: the station's, turned with the table. Angles count
counter-clockwise seen from above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Annotated

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.poses import Sweep
from acquisition.settings import Key


class Kind(Enum):
    """Where the kinematics come from."""

    NOMINAL = "nominal"  # measured with a ruler, written by hand


class Turning(Enum):
    """How the part turns, seen from above, when the table's angle grows."""

    COUNTER_CLOCKWISE = "counter-clockwise"
    CLOCKWISE = "clockwise"


class Lifting(Enum):
    """What the laser plane does on the part when the stage's position grows."""

    UP = "up"
    DOWN = "down"


class Side(Enum):
    """Where the sensor's x points, for somebody who looks along the beam from above it."""

    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True, kw_only=True)
class Kinematics:
    """How the axes and the sensor stand to each other."""

    kind: Annotated[Kind, Key("nominal: as written here; a calibration replaces it")]
    table_sense: Annotated[
        Turning,
        Key("counter-clockwise or clockwise: the part's turn for growing angles, seen from above"),
    ]
    stage_sense: Annotated[
        Lifting,
        Key("up or down: where the laser plane goes on the part for growing stage positions"),
    ]
    height_mm: Annotated[float, Key("height of the laser plane over the plate, stage at 0")]
    standoff_mm: Annotated[
        float, Key("from the sensor's z = 0 to the table's axis, along the beam")
    ]
    side_mm: Annotated[
        float, Key("how far the sensor's x = 0 passes the axis, to the left along the beam")
    ] = 0.0
    sensor_x: Annotated[
        Side, Key("left or right: where the sensor's x points, seen from above along the beam")
    ] = Side.RIGHT
    azimuth_deg: Annotated[
        float, Key("where the sensor stands around the axis, counter-clockwise from x")
    ] = 0.0

    @property
    def table_sign(self) -> int:
        """+1 when growing angles turn the part counter-clockwise."""
        return 1 if self.table_sense is Turning.COUNTER_CLOCKWISE else -1

    @property
    def stage_sign(self) -> int:
        """+1 when growing positions lift the plane."""
        return 1 if self.stage_sense is Lifting.UP else -1

    @property
    def x_sign(self) -> int:
        """+1 when the sensor's x points along the station's y (azimuth 0)."""
        return 1 if self.sensor_x is Side.RIGHT else -1


def sensor_to_station(
    points_mm: FloatArray, stage_mm: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points x, z of the laser plane (n, 2) taken at stage positions (n,) to the station, (n, 3).

    Without azimuth the beam runs along -x, so that its left is -y.
    """
    along = kinematics.standoff_mm - points_mm[:, 1]
    across = kinematics.x_sign * points_mm[:, 0] - kinematics.side_mm
    height = kinematics.height_mm + kinematics.stage_sign * np.asarray(stage_mm, np.float64)
    facing = np.column_stack([along, across, height])
    return _turned(facing, np.full(len(facing), math.radians(kinematics.azimuth_deg)))


def station_to_sensor(
    points_mm: FloatArray, kinematics: Kinematics
) -> tuple[FloatArray, FloatArray]:
    """Invert `sensor_to_station`: x, z of the laser plane (n, 2) and the stage positions (n,)."""
    facing = _turned(points_mm, np.full(len(points_mm), -math.radians(kinematics.azimuth_deg)))
    x_mm = kinematics.x_sign * (facing[:, 1] + kinematics.side_mm)
    z_mm = kinematics.standoff_mm - facing[:, 0]
    stage_mm = kinematics.stage_sign * (facing[:, 2] - kinematics.height_mm)
    return np.column_stack([x_mm, z_mm]), np.asarray(stage_mm)


def station_to_part(
    points_mm: FloatArray, table_rad: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points (n, 3) seen at table angles (n,) to the part: the table's turn undone."""
    return _turned(points_mm, -kinematics.table_sign * np.asarray(table_rad, np.float64))


def part_to_station(
    points_mm: FloatArray, table_rad: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points (n, 3) of the part to where they stand at table angles (n,)."""
    return _turned(points_mm, kinematics.table_sign * np.asarray(table_rad, np.float64))


def part_points(sweep: Sweep, kinematics: Kinematics) -> FloatArray:
    """Every measured point of a sweep in the part frame, (n, 3), in the order it was taken."""
    planar = [profile.points_mm for profile in sweep.profiles]
    counts = [len(each) for each in planar]
    stage_mm = np.repeat([pose.stage_mm for pose in sweep.poses], counts)
    table_rad = np.repeat([pose.table_rad for pose in sweep.poses], counts)
    stacked = np.concatenate([np.empty((0, 2)), *planar])
    station = sensor_to_station(stacked, stage_mm, kinematics)
    return station_to_part(station, table_rad, kinematics)


def ring_plane(sweep: Sweep, kinematics: Kinematics) -> tuple[FloatArray, FloatArray]:
    """Origin (3,) and axes (3, 3: rows x, y, normal) of a ring's plane in the part frame.

    Raises
    ------
    ValueError
        A sweep without a pose has no height.
    """
    if not sweep.poses:
        raise ValueError(f"sweep {sweep.index}: no pose, so the height of its plane is unknown")
    stage_mm = float(np.mean([pose.stage_mm for pose in sweep.poses]))
    height_mm = kinematics.height_mm + kinematics.stage_sign * stage_mm
    return np.array([0.0, 0.0, height_mm]), np.eye(3)


def _turned(points_mm: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Turn points (n, 3) by angles (n,) around z, counter-clockwise."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = points_mm.T
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y, z])
