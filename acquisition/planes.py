r"""The plane of a slice in the part frame, and whether a station's sheet cuts such slices at all.

::

    ring       across the axis, at the sheet's height            `acquisition.frames.ring_plane`
    meridian   the sheet itself; x away from the axis, y up      x, y and normal are right-handed
    stripe     the sheet itself; the normal goes as the stage does
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kinematics, ring_plane, sensor_to_station, station_to_part
from acquisition.patterns import Meridian, SliceKind
from acquisition.plan import Plan
from acquisition.poses import Sweep

_MOST_ROLL_DEG = 30.0  # of a sheet that cuts rings; what it does to a ring, pitch does as well
_MOST_PITCH_DEG = 60.0
_UPRIGHT_DEG = 2.0  # a sheet that leans more against the axis cuts no meridians
_BESIDE_MM = 1.0  # nor does one that passes it by more
_ACROSS = 0.1  # sine of the least angle between the stage's way and a sheet that cuts stripes
_DOWNWARD = np.diag([1.0, -1.0, -1.0])  # a frame turned over around x: its normal points down
_CORNER = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])  # the sensor's own x, z


def slice_plane(
    sweep: Sweep, kinematics: Kinematics, kind: SliceKind = SliceKind.RING
) -> tuple[FloatArray, FloatArray]:
    """Origin (3,) and axes (3, 3: rows x, y, normal) of a slice's plane in the part frame.

    The normal points from slice to slice; where a growing stage position lowers the laser plane on
    the part, a ring's points down, and the plane's y is turned over with it.

    Raises
    ------
    ValueError
        A sweep without a pose has no place.
    """
    if kind is SliceKind.RING:
        origin_mm, axes = ring_plane(sweep, kinematics)
        return origin_mm, axes if kinematics.stage_sign > 0 else _DOWNWARD @ axes
    if not sweep.poses:
        raise ValueError(f"sweep {sweep.index}: no pose, so the place of its plane is unknown")
    stage_mm = float(np.mean([pose.stage_mm for pose in sweep.poses]))
    table_rad = float(np.mean([pose.table_rad for pose in sweep.poses]))
    sheet = _sheet(kinematics, stage_mm, table_rad)
    if kind is SliceKind.MERIDIAN:
        return _meridian(sheet)
    further_mm = _sheet(kinematics, stage_mm + 1.0, table_rad).sensor_mm
    return _stripe(sheet, further_mm - sheet.sensor_mm)


def check_sheet(plan: Plan, kinematics: Kinematics, name: str = "plan.toml") -> None:
    """Refuse a plan that the sheet, as it stands, cannot cut.

    Raises
    ------
    ValueError
        One line: the plan's table, what stands how, and what would do.
    """
    roll_deg, pitch_deg = kinematics.roll_deg, kinematics.pitch_deg
    sheet = _sheet(kinematics, 0.0, 0.0)
    step = _sheet(kinematics, 1.0, 0.0).sensor_mm - sheet.sensor_mm
    across = abs(float(sheet.normal @ step)) / float(np.linalg.norm(step))
    if plan.kind is SliceKind.RING:
        if abs(math.cos(math.radians(roll_deg))) < math.cos(math.radians(_MOST_ROLL_DEG)):
            raise ValueError(
                f"{name}: ring: the sheet is rolled by {roll_deg:g} deg, and rings need a level"
                " one; plan [meridian] or [stripe], or correct roll_deg"
            )
        if abs(pitch_deg) > _MOST_PITCH_DEG:
            raise ValueError(
                f"{name}: ring: the sheet is pitched by {pitch_deg:g} deg, and rings need less"
                f" than {_MOST_PITCH_DEG:g}; plan [stripe], or correct pitch_deg"
            )
    elif plan.meridian is not None:
        _check_meridian(plan.meridian, sheet, step, roll_deg, name)
    elif across < _ACROSS:
        raise ValueError(
            f"{name}: stripe: the stage moves along the sheet,"
            f" {math.degrees(math.asin(across)):.1f} deg off it, and not across; turn the sensor,"
            " or correct roll_deg and stage_x_mm, stage_y_mm, stage_z_mm"
        )


def _check_meridian(
    meridian: Meridian, sheet: _Sheet, step: FloatArray, roll_deg: float, name: str
) -> None:
    leaning_deg = math.degrees(math.asin(min(1.0, abs(float(sheet.normal[2])))))
    if leaning_deg > _UPRIGHT_DEG:
        raise ValueError(
            f"{name}: meridian: the sheet leans {leaning_deg:.3g} deg against the table's axis"
            f" (roll_deg {roll_deg:g}), and meridians need an upright one, within"
            f" {_UPRIGHT_DEG:g}; turn the sensor to roll_deg 90, or plan [ring]"
        )
    beside_mm = abs(float(sheet.normal @ (sheet.sensor_mm - sheet.axis_mm)))
    if beside_mm > _BESIDE_MM:
        raise ValueError(
            f"{name}: meridian: the sheet passes the table's axis by {beside_mm:.3g} mm, and may by"
            f" {_BESIDE_MM:g}; shift the sensor (side_mm), or calibrate it"
        )
    places_mm = meridian.positions_mm
    strayed_mm = abs(float(sheet.normal @ step)) * (places_mm[-1] - places_mm[0])
    if strayed_mm > _BESIDE_MM:
        raise ValueError(
            f"{name}: meridian.last_mm: the stage carries the sheet {strayed_mm:.3g} mm out of its"
            f" plane on the way, and may by {_BESIDE_MM:g}; lower it, or align the stage"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """Where the sheet stands on the part."""

    sensor_mm: FloatArray  # (3,) the sensor's x = z = 0
    normal: FloatArray  # (3,) unit
    axis_mm: FloatArray  # (3,) the place on the axis that is as high as the beam is there


def _sheet(kinematics: Kinematics, stage_mm: float, table_rad: float) -> _Sheet:
    stage, table = np.full(3, stage_mm), np.full(3, table_rad)
    placed = station_to_part(sensor_to_station(_CORNER, stage, kinematics), table, kinematics)
    sensor_mm, beam = placed[0], placed[2] - placed[0]
    normal = np.cross(placed[1] - placed[0], beam)
    ahead = float(np.hypot(*beam[:2]))
    rise = float(beam[2]) / ahead if ahead > _ACROSS else 0.0
    height_mm = float(sensor_mm[2]) + rise * float(np.hypot(*sensor_mm[:2]))
    return _Sheet(sensor_mm, normal / np.linalg.norm(normal), np.array([0.0, 0.0, height_mm]))


def _meridian(sheet: _Sheet) -> tuple[FloatArray, FloatArray]:
    """The half plane on the sensor's side; its origin is the place nearest to the axis."""
    normal, up = sheet.normal, np.array([0.0, 0.0, 1.0])
    y = up - (up @ normal) * normal
    y /= np.linalg.norm(y)
    x = np.cross(y, normal)
    if x @ sheet.sensor_mm < 0.0:
        x, normal = -x, -normal
    beside_mm = (sheet.sensor_mm - sheet.axis_mm) @ normal
    return sheet.axis_mm + beside_mm * normal, np.stack([x, y, normal])


def _stripe(sheet: _Sheet, step: FloatArray) -> tuple[FloatArray, FloatArray]:
    """All stripes have the same x and y, from the same place in their planes."""
    normal = sheet.normal if sheet.normal @ step > 0.0 else -sheet.normal
    # x is the horizontal direction in the sheet; of a level sheet any is, and the part's x taken.
    x = np.cross(np.array([0.0, 0.0, 1.0]), normal)
    x = x if np.linalg.norm(x) > _ACROSS else np.array([1.0, 0.0, 0.0])
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    return (sheet.sensor_mm @ normal) * normal, np.stack([x, np.cross(normal, x), normal])
