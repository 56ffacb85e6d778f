"""What the optics tests share: a naive twin, fine sensors, and the way back to the part."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sim import Mounting, Reason, Sensor, SimProfile
from sim.optics import OpticsSettings
from sim.parts import cylinder
from sim.solids import Part

# Half a micrometre a count, around a thin part on the axis.
FINE = Sensor(
    points=301,
    near_mm=205.0,
    far_mm=235.0,
    width_mm=26.0,
    x_mm_per_count=0.0005,
    z_mm_per_count=0.0005,
    z_offset_mm=204.0,
)


def shifted(part: Part, x_mm: float, y_mm: float) -> Part:
    return replace(part, vertices_mm=part.vertices_mm + np.array([x_mm, y_mm, 0.0]), radius_mm=None)


def peg(x_mm: float = 0.0, y_mm: float = 0.0) -> Part:
    """A cylinder of 10 mm, its facets within 0.02 um of the circle."""
    return shifted(cylinder(10.0, 20.0, levels=5), x_mm, y_mm)


def planar_mm(profile: SimProfile, sensor: Sensor) -> np.ndarray:
    """x, z (n, 2) of every beam in the sensor's plane; nan where nothing was seen."""
    scale = [sensor.x_mm_per_count, sensor.z_mm_per_count]
    points_mm = profile.counts * scale + [sensor.x_offset_mm, sensor.z_offset_mm]
    return np.where(profile.seen[:, None], points_mm, np.nan)


def turned(x, y, angle_rad):
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return cosine * x - sine * y, sine * x + cosine * y


def part_xy_mm(points_mm: np.ndarray, mounting: Mounting, table_rad: float) -> np.ndarray:
    """Where the sensor's points lie on the part, by docs/frames.md."""
    x = mounting.standoff_mm - points_mm[:, 1]
    y = mounting.hand.value * points_mm[:, 0] - mounting.side_mm
    x, y = turned(x, y, mounting.azimuth_rad)
    return np.column_stack(turned(x, y, -mounting.turning.value * table_rad))


def naive_profile(
    part: Part, settings: OpticsSettings, table_rad: float, stage_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Every beam against every face in float64, the part turned and the sensor standing.

    Returns z (n,) in mm and the reasons (n,) without flaws: Moeller and Trumbore 1997.
    """
    mounting, sensor, flaws = settings.mounting, settings.sensor, settings.flaws
    x, y, z = part.vertices_mm.T
    x, y = turned(x, y, mounting.turning.value * table_rad - mounting.azimuth_rad)
    corners = np.column_stack([x, y, z])[part.faces]
    height_mm = mounting.height_mm + mounting.lifting.value * stage_mm
    emitter = np.array([mounting.standoff_mm, -mounting.side_mm, height_mm])
    camera = emitter + np.array([0.0, 0.0, sensor.middle_mm * math.tan(sensor.triangulation_rad)])
    found_mm, reasons = np.full(sensor.points, np.nan), np.zeros(sensor.points, np.uint8)
    half = sensor.width_mm / 2 / sensor.middle_mm
    for beam, slope in enumerate(np.linspace(-half, half, sensor.points)):
        direction = np.array([-1.0, mounting.hand.value * slope, 0.0])
        ways = naive_hits(corners, emitter, direction)
        if not np.isfinite(ways).any():
            reasons[beam] = Reason.NO_HIT
            continue
        a, b, c = corners[ways.argmin()]
        normal = np.cross(b - a, c - a)
        squareness = abs(normal @ direction) / np.linalg.norm(normal) / np.linalg.norm(direction)
        found_mm[beam] = ways.min()
        start = emitter + direction * (ways.min() - 1e-5 * part.size_mm)
        if not sensor.near_mm <= ways.min() <= sensor.far_mm:
            reasons[beam] = Reason.OUT_OF_RANGE
        elif math.acos(min(squareness, 1.0)) > flaws.steepest_incidence_rad:
            reasons[beam] = Reason.GRAZING
        elif np.isfinite(naive_hits(corners, start, camera - start)).any():
            reasons[beam] = Reason.OCCLUDED
    return found_mm, reasons


def naive_hits(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """How far along the ray each face is met, inf where it is not."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, two)
    determinant = np.einsum("ij,ij->i", one, across)
    sound = np.abs(determinant) > 1e-14
    inverse = 1.0 / np.where(sound, determinant, 1.0)
    offset = origin - corners[:, 0]
    u = np.einsum("ij,ij->i", offset, across) * inverse
    lateral = np.cross(offset, one)
    v = lateral @ direction * inverse
    way = np.einsum("ij,ij->i", two, lateral) * inverse
    inside = sound & (u >= 0) & (v >= 0) & (u + v <= 1) & (way > 0)
    return np.where(inside, way, np.inf)
