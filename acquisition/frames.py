"""From the sensor's plane to the part: the station's whole kinematic chain, arrays in, arrays out.

Drawn, with every sign, in docs/frames.md; as NXtransformations in `acquisition.transformations`::

    seen from above                 seen from the side

         y                               z
         |                               |    ......... laser plane, pitched and rolled a little
         |  part                         |  part      <====[S] on the stage
         o ------ x  <====[S]            |            z = height_mm ± stage_mm
       table axis      |              ---o--- plate ------ x
             standoff_mm, side_mm

Station frame: z up along the table's axis, origin on it, x towards the sensor (turned by
azimuth_deg); so the axis's tilt and offset are told as the sensor's pose, the stage's direction as
a vector in this frame. Part frame: the station's, turned with the table. Angles count
counter-clockwise seen from above.

Two of the sensor's six degrees of freedom are a choice (gauge): a turn around the axis is
`azimuth_deg`, a shift along it `height_mm`. A calibration keeps what station.toml says of them.
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

_SHORTEST_MM = 1e-3  # true, of a reported mm
_FACING = 0.7  # mean of the cosine over the 80 degrees each way that a sensor sees of a round part
_IN_PLANE = 1e-6  # volume that three unit steps span


class Kind(Enum):
    """Where the kinematics come from."""

    NOMINAL = "nominal"  # measured with a ruler, written by hand
    CALIBRATED = "calibrated"  # solved from an artefact by `loftscan calibrate`
    SIMULATED = "simulated"  # as the simulator stands: known, there is nothing to calibrate


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
class SecondStage:
    """A rail that carries the sensor as well, set by hand and read on its scale."""

    position_mm: Annotated[float, Key("where its carriage stands, on its scale")]
    x_mm: Annotated[float, Key("the sensor's way outward for a mm of its scale")] = 1.0
    y_mm: Annotated[float, Key("likewise across, to the right of somebody at the sensor")] = 0.0
    z_mm: Annotated[float, Key("likewise up")] = 0.0

    def __post_init__(self) -> None:
        _must_point("second_stage", (self.x_mm, self.y_mm, self.z_mm))


@dataclass(frozen=True, slots=True, kw_only=True)
class Kinematics:
    """How the axes and the sensor stand to each other."""

    kind: Annotated[
        Kind, Key("nominal: by a ruler, a calibration replaces it; calibrated; simulated")
    ]
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
    pitch_deg: Annotated[
        float, Key("how steeply the beam rises on its way", at_least=-90.0, at_most=90.0)
    ] = 0.0
    roll_deg: Annotated[
        float, Key("the sheet's turn around the beam: its right goes up; 90: meridians")
    ] = 0.0
    table_deg_per_deg: Annotated[float, Key("true turn for a reported one", above=0.0)] = 1.0
    stage_x_mm: Annotated[
        float, Key("true way for a reported mm of the stage, outward; its sense is stage_sense")
    ] = 0.0
    stage_y_mm: Annotated[float, Key("likewise along the station's y")] = 0.0
    stage_z_mm: Annotated[float, Key("likewise along the axis")] = 1.0
    x_mm_per_mm: Annotated[float, Key("true for a reported mm of the sensor's x", above=0.0)] = 1.0
    z_mm_per_mm: Annotated[float, Key("true for a reported mm of the sensor's z", above=0.0)] = 1.0
    x_mm_per_z_mm: Annotated[float, Key("shear: added to x for each mm of the sensor's z")] = 0.0
    second_stage: Annotated[
        SecondStage | None, Key("a rail under the sensor, set by hand; absent: none")
    ] = None

    def __post_init__(self) -> None:
        _must_point("stage_z_mm", (self.stage_x_mm, self.stage_y_mm, self.stage_z_mm))

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


def sensor_axes(kinematics: Kinematics) -> FloatArray:
    """Steps in the station, before azimuth, of a mm of the sensor's x and of its z: (2, 3)."""
    rotation = sensor_rotation(kinematics)
    right = kinematics.x_sign * rotation[:, 1]
    along = kinematics.x_mm_per_z_mm * right - kinematics.z_mm_per_mm * rotation[:, 0]
    return np.stack([kinematics.x_mm_per_mm * right, along])


def sensor_rotation(kinematics: Kinematics) -> FloatArray:
    """Pitch after roll, (3, 3): takes -x to the beam and y to the sheet's right."""
    pitch, roll = math.radians(kinematics.pitch_deg), math.radians(kinematics.roll_deg)
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    pitched = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    rolled = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(pitched @ rolled)


def stage_step(kinematics: Kinematics) -> FloatArray:
    """Step of the sensor on the part, before azimuth, for a reported mm of the stage: (3,)."""
    step_mm = (kinematics.stage_x_mm, kinematics.stage_y_mm, kinematics.stage_z_mm)
    return kinematics.stage_sign * np.array(step_mm, np.float64)


