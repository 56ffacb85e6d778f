"""The kinematic chain as NXtransformations say one: ordered steps, each with vector, value, unit.

NeXus NXtransformations (manual.nexusformat.org): a field is a translation or a rotation by its
value along or around `vector`, then shifted by `offset`; it depends on the step after which it is
done. Point p of the sensor, in homogeneous coordinates, comes to the part as

    table . azimuth . stage . [rail] . mount . pitch . roll . p        (the last one is done first)

A rotation's sense is the right hand's. `placed` works the chain out one step after the other; it is
the slow twin of `acquisition.frames`, and what a reader of an export would do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import Kinematics, sensor_origin, stage_step, true_turn

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_ROOT = "."


@dataclass(frozen=True, slots=True)
class Transformation:
    """One step; `depends_on` is the next one outward, "." the part itself."""

    name: str
    type: str  # "translation" or "rotation"
    vector: tuple[float, float, float]  # of length 1
    value: float
    units: str  # "mm" or "deg"
    depends_on: str
    offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def matrix(self) -> FloatArray:
        """Homogeneous, (4, 4)."""
        made = np.eye(4)
        vector = np.array(self.vector)
        if self.type == "translation":
            made[:3, 3] = self.value * vector
        else:
            made[:3, :3] = _rotation(vector, math.radians(self.value))
        made[:3, 3] += self.offset_mm
        return made


def transformations(
    kinematics: Kinematics, *, table_rad: float, stage_mm: float
) -> tuple[Transformation, ...]:
    """Give the chain at one pose, outermost first: from the part inward to the sensor's plane."""
    turn_deg = -math.degrees(true_turn(kinematics) * table_rad)
    step = stage_step(kinematics)
    length = float(np.linalg.norm(step))
    direction, origin_mm = _triple(step / length), _triple(sensor_origin(kinematics))
    steps = (
        ("table", "rotation", _Z, turn_deg, (0.0, 0.0, 0.0)),
        ("azimuth", "rotation", _Z, kinematics.azimuth_deg, (0.0, 0.0, 0.0)),
        ("stage", "translation", direction, length * stage_mm, (0.0, 0.0, 0.0)),
        ("mount", "translation", _X, 0.0, origin_mm),
        ("pitch", "rotation", _Y, kinematics.pitch_deg, (0.0, 0.0, 0.0)),
        ("roll", "rotation", _X, kinematics.roll_deg, (0.0, 0.0, 0.0)),
    )
    units = {"rotation": "deg", "translation": "mm"}
    outward = (_ROOT, *(name for name, *_ in steps))
    return tuple(
        Transformation(name, kind, vector, value, units[kind], before, offset_mm)
        for (name, kind, vector, value, offset_mm), before in zip(steps, outward, strict=False)
    )


def placed(
    points_mm: FloatArray, kinematics: Kinematics, chain: tuple[Transformation, ...]
) -> FloatArray:
    """Points x, z of the laser plane (n, 2) in the part frame, (n, 3), step by step."""
    x_mm, z_mm = points_mm.T
    across = kinematics.x_mm_per_mm * x_mm + kinematics.x_mm_per_z_mm * z_mm
    flat = np.zeros((len(points_mm), 4))
    flat[:, 0], flat[:, 1] = -kinematics.z_mm_per_mm * z_mm, kinematics.x_sign * across
    flat[:, 3] = 1.0
    for each in reversed(chain):
        flat = flat @ each.matrix().T
    return np.asarray(flat[:, :3])


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in values)
    return x, y, z


def _rotation(axis: FloatArray, angle_rad: float) -> FloatArray:
    """Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = math.sin(angle_rad), math.cos(angle_rad)
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))
