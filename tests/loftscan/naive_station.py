"""A station that stands crookedly, ray by ray: the calibration's truth, written from the physics.

Nothing here is of the code under test. The base frame is the stage's: its z is up along a perfect
stage, x towards the sensor. The table's axis leans in it and passes beside the origin::

    base            sensor at (standoff, 0, height) + s * lift, turned by yaw, pitch, roll
                    table turns by k * reported around `axis` through `pivot`

A ray is turned back by the table's turn and met with the artefact as it stands at table angle 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def turn(axis: Array, angle_rad: float) -> Array:
    """Rotation matrix around a unit axis: e(e.v) + cos (v - e(e.v)) + sin e x v."""
    e = axis / np.linalg.norm(axis)
    columns = []
    for v in np.eye(3):
        along = e * (e @ v)
        columns.append(
            along + math.cos(angle_rad) * (v - along) + math.sin(angle_rad) * np.cross(e, v)
        )
    return np.array(columns).T


@dataclass(frozen=True)
class Ball:
    centre: tuple[float, float, float]
    radius: float

    def meet(self, origin: Array, way: Array) -> Array:
        """First parameter along each ray (n,), inf where it passes."""
        out = origin - np.array(self.centre)
        a, b = np.einsum("ij,ij->i", way, way), np.einsum("ij,ij->i", way, out)
        c = np.einsum("ij,ij->i", out, out) - self.radius**2
        root = b * b - a * c
        hit = np.full(len(way), np.inf)
        hit[root > 0] = ((-b - np.sqrt(np.maximum(root, 0))) / a)[root > 0]
        return hit


@dataclass(frozen=True)
class Plate:
    """A round plate seen from the side of its normal."""

    centre: tuple[float, float, float]
    normal: tuple[float, float, float]
    radius: float

    def meet(self, origin: Array, way: Array) -> Array:
        n = np.array(self.normal) / np.linalg.norm(self.normal)
        facing = way @ n
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = ((np.array(self.centre) - origin) @ n) / facing
        away = np.linalg.norm(origin + hit[:, None] * way - np.array(self.centre), axis=1)
        hit[~((facing < 0) & (away < self.radius))] = np.inf
        return hit


@dataclass(frozen=True)
class Rod:
    """A cylinder between two heights along its axis."""

    foot: tuple[float, float, float]
    axis: tuple[float, float, float]
    radius: float
    length: float

    def meet(self, origin: Array, way: Array) -> Array:
        e = np.array(self.axis) / np.linalg.norm(self.axis)
        out = origin - np.array(self.foot)
        way_off, out_off = way - np.outer(way @ e, e), out - np.outer(out @ e, e)
        a = np.einsum("ij,ij->i", way_off, way_off)
        b = np.einsum("ij,ij->i", way_off, out_off)
        c = np.einsum("ij,ij->i", out_off, out_off) - self.radius**2
        root = b * b - a * c
        hit = (-b - np.sqrt(np.maximum(root, 0))) / a
        along = (out + hit[:, None] * way) @ e
        hit[~((root > 0) & (along > 0) & (along < self.length))] = np.inf
        return hit


@dataclass(frozen=True)
class Block:
    """A convex solid of planes: rows of outward normal and distance from `centre`."""

    centre: tuple[float, float, float]
    planes: Array

    def meet(self, origin: Array, way: Array) -> Array:
        near, far = np.zeros(len(way)), np.full(len(way), np.inf)
        for *n, distance in self.planes:
            rate = way @ np.array(n)
            height = (origin - np.array(self.centre)) @ np.array(n) - distance
            with np.errstate(divide="ignore", invalid="ignore"):
                at = -height / rate
            near = np.where(rate < 0, np.maximum(near, at), near)
            far = np.where(rate > 0, np.minimum(far, at), far)
        return np.where((near < far) & (near > 0), near, np.inf)


@dataclass(frozen=True)
class Crooked:
    """How the station truly stands; the defaults are those that the calibration is held to."""

    standoff_mm: float = 225.0
    height_mm: float = -3.0
    yaw_deg: float = 1.0
    pitch_deg: float = 0.4
    roll_deg: float = -0.6
    axis_tilt_deg: float = 1.0
    axis_tilt_towards_deg: float = 50.0
    pivot_mm: tuple[float, float] = (1.2, -1.6)  # 2 mm off
    table_scale: float = 1.03
    table_sense: int = 1
    lift: tuple[float, float, float] = (0.0, 0.0, 1.002)
    x_scale: float = 1.003
    z_scale: float = 0.998
    shear: float = 0.001
    sigma_mm: float = 0.010
    beams: int = 200
    steepest: float = 60.0 / 225.0
    meridian: bool = False  # the sheet stands upright
    rng_seed: int = 0

    @property
    def axis(self) -> Array:
        tilt, to = math.radians(self.axis_tilt_deg), math.radians(self.axis_tilt_towards_deg)
        return np.array(
            [math.sin(tilt) * math.cos(to), math.sin(tilt) * math.sin(to), math.cos(tilt)]
        )

    @property
    def pivot(self) -> Array:
        return np.array([*self.pivot_mm, 0.0])

    @property
    def beam_and_right(self) -> tuple[Array, Array]:
        """Unit vectors of the sensor's z and x in the base frame."""
        beam, right, up = np.array([-1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, 1.0])
        if self.meridian:
            right = up
        for about, deg in (
            (np.array([1.0, 0, 0]), self.roll_deg),
            (np.array([0, 1.0, 0]), self.pitch_deg),
            (up, self.yaw_deg),
        ):
            by = turn(about, math.radians(deg))
            beam, right = by @ beam, by @ right
        return beam, right

    def origin(self, stage_mm: float) -> Array:
        start = np.array([self.standoff_mm, 0.0, self.height_mm])
        return start + stage_mm * np.array(self.lift)

    def profile(
        self, artefact: list[object], table_rad: float, stage_mm: float, rng: np.random.Generator
    ) -> tuple[Array, NDArray[np.int64]]:
        """x, z as the sensor reports them (n, 2), and which element each point is of (n,)."""
        beam, right = self.beam_and_right
        slopes = np.linspace(-self.steepest, self.steepest, self.beams)
        way = beam + slopes[:, None] * right
        back = turn(self.axis, -self.table_sense * self.table_scale * table_rad)
        origin = self.pivot + back @ (self.origin(stage_mm) - self.pivot)
        origins, way = np.broadcast_to(origin, way.shape), way @ back.T
        hits = np.array([each.meet(origins, way) for each in artefact])
        which = hits.argmin(axis=0)
        z_true = hits[which, np.arange(self.beams)]
        met = np.isfinite(z_true) & (z_true > 0)
        z = z_true[met] / self.z_scale
        x = (slopes[met] * z_true[met] - self.shear * z) / self.x_scale
        noise = rng.normal(0.0, self.sigma_mm, (2, len(z))) if self.sigma_mm else np.zeros((2, 1))
        return np.column_stack([x + noise[0], z + noise[1]]), which[met]

    def truth(self) -> dict[str, float]:
        """The parameters as docs/frames.md means them, seen from the axis."""
        beam, right = self.beam_and_right
        z = self.axis
        x = -(beam - (beam @ z) * z)
        x /= np.linalg.norm(x)
        y = np.cross(z, x)
        away = self.origin(0.0) - self.pivot
        lift = np.array(self.lift)
        pitch = math.asin(beam @ z)
        return {
            "standoff_mm": float(away @ x),
            "side_mm": float(-(away @ y)),
            "pitch_deg": math.degrees(pitch),
            "roll_deg": math.degrees(math.atan2(right @ z / math.cos(pitch), right @ y)),
            "table_deg_per_deg": self.table_scale,
            "stage_x_mm": float(lift @ x),
            "stage_y_mm": float(lift @ y),
            "stage_z_mm": float(lift @ z),
            "x_mm_per_mm": self.x_scale,
            "z_mm_per_mm": self.z_scale,
            "x_mm_per_z_mm": self.shear,
        }


@dataclass(frozen=True)
class Scanned:
    """A scan of an artefact: a row a point."""

    planar: Array
    stage: Array
    table: Array
    profile: NDArray[np.int64]
    element: NDArray[np.int64]
    extra: dict[str, float] = field(default_factory=dict)


def scanned(
    station: Crooked,
    artefact: list[object],
    stages_mm: Array,
    tables_rad: Array,
    rng: np.random.Generator,
) -> Scanned:
    rows: list[tuple[Array, NDArray[np.int64], float, float]] = []
    for stage_mm in stages_mm:
        for table_rad in tables_rad:
            points, which = station.profile(artefact, float(table_rad), float(stage_mm), rng)
            rows.append((points, which, float(stage_mm), float(table_rad)))
    counts = [len(each[0]) for each in rows]
    return Scanned(
        np.concatenate([each[0] for each in rows]),
        np.repeat([each[2] for each in rows], counts),
        np.repeat([each[3] for each in rows], counts),
        np.repeat(np.arange(len(rows)), counts),
        np.concatenate([each[1] for each in rows]),
    )
