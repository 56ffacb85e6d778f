"""The joint model: points of artefacts as the kinematics place them, and every derivative.

A point seen at x, z with the stage at s and the table at t comes to the part by (docs/frames.md)

    p = Rz(azimuth - k t) (o + x a + z b + s d)          a, b: `sensor_axes`; d: `stage_step`

and lies off its face by f(p). With the face's normal n, and m = n turned back to the sensor's
facing frame, the derivative by a parameter that moves a point by v there is m . v. The residual is
f / (sigma s): noise of sigma in the sensor's x and in its z has along the normal the standard
deviation sigma s, s^2 = (m . a)^2 + (m . b)^2. Because s counts in the true mm, its derivatives
by the sensor's scales are part of the residual's; without them noise alone makes a shrunken
station fit better (the attenuation of errors in variables).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.arrays import FloatArray
from acquisition.frames import (
    Kinematics,
    sensor_axes,
    sensor_origin,
    sensor_rotation,
    stage_step,
    true_turn,
)
from loftscan.calibrating.shapes import Shape, distances

IntArray = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
PARAMETERS = (
    *("standoff_mm", "side_mm", "pitch_deg", "roll_deg", "table_deg_per_deg"),
    *("stage_x_mm", "stage_y_mm", "stage_z_mm"),
    *("x_mm_per_mm", "z_mm_per_mm", "x_mm_per_z_mm"),
)
LENGTHS = ("stage_z_mm", "x_mm_per_mm", "z_mm_per_mm", "x_mm_per_z_mm")
_RUN_AWAY = {name: 3.0 if name in ("pitch_deg", "roll_deg") else 0.05
             for name in PARAMETERS} | {"standoff_mm": 5.0, "side_mm": 5.0}  # fmt: skip
_LEAST_IN_PLANE = 0.05  # a face that lies in the sheet has no distance in it


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Points of scans, as the sensor gave them; all arrays of n rows."""

    planar_mm: FloatArray  # (n, 2): x, z
    stage_mm: FloatArray
    table_rad: FloatArray
    scan: IntArray  # which scan
    profile: IntArray  # which profile, counted over all scans

    def __len__(self) -> int:
        return len(self.planar_mm)

    def of(self, rows: IntArray | np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> Seen:
        """Some of them."""
        return Seen(
            self.planar_mm[rows],
            self.stage_mm[rows],
            self.table_rad[rows],
            self.scan[rows],
            self.profile[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """One element of an artefact as it stands in one scan, and the points that are its."""

    name: str  # of the element, as in artefact.toml
    scan: int
    shape: Shape
    own: FloatArray  # where the solve begins
    rows: IntArray  # of `Seen`
    radius: float | None = None  # known; None: in `own`, or none
    radius_sd_mm: float = 0.0  # how well; 0: exactly


@dataclass(frozen=True, slots=True)
class Spacing:
    """A known distance of two spheres."""

    name: str
    one: str
    other: str
    distance_mm: float
    sd_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """What is solved: the kinematics of `start` in their free parameters, radii, and faces.

    The parameter vector is: `free` of the kinematics; a radius for each of `radii`, shared by all
    scans; each face's own without its radius.
    """

    start: Kinematics
    free: tuple[str, ...]
    seen: Seen
    faces: tuple[Face, ...]
    spacings: tuple[Spacing, ...]
    sigma_mm: FloatArray  # of each scan
    anchor: Kinematics | None = None  # where it stands but for `_RUN_AWAY`; None: at the start

    @property
    def radii(self) -> tuple[str, ...]:
        """Elements whose radius is solved."""
        names = [each.name for each in self.faces if _solves_radius(each)]
        return tuple(dict.fromkeys(names))

    def begin(self) -> FloatArray:
        """The parameter vector where the solve begins."""
        kinematic = [float(getattr(self.start, name)) for name in self.free]
        radii = [_radius_of(self.faces, name) for name in self.radii]
        own = [each.own[: _own_size(each)] for each in self.faces]
        return np.concatenate([np.array(kinematic + radii), *own])

    def kinematics(self, at: FloatArray) -> Kinematics:
        """The kinematics of a parameter vector."""
        values = dict(zip(self.free, (float(each) for each in at), strict=False))
        return replace(self.start, **values)  # type: ignore[arg-type] # all of them are numbers

    def own(self, at: FloatArray) -> list[FloatArray]:
        """Every face's own parameters, its radius among them."""
        found = []
        for face, columns, radius in zip(*self._columns(), strict=True):
            own = at[columns]
            if radius is not None:
                own = np.append(own, at[radius])
            elif _has_radius(face):
                own = np.append(own, face.radius or 0.0)
            found.append(own)
        return found

    def residuals(self, at: FloatArray) -> FloatArray:
        """In standard deviations: every point in the order of the faces, then what is known."""
        return self.evaluate(at)[0]

    def jacobian(self, at: FloatArray) -> FloatArray:
        """Of the residuals, (rows, parameters)."""
        return self.evaluate(at)[1]

    def rows(self) -> IntArray:
        """Which point of `seen` each of the first residuals belongs to."""
        return np.concatenate([np.empty(0, np.int64), *(each.rows for each in self.faces)])

    def told(self) -> tuple[str, ...]:
        """What the last of the residuals are of: certified radii, then spacings, by name."""
        radii = [face.name for face in self.faces if _solves_radius(face) and face.radius_sd_mm]
        spacings: list[str] = []
        for scan in sorted({each.scan for each in self.faces}):
            here = {face.name for face in self.faces if face.scan == scan}
            spacings += [s.name for s in self.spacings if {s.one, s.other} <= here]
        return (*(f"radius {name}" for name in dict.fromkeys(radii)),
                *(f"spacing {name}" for name in spacings))  # fmt: skip

    def columns(self) -> list[slice]:
        """Where each face's own parameters stand, but for its radius."""
        return self._columns()[1]

    def evaluate(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals and their Jacobian."""
        placing = placed_with(self.kinematics(at), self.seen)
        rows, jacobians = [], []
        for face, own, columns, radius in zip(
            self.faces, self.own(at), *self._columns()[1:], strict=True
        ):
            gap, normal, by_own = distances(face.shape, own, placing.part_mm[face.rows])
            spread, by_spread = placing.spread(normal, face.rows, self.free)
            weight = 1.0 / (self.sigma_mm[face.scan] * spread)
            whole = np.zeros((len(gap), len(at)))
            moved = placing.by_kinematics(normal, face.rows, self.free)
            whole[:, : len(self.free)] = moved - gap[:, None] * by_spread
            whole[:, columns] = by_own[:, : columns.stop - columns.start]
            if radius is not None:
                whole[:, radius] = by_own[:, -1]
            rows.append(gap * weight)
            jacobians.append(whole * weight[:, None])
        known, by_known = self._known(at)
        return np.concatenate([*rows, known]), np.concatenate([*jacobians, by_known])

    def _known(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Certified spacings and radii as observations of their own.

        And that no station stands far from its anchor, with `_RUN_AWAY` as standard deviations: it
        is far below what any point tells, and keeps what nothing tells from running away.
        """
        gaps: list[float] = []
        rows: list[FloatArray] = []
        for column, name in enumerate(self.free):
            row = np.zeros(len(at))
            row[column] = 1.0 / _RUN_AWAY[name]
            gaps.append(
                float(row[column]) * (at[column] - float(getattr(self.anchor or self.start, name)))
            )
            rows.append(row)
        faces, columns, radii = self._columns()
        told: set[str] = set()
        for face, radius in zip(faces, radii, strict=True):
            if radius is None or not face.radius_sd_mm or face.name in told:
                continue
            told.add(face.name)
            row = np.zeros(len(at))
            row[radius] = 1.0 / face.radius_sd_mm
            gaps.append((at[radius] - (face.radius or 0.0)) / face.radius_sd_mm)
            rows.append(row)
        for scan in sorted({each.scan for each in faces}):
            where = {f.name: c for f, c in zip(faces, columns, strict=True) if f.scan == scan}
            for each in self.spacings:
                if each.one not in where or each.other not in where:
                    continue
                one, other = where[each.one], where[each.other]
                way = at[one] - at[other]
                length = float(np.linalg.norm(way))
                row = np.zeros(len(at))
                row[one], row[other] = way / length / each.sd_mm, -way / length / each.sd_mm
                gaps.append((length - each.distance_mm) / each.sd_mm)
                rows.append(row)
        return np.array(gaps), np.array(rows).reshape(-1, len(at))

    def _columns(self) -> tuple[tuple[Face, ...], list[slice], list[int | None]]:
        """Columns of each face's own parameters, and that of its radius."""
        radii = self.radii
        first = len(self.free) + len(radii)
        columns, radius = [], []
        for face in self.faces:
            size = _own_size(face)
            columns.append(slice(first, first + size))
            solved = _solves_radius(face)
            radius.append(len(self.free) + radii.index(face.name) if solved else None)
            first += size
        return self.faces, columns, radius


@dataclass(frozen=True, slots=True, eq=False)
class Placing:
    """Points placed by some kinematics, and how each parameter moves them."""

    kinematics: Kinematics
    seen: Seen
    part_mm: FloatArray  # (n, 3)
    arm_mm: FloatArray  # (n, 3), from the sensor's origin, facing
    back_rad: FloatArray  # (n,), from the part to the facing frame

    def spread(
        self, normal: FloatArray, rows: IntArray, free: Sequence[str]
    ) -> tuple[FloatArray, FloatArray]:
        """Standard deviation along unit normals (m, 3) of noise of 1 in x and z, (m,).

        And its derivatives by the parameters, (m, k), over itself: where all lengths shrink the
        noise shrinks with them, and no fit becomes better by it. That a normal turns is left out;
        it changes nothing to first order.
        """
        facing = self._facing(normal, rows)
        axes = sensor_axes(self.kinematics)
        by_x, by_z = facing @ axes[0], facing @ axes[1]
        square = np.maximum(by_x**2 + by_z**2, _LEAST_IN_PLANE**2)
        rotation = sensor_rotation(self.kinematics)
        right = self.kinematics.x_sign * (facing @ rotation[:, 1])
        columns = {
            "x_mm_per_mm": by_x * right,
            "z_mm_per_mm": -by_z * (facing @ rotation[:, 0]),
            "x_mm_per_z_mm": by_z * right,
        }
        none = np.zeros(len(facing))
        change = [columns.get(name, none) / square for name in free]
        return np.sqrt(square), np.column_stack([*change, none])[:, : len(free)]

    def by_kinematics(self, normal: FloatArray, rows: IntArray, free: Sequence[str]) -> FloatArray:
        """Derivatives of the distances of some points by kinematic parameters, (m, k)."""
        if not free:
            return np.empty((len(rows), 0))
        m = self._facing(normal, rows)
        arm, part = self.arm_mm[rows], self.part_mm[rows]
        x_mm, z_mm = self.seen.planar_mm[rows].T
        rotation = sensor_rotation(self.kinematics)
        pitch = math.radians(self.kinematics.pitch_deg)
        pitched_x = np.array([math.cos(pitch), 0.0, -math.sin(pitch)])
        right = self.kinematics.x_sign * (m @ rotation[:, 1])
        lift = self.kinematics.stage_sign * self.seen.stage_mm[rows]
        turn = self.kinematics.table_sign * self.seen.table_rad[rows]
        columns = {
            "standoff_mm": m[:, 0],
            "side_mm": -m[:, 1],
            "pitch_deg": math.radians(1.0) * (m[:, 0] * arm[:, 2] - m[:, 2] * arm[:, 0]),
            "roll_deg": math.radians(1.0) * np.einsum("ij,ij->i", m, np.cross(pitched_x, arm)),
            "table_deg_per_deg": turn * (normal[:, 0] * part[:, 1] - normal[:, 1] * part[:, 0]),
            "stage_x_mm": lift * m[:, 0],
            "stage_y_mm": lift * m[:, 1],
            "stage_z_mm": lift * m[:, 2],
            "x_mm_per_mm": right * x_mm,
            "z_mm_per_mm": -(m @ rotation[:, 0]) * z_mm,
            "x_mm_per_z_mm": right * z_mm,
        }
        return np.column_stack([columns[name] for name in free])

    def beams(self) -> FloatArray:
        """Which way the light went to each point, in the part frame, (n, 3)."""
        beam = -sensor_rotation(self.kinematics)[:, 0]
        return turned(np.tile(beam, (len(self.seen), 1)), -self.back_rad)

    def _facing(self, normal: FloatArray, rows: IntArray) -> FloatArray:
        return turned(normal, self.back_rad[rows])


def placed_with(kinematics: Kinematics, seen: Seen) -> Placing:
    """Place points in the part frame."""
    arm_mm = seen.planar_mm @ sensor_axes(kinematics)
    lift_mm = seen.stage_mm[:, None] * stage_step(kinematics)
    turn_rad = true_turn(kinematics) * seen.table_rad - math.radians(kinematics.azimuth_deg)
    facing_mm = sensor_origin(kinematics) + arm_mm + lift_mm
    return Placing(kinematics, seen, turned(facing_mm, -turn_rad), arm_mm, turn_rad)


def turned(points: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Turn points (n, 3) by angles (n,) around z, counter-clockwise."""
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = points.T
    return np.column_stack([cosine * x - sine * y, sine * x + cosine * y, z])


def _has_radius(face: Face) -> bool:
    return face.shape.form.value in ("sphere", "cylinder")


def _solves_radius(face: Face) -> bool:
    return _has_radius(face) and (face.radius is None or face.radius_sd_mm > 0.0)


def _own_size(face: Face) -> int:
    return face.shape.size - int(_has_radius(face))


def _radius_of(faces: Sequence[Face], name: str) -> float:
    found = [each for each in faces if each.name == name]
    return float(np.mean([each.own[-1] if each.radius is None else each.radius for each in found]))
