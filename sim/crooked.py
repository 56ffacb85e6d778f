r"""A station that does not stand as its station.toml says, and optics that look at a part so.

Written from the physics; the program that is to find it out has its own formulas. In the base
frame the stage lifts straight up, but for `lift`; the table's axis leans and passes beside the
origin; the sheet of light is yawed, pitched and rolled about the sensor::

           axis                     part -> base:  pivot + lean . turn(k * reported) . P
            \    |                  base -> sheet: w ahead, x across, h over it
    sheet ---\---|------<=[S]       reported mm = true mm / scale
              \  | stage up
          pivot o|

Every pose has a sheet of its own, so that faces and boxes are moved before each profile and the
kernels of the level station see a level sheet at height 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from sim.arrays import FaceArray, FloatArray
from sim.beams import first_met
from sim.hierarchy import arrange
from sim.optics import OpticsSettings
from sim.readout import gauge, read_out
from sim.returns import returned
from sim.sensor import SeedKey, SimProfile
from sim.shadows import hide
from sim.sheet import cut
from sim.solids import Part
from sim.speckle import Speckle

_CLEARANCE = 1e-5  # of the part's size: where the ray to the camera starts before the surface
_SLACK = 1e-9  # of the part's size, around boxes
_LEVEL = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])


@dataclass(frozen=True, slots=True, kw_only=True)
class Crookedness:
    """By how much a station is off; the defaults are what a calibration must find out."""

    yaw_rad: float = math.radians(1.0)
    pitch_rad: float = math.radians(0.4)
    roll_rad: float = math.radians(-0.6)
    axis_tilt_rad: float = math.radians(1.0)
    axis_towards_rad: float = math.radians(50.0)
    pivot_mm: tuple[float, float] = (1.2, -1.6)  # 2 mm
    table_scale: float = 1.03
    lift: tuple[float, float, float] = (0.0, 0.0, 1.002)  # true mm for a reported one
    x_scale: float = 1.003
    z_scale: float = 0.998


class CrookedBench:
    """As `OpticalBench`, of a crooked station."""

    def __init__(self, part: Part, settings: OpticsSettings, crooked: Crookedness) -> None:
        sensor, flaws = settings.sensor, settings.flaws
        self._part, self._settings, self._crooked = part, settings, crooked
        self._slopes = np.linspace(-sensor.steepest, sensor.steepest, sensor.points)
        self._least = (flaws.faintest, math.cos(flaws.steepest_incidence_rad))
        self._clearance_mm = _CLEARANCE * part.size_mm
        self._slack_mm = _SLACK * part.size_mm
        tree = arrange(part)
        self._corners_mm, self._boxes_mm = tree.corners_mm, tree.boxes_mm.copy()
        self._moved_mm = np.empty_like(tree.corners_mm)
        self._spans_mm = np.empty((len(part.faces), 2))
        self._speckle = Speckle(flaws)
        own = gauge(sensor, flaws)
        self._gauge = own._replace(
            x_mm_per_count=own.x_mm_per_count * crooked.x_scale,
            z_mm_per_count=own.z_mm_per_count * crooked.z_scale,
            x_offset_mm=own.x_offset_mm * crooked.x_scale,
            z_offset_mm=own.z_offset_mm * crooked.z_scale,
        )
        self.profile(0.0, 0.0, SeedKey(0, 0))  # so that all is compiled before anybody waits

    @property
    def settings(self) -> OpticsSettings:
        """What it was made with."""
        return self._settings

    def profiles(
        self, table_rad: ArrayLike, stage_mm: float, seed_keys: Sequence[SeedKey]
    ) -> tuple[SimProfile, ...]:
        """Many profiles at one stage position."""
        angles_rad = np.asarray(table_rad, np.float64)
        return tuple(
            self.profile(float(angle), stage_mm, key)
            for angle, key in zip(angles_rad, seed_keys, strict=True)
        )

    def profile(self, table_rad: float, stage_mm: float, seed_key: SeedKey) -> SimProfile:
        """One profile with the table and the stage where they say they are."""
        turned, shift_mm = self.pose(table_rad, stage_mm)
        vertices_mm = self._part.vertices_mm @ turned.T + shift_mm
        _span(vertices_mm, self._part.faces, self._spans_mm)
        section = cut(vertices_mm, self._spans_mm, 0.0, self._part)
        met = first_met(section.ends_mm, _LEVEL, self._slopes)
        light = returned(
            (section.ends_mm, section.normals, section.reflectance),
            _LEVEL, self._slopes, self._least, met,
        )  # fmt: skip
        _move(self._corners_mm, turned, shift_mm, self._slack_mm, self._moved_mm, self._boxes_mm)
        hide(
            (self._boxes_mm, self._moved_mm), _LEVEL, self._slopes,
            (0.0, self._settings.sensor.rise_mm), light.z_mm - self._clearance_mm, light.reasons,
        )  # fmt: skip
        speckle = self._speckle.draw([seed_key], len(self._slopes))
        return read_out(light, self._slopes, speckle, self._gauge)[0]

    def pose(self, table_rad: float, stage_mm: float) -> tuple[FloatArray, FloatArray]:
        """Rotation (3, 3) and shift (3,) that take the part to (w, x, h) of the sheet."""
        mounting, off = self._settings.mounting, self._crooked
        turn = _about_z(mounting.turning.value * off.table_scale * table_rad)
        part_to_base = _leaning(off.axis_tilt_rad, off.axis_towards_rad) @ turn
        around = _about_z(mounting.azimuth_rad)
        sheet = around @ _about_z(off.yaw_rad) @ _about_y(off.pitch_rad) @ _about_x(off.roll_rad)
        start = np.array([mounting.standoff_mm, -mounting.side_mm, mounting.height_mm])
        lifted = mounting.lifting.value * stage_mm * np.array(off.lift)
        origin = around @ start + lifted
        rows = np.stack([-sheet[:, 0], mounting.hand.value * sheet[:, 1], sheet[:, 2]])
        return rows @ part_to_base, rows @ (np.array([*off.pivot_mm, 0.0]) - origin)


def _about_x(angle_rad: float) -> FloatArray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(angle_rad: float) -> FloatArray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_z(angle_rad: float) -> FloatArray:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _leaning(tilt_rad: float, towards_rad: float) -> FloatArray:
    """Lean z by an angle towards a direction, with no turn about itself."""
    return np.asarray(_about_z(towards_rad) @ _about_y(tilt_rad) @ _about_z(-towards_rad))


@njit(cache=True, nogil=True)
def _span(vertices_mm: FloatArray, faces: FaceArray, spans_mm: FloatArray) -> None:
    """Write lowest and highest z of every face."""
    for face in range(faces.shape[0]):
        a = vertices_mm[faces[face, 0], 2]
        b = vertices_mm[faces[face, 1], 2]
        c = vertices_mm[faces[face, 2], 2]
        spans_mm[face, 0], spans_mm[face, 1] = min(a, b, c), max(a, b, c)


@njit(cache=True, nogil=True)
def _move(
    corners_mm: FloatArray,
    turned: FloatArray,
    shift_mm: FloatArray,
    slack_mm: float,
    moved_mm: FloatArray,
    boxes_mm: FloatArray,
) -> None:
    """Write the moved corners, and the boxes of the tree around them, leaves first."""
    inner = boxes_mm.shape[0] // 2
    low, high = np.empty(3), np.empty(3)
    for node in range(boxes_mm.shape[0] - 1, -1, -1):
        low[:], high[:] = np.inf, -np.inf
        if node >= inner:
            leaf = node - inner
            for face in range(corners_mm.shape[1]):
                for corner in range(3):
                    for k in range(3):
                        value = shift_mm[k]
                        for j in range(3):
                            value += turned[k, j] * corners_mm[leaf, face, corner, j]
                        moved_mm[leaf, face, corner, k] = value
                        low[k] = min(low[k], value - slack_mm)
                        high[k] = max(high[k], value + slack_mm)
        else:
            for child in (2 * node + 1, 2 * node + 2):
                for k in range(2):
                    low[k] = min(low[k], boxes_mm[child, k] - boxes_mm[child, 2 + k])
                    high[k] = max(high[k], boxes_mm[child, k] + boxes_mm[child, 2 + k])
                low[2] = min(low[2], boxes_mm[child, 4])
                high[2] = max(high[2], boxes_mm[child, 5])
        for k in range(2):
            boxes_mm[node, k] = (low[k] + high[k]) / 2.0
            boxes_mm[node, 2 + k] = (high[k] - low[k]) / 2.0
        boxes_mm[node, 4], boxes_mm[node, 5] = low[2], high[2]