def sensor_origin(kinematics: Kinematics) -> FloatArray:
    """Where the sensor's x = z = 0 stands at stage 0, before azimuth: (3,)."""
    origin_mm = np.array([kinematics.standoff_mm, -kinematics.side_mm, kinematics.height_mm])
    if (rail := kinematics.second_stage) is None:
        return origin_mm
    return origin_mm + rail.position_mm * np.array([rail.x_mm, rail.y_mm, rail.z_mm])


def sensor_to_station(
    points_mm: FloatArray, stage_mm: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points x, z of the laser plane (n, 2) taken at stage positions (n,) to the station, (n, 3).

    Without azimuth the beam runs along -x, so that its left is -y.
    """
    along_stage = np.asarray(stage_mm, np.float64)[:, None] * stage_step(kinematics)
    facing = sensor_origin(kinematics) + points_mm @ sensor_axes(kinematics) + along_stage
    return _turned(facing, np.full(len(facing), math.radians(kinematics.azimuth_deg)))


def station_to_sensor(
    points_mm: FloatArray, kinematics: Kinematics
) -> tuple[FloatArray, FloatArray]:
    """Invert `sensor_to_station`: x, z of the laser plane (n, 2) and the stage positions (n,).

    Raises
    ------
    ValueError
        The stage moves within the laser plane, so that no position puts a point into it.
    """
    facing = _turned(points_mm, np.full(len(points_mm), -math.radians(kinematics.azimuth_deg)))
    steps = np.vstack([sensor_axes(kinematics), stage_step(kinematics)])
    if abs(np.linalg.det(steps)) < _IN_PLANE:
        raise ValueError("stage_z_mm: the stage moves within the laser plane, not across it")
    found = np.linalg.solve(steps.T, (facing - sensor_origin(kinematics)).T).T
    return np.asarray(found[:, :2]), np.asarray(found[:, 2])


def onto_sheet(points_mm: FloatArray, stage_mm: FloatArray, kinematics: Kinematics) -> FloatArray:
    """Points (n, 3) in the station to the nearest x, z of the sheet at stage positions (n,)."""
    facing = _turned(points_mm, np.full(len(points_mm), -math.radians(kinematics.azimuth_deg)))
    along_stage = np.asarray(stage_mm, np.float64)[:, None] * stage_step(kinematics)
    arms = facing - sensor_origin(kinematics) - along_stage
    return np.asarray(arms @ np.linalg.pinv(sensor_axes(kinematics)))


def true_turn(kinematics: Kinematics) -> float:
    """Radians that the part turns, counter-clockwise, for a reported one."""
    return kinematics.table_sign * kinematics.table_deg_per_deg


def station_to_part(
    points_mm: FloatArray, table_rad: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points (n, 3) seen at table angles (n,) to the part: the table's turn undone."""
    turn_rad = true_turn(kinematics) * np.asarray(table_rad, np.float64)
    return _turned(points_mm, -turn_rad)


def part_to_station(
    points_mm: FloatArray, table_rad: FloatArray, kinematics: Kinematics
) -> FloatArray:
    """Points (n, 3) of the part to where they stand at table angles (n,)."""
    return _turned(points_mm, true_turn(kinematics) * np.asarray(table_rad, np.float64))


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

    A pitched sheet cuts a shallow cone out of a whole turn; its plane is then the one across the
    axis at the sheet's height where the points are, in the mean. That is told by their median
    radius, not by their mean height: planes must follow each other as the stage does, and of a ring
    at the part's top only the side that the sheet still meets has points.

    Raises
    ------
    ValueError
        A sweep without a pose has no height.
    """
    if not sweep.poses:
        raise ValueError(f"sweep {sweep.index}: no pose, so the height of its plane is unknown")
    stage_mm = float(np.mean([pose.stage_mm for pose in sweep.poses]))
    origin_mm = sensor_origin(kinematics) + stage_mm * stage_step(kinematics)
    rise = math.tan(math.radians(kinematics.pitch_deg))
    outward_mm = 0.0
    if rise and len(points_mm := part_points(sweep, kinematics)):
        outward_mm = _FACING * float(np.median(np.hypot(points_mm[:, 0], points_mm[:, 1])))
    height_mm = float(origin_mm[2] + rise * (origin_mm[0] - outward_mm))
    return np.array([0.0, 0.0, height_mm]), np.eye(3)


def _must_point(name: str, step_mm: tuple[float, float, float]) -> None:
    if math.hypot(*step_mm) < _SHORTEST_MM:
        raise ValueError(f"{name}: it moves nowhere; write 1 for the way it moves")


def _turned(points_mm: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Turn points (n, 3) by angles (n,) around z, counter-clockwise."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = points_mm.T
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y, z])
